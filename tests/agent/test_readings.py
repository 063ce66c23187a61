"""What a reading means: as a sensor reports it, in a batch, and when beams miss walls."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from support.bags import odometry, scan, write_bag
from support.command_line import limslam
from support.drives import along, drive, ranges_at, room, straight

from limslam_agent import BatchSlam, Mapper, preset, read_log, replay_log
from limslam_agent.config.presets import GridConfig
from limslam_agent.dropouts import Dropouts, short_series, without_dropouts
from limslam_agent.grid.drawing import ReadingDrawer
from limslam_agent.grid.occupancy import GridView, OccupancyGrid, drawn_grid
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.table_options import TableOptions
from limslam_agent.readings import as_readings
from limslam_env import NominalNoise, RobotSpec, SensorSpec
from limslam_env.geometry import FloatArray
from limslam_env.interface import beams_on_rim

MOST = 3.0
LEAST = {"carmen": 0.02, "table": 0.02, "bag": 0.05, "npz": 0.05}
NAN = math.nan
# What a sensor reports, and what becomes of it: 0 stands for the beam's minimum.
MEANINGS = [
    (math.inf, MOST),
    (8.19, MOST),
    (3e38, MOST),
    (MOST, MOST),
    (2.5, 2.5),
    (0.01, 0.0),
    (-0.0, 0.0),
    (NAN, NAN),
    (-0.5, NAN),
    (-math.inf, NAN),
]
BEAMS = tuple(
    SensorSpec(0.0, 0.0, math.radians(degrees), 0.05, MOST) for degrees in (-90.0, 0.0, 90.0)
)
ROBOT = RobotSpec(beams=BEAMS)
CONFIG = preset("consistent")


def carmen(folder: Path, reading: float) -> Path:
    values = [2.0] * 181
    values[90] = reading
    lines = [
        f"FLASER 181 {' '.join(map(str, values))} 0 0 0 0 0 0 {time} host {time}\n"
        for time in (1.0, 2.0)
    ]
    path = folder / "some.clf"
    path.write_text("".join(lines))
    return path


def table(folder: Path, reading: float) -> Path:
    path = folder / "some.csv"
    path.write_text(f"t,x,y,theta,r_-90,r_0,r_90\n1,0,0,0,2,{reading},2\n2,0,0,0,2,{reading},2\n")
    return path


def bag(folder: Path, reading: float) -> Path:
    times = (1.0, 2.0)
    messages = [odometry(time, 0.0) for time in times]
    return write_bag(folder, [*messages, *(scan(time, [2.0, reading, 2.0]) for time in times)])


def npz(folder: Path, reading: float) -> Path:
    path = folder / "log.npz"
    np.savez(
        path,
        time=[0.0, 0.1],
        ranges=[[2.0, reading, 2.0]] * 2,
        wheels=np.zeros((2, 2)),
        action=np.zeros((2, 2)),
        true_pose=np.zeros((2, 3)),
        wall_seen=np.zeros((2, 3)),
        robot=ROBOT.to_json(),
        start_pose=np.zeros(3),
    )
    return path


FORMATS = {"carmen": carmen, "table": table, "bag": bag, "npz": npz}


@pytest.mark.parametrize(("reading", "meaning"), MEANINGS)
@pytest.mark.parametrize("kind", FORMATS)
def test_a_reading_of_a_log_means_what_the_table_says(kind, reading, meaning, tmp_path):
    path = FORMATS[kind](tmp_path, reading)
    log = read_log(path) if kind == "npz" else read_log(path, (-90.0, 0.0, 90.0), MOST)
    expected = np.float32(LEAST[kind] if meaning == 0.0 else meaning)
    np.testing.assert_array_equal(log.ranges, np.float32([[2.0, expected, 2.0]] * 2))
    replayed = replay_log(log, CONFIG)
    assert replayed.refused_readings == (2 if math.isnan(meaning) else 0)
    assert max(replayed.grid.values.shape) * replayed.grid.cell < 3.0 * MOST


@pytest.mark.parametrize(("reading", "meaning"), MEANINGS)
def test_a_live_reading_means_the_same(reading, meaning):
    mapper = Mapper(ROBOT, CONFIG)
    mapper.step({"ranges": np.array([2.0, reading, 2.0]), "wheels": np.zeros(2)})
    expected = [2.0, 0.05 if meaning == 0.0 else meaning, 2.0]
    np.testing.assert_array_equal(mapper.belief.ranges, expected)
    assert mapper.slam.refused_readings == math.isnan(meaning)
    # Nothing is claimed to be free farther away than the sensor can see.
    assert max(mapper.grid.values.shape) * mapper.grid.cell < 3.0 * MOST


def test_a_batch_takes_readings_as_one_mapper_does():
    readings = np.array([[2.0, reading, 2.0] for reading, _ in MEANINGS])
    batch = BatchSlam(ROBOT, CONFIG, len(readings))
    believed = batch.step(readings, np.zeros((len(readings), 2)))
    np.testing.assert_array_equal(
        batch.refused_readings, [math.isnan(meaning) for _, meaning in MEANINGS]
    )
    meant = as_readings(readings, ROBOT.min_ranges, ROBOT.max_ranges)
    as_meant = BatchSlam(ROBOT, CONFIG, len(meant)).step(meant, np.zeros((len(meant), 2)))
    np.testing.assert_array_equal(believed.grid, as_meant.grid)


def test_each_beam_has_its_own_limits():
    beams = (BEAMS[0], dataclasses.replace(BEAMS[1], min_range=0.2, max_range=1.0))
    robot = RobotSpec(beams=beams)
    readings = as_readings([[0.1, 0.1], [2.0, 2.0]], robot.min_ranges, robot.max_ranges)
    np.testing.assert_array_equal(readings, [[0.1, 0.2], [2.0, 1.0]])


SIX = RobotSpec()


# A corridor around a block, with open space beyond the longest range.
CORRIDOR = np.vstack((room(-0.5, -0.5, 5.5, 3.5), room(0.5, 0.5, 4.5, 2.5)))
LOOP = [(0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (0.0, 3.0), (0.0, 0.0)]
START = np.zeros(3)


def driven(split: int = 1, noise: float = 0.02) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Readings (n, 6) in whole millimetres, m, wheel travel (n, 2), m, and true poses (n, 3) of a
    drive, with ``split`` rows in place of each of its steps.
    """
    wheels = [(left / split, right / split) for left, right in along(LOOP) for _ in range(split)]
    observations, poses = drive(CORRIDOR, START, wheels, noise=noise)
    ranges = np.round([seen["ranges"] for seen in observations], 3)
    return ranges, np.array([seen["wheels"] for seen in observations]), poses


