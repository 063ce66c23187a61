"""Wheel reports that are missing in a log, or that are 0 while the wheels drive."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

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


def log(wheels):
    return RecordedLog(ROBOT, TIME, RANGES, np.ones(COUNT, bool), wheels=wheels)


def read_table(tmp_path, columns, **options):
    """The log of a table without the rows of lost reports."""
    header = ["t", *columns, *(f"r_{round(angle)}" for angle in np.degrees(ROBOT.beam_angles))]
    rows = np.column_stack((TIME, *columns.values(), RANGES))[~LOST]
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, "%.6f", ",", header=",".join(header), comments="")
    return read_log(path, table=TableOptions(ROBOT, **options))


@pytest.mark.parametrize("report", [0.0, np.nan])
def test_reports_that_are_missing_or_impossibly_0_are_taken_from_the_speeds_around(report):
    found = log(np.where(LOST[:, None], report, WHEELS))
    (note,) = found.notes
    assert f"{LOST.sum()} wheel reports are missing or impossibly 0, in gaps of 0.1 to" in note
    assert_array_equal(found.wheel_variances[:, 0] > 0.0, LOST)
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
        assert_array_equal(found.wheels, wheels)
        assert not found.notes


@pytest.mark.parametrize(("unit", "seconds"), [("m", 1.0), ("m_s", 0.1)])
def test_the_motion_in_missing_rows_is_that_of_the_speeds_around(tmp_path, unit, seconds):
    left, right = WHEELS.T / seconds
    found = read_table(tmp_path, {f"left_{unit}": left, f"right_{unit}": right})
    assert any(f"{LOST.sum()} wheel reports are missing" in each for each in found.notes)
    off = found.wheels.sum(axis=0) - WHEELS.sum(axis=0)
    assert (np.abs(off) < 3.0 * np.sqrt(found.wheel_variances.sum(axis=0))).all()


def test_counters_count_on_while_rows_are_missing(tmp_path):
    left, right = totals = np.cumsum(WHEELS, axis=0).T
    found = read_table(tmp_path, {"left_m": left, "right_m": right}, accumulated=True)
    assert not found.wheel_variances.any()
    assert_allclose(found.wheels.sum(axis=0), totals[:, -1], atol=1e-4)
