"""What a reading means: the same for live observations, batches, ``log.npz``, tables, bags and CARMEN logs."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from support.bags import odometry, scan, write_bag

from limslam_agent import BatchSlam, LimSlamAgent, Mapper, preset, read_log, replay_log
from limslam_agent.readings import as_readings
from limslam_env import RobotSpec, SensorSpec

MOST = 3.0
LEAST = {"carmen": 0.02, "table": 0.02, "bag": 0.05, "npz": 0.05}
NAN = math.nan
# What a sensor reports, and what becomes of it: 0 stands for the beam's minimum.
MEANINGS = [
    (math.inf, MOST), (8.19, MOST), (3e38, MOST), (MOST, MOST), (2.5, 2.5), (0.01, 0.0), (-0.0, 0.0), (NAN, NAN),
    (-0.5, NAN), (-math.inf, NAN),
]  # fmt: skip
BEAMS = tuple(SensorSpec(0.0, 0.0, math.radians(degrees), 0.05, MOST) for degrees in (-90.0, 0.0, 90.0))
ROBOT = RobotSpec(beams=BEAMS)
CONFIG = preset("consistent")


def carmen(folder: Path, reading: float) -> Path:
    values = [2.0] * 181
    values[90] = reading
    lines = [f"FLASER 181 {' '.join(map(str, values))} 0 0 0 0 0 0 {time} host {time}\n" for time in (1.0, 2.0)]
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
        path, time=[0.0, 0.1], ranges=[[2.0, reading, 2.0]] * 2, wheels=np.zeros((2, 2)), action=np.zeros((2, 2)),
        true_pose=np.zeros((2, 3)), wall_seen=np.zeros((2, 3)), robot=ROBOT.to_json(), start_pose=np.zeros(3),
    )  # fmt: skip
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
    np.testing.assert_array_equal(batch.refused_readings, [math.isnan(meaning) for _, meaning in MEANINGS])
    as_meant = batch_of_meanings(readings)
    np.testing.assert_array_equal(believed.grid, as_meant)


def batch_of_meanings(readings):
    """The grids of a batch whose sensors report nothing beyond their limits."""
    meant = as_readings(readings, ROBOT.min_ranges, ROBOT.max_ranges)
    return BatchSlam(ROBOT, CONFIG, len(meant)).step(meant, np.zeros((len(meant), 2))).grid


def test_an_agent_acts_on_a_reading_of_8190_millimetres_as_on_one_at_the_maximum():
    actions = []
    for far in (MOST, 8.19, 8190.0, math.inf):
        agent = LimSlamAgent(ROBOT, CONFIG)
        agent.reset(np.zeros(3))
        observation = {"ranges": np.array([2.0, far, 1.0]), "wheels": np.zeros(2)}
        actions.append(agent.act(observation))
    np.testing.assert_array_equal(actions, [actions[0]] * len(actions))


def test_each_beam_has_its_own_limits():
    beams = (BEAMS[0], dataclasses.replace(BEAMS[1], min_range=0.2, max_range=1.0))
    robot = RobotSpec(beams=beams)
    readings = as_readings([[0.1, 0.1], [2.0, 2.0]], robot.min_ranges, robot.max_ranges)
    np.testing.assert_array_equal(readings, [[0.1, 0.2], [2.0, 1.0]])
