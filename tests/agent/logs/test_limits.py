"""Bounds of the readers: beams, regular files only, and messages of one short line."""

import os
import zipfile

import numpy as np
import pytest
import yaml
from support.bags import odometry, scan, write_bag
from support.command_line import limslam
from support.data import own_log, refusal

from limslam_agent import read_log
from limslam_agent.policies.learned.network import load_network
from limslam_env.messages import LONGEST_MESSAGE, described, one_line, printable


def test_too_many_columns_are_refused_and_only_chosen_columns_are_stored(write):
    names = [f",r_{degrees / 100}" for degrees in range(4097)]
    path = write("t,x,y,theta", *names, "\n0,0,0,0", ",1" * 4097, "\n")
    assert "4101 columns, more than 4100" in refusal(path)
    path = write("t,x,y,theta", *names[:-1], "\n0,0,0,0", ",1" * 4096, "\n")
    assert read_log(path, (3.0, 5.0)).ranges.shape == (1, 2)


def test_a_header_that_promises_more_than_the_file_holds_is_refused_before_memory_is_reserved(
    tmp_path,
):
    path = tmp_path / "log.npz"
    np.savez_compressed(path, **own_log())
    with zipfile.ZipFile(path) as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
    held["time.npy"] = held["time.npy"].replace(b"(4,), }", b"(4000000000,), }"[:16])
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in held.items():
            archive.writestr(name, content)
    assert "damaged" in refusal(path)


@pytest.mark.parametrize("name", ["some.csv", "log.npz", "some.bag"])
def test_a_pipe_is_refused_without_being_opened(tmp_path, name):
    path = tmp_path / name
    os.mkfifo(path)
    assert "not a regular file" in refusal(path)
    for arguments in (("replay", path), ("run", "--config", path), ("replay", "--config", path)):
        finished = limslam(*arguments, cwd=tmp_path)
        assert finished.returncode == 2
        assert "not a regular file" in finished.stderr
    with pytest.raises(ValueError, match="not a regular file"):
        load_network(path)


@pytest.mark.parametrize("count", [[], None])
def test_a_bag_whose_list_of_topics_is_damaged_is_refused_in_one_line(tmp_path, count):
    bag = write_bag(tmp_path, [odometry(1, 0.0), scan(1, [1.0, 2.0])], "sqlite")
    about = yaml.safe_load((bag / "metadata.yaml").read_text())
    about["rosbag2_bagfile_information"]["topics_with_message_count"][0]["message_count"] = count
    (bag / "metadata.yaml").write_text(yaml.safe_dump(about))
    assert "damaged" in refusal(bag)


def test_messages_are_short_printable_and_on_one_line(tmp_path):
    name = "\x1b[31mred\x07" + "x" * 200 + ".csv"
    finished = limslam("replay", tmp_path / name, "--topics", "y" * 20_000, cwd=tmp_path)
    assert finished.returncode == 2
    assert "\\x1b[31mred\\x07" in finished.stderr
    assert finished.stderr.strip().isprintable()
    long = limslam(
        "replay", tmp_path / "no.csv", "--beams", ",".join(["1"] * 9000 + ["b"]), cwd=tmp_path
    ).stderr
    assert len(long) < LONGEST_MESSAGE + 20
    assert long.startswith("limslam: --beams")
    assert long.rstrip().endswith("is not a list of numbers like 1,2.5")


def test_text_for_messages():
    assert printable("a\x1b\x9b\udc80é") == "a\\x1b\\x9b\\udc80é"
    assert one_line("a\n\tb  c") == "a b c"
    assert len(one_line("x" * 10**6)) == LONGEST_MESSAGE
    assert one_line("head " + "x" * 10**6 + " tail").startswith("head x")
    assert one_line("head " + "x" * 10**6 + " tail").endswith("x tail")
    assert described(10**6000) == "a very large int"
    assert len(described(["x"] * 1000)) == 200
