"""Manifests of entries: what they may say, and what is refused with one line."""

import numpy as np
import pytest
from support.arena import MANIFEST, made_entry

from limslam_agent.arena.entry import read_entry
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.runs.policy_file import made_by_file
from limslam_env.interface import RobotSpec

GOOD = MANIFEST.format(name="Mine")


def test_the_shipped_entries_can_be_read(examples):
    found = {folder.name: read_entry(folder).manifest for folder in sorted(examples.iterdir())}
    assert {"random", "wall_follower", "frontier", "learned"} <= set(found)


def test_learned_explorers_that_share_nothing_have_a_map_each(examples):
    entry = read_entry(examples / "learned_alone")
    robots = made_by_file(entry.run, RobotSpec(), PolicyConfig(), robots=2, seed=0)
    for number, robot in enumerate(robots):
        robot.reset(np.array([float(number), 0.0, 0.0]))
        robot.act({"ranges": np.full(6, 0.5, dtype=np.float32), "wheels": np.zeros(2, dtype=np.float32)})
    first, second = (robot.mapper.belief for robot in robots)
    assert first.pose[0] == pytest.approx(0.0, abs=0.01)
    assert second.pose[0] == pytest.approx(1.0, abs=0.01)
    assert len(first.other_poses) == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "Mine"\n', "", "entry.toml: name: is missing"),
        ('kind = "shipped"', 'kind = "magic"', "shipped, python, command can be chosen, not 'magic'"),
        ('uses = "belief"', 'uses = "truth"', "belief, readings can be chosen, not 'truth'"),
        ('run = "random"', 'run = "tour"', "can be chosen, not 'tour'"),
        ("robots = 2", "speed = 2", "speed"),
        ('run = "random"', 'command = ["drive"]', "a command has the key command"),
        ('kind = "shipped"\nrun = "random"', 'kind = "python"\nrun = "../mine.py:Mine"', "not in the folder"),
        ('name = "Mine"', "name = ", "is not TOML"),
    ],
)
def test_a_manifest_that_cannot_be_used_is_refused_in_one_line(tmp_path, old, new, message):
    assert old in GOOD
    with pytest.raises(ValueError, match=r"(?s).*") as refusal:
        made_entry(tmp_path / "mine", GOOD.replace(old, new))
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("place", [".hidden", "__pycache__"])
def test_what_is_run_is_part_of_the_digest(tmp_path, place):
    mine = tmp_path / "mine"
    made_entry(mine, GOOD)
    (mine / place).mkdir()
    (mine / place / "mine.py").write_text("class Mine: pass")
    kinds = ('kind = "python"\nrun = "{}/mine.py:Mine"', 'kind = "command"\ncommand = ["{{python}}", "{}/mine.py"]')
    for kind in kinds:
        manifest = GOOD.replace('kind = "shipped"\nrun = "random"', kind.format(place)).replace("belief", "readings")
        (mine / "entry.toml").write_text(manifest)
        with pytest.raises(ValueError, match="not part of the entry's digest"):
            read_entry(mine)


def test_a_link_to_a_folder_is_refused(tmp_path):
    first = made_entry(tmp_path / "mine", GOOD)
    (tmp_path / "elsewhere").mkdir()
    (first.folder / "code").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="code: is a link to a folder"):
        read_entry(first.folder)


def test_the_digest_covers_all_files_but_what_python_compiled(tmp_path):
    first = made_entry(tmp_path / "mine", GOOD)
    (tmp_path / "mine" / "__pycache__").mkdir()
    (tmp_path / "mine" / "__pycache__" / "x.pyc").write_bytes(b"x")
    assert read_entry(first.folder).digest == first.digest
    (tmp_path / "mine" / "weights.bin").write_bytes(b"x")
    assert read_entry(first.folder).digest != first.digest
