"""How many times faster than its robot an exploring agent is, part by part: ``python -m benchmarks.speed.run``.

The runs are those of ``limslam run`` with default settings, without the start of the program, the final smoothing and
the pictures. The time is processor time, which a busy machine changes less than the time by the clock.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

from limslam_agent.cli.main import collect_rarely
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.mapping.renewal import Renewal
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.places.recovery import Recovery
from limslam_agent.policies import frontier_policy
from limslam_agent.policies.collision_guard import CollisionGuard
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.monitor import StatusMonitor
from limslam_env.envs.parallel_env import LimSlamParallelEnv

BAR = 200.0
"""How many times faster than its robot the agent should be in Env1."""

WORLDS = ("env1", "env3", "random:110")

PARTS: dict[str, tuple[tuple[Any, str], ...]] = {
    "simulation": ((LimSlamParallelEnv, "step"),),
    "SLAM": ((LineSlam, "step"),),
    "grid": ((OccupancyGrid, "update"),),
    "status": ((StatusMonitor, "observe"), (StatusMonitor, "check")),
    "recovery": ((Recovery, "note"),),
    "renewal": ((Renewal, "note"), (Renewal, "renew_if_due")),
    "observing, all of it": ((Mapper, "step"),),
    "planning": ((frontier_policy, "next_target"),),
    "collision guard": ((CollisionGuard, "add_readings"), (CollisionGuard, "limit_speed")),
    "deciding, all of it": ((LimSlamTeam, "decide"),),
}
"""The functions whose time makes a part. Observing has the parts from SLAM to renewal; deciding has the next two."""


@contextmanager
def timed_parts() -> Iterator[dict[str, float]]:
    """Processor time of each part, s, while the context is open."""
    spent = dict.fromkeys(PARTS, 0.0)

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            begin = time.process_time()
            try:
                return function(*arguments, **named)
            finally:
                spent[name] += time.process_time() - begin

        return call

    patches = [
        patch.object(owner, attribute, timed(name, getattr(owner, attribute)))
        for name, functions in PARTS.items()
        for owner, attribute in functions
    ]
    for each in patches:
        each.start()
    try:
        yield spent
    finally:
        for each in patches:
            each.stop()


def measured(config: RunConfig, clock: Callable[[], float] = time.process_time) -> tuple[float, int]:
    """Time of a run, s, and its number of steps."""
    begin = clock()
    episode = run_episode(config)
    return clock() - begin, len(episode.time)


def times_faster(
    world: str, runs: int, clock: Callable[[], float] = time.process_time, max_time: float = 1800.0
) -> float:
    """Simulated time over the time of the run, after a first run that loads what is needed: the median of runs."""
    period, found = RunConfig(world).robot.control_period, []
    for seed in range(runs + 1):
        used, steps = measured(RunConfig(world, 0.02, seed=seed, max_time=max_time, until="walls"), clock)
        found.append(steps * period / used)
    return float(np.median(found[1:]))


def parts_of_step(world: str, max_time: float = 1800.0) -> dict[str, float]:
    """Processor time of each part, us a step, in one run; and of all of it."""
    with timed_parts() as spent:
        used, steps = measured(RunConfig(world, 0.02, max_time=max_time, until="walls"))
    return {name: 1e6 * seconds / steps for name, seconds in (spent | {"all": used}).items()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table for some worlds. The arguments are those of the command line unless they are given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=5, help="runs in each world, of which the median counts")
    parser.add_argument("--max-time", type=float, default=1800.0, help="longest simulated time of a run, s")
    parser.add_argument("worlds", nargs="*", default=WORLDS)
    chosen = parser.parse_args(arguments)
    collect_rarely()
    print("| world | x real time | " + " | ".join(f"{name}, us" for name in (*PARTS, "all")) + " |")
    print("|---" * (len(PARTS) + 3) + "|")
    for world in chosen.worlds:
        ratio = times_faster(world, chosen.runs, max_time=chosen.max_time)
        parts = parts_of_step(world, chosen.max_time)
        print(f"| {world} | {ratio:.0f} | " + " | ".join(f"{each:.0f}" for each in parts.values()) + " |", flush=True)


if __name__ == "__main__":
    main()
