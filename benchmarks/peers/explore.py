"""Explorations with the sensor of the peers and the true pose: a point that goes from node to node, and our robot."""

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.peers.lidar import NODE_SPACING, LidarMap
from benchmarks.peers.maps import PeerMap, world_of
from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.frontier import frontier_cells, sight_begins
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.planner import routes
from limslam_agent.policies.policy import Policy
from limslam_agent.runs.oracle import policies_by_belief
from limslam_env.config import NoiseConfig
from limslam_env.geometry import BoolArray, FloatArray, no_rows
from limslam_env.interface import RobotSpec
from limslam_env.simulation.simulation import Readings, Simulation, Truth

MOST_MOVES = 5000
"""Largest number of moves of the point. A map of 640 x 480 pixels needs some hundreds."""

# What the explorers do because a pose may be wrong. Here the pose is the true one.
_NO_LIMIT = 1e6
# Motion that is less than this in a step (pixels) is standing.
_STANDING = 0.01


@dataclass(frozen=True, eq=False)
class Exploration:
    """An exploration.

    Attributes
    ----------
    path
        Places (k, 2), m.
    seen
        The map at the end.
    time_s
        Driving time, s. None for a point without speed.
    decisions, decide_s
        Number of decisions, and their processor time, s.
    stop_reason
        Why it ended.
    """

    path: FloatArray
    seen: LidarMap
    time_s: float | None
    decisions: int
    decide_s: float
    stop_reason: str


DONE = "done: 250 free pixels or fewer are unseen"


def explore_as_point(found: PeerMap, scale: float) -> Exploration:
    """A point goes towards the frontier that is nearest by path, and scans after each move of a node's spacing.

    This is a nearest-frontier explorer under the rules of the peers: no body, no heading, and a scan at the end of a
    straight move only. So it shows what the rules give, before our robot changes them.
    """
    seen, place, begin = LidarMap(found, scale), found.place(found.start, scale), time.process_time()
    path, ignored = [place], np.zeros(seen.view.values.shape, dtype=bool)
    seen.scan(place)
    while len(path) <= MOST_MOVES and not seen.is_done:
        way = _way_to_frontier(seen.view, place, ignored)
        if way is None:
            break
        place = way[::-1][sight_begins(seen.view, way[::-1], NODE_SPACING * scale)]
        path.append(place)
        seen.scan(place)
        if np.array_equal(place, way[-1]):
            # A scan on the spot shows all that can be seen of this frontier.
            ignored[tuple(seen.view.cells(place[None])[0])] = True
    stopped = "no frontier can be reached" if len(path) <= MOST_MOVES else f"moves: {MOST_MOVES} were made"
    reason = DONE if seen.is_done else stopped
    return Exploration(np.array(path), seen, None, len(path) - 1, time.process_time() - begin, reason)


def _way_to_frontier(grid: GridView, place: FloatArray, ignored: BoolArray) -> FloatArray | None:
    """The path (k, 2), m, to the frontier cell that is nearest by path. None if no frontier can be reached."""
    frontier = frontier_cells(grid, min_size=1, ignored=ignored)
    if not frontier.any():
        return None
    ways = routes(grid, place, 0.0, 0.0, targets=frontier)
    cost = np.where(frontier, ways.cost, np.inf)
    best = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return grid.centres(ways.path_to((int(best[0]), int(best[1])))) if np.isfinite(cost[best]) else None


def explore_as_robot(
    found: PeerMap, scale: float, policy: str, robot: RobotSpec, config: AgentConfig, *, seed: int, max_time: float
) -> Exploration:
    """Our robot drives by one of our policies, on the map that 720 rays draw from the true pose.

    Scans are as far apart as the nearest nodes of the peers. Further scans are taken where the robot stands. The six
    beams, without noise, serve the collision guard, and the learned explorer as its input.

    Parameters
    ----------
    found, scale
        The map, and the side of a pixel, m.
    policy
        Name of a policy that acts on the belief, not ``frontier``, which a team makes itself.
    robot, config
        The robot, and the settings of its policy.
    seed
        Seed of the policy's random numbers.
    max_time
        Longest driving time, s.
    """
    config = replace(config, policy=replace(config.policy, large_map=_NO_LIMIT, longest_excursion=_NO_LIMIT))
    driver = (policies_by_belief(policy, robot, config, robots=1, seed=seed) or [])[0]
    simulation = Simulation(world_of(found, scale, robot.radius), robot)
    state = simulation.reset(np.random.SeedSequence(seed), NoiseConfig(wheel_variance=0.0))
    scanner, path, spent = _Scanner(found, scale), [state[1].poses[0, :2]], 0.0
    while not scanner.observe(path[-1]) and len(path) * robot.control_period < max_time:
        begin = time.process_time()
        wheels = driver.act(_belief(state, scanner.seen.view))
        spent += time.process_time() - begin
        if driver.stop_reason is not None:
            break
        state = simulation.step([(float(wheels[0]), float(wheels[1]))])
        path.append(state[1].poses[0, :2])
    steps = len(path) - 1
    return Exploration(
        np.array(path), scanner.seen, steps * robot.control_period, steps, spent, _reason(scanner.seen, driver)
    )


def _belief(state: tuple[Readings, Truth], grid: GridView) -> Belief:
    """What the robot believes: the true pose, without any doubt."""
    readings, truth = state
    return Belief(truth.poses[0], np.zeros((3, 3)), readings.ranges[0].astype(float), no_rows(4), grid)


def _reason(seen: LidarMap, driver: Policy) -> str:
    return DONE if seen.is_done else driver.stop_reason or "time: the longest time is over"


class _Scanner:
    """Takes a scan after each stretch of a node's spacing, and once wherever the robot comes to stand."""

    def __init__(self, found: PeerMap, scale: float) -> None:
        self.seen, self._scale = LidarMap(found, scale), scale
        self._last: FloatArray | None = None
        self._driven = math.inf

    def observe(self, place: FloatArray) -> bool:
        """Note where the robot is (2,), m; whether the exploration is done."""
        step = 0.0 if self._last is None else math.dist(place, self._last) / self._scale
        self._driven, self._last = self._driven + step, place
        if self._driven >= NODE_SPACING or (step < _STANDING and self._driven > 1.0):
            self.seen.scan(place)
            self._driven = 0.0
        return self.seen.is_done