def log_of(ranges: FloatArray, wheels: FloatArray, missing: str = "auto") -> RecordedLog:
    time = 0.1 * np.arange(len(ranges))
    has_scan = np.ones(len(ranges), dtype=bool)
    return RecordedLog(SIX, time, ranges, has_scan, wheels=wheels, missing=missing)


RANGES, WHEELS, POSES = driven()
SAW_NOTHING = SIX.max_ranges <= RANGES


@pytest.mark.parametrize("code", [NAN, -1.0, 0.0, 65.535, 655.35, 65535.0])
def test_what_is_missing_where_the_readings_end_saw_nothing(code: float) -> None:
    reported = np.where(SAW_NOTHING, code, RANGES)
    log = log_of(reported, WHEELS)
    np.testing.assert_array_equal(log.ranges, RANGES.astype(np.float32))
    is_as_ever = code > SIX.reach
    ends = [note.endswith("--missing not-measured leaves them out") for note in log.readings_notes]
    assert ends == ([] if is_as_ever else [True])
    told = log.taken("not-measured")
    np.testing.assert_array_equal(np.isnan(told.ranges), SAW_NOTHING)
    assert told.readings_notes == ()


def test_a_table_with_empty_cells_and_decimal_commas(tmp_path: Path) -> None:
    lines = ["t;left;right;" + ";".join(f"r_{angle:g}" for angle in (90, 45, 15, -15, -45, -90))]
    for row, (left, right) in enumerate(WHEELS.tolist()):
        readings = ["" if value >= 1.5 else f"{value:.3f}" for value in RANGES[row].tolist()]
        fields = [f"{0.1 * row:.1f}", f"{left:.6f}", f"{right:.6f}", *readings]
        lines.append(";".join(fields).replace(".", ","))
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    log = read_log(path, table=TableOptions(SIX))
    np.testing.assert_array_equal(log.ranges, RANGES.astype(np.float32))
    refused = limslam("replay", path, "--robot", "paper", "--missing", "none")
    assert refused.returncode == 2
    assert refused.stderr.endswith(
        "--missing must be one of auto, nothing, not-measured, not 'none'\n"
    )


