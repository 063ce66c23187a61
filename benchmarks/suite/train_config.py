"""The ``[train]`` table of a suite: training data, duration, and evaluation."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

from benchmarks.suite.jobs import RANDOM, Job

Pose = Literal["true", "odometry", "belief"]


@dataclass(frozen=True)
class Phase:
    """A phase of the training.

    Attributes
    ----------
    pose
        The pose by which the robots' grids are drawn (see `benchmarks.training.explore_env.ExploreConfig`).
    decisions
        Number of decisions in the phase, over all robots.
    """

    pose: Pose
    decisions: int

    def __post_init__(self) -> None:
        if self.pose not in get_args(Pose):
            raise ValueError(f"pose: must be one of {', '.join(get_args(Pose))}, not {self.pose!r}")
        _check("decisions", self.decisions, int, lambda value: value >= 1, "1 or more")


@dataclass(frozen=True)
class Plans:
    """Floor plans by their seeds: ``count`` successive seeds from ``first``."""

    first: int
    count: int

    def __post_init__(self) -> None:
        _check("first", self.first, int, lambda value: value >= 0, "0 or more")
        _check("count", self.count, int, lambda value: value >= 1, "1 or more")

    @property
    def seeds(self) -> range:
        """The seeds of the floor plans."""
        return range(self.first, self.first + self.count)


@dataclass(frozen=True)
class TrainConfig:
    """The settings of a training by PPO (Schulman et al. 2017) with a fixed budget.

    Attributes
    ----------
    phases
        The successive phases; each phase writes its weights.
    plans, held_out
        Floor plans for training, and floor plans for periodic evaluation.
    noise
        Standard deviation of the ranges, m.
    robots, rollout
        Number of robots that drive at once, and number of decisions of each robot in a rollout.
    batch, epochs, learning_rate, gamma, entropy
        Parameters of PPO. Learning rate and entropy weight decrease to a twentieth.
    coverage_goal, max_time
        An episode ends at this coverage, or after this time, s.
    time_cost, collision_cost
        Costs that are subtracted from the reward (new area in m^2) for each step of 0.1 s, and for each such step in
        contact.
    try_every
        Number of decisions between two evaluations on the held-out plans.
    minutes
        Processor time after which training always stops, min. With processor time, the same budget gives the same
        policy on a busy machine, too. One thread does the work, so that on an idle machine processor time equals
        wall-clock time.
    seed
        Seed of all random numbers.

    Raises
    ------
    ValueError
        If a number is out of bounds, or a plan is used both for training and for evaluation.
    """

    phases: tuple[Phase, ...]
    plans: Plans
    held_out: Plans
    noise: float = 0.02
    robots: int = 64
    rollout: int = 64
    batch: int = 512
    epochs: int = 3
    learning_rate: float = 5e-4
    gamma: float = 0.98
    entropy: float = 0.01
    coverage_goal: float = 0.9
    max_time: float = 200.0
    time_cost: float = 0.02
    collision_cost: float = 0.02
    try_every: int = 200_000
    minutes: float = 20.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.phases:
            raise ValueError("phases: there must be at least one")
        for name in ("robots", "rollout", "batch", "epochs", "try_every"):
            _check(name, getattr(self, name), int, lambda value: value >= 1, "1 or more")
        _check("seed", self.seed, int, lambda value: value >= 0, "0 or more")
        for name in ("learning_rate", "max_time", "minutes"):
            _check(name, getattr(self, name), float, lambda value: value > 0.0, "above 0")
        for name in ("noise", "entropy", "time_cost", "collision_cost"):
            _check(name, getattr(self, name), float, lambda value: value >= 0.0, "0 or more")
        for name in ("gamma", "coverage_goal"):
            _check(name, getattr(self, name), float, lambda value: 0.0 < value <= 1.0, "above 0 and at most 1")
        if set(self.plans.seeds) & set(self.held_out.seeds):
            raise ValueError("held_out: shares floor plans with those that are learned on")

    def check_apart(self, jobs: list[Job]) -> None:
        """Check that no job uses a floor plan of the training.

        Raises
        ------
        ValueError
            If a job uses such a floor plan.
        """
        for job in jobs:
            seed = job.world.removeprefix(RANDOM)
            if job.world.startswith(RANDOM) and seed.isdigit() and int(seed) in self.plans.seeds:
                raise ValueError(f"plans: {job.world} is learned on and is in a grid, too")


def train_config(table: Any) -> TrainConfig:
    """The training that a table describes. Unknown content raises an error.

    Raises
    ------
    ValueError
        If the table is not a valid training; the message names the key.
    """
    known = _table(table, TrainConfig, "a training")
    phases = known.get("phases")
    if not isinstance(phases, list):
        raise ValueError(f"phases: must be a list of tables, not {phases!r}")  # noqa: TRY004 (a value of a file)
    known["phases"] = tuple(Phase(**_table(part, Phase, "a phase")) for part in phases)
    for name in ("plans", "held_out"):
        known[name] = Plans(**_table(known.get(name), Plans, name))
    return TrainConfig(**known)


def _table(table: Any, kind: type[Any], what: str) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise ValueError(f"{what} must be a table, not {table!r}")  # noqa: TRY004 (a value of a file)
    names = {part.name for part in fields(kind)}
    if unknown := sorted(set(table) - names):
        raise ValueError(f"unknown key {unknown[0]!r}; {what} has {', '.join(sorted(names))}")
    needed = {"phases", "plans", "held_out"} if kind is TrainConfig else names
    if missing := sorted(needed - set(table)):
        raise ValueError(f"the key {missing[0]!r} of {what} is missing")
    return dict(table)


def _check(name: str, value: Any, kind: type, is_good: Callable[[Any], bool], wanted: str) -> None:
    kinds = {int} if kind is int else {int, float}
    if type(value) not in kinds or not math.isfinite(value) or not is_good(value):
        what = "a whole number" if kind is int else "a number"
        raise ValueError(f"{name}: must be {what}, {wanted}, not {value!r}")
