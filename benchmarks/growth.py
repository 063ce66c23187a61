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


ROBOT = RobotSpec()


def _laps() -> Iterator[Observation]:
    """Laps of a world, for ever, driven by somebody who knows the true pose."""
    world = load_world(_WORLD)
    env = LimSlamEnv(world, robot=ROBOT, sensor_noise=_NOISE, coverage_goal=None)
    tour = Tour(ROBOT, lambda pose: loop_tour(world, ROBOT, pose, 1), tours=10**6)
    seen, info = env.reset(seed=0)
    while True:
        yield seen
        tour.observe_truth(info["pose"])
        seen, _, _, _, info = env.step(tour.act(None))


def _jumping() -> Iterator[Observation]:
    """Laps in which the odometry jumps once."""
    for number, seen in enumerate(_laps()):
        jump = _JUMP if number == _FIRST - 1 else 0.0
        yield Observation(ranges=seen["ranges"], wheels=seen["wheels"] + jump)


def _standing(seen: Observation) -> Iterator[Observation]:
    """What a robot observes that stands where it has seen something, for ever."""
    generator = np.random.default_rng(0)
    ranges = np.asarray(seen["ranges"], dtype=float)
    noise = np.where(ranges < ROBOT.too_far, _NOISE, 0.0)
    while True:
        shaken = ranges + noise * generator.standard_normal(len(ranges))
        yield Observation(ranges=shaken, wheels=np.zeros(2))


def _stands_after(drive: Iterable[Observation], mapper: Mapper) -> Iterator[None]:
    """The steps of a mapper in a drive, and then of a robot that stands."""
    for seen in drive:
        last = seen
        mapper.step(seen)
        yield
    for seen in _standing(last):
        mapper.step(seen)
        yield


def drives(config: AgentConfig | None = None) -> Iterator[None]:
    """A robot drives laps."""
    return _stands_after(_laps(), Mapper(ROBOT, config))


def stands(config: AgentConfig | None = None) -> Iterator[None]:
    """A robot stands after a drive."""
    return _stands_after(itertools.islice(_laps(), _FIRST), Mapper(ROBOT, config))


def lost(config: AgentConfig | None = None) -> Iterator[None]:
    """A robot stands after its odometry has jumped, and it is lost."""
    return _stands_after(itertools.islice(_jumping(), _FIRST), Mapper(ROBOT, config))


def placed(config: AgentConfig | None = None) -> Iterator[None]:
    """A robot stands after it has found its place again, which is not confirmed."""
    mapper = Mapper(ROBOT, config)
    until_found = itertools.takewhile(
        lambda _: "found" not in [each["event"] for each in mapper.places.records], _jumping()
    )
    return _stands_after(itertools.islice(until_found, HOUR), mapper)


def blind(_config: AgentConfig | None = None) -> Iterator[None]:
    """The graph of a log of poses: a robot moves where its beams see nothing."""
    graph = _graph()
    nothing = np.zeros(len(ROBOT.beams), dtype=bool)
    for number in itertools.count():
        pose = np.array([0.1 * _SPEED * number, 0.0, 0.0])
        graph.step(0.1 * number, pose, ROBOT.max_ranges, nothing)
        yield


def log(_config: AgentConfig | None = None) -> Iterator[None]:
    """The graph of a log of poses: laps."""
    graph = _graph()
    pose = np.zeros(3)
    for number, seen in enumerate(_laps()):
        wheels = np.asarray(seen["wheels"], dtype=float)
        pose = se2.compose(pose, se2.arc(*se2.wheels_to_arc(wheels, ROBOT.axle)))
        ranges = np.asarray(seen["ranges"], dtype=float)
        graph.step(0.1 * number, pose, ranges, (ranges > ROBOT.too_near) & (ranges < ROBOT.too_far))
        yield


def _graph() -> OnlineGraph:
    nothing = np.zeros((0, len(ROBOT.beams)))
    beams = ROBOT.beam_origins, ROBOT.beam_angles, float(ROBOT.max_ranges.max())
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
