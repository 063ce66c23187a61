"""Wheel reports that are missing in a log, or that are 0 while the wheels drive."""

import numpy as np
import pytest

from limslam_agent import read_log
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.table_options import TableOptions
from limslam_env import RobotSpec

COUNT = 400
ROBOT = RobotSpec()
TIME = 0.1 * np.arange(COUNT)
# Speeds that change at random times, as those of a robot that drives and turns
TURNS = np.random.default_rng(3).choice([-0.02, 0.0, 0.0, 0.02], COUNT // 20).repeat(20)
WHEELS = np.column_stack((0.03 - np.maximum(TURNS, 0.0), 0.03 + np.minimum(TURNS, 0.0)))
WHEELS[0] = 0.0
RANGES = np.ones((COUNT, len(ROBOT.beams)))
LOST = np.random.default_rng(4).random(COUNT) < 0.1
LOST[:2] = LOST[-2:] = False


def log(wheels, keep=slice(None)):
    return RecordedLog(ROBOT, TIME[keep], RANGES[keep], np.ones(COUNT, bool)[keep], wheels=wheels)


def table(tmp_path, columns, keep):
    header = ["t", *columns, *(f"r_{round(angle)}" for angle in np.degrees(ROBOT.beam_angles))]
    rows = np.column_stack((TIME, *columns.values(), RANGES))[keep]
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, "%.6f", ",", header=",".join(header), comments="")
    return path


@pytest.mark.parametrize("report", [0.0, np.nan])
def test_reports_that_are_missing_or_impossibly_0_are_taken_from_the_speeds_around(report):
    found = log(np.where(LOST[:, None], report, WHEELS))
    assert found.wheels is not None
    assert found.wheel_variances is not None
    (note,) = found.notes
    assert f"{LOST.sum()} wheel reports are missing or impossibly 0, in gaps of 0.1 to" in note
    np.testing.assert_array_equal(found.wheel_variances[:, 0] > 0.0, LOST)
    off = (found.wheels - WHEELS)[LOST]
    assert np.mean(off**2 / found.wheel_variances[LOST]) < 1.5
    assert [("wheel_variances" in each) for each in found.observations()] == LOST.tolist()


def test_a_robot_that_stops_and_an_encoder_with_long_ticks_report_0_rightly():
    stops = WHEELS.copy()
    ticks = np.full((COUNT, 2), 0.03)
    stops[50:80] = stops[120] = 0.0
    ticks[::3] = 0.0
    for wheels in (WHEELS, stops, ticks):
        found = log(wheels)
        np.testing.assert_array_equal(found.wheels, wheels)
        assert not found.notes


@pytest.mark.parametrize("form", ["travel", "speeds"])
def test_the_motion_in_missing_rows_is_that_of_the_speeds_around(tmp_path, form):
    names = ("left_m", "right_m") if form == "travel" else ("left_m_s", "right_m_s")
    wheels = WHEELS if form == "travel" else WHEELS / 0.1
    keep = ~LOST
    path = table(tmp_path, dict(zip(names, wheels.T, strict=True)), keep)
    found = read_log(path, table=TableOptions(ROBOT))
    assert found.wheels is not None
    assert found.wheel_variances is not None
    assert any(f"{LOST.sum()} wheel reports are missing" in each for each in found.notes)
    off = np.cumsum(found.wheels - np.diff(np.cumsum(WHEELS, axis=0)[keep], axis=0, prepend=0.0), 0)
    std = np.sqrt(np.cumsum(found.wheel_variances, axis=0))
    assert (np.abs(off[-1]) < 3.0 * std[-1]).all()


def test_counters_count_on_while_rows_are_missing(tmp_path):
    totals = np.cumsum(WHEELS, axis=0)
    path = table(tmp_path, {"left_m": totals[:, 0], "right_m": totals[:, 1]}, ~LOST)
    found = read_log(path, table=TableOptions(ROBOT, accumulated=True))
    assert found.wheels is not None
    assert found.wheel_variances is not None
    assert not found.wheel_variances.any()
    np.testing.assert_allclose(found.wheels.sum(axis=0), totals[-1], atol=1e-4)
