"""Explorers on the maps of exploration papers: on one drawn by hand, and on recorded ones."""

import functools

import numpy as np
import pytest
from PIL import Image
from support.command_line import benchmarks
from support.data import data_folder

from benchmarks.peers import Entrant, Job, Sweep, measure
from limslam_env import RobotSpec, load_world


def run(path, beams, policy="frontier", **more):
    entrant = Entrant(policy, beams)
    job = Job(world=str(path), noise=more.pop("noise", 0.0), preset="graph", fault="it", **more)
    return measure({"it": entrant}, job).metrics


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """Two rooms with a corridor between them."""
    folder = tmp_path_factory.mktemp("maps") / "dungeon"
    folder.mkdir()
    pixels = np.full((160, 320), 127, dtype=np.uint8)
    for rows, columns in (((20, 140), (20, 120)), ((20, 140), (200, 300)), ((60, 100), (120, 200))):
        pixels[slice(*rows), slice(*columns)] = 195
    pixels[72:88, 60:76] = 208
    path = folder / "easy-img_1.png"
    Image.fromarray(pixels).save(path)
    return path


def test_a_scanner_at_a_place_sweeps_the_pixels_within_its_range(rooms):
    world = load_world(rooms, metres_per_pixel=0.02)
    free = np.array(Image.open(rooms)) != 127
    sweep = Sweep(free, 0.02, world, RobotSpec.lidar(720, 0.5))
    sweep.add(np.array([70 * 0.02, 80 * 0.02, 0.0]))
    assert sweep.share == pytest.approx(np.pi * 25.0**2 / free.sum(), rel=0.03)


@pytest.mark.parametrize(("beams", "least"), [(360, 0.99), (6, 0.9)])
def test_the_distance_is_that_of_a_drive_past_everything(rooms, beams, least):
    found = run(rooms, beams)
    assert found["seen"] > least
    assert found["coverage"] > 0.98
    assert 120 < found["cells_95_px"] <= found["end_px"] < 700
    assert found["reason"] == "explored: no frontier is left"
    assert found["touches"] == 0
    # A robot needs at least the time for its distance, at 0.2 m/s.
    assert found["time_s"] > found["end_px"] * 0.02 / 0.2


def test_a_run_that_does_not_end_has_no_end(rooms):
    found = run(rooms, 6, max_time=3.0)
    assert (found["end_px"], found["reason"]) == (None, None)
    assert "cells_99_px" not in found


def test_two_robots_share_the_way(rooms):
    one, two = (run(rooms, 36, robots=robots) for robots in (1, 2))
    assert two["coverage"] > 0.99
    assert two["time_s"] < one["time_s"]


def test_with_noise_the_estimator_drives(rooms):
    found = run(rooms, 6, noise=0.02, max_time=20.0)
    assert 0.05 < found["coverage"] < 0.9


def test_the_command_prints_a_table_and_goes_on(rooms, tmp_path):
    arguments = ("peers", "--data", rooms.parent, "--beams", "6", "--out", tmp_path / "out")
    code, out, error = benchmarks(*arguments)
    assert (code, error) == (0, "")
    *table, _, summary = out.splitlines()
    assert table[-1].startswith("| frontier, 6 beams, 0 cm | easy | 1 | ")
    assert table[-1].endswith(" | 1 of 1 | 0 |")
    assert summary == f"peers: 1 runs, 0 of them before, 0 failed; {tmp_path / 'out'}"
    again = benchmarks(*arguments)[1]
    assert "1 runs, 1 of them before" in again
    code, _, error = benchmarks("peers", "--data", rooms.parent, "--maps", "hard*")
    assert code == 2
    assert error.endswith("no maps there that are called hard* (.png)\n")


@pytest.mark.parametrize(
    ("levels", "reason"),
    [
        ((127, 195), "a map of ARiADNE or DARE has walls (level 127), floor (195) and a block "),
        ((10, 60, 195, 250), "a map of ARiADNE or DARE has walls (level 127), floor (195) and a "),
        ((195,), "no cell is occupied"),
        ((), "cannot be read: it is no PNG file"),
    ],
)
def test_a_picture_that_is_no_such_map_is_refused_before_the_start(tmp_path, levels, reason):
    path = tmp_path / "easy-img_1.png"
    path.write_text("A text.")
    if levels:
        Image.fromarray(np.resize(np.array(levels, np.uint8), (3, 200)).repeat(60, 0)).save(path)
    code, out, error = benchmarks("peers", "--data", tmp_path, "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert error.startswith(f"benchmarks: {path}: {reason}")
    assert error.count("\n") == 1


def test_the_folder_says_how_large_the_pixels_are(rooms, monkeypatch):
    folder = rooms.parent.parent / "dare"
    folder.mkdir()
    (folder / rooms.name).write_bytes(rooms.read_bytes())
    monkeypatch.chdir(folder)
    assert run(rooms.name, 6, max_time=0.1)["coverage"] < run(rooms, 6, max_time=0.1)["coverage"]


MAPS = ("dungeon/complex-img_4", "dungeon/easy-img_9", "dare/7")


@functools.cache
def recorded(name, beams):
    return run(data_folder() / "peers" / f"{name}.png", beams)


@pytest.mark.parametrize("beams", [6, 72, 360])
@pytest.mark.parametrize("name", MAPS)
def test_explorers_end_on_recorded_maps(name, beams):
    found = recorded(name, beams)
    assert found["reason"] is not None, "the explorer has not ended"
    assert found["coverage"] > 0.98
    assert found["touches"] == 0