def test_beams_that_often_have_no_reading_are_not_left_out() -> None:
    mapper = Mapper(SIX, preset("consistent", NominalNoise(0.02)), START)
    for ranges, wheels in zip(np.where(SAW_NOTHING, NAN, RANGES), WHEELS, strict=True):
        mapper.step({"ranges": ranges, "wheels": wheels})
    mapper.finish()
    assert mapper.slam.sensor.broken == ()
    assert np.hypot(*(mapper.poses[0] - POSES[-1])[:2]) < 0.1
    assert mapper.statuses[0].level == "ok"


@pytest.mark.parametrize("code", [NAN, -1.0, 0.0, 65.535])
def test_what_is_missing_beside_any_reading_was_not_measured(code: float) -> None:
    is_lost = np.random.default_rng(1).random(RANGES.shape) < 0.1
    log = log_of(np.where(is_lost, code, RANGES), WHEELS)
    np.testing.assert_array_equal(log.ranges, np.where(is_lost, np.float32(NAN), RANGES))
    (note,) = log.readings_notes
    assert "they stand beside near and far readings alike, so they count as not measured" in note
    assert note.endswith("--missing nothing takes them for 'nothing seen'")
    told = log.taken("nothing")
    np.testing.assert_array_equal(told.ranges, np.where(is_lost, np.float32(1.5), log.ranges))


def test_rows_between_two_scans_say_nothing_of_what_is_missing() -> None:
    ranges, wheels, _ = driven(split=5)
    reported = np.where(ranges >= SIX.max_ranges, NAN, ranges)
    is_between = np.arange(len(ranges)) % 5 > 0
    reported[is_between] = NAN
    log = log_of(reported, wheels)
    expected = np.where(is_between[:, None], NAN, ranges).astype(np.float32)
    np.testing.assert_array_equal(log.ranges, expected)
    (note,) = log.readings_notes
    assert "they begin where the readings end near the longest range" in note


def test_rows_in_which_no_beam_saw_anything_are_told_from_those_between_two_scans() -> None:
    beams = beams_on_rim((90.0, -90.0), 0.06, max_range=1.5)
    robot = RobotSpec(beams=beams)
    steps = 300
    reading = 1.2 + 0.5 * np.sin(0.1 * np.arange(steps))
    ranges = np.column_stack((reading, reading))
    wheels = np.full((steps, 2), 0.02)
    scans = np.ones(steps, dtype=bool)
    reported = np.where(ranges >= 1.5, NAN, ranges)
    log = RecordedLog(robot, 0.1 * np.arange(steps), reported, scans, wheels=wheels)
    np.testing.assert_array_equal(log.ranges, np.minimum(ranges, 1.5).astype(np.float32))


def test_a_wall_that_comes_too_near_is_no_free_space() -> None:
    # To a wall and back, again and again, nearer than the beams can measure.
    wheels = [*straight(0.4), *straight(-0.4)] * 6
    observations, _ = drive(room(-1.0, -1.0, 1.05, 1.0), np.array([0.525, 0.0, 0.0]), wheels)
    reported = np.array([seen["ranges"] for seen in observations])
    reported[reported <= SIX.too_near] = 0.0
    assert (reported == 0.0).mean() > 0.01
    log = log_of(reported, np.array([seen["wheels"] for seen in observations]))
    np.testing.assert_array_equal(log.ranges == np.float32(0.05), reported == 0.0)
    assert log.readings_notes == ()


def test_an_unknown_meaning_is_refused() -> None:
    with pytest.raises(ValueError, match=r"--missing must be one of auto, .* not 'zero'"):
        log_of(RANGES, WHEELS, "zero")


def repeated_rows(kind: str, count: int) -> FloatArray:
    """The row (n, 6) in which each reading of a log was measured."""
    rows = np.tile(np.arange(count)[:, None], (1, 6))
    beams = np.arange(6)
    if kind == "held":
        return rows - rows % 5
    if kind == "in turn":
        return np.maximum(rows - (rows - beams) % 6, 0)
    if kind == "one beam":
        return np.where(beams == 4, rows - rows % 3, rows)
    is_new = np.random.default_rng(2).random(count) < 0.4  # irregular
    return np.maximum.accumulate(np.where(is_new[:, None], rows, 0), axis=0)


FAST_RANGES, FAST_WHEELS, FAST_POSES = driven(split=5)


