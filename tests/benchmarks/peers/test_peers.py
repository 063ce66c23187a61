"""Maps of other work: how they are read, what 720 rays see, explorations on stand-ins, rows, table and refusals."""

import math
from collections.abc import Generator, Sequence

import numpy as np
import pytest
from PIL import Image
from support.command_line import call

from benchmarks.__main__ import main
from benchmarks.peers.comparison import PeersConfig, compare_peers
from benchmarks.peers.explore import MOST_MOVES, explore_as_point
from benchmarks.peers.lidar import RANGE, RAYS, LidarMap, ray_pixels
from benchmarks.peers.maps import PeerMap, read_map, read_maps, start_with_body, world_of
from benchmarks.peers.stand_ins import TILE, stand_in, write_stand_ins
from benchmarks.peers.table import peers_table, read_published
from benchmarks.suite.engines import Result, Work, stages
from benchmarks.suite.jobs import Job
from benchmarks.suite.store import Row
from limslam_env.geometry.segment import distances
from limslam_env.worlds.regions import start_region
from limslam_env.worlds.world import WorldError

SCALE = 0.05


class Here:
    """An engine that runs jobs in this process, and keeps what it was asked for."""

    def __init__(self) -> None:
        self.asked = list[str]()

    def run(self, jobs: Sequence[Job], work: Work) -> Generator[tuple[Job, Result]]:
        for job in jobs:
            self.asked.append(job.policy)
            *_, result = stages(work, job)
            yield job, result


