"""The ``[train]`` table of a suite: training data, duration, and evaluation."""

from dataclasses import dataclass
from typing import Annotated, Literal

from benchmarks.suite.jobs import RANDOM, Job
from limslam_agent.config.bounds import Bounded, Bounds, Count, NonNegative, Positive

Pose = Literal["true", "odometry", "belief"]

_Many = Annotated[int, Bounds(1, 10**12)]
_Seed = Annotated[int, Bounds(0, 10**12)]
_ShareAbove0 = Annotated[float, Bounds(1e-6, 1.0)]


@dataclass(frozen=True)
class Phase(Bounded):
    """A phase of the training.

    Attributes
    ----------
    pose
        The pose by which the robots' grids are drawn (see `benchmarks.training.explore_env.ExploreConfig`).
    decisions
        Number of decisions in the phase, over all robots.
    """

    pose: Pose
    decisions: _Many


@dataclass(frozen=True)
class Plans(Bounded):
    """Floor plans by their seeds: ``count`` successive seeds from ``first``."""

    first: _Seed
    count: Count

    @property
    def seeds(self) -> range:
        """The seeds of the floor plans."""
        return range(self.first, self.first + self.count)


@dataclass(frozen=True)
class TrainConfig(Bounded):
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
    noise: NonNegative = 0.02
    robots: Count = 64
    rollout: Count = 64
    batch: Count = 512
    epochs: Count = 3
    learning_rate: Positive = 5e-4
    gamma: _ShareAbove0 = 0.98
    entropy: NonNegative = 0.01
    coverage_goal: _ShareAbove0 = 0.9
    max_time: Positive = 200.0
    time_cost: NonNegative = 0.02
    collision_cost: NonNegative = 0.02
    try_every: _Many = 200_000
    minutes: Positive = 20.0
    seed: _Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.phases:
            raise ValueError("phases: there must be at least one")
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