@pytest.mark.parametrize("resolution", [0.0, 0.001, 0.01])
@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("kind", ["held", "in turn", "one beam", "irregular"])
def test_repeats_are_found_from_the_readings(kind: str, noise: float, resolution: float) -> None:
    ranges, wheels, _ = driven(split=3, noise=noise)
    if resolution:
        ranges = np.round(ranges / resolution) * resolution
    rows = repeated_rows(kind, len(ranges))
    ranges = ranges[rows, np.arange(6)]
    log = log_of(ranges, wheels)
    is_repeat = rows != np.arange(len(rows))[:, None]
    is_wall = ranges < 1.45
    used = ~np.isnan(log.ranges)
    assert used[1:][ranges[1:] != ranges[:-1]].all()
    # A reading that does not change for long is used again from time to time.
    assert used[is_repeat & is_wall].mean() < (0.05 if noise else 0.3)
    if kind == "one beam":
        assert used[:, np.arange(6) != 4].all()
    (note,) = log.readings_notes
    assert note.startswith("each reading") == (kind != "one beam") or "beams at -45 deg" in note
    assert replay_log(log, preset("paper")).refused_readings == 0


def coarse(step: float, split: int, noise: float = 0.0) -> tuple[FloatArray, FloatArray]:
    ranges, wheels, _ = driven(split, noise)
    return np.round(ranges / step) * step, wheels


def stuck() -> tuple[FloatArray, FloatArray]:
    ranges = RANGES.copy()
    ranges[:, 3] = 0.7
    return ranges, WHEELS


def standing() -> tuple[FloatArray, FloatArray]:
    seen = ranges_at(START, CORRIDOR) + 0.004 * np.random.default_rng(3).normal(size=(600, 6))
    return np.round(seen, 2), np.zeros((600, 2))


@pytest.mark.parametrize(
    ("ranges", "wheels"),
    [
        driven(noise=0.0)[:2],
        driven(split=5, noise=0.0)[:2],
        coarse(0.01, 1),
        coarse(0.01, 5),
        coarse(0.02, 5),
        coarse(0.01, 1, 0.02),
        coarse(0.01, 5, 0.01),
        stuck(),
        standing(),
    ],
)
def test_other_equal_readings_are_no_repeats(ranges: FloatArray, wheels: FloatArray) -> None:
    log = log_of(ranges, wheels)
    assert log.repeated == 0
    assert log.readings_notes == ()


@pytest.mark.parametrize("kind", ["held", "in turn"])
def test_a_mapper_uses_each_reading_once(kind: str) -> None:
    rows = repeated_rows(kind, len(FAST_RANGES))
    ranges = FAST_RANGES[rows, np.arange(6)]
    robot = dataclasses.replace(SIX, control_period=0.02)
    mapper = Mapper(robot, preset("consistent", NominalNoise(0.02)), START)
    used = np.zeros(ranges.shape, dtype=bool)
    off = []
    for row in range(len(ranges)):
        mapper.step({"ranges": ranges[row], "wheels": FAST_WHEELS[row]})
        used[row] = mapper.slam.measured
        off.append(np.hypot(*(mapper.slam.pose - FAST_POSES[row])[:2]))
    mapper.finish()
    assert all(mapper.slam.robots[0].holds)
    late = slice(500, None)
    is_wall = ranges[late] < 1.45
    is_repeat = (rows != np.arange(len(rows))[:, None])[late]
    assert used[late][is_wall & is_repeat].mean() < 0.02
    assert used[late][is_wall & ~is_repeat].mean() > 0.95
    assert mapper.slam.refused_readings == 0
    assert max(off) < 0.1
    assert len(mapper.slam.segments) == 8
    assert mapper.statuses[0].level == "ok"


@pytest.mark.parametrize("seed", range(3))
def test_dropouts(seed: int) -> None:
    nothing = np.random.default_rng(seed).random((15, 6)) < 0.7
    expected = nothing.copy()
    for first in range(15 - 4 + 1):
        expected[first : first + 4, nothing[first : first + 4].all(axis=0)] = False
    np.testing.assert_array_equal(short_series(nothing, 4), expected)


COUNT = len(SIX.beams)
ALL = np.ones(COUNT, dtype=bool)


def readings_of_a_wall(steps: int, chance: float, *, at: float = 0.8, seed: int = 0) -> FloatArray:
    """Readings (steps, n_beams), m, of a wall that each beam misses with some probability."""
    generator = np.random.default_rng(seed)
    seen = at + 0.02 * generator.standard_normal((steps, COUNT))
    return np.where(generator.random(seen.shape) < chance, SIX.max_ranges, seen)


