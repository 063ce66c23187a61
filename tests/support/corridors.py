"""Simulated logs for the graph of local maps: laps of a corridor, with odometry that is wrong in
known ways.
"""

from dataclasses import replace

import numpy as np
from support.drives import along, drive, room

from limslam_agent.slam.map_graph.key_poses import LogData
from limslam_env import RobotSpec
from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import beams_on_rim

SIX_BEAMS = RobotSpec(
    beams=beams_on_rim((90.0, 54.0, 18.0, -18.0, -54.0, -90.0), 0.10, max_range=5.0)
)
FOUR_BEAMS = RobotSpec(beams=beams_on_rim((90.0, 0.0, -90.0, 180.0), 0.05, max_range=5.0))
EVERY = 4
TURN_PER_METRE = np.radians(2.0)


def walls() -> FloatArray:
    """A corridor 2 m wide round a block, its outline 12 x 9 m, with alcoves so that no side looks
    like another.
    """
    alcoves = [
        room(3.0, -0.6, 4.5, 0.0),
        room(12.0, 2.0, 12.7, 3.0),
        room(12.0, 5.5, 12.5, 7.5),
        room(6.5, 9.0, 7.0, 9.9),
    ]
    boxes = [room(0.0, 4.0, 0.3, 4.5), room(8.0, 8.7, 8.8, 9.0)]
    outer = room(0.0, 0.0, 12.0, 9.0)
    return np.vstack((outer, room(2.0, 2.0, 10.0, 7.0), *alcoves, *boxes))


def plain_walls() -> FloatArray:
    """The corridor without alcoves: it looks the same after half a turn."""
    return np.vstack((room(0.0, 0.0, 12.0, 9.0), room(2.0, 2.0, 10.0, 7.0)))


def uneven_walls() -> FloatArray:
    """A corridor that is wider on one side, with cupboards along its walls: it fits into itself at
    no other place.
    """
    cupboards = [
        room(3.0, 0.0, 6.0, 0.5),
        room(11.5, 2.5, 12.0, 3.5),
        room(1.6, 4.0, 2.0, 6.5),
        room(4.0, 7.0, 5.0, 7.4),
        room(8.0, 8.5, 8.8, 9.0),
    ]
    return np.vstack((room(0.0, 0.0, 12.0, 9.0), room(2.0, 2.0, 8.5, 7.0), *cupboards))


def later_part(log: LogData, first: int) -> LogData:
    """A log from an event on, with odometry that begins at the origin."""
    odometry = se2.between(log.odometry[first], log.odometry[first:])
    return replace(
        log,
        time=log.time[first:],
        odometry=odometry,
        ranges=log.ranges[first:],
        hit=log.hit[first:],
    )


def corridor_log(
    laps: int = 2,
    bias: float = TURN_PER_METRE,
    robot: RobotSpec = SIX_BEAMS,
    seed: int = 0,
    noise: float = 0.01,
    slip: float = 0.0,
    world: FloatArray | None = None,
) -> tuple[LogData, FloatArray]:
    """A log of laps and the true poses (n, 3); ``slip`` (rad) is missed by odometry once, in the
    middle.
    """
    corners = [(1.0, 1.0), (11.0, 1.0), (11.0, 8.0), (1.0, 8.0)]
    places = [*(corners * laps), corners[0], (6.0, 1.0)]
    observations, truth = drive(
        walls() if world is None else world,
        np.array([1.0, 1.0, 0.0]),
        along(places),
        robot,
        noise,
        seed,
    )
    rows = np.arange(0, len(truth), EVERY)
    ranges = np.array([observations[row]["ranges"] for row in rows], dtype=float)
    truth = truth[rows]
    generator = np.random.default_rng(seed)
    moves = se2.between(truth[:-1], truth[1:])
    length = np.hypot(moves[:, 0], moves[:, 1])
    turn = np.abs(moves[:, 2])
    spread = np.column_stack(
        (0.02 * np.sqrt(length), 0.01 * np.sqrt(length), 0.02 * np.sqrt(length + turn))
    )
    moves += spread * generator.standard_normal(moves.shape)
    moves[:, 2] -= bias * moves[:, 0]
    moves[len(moves) // 2, 2] += slip
    odometry = np.zeros_like(truth)
    for row, move in enumerate(moves, 1):
        odometry[row] = se2.compose(odometry[row - 1], move)
    hit = (ranges > robot.too_near) & (ranges < robot.too_far)
    time = 0.1 * np.asarray(rows, dtype=float)
    return LogData(
        time, odometry, ranges, hit, robot.beam_origins, robot.beam_angles, 5.0, noise
    ), truth


def loop_errors(poses: FloatArray, truth: FloatArray, apart: int) -> FloatArray:
    """Errors (k,) m of the motions between events so many rows apart."""
    wanted = se2.between(truth[:-apart], truth[apart:])
    found = se2.between(poses[:-apart], poses[apart:])
    return np.asarray(np.hypot(*(found - wanted)[:, :2].T))
