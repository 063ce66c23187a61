"""Whether memory and time of a step stay the same for hours, whatever the robot does.

Each case runs in a process of its own, whose most memory is shown. A case that keeps something of
every step shows as memory that grows, and one that looks at all that it has kept as steps that take
longer.
"""

import itertools
import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from limslam_agent import AgentConfig, Mapper
from limslam_agent.output.summary import peak_memory
from limslam_agent.runs.policies import Tour
from limslam_agent.slam.map_graph.key_poses import LogData
from limslam_agent.slam.map_graph.online import OnlineGraph
from limslam_env import LimSlamEnv, RobotSpec, load_world
from limslam_env.bounds import loop_tour
from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import Observation

HOUR = 36_000
"""Steps of 0.1 s in an hour."""

_WORLD = "env2"
_NOISE = 0.02
_SPEED = 0.3
_FIRST = 900  # steps in which the robot drives before it stands
_JUMP = np.array([2.0, 2.0])  # m: travel of the wheels by which a robot is lost


def _laps(robot: RobotSpec) -> Iterator[Observation]:
    """Laps of a world, for ever, driven by somebody who knows the true pose."""
    world = load_world(_WORLD)
    env = LimSlamEnv(world, robot=robot, sensor_noise=_NOISE, coverage_goal=None)
    tour = Tour(robot, lambda pose: loop_tour(world, robot, pose, 1), tours=10**6)
    seen, info = env.reset(seed=0)
    while True:
        yield seen
        tour.observe_truth(info["pose"])
        seen, _, _, _, info = env.step(tour.act(None))


def _standing(robot: RobotSpec, seen: Observation) -> Iterator[Observation]:
    """What a robot observes that stands where it has seen something, for ever."""
    generator = np.random.default_rng(0)
    ranges = np.asarray(seen["ranges"], dtype=float)
    noise = np.where(ranges < robot.too_far, _NOISE, 0.0)
    while True:
        yield Observation(
            ranges=ranges + noise * generator.standard_normal(len(ranges)), wheels=np.zeros(2)
        )


def drives(config: AgentConfig | None = None) -> Iterator[None]:
    """A robot drives laps."""
    robot = RobotSpec()
    mapper = Mapper(robot, config)
    for seen in _laps(robot):
        mapper.step(seen)
        yield


def stands(config: AgentConfig | None = None) -> Iterator[None]:
    """A robot stands after a drive."""
    robot = RobotSpec()
    mapper = Mapper(robot, config)
    yield from _stands_after(mapper, itertools.islice(_laps(robot), _FIRST))


def lost(config: AgentConfig | None = None) -> Iterator[None]:
    """A robot stands after its odometry has jumped, and it is lost."""
    robot = RobotSpec()
    mapper = Mapper(robot, config)
    laps = _laps(robot)
    yield from _stands_after(mapper, itertools.islice(_jumping(laps), _FIRST))


def placed(config: AgentConfig | None = None) -> Iterator[None]:
    """A robot stands after it has found its place again, which is not confirmed."""
    robot = RobotSpec()
    mapper = Mapper(robot, config)
    until_found = itertools.takewhile(
        lambda _: "found" not in [each["event"] for each in mapper.places.records],
        _jumping(_laps(robot)),
    )
    yield from _stands_after(mapper, itertools.islice(until_found, HOUR))


def _jumping(laps: Iterator[Observation]) -> Iterator[Observation]:
    """A drive in which the odometry jumps shortly before its end."""
    for number, seen in enumerate(laps):
        jump = _JUMP if number == _FIRST - 1 else 0.0
        yield Observation(ranges=seen["ranges"], wheels=seen["wheels"] + jump)


def _stands_after(mapper: Mapper, drive: Iterator[Observation]) -> Iterator[None]:
    """The steps of a mapper in a drive, and then of a robot that stands."""
    for seen in drive:
        last = seen
        mapper.step(seen)
        yield
    for seen in _standing(mapper.robot, last):
        mapper.step(seen)
        yield


def blind(config: AgentConfig | None = None) -> Iterator[None]:
    """The graph of a log of poses: a robot moves where its beams see nothing."""
    del config
    robot = RobotSpec()
    graph = _graph(robot)
    number = 0
    nothing = np.zeros(len(robot.beams), dtype=bool)
    while True:
        pose = np.array([0.1 * _SPEED * number, 0.0, 0.0])
        graph.step(0.1 * number, pose, robot.max_ranges, nothing)
        yield
        number += 1


def log(config: AgentConfig | None = None) -> Iterator[None]:
    """The graph of a log of poses: laps."""
    del config
    robot = RobotSpec()
    graph = _graph(robot)
    pose = np.zeros(3)
    for number, seen in enumerate(_laps(robot)):
        wheels = np.asarray(seen["wheels"], dtype=float)
        pose = se2.compose(pose, se2.arc(*se2.wheels_to_arc(wheels, robot.axle)))
        ranges = np.asarray(seen["ranges"], dtype=float)
        hit = (ranges > robot.too_near) & (ranges < robot.too_far)
        graph.step(0.1 * number, pose, ranges, hit)
        yield


def _graph(robot: RobotSpec) -> OnlineGraph:
    nothing = np.zeros((0, len(robot.beams)))
    beams = robot.beam_origins, robot.beam_angles, float(robot.max_ranges.max())
    data = LogData(np.zeros(0), np.zeros((0, 3)), nothing, nothing > 0.0, *beams, _NOISE)
    return OnlineGraph(data, np.zeros(3))


CASES: dict[str, Callable[..., Iterator[None]]] = {
    each.__name__: each for each in (stands, lost, placed, drives, blind, log)
}


def hours_of(case: str, hours: int, steps: int = HOUR) -> FloatArray:
    """Most memory so far, MB, and time of a step in the mean and of the slowest one, ms, after each
    hour (hours, 3).
    """
    going = CASES[case]()
    rows = []
    for _ in range(hours):
        spent = np.empty(steps)
        for number in range(steps):
            begin = time.perf_counter()
            next(going)
            spent[number] = 1e3 * (time.perf_counter() - begin)
        rows.append((peak_memory().get("peak_rss_mb", np.nan), spent.mean(), spent.max()))
    return np.array(rows)


def print_growth(cases: Iterable[str], hours: int) -> None:
    """Print a Markdown table of cases over simulated hours."""
    print(
        "| case | hour | most memory MB | mean step ms | slowest step ms |\n|---|---|---|---|---|"
    )
    for case in cases:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
            rows = process.submit(hours_of, case, hours).result()
        for hour, (memory, mean, slowest) in enumerate(rows, 1):
            print(f"| {case} | {hour} | {memory:.0f} | {mean:.3f} | {slowest:.0f} |", flush=True)