def noted(ranges: FloatArray) -> Dropouts:
    """The drop-outs among readings (t, n_beams), m."""
    dropouts = Dropouts(SIX)
    for row in ranges:
        dropouts.note(row, ALL)
    return dropouts


@pytest.mark.parametrize("chance", [0.05, 0.3])
def test_their_share_is_estimated(chance: float) -> None:
    dropouts = noted(readings_of_a_wall(1000, chance))
    assert dropouts.share == pytest.approx(chance, rel=0.15)


def test_a_sensor_that_misses_nothing_has_none() -> None:
    # Open doors of many widths, an object that moves, and a wall at the end of the longest range.
    ranges = readings_of_a_wall(300, 0.0)
    for step in range(10, 290, 20):
        ranges[step : step + step // 20 + 2] = SIX.max_ranges
    ranges[:, 0] = np.where(np.arange(300) % 3 == 0, SIX.max_ranges[0], 0.97 * SIX.max_ranges[0])
    ranges[::2, 1] = 0.4
    ranges[1::2, 1] = 1.2
    dropouts = noted(ranges)
    assert (dropouts.share, dropouts.enough) == (0.0, 1)


def drawn_with(ranges: FloatArray) -> OccupancyGrid:
    """The grid of a robot that stands at the origin, after readings (t, n_beams), m."""
    drawer = ReadingDrawer(SIX)
    grid = OccupancyGrid(GridConfig())
    for row in ranges:
        drawer.draw(grid, 0, np.zeros(3), row, ALL)
    return grid


def reach_of(view: GridView) -> float:
    """Distance (m) of the farthest free cell from the origin."""
    return float(np.hypot(*view.centres(np.argwhere(view.free)).T).max())


def test_readings_that_saw_nothing_are_drawn_when_enough_of_them_follow_each_other() -> None:
    # The first drop-outs make some free ground behind the wall, before it is known that there are
    # drop-outs.
    before = readings_of_a_wall(1000, 0.1, at=0.5)
    known = drawn_with(before).view.values
    nothing = np.tile(SIX.max_ranges, (6, 1))
    seen = np.full((1, COUNT), 0.5)
    short = drawn_with(np.vstack((before, seen, nothing[:2], seen))).view
    assert np.count_nonzero(short.free) == np.count_nonzero(known > 0)
    # A chance of 0.1 makes a series of four with a probability of 1e-4. The estimated chance is not
    # exactly 0.1.
    assert np.count_nonzero(
        drawn_with(np.vstack((before, nothing))).view.free
    ) > 1.2 * np.count_nonzero(known > 0)


def test_a_beam_that_takes_turns_with_others_is_compared_with_its_own_readings() -> None:
    dropouts = Dropouts(SIX)
    ranges = readings_of_a_wall(6000, 0.1)
    for step, row in enumerate(ranges):
        fresh = np.arange(COUNT) == step % COUNT
        # What the other beams read earlier means nothing now.
        dropouts.note(np.where(fresh, row, np.nan), fresh)
    assert dropouts.share == pytest.approx(0.1, rel=0.2)


def test_a_finished_map_has_no_free_ground_behind_a_wall() -> None:
    steps = 400
    ranges = readings_of_a_wall(steps, 0.1, at=0.5)[:, None]
    measured = np.ones(ranges.shape, dtype=bool)
    poses = np.zeros((steps, 1, 3))
    grid = drawn_grid(GridConfig(), SIX, poses, ranges, measured)
    assert reach_of(grid) < 0.75
    kept = without_dropouts(SIX, ranges[:, 0], measured[:, 0])
    assert (kept | (ranges[:, 0] >= SIX.too_far)).all()


def test_a_mapper_that_is_reset_draws_no_reading_of_the_estimate_before() -> None:
    mapper = Mapper(SIX, preset("consistent", NominalNoise(0.02)))
    for row in readings_of_a_wall(300, 0.1, at=0.5):
        mapper.step({"wheels": np.zeros(2), "ranges": row})
    mapper.step({"wheels": np.zeros(2), "ranges": SIX.max_ranges})  # these readings wait
    mapper.reset(np.array([20.0, 0.0, 0.0]))
    for _ in range(8):
        mapper.step({"wheels": np.zeros(2), "ranges": SIX.max_ranges})
    cells = mapper.grid.centres(np.argwhere(mapper.grid.free))
    assert np.hypot(*(cells - np.array([20.0, 0.0])).T).max() < 1.7
