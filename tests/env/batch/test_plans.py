"""Floor plans of a batch: kept on disk, and little memory."""

import os

import numpy as np
import pytest

from limslam_env import FloorPlanConfig, RobotSpec, World
from limslam_env.batch import places, plan_cache
from limslam_env.batch.places import Places
from limslam_env.batch.plan_cache import FOLDER, PlanCache, cache_folder
from limslam_env.batch.progress import work_through
from limslam_env.batch.worlds import Site, prepare
from limslam_env.interface import beams_on_rim
from limslam_env.worlds.generation.floor_plans import floor_plan
from limslam_env.worlds.world import WorldError

ROBOT = RobotSpec()
LARGE = RobotSpec(radius=0.17, beams=beams_on_rim((0.0, 70.0, -70.0), 0.17, max_range=1.2))
SMALL = FloorPlanConfig(width=(3.0, 4.0), height=3.0)
WIDE = FloorPlanConfig(width=14.0, height=9.0, door_width=(0.6, 0.8))


def plan(config: FloorPlanConfig, seed: int, robot: RobotSpec = ROBOT) -> World:
    return floor_plan(config, np.random.default_rng(seed), robot.radius)


def assert_same(one: Site, other: Site) -> None:
    for mine, their in (
        (one.tiles, other.tiles), (one.area, other.area), (one.walls.edges, other.walls.edges),
        (one.walls.cell_starts, other.walls.cell_starts), (one.walls.cell_edges, other.walls.cell_edges),
        (one.walls.grid, other.walls.grid), (one.starts.runs, other.starts.runs),
        (one.starts.space, other.starts.space), (one.starts.given, other.starts.given),
    ):  # fmt: skip
        np.testing.assert_array_equal(mine, their)
        assert mine.dtype == their.dtype
    assert (one.shape, one.reach, one.starts.count) == (other.shape, other.reach, other.starts.count)
    assert (one.near is None) == (other.near is None)


def test_where_no_robot_fits_is_refused():
    corners = np.array([[0.0, 0.0], [0.15, 0.0], [0.15, 2.0], [0.0, 2.0]])
    walls = np.hstack((corners, np.roll(corners, -1, axis=0)))
    with pytest.raises(WorldError, match="no room"):
        prepare(World("slit", (0.15, 2.0), walls), ROBOT, 1)


@pytest.fixture
def cache(tmp_path) -> PlanCache:
    return PlanCache(SMALL, ROBOT, tmp_path / "plans")


def test_what_is_kept_is_what_is_read(cache):
    site = prepare(plan(SMALL, 7), ROBOT, 1)
    assert cache.read(7) is None
    cache.write(7, site)
    assert_same(cache.read(7), site)
    assert [path.name for path in cache.path(7).parent.iterdir()] == [cache.path(7).name]
    if os.name == "posix":
        assert cache.path(7).stat().st_mode & 0o777 == 0o644, "other users read it, too"


def test_an_entry_belongs_to_one_plan_one_robot_and_one_version(cache, tmp_path, monkeypatch):
    folder = tmp_path / "plans"
    others = [cache.path(8), PlanCache(WIDE, ROBOT, folder).path(7), PlanCache(SMALL, LARGE, folder).path(7)]
    monkeypatch.setattr(plan_cache, "source_stamp", lambda *_: "changed")
    others.append(PlanCache(SMALL, ROBOT, folder).path(7))
    assert len({cache.path(7), *others}) == 5


@pytest.mark.parametrize("place", [0, 3, 200, 2000])
def test_a_damaged_entry_counts_as_missing(cache, place):
    cache.write(7, prepare(plan(SMALL, 7), ROBOT, 1))
    data = bytearray(cache.path(7).read_bytes())
    data[place] ^= 1
    cache.path(7).write_bytes(data)
    assert cache.read(7) is None


@pytest.mark.parametrize("length", [0, 50, 500])
def test_an_entry_that_is_cut_off_counts_as_missing(cache, length):
    cache.write(7, prepare(plan(SMALL, 7), ROBOT, 1))
    cache.path(7).write_bytes(cache.path(7).read_bytes()[:length])
    assert cache.read(7) is None


def test_a_cache_that_cannot_be_used_does_no_harm(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder", encoding="utf-8")
    for folder in (tmp_path / "file", None):
        cache = PlanCache(SMALL, ROBOT, folder)
        cache.write(7, prepare(plan(SMALL, 7), ROBOT, 1))
        assert cache.read(7) is None
        cache.prune(0)
    entry = PlanCache(SMALL, ROBOT, tmp_path).path(7)
    entry.mkdir()
    monkeypatch.setenv(FOLDER, str(tmp_path))
    assert len(Places(SMALL, ROBOT, 1, 1, [7]).sites) == 1
    assert entry.is_dir()


def test_the_oldest_entries_make_room(cache):
    site = prepare(plan(SMALL, 7), ROBOT, 1)
    for seed in range(4):
        cache.write(seed, site)
        os.utime(cache.path(seed), (1000.0 + seed, 1000.0 + seed))
    cache.prune(2 * cache.path(0).stat().st_size)
    assert [seed for seed in range(4) if cache.read(seed)] == [2, 3]


def test_plans_come_from_the_disk_the_second_time_and_damaged_ones_are_made_again(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER, str(tmp_path))
    first = Places(SMALL, ROBOT, 1, 4, [3, 4, 5])
    entries = sorted(tmp_path.iterdir())
    assert len(entries) == 3
    entries[0].write_bytes(b"damaged")
    drawn = []

    def counted(*arguments):
        drawn.append(1)
        return floor_plan(*arguments)

    monkeypatch.setattr(places, "floor_plan", counted)
    again = Places(SMALL, ROBOT, 1, 4, [3, 4, 5])
    assert len(drawn) == 2, "one shows whether the settings can be used, and one was damaged"
    for mine, their in zip(first.sites.worlds, again.sites.worlds, strict=True):
        np.testing.assert_array_equal(mine, their)
    assert entries[0].stat().st_size > 100


def test_the_folder_is_the_user_s_unless_it_is_named_or_switched_off(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER, str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.setenv(FOLDER, "off")
    assert cache_folder() is None
    monkeypatch.delenv(FOLDER)
    monkeypatch.setattr(plan_cache.sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert cache_folder() == tmp_path / "caches" / "limslam" / "plans"


@pytest.mark.parametrize("threads", [1, 3])
def test_results_come_in_order_and_the_first_error_ends_the_work(threads):
    squares = work_through(lambda number: number**2, range(50), threads, "squares")
    assert list(squares) == [number**2 for number in range(50)]
    done = []

    def failing(number: int) -> None:
        if number == 3:
            raise WorldError("no room")
        done.append(number)

    with pytest.raises(WorldError, match="no room"):
        list(work_through(failing, range(300), threads, "failures"))
    assert done[:3] == [0, 1, 2] or threads > 1