def room(rows=40, columns=60, wall=10) -> PeerMap:
    """A room, with a wall around it that is ``wall`` pixels thick."""
    free = np.zeros((rows, columns), dtype=bool)
    free[wall:-wall, wall:-wall] = True
    return PeerMap("room.png", free, (rows // 2, columns // 2))


def saved(path, grey, mode="RGB"):
    levels = np.asarray(grey, dtype=np.uint8)
    Image.fromarray(np.repeat(levels[..., None], 3, axis=2) if mode == "RGB" else levels).save(path)
    return path


def test_a_map_is_read_as_the_peers_read_it(tmp_path):
    grey = stand_in(3, 12, 10)
    starts = np.argwhere(grey == 208)
    found = read_map(saved(tmp_path / "map.png", grey))
    assert found.start == tuple(starts[127])
    np.testing.assert_array_equal(found.free, grey > 150)
    # With one channel, their reader gets 256 minus the level; both kinds are the same map.
    for levels in (grey, 256 - grey.astype(int)):
        again = read_map(saved(tmp_path / "map.png", levels, "L"))
        assert again.digest == found.digest


def test_maps_come_in_the_order_of_the_peers_test(tmp_path):
    write_stand_ins(tmp_path / "maps", 3, 12, 10)
    write_stand_ins(tmp_path / "maps", 3, 12, 10)  # the same command may be given again
    assert [found.name for found in read_maps(tmp_path / "maps", 2)] == ["stand_in_002.png", "stand_in_001.png"]


def test_the_rays_are_straight_and_touch_at_their_sides():
    offsets, counts = ray_pixels()
    assert len(offsets) == RAYS
    for ray in (0, 45, 90, 137, 360, 719):
        pixels, angle = offsets[ray, : counts[ray]], 2.0 * math.pi * ray / RAYS
        assert (np.abs(np.diff(pixels, axis=0)).sum(axis=1) == 1).all()
        aside = pixels[:, 1] * math.sin(angle) - pixels[:, 0] * math.cos(angle)
        assert np.abs(aside).max() < 1.5
        assert math.hypot(*pixels[-1]) == pytest.approx(RANGE, abs=2.0)


def test_rays_see_a_room_and_nine_pixels_of_its_walls():
    found = room(wall=12)
    seen = LidarMap(found, SCALE)
    assert (seen.explored, seen.is_done) == (0.0, False)
    seen.scan(found.place(found.start, SCALE))
    assert (seen.unseen, seen.explored, seen.is_done) == (0, 1.0, True)
    values = seen.view.values
    # Straight down the middle: three pixels of wall are too deep to be seen, then 4 cells of wall, then the room.
    column = values[:, found.start[1] // 2]
    assert column[:8].tolist() == [0, -1, -1, -1, -1, -1, 1, 1]
    assert seen.view.cell == 2 * SCALE


def test_rays_end_at_walls_and_at_their_range():
    found = room(40, 300)
    found.free[:, 120] = False
    found.free[5:15, 118:123] = True
    seen = LidarMap(found, SCALE)
    seen.scan(found.place((20, 20), SCALE))
    known = seen.view.values[len(seen.view.values) // 2]
    assert known[55] == 0  # beyond the range
    seen.scan(found.place((20, 110), SCALE))
    known = seen.view.values[len(seen.view.values) // 2]
    assert (known[59], known[60], known[62]) == (1, -1, 0)  # the wall at pixel 120, and nothing behind it


def test_a_map_becomes_a_world_where_the_body_fits():
    free = np.zeros((60, 90), dtype=bool)
    free[10:50, 10:80] = True
    free[10:30:2, 10] = False  # a jagged wall
    world = world_of(PeerMap("jagged.png", free, (11, 11)), SCALE, 0.10)
    world.check(0.10)
    assert len(world.edges) < 12
    np.testing.assert_allclose(world.starts[0, :2], [11 * SCALE, 49 * SCALE], atol=5 * SCALE)
    assert distances(world.starts[:, :2], world.edges).min() >= 0.10
    with pytest.raises(WorldError, match="fits nowhere"):
        start_with_body(PeerMap("narrow.png", free[:13], (10, 40)), 2.0)


def test_solid_ground_is_no_floor():
    found = room(100, 200, wall=30)
    found.free[45:55, 80:90] = False  # a pillar
    found.free[5:15, 5:25] = True  # a room that cannot be reached
    world = world_of(found, SCALE, 0.10)
    assert (len(world.walls), [len(polygon) for polygon in world.obstacles]) == (4, [4])
    region = start_region(world, 0.10)
    assert region.share == 1.0
    assert region.floor == pytest.approx((40 * 140 - 10 * 10) * SCALE**2, rel=0.05)


def test_a_point_explores_a_stand_in_until_the_peers_call_it_done(tmp_path):
    found = read_map(saved(tmp_path / "map.png", stand_in(1, 20, 15)))
    done = explore_as_point(found, SCALE)
    assert done.seen.is_done
    assert done.decisions < MOST_MOVES
    moves = np.hypot(*np.diff(done.path, axis=0).T) / SCALE
    assert moves.max() < 480 / 29 + 1.5
    pixels = [found.pixel(place, SCALE) for place in done.path]
    assert all(found.free[pixel] for pixel in pixels)


@pytest.fixture
def maps(tmp_path):
    folder = tmp_path / "maps"
    folder.mkdir()
    grey = np.full((6 * TILE, 8 * TILE), 127)
    grey[TILE:-TILE, TILE:-TILE] = 194
    grey[2 * TILE : 3 * TILE, 2 * TILE : 3 * TILE] = 208
    saved(folder / "stand_in_000.png", grey)
    return folder


def test_rows_are_kept_and_the_table_says_what_is_alike(maps, tmp_path):
    part = PeersConfig(maps, lidar=("point", "frontier_fast"), six=("frontier_fast",), max_time=2.0)
    engine = Here()
    summary, text = compare_peers(part, tmp_path / "out", engine)
    assert (summary.done, summary.failures) == (3, ())
    lines = text.splitlines()
    assert "nearest frontier, a point | 720 rays, true pose | 1 | 1 | 0 ± 0 |" in lines[2]
    assert "| true pose | b |" in lines[3]
    assert "six beams, unknown pose | 1 | 0 |" in lines[4]
    assert "Cao et al. 2024 | published" in lines[5]
    assert "stand-ins, not the maps of the peers" in text
    again = Here()
    assert compare_peers(part, tmp_path / "out", again)[1] == text
    assert (engine.asked, again.asked) == (["point", "frontier_fast", "frontier_fast"], [])


def test_failed_runs_are_counted_and_left_out_of_the_means():
    rows = [
        Row("a.png", 0.0, 1, "lidar", "point", None, 0, 0, {"path_px": 100.0, "is_done": 1, "explored": 1.0}),
        Row("b.png", 0.0, 1, "lidar", "point", None, 0, 0, {"path_px": 300.0, "is_done": 0, "explored": 0.5}),
        Row("c.png", 0.0, 1, "lidar", "point", None, 0, 0, {}, error="a reason"),
    ]
    text = peers_table(rows)
    assert "| 2 (1 failed) | 1 | 200 ± 100 |  | 0.750 ± 0.250 | true pose | a |" in text
    assert "stand-ins" not in text


def test_published_figures_that_are_none_are_refused(tmp_path):
    path = tmp_path / "figures.toml"
    path.write_text('[[figure]]\nname = "A"\n', encoding="utf-8")
    with pytest.raises(ValueError, match="not a file of published figures"):
        read_published(path)


@pytest.mark.parametrize(
    ("grey", "message"),
    [
        (None, "it is no PNG file"),
        (np.full((40, 40), 194), "no start: 0 pixels have the grey level 208, and 128 are needed"),
        (np.full((40, 40), 208), "no walls"),
    ],
)
def test_what_is_no_map_is_refused_in_one_line(tmp_path, grey, message):
    folder = tmp_path / "maps"
    folder.mkdir()
    if grey is None:
        (folder / "bad.png").write_bytes(b"text")
    else:
        saved(folder / "bad.png", grey)
    done = call(main, "peers", "--maps", folder, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "bad.png" in done.stderr
    assert message in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "holds no .png file"),
        (["--maps", "nowhere"], "no such folder of maps"),
        (["--six", "dreamer"], "--six: no explorer is called 'dreamer'"),
        (["--lidar", "", "--six", ""], "no explorer is named"),
        (["--lidar", "point,point"], "each explorer is named once"),
        (["--scale", "0"], "a pixel has a side"),
        (["--count", "0"], "--count"),
        (["--noise", "nan"], "--noise"),
        (["--max-time", "0"], "--max-time"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(tmp_path, arguments, message):
    (tmp_path / "empty").mkdir()
    done = call(main, "peers", "--maps", tmp_path / "empty", "--out", tmp_path / "out", *arguments)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert message in done.stderr
    assert not (tmp_path / "out").exists()


def test_stand_ins_are_not_written_beside_other_files(tmp_path):
    kept = tmp_path / "mine.txt"
    kept.write_text("mine", encoding="utf-8")
    done = call(main, "peers", "--maps", tmp_path, "--stand-ins", 2, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
