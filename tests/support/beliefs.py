"""Beliefs drawn by hand, and runs of a policy on them or in the simulator."""

import math

import numpy as np

from limslam_agent import Belief, LimSlamAgent, Policy, preset
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.occupancy import GridView
from limslam_env import LimSlamEnv, NoiseConfig, NominalNoise, RobotSpec, World
from limslam_env.geometry import FloatArray, se2

ROBOT = RobotSpec()
CONFIG = PolicyConfig()
CELL = 0.1
CLEAR = ROBOT.max_ranges
# The beams at 15 degrees see something directly in front of the rim.
BLOCKED = np.where(np.abs(ROBOT.beam_angles) < math.radians(20.0), 0.05, CLEAR)


def grid_of(*rows: str) -> GridView:
    """A grid drawn with . for free, # for occupied and ? for unknown; the first row is row 0."""
    meaning = {".": 2, "#": -4, "?": 0}
    return GridView(
        np.zeros(2),
        CELL,
        np.array([[meaning[cell] for cell in row] for row in rows], dtype=np.int16),
    )


def place(row: int, column: int, heading: float = 0.0) -> FloatArray:
    return np.array([CELL * (column + 0.5), CELL * (row + 0.5), heading])


def belief_of(pose: FloatArray, grid: GridView, ranges: FloatArray = CLEAR) -> Belief:
    return Belief(pose, np.zeros((3, 3)), ranges, np.zeros((0, 4)), grid)


# A corridor that is open to the right, a closed room, a hall with two open ends, and a room beside
# free cells that no path leads to.
CORRIDOR = grid_of("#" * 30, *["#" + "." * 29] * 5, "#" * 30)
CLOSED = grid_of("#" * 12, *["#" + "." * 10 + "#"] * 8, "#" * 12)
HALL = grid_of("#" * 41, *["." * 41] * 7, "#" * 41)
CUT_OFF = grid_of("#" * 18, *["#" + "." * 10 + "#" + "." * 6] * 8, "#" * 18)


def actions_until_stopped(policy: Policy, belief: Belief, most: int = 3000) -> FloatArray:
    """The actions (n, 2) of a robot that does not move although its wheels turn, until the policy
    stops.
    """
    actions = []
    while policy.stop_reason is None and len(actions) < most:
        actions.append(np.array(policy.act(belief)))
    return np.array(actions)


def drive(pose: FloatArray, action: FloatArray) -> FloatArray:
    """The pose after one control period without contact."""
    travel = action * ROBOT.max_wheel_speed * ROBOT.control_period
    return se2.compose(pose, se2.arc(*se2.wheels_to_arc(travel, ROBOT.axle)))


def explored(
    world: World | str, policy: Policy, max_time: float, seed: int = 100
) -> tuple[float, int]:
    """True coverage and contacts begun of an agent with a policy and its robot, 2 cm noise."""
    robot = getattr(policy, "robot", ROBOT)
    noise = NoiseConfig(sensor_noise=0.02)
    env = LimSlamEnv(world, robot=robot, noise=noise, coverage_goal=None)
    agent = LimSlamAgent(robot, preset("paper", NominalNoise(0.02)), policy)
    observation, info = env.reset(seed=seed)
    agent.reset(info["pose"])
    contacts = [False]
    while info["time"] < max_time and policy.stop_reason is None:
        observation, _, _, _, info = env.step(agent.act(observation))
        contacts.append(info["collision"])
    return float(info["coverage"]), int(
        np.count_nonzero(np.diff(contacts, prepend=False)[1:] & contacts[1:])
    )
