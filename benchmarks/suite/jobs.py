"""A suite, its jobs, and the result of one."""

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

from limslam_agent.runs.run_spec import RunSpec
from limslam_env.messages import counted

LAPS_POLICY = "laps"
KIDNAPPED = "kidnapped"
RANDOM = "random:"
PLAN = "plan:"
OWN_PLAN = f"{RANDOM}seed"
"""The floor plan of the job's own seed."""

# No suite sets these, so that they are not part of a job's digest.
_UNUSED = {"kidnap_at", "unknown_starts", "imu", "map"}

Metric: TypeAlias = float | int | str | None


@dataclass(frozen=True)
class Job(RunSpec):
    """One run of a suite. The seed is a field of the job, so that engine and order do not change
    the result.

    A world can also be ``plan:NAME``, a wall list in the data folder, or ``random:seed``, the floor
    plan of the job's seed.
    """

    preset: str = "paper"
    until: str = "seen"
    # A fault of :mod:`benchmarks.suite.faults` that begins in the middle of the run; None for a
    # healthy robot
    fault: str | None = None
    # fault_time, after_fault: the earliest and the latest time at which the fault begins, s (the
    # seed chooses), and how long the robot drives after that, s, in place of ``max_time``
    fault_time: tuple[float, float] = (80.0, 120.0)
    after_fault: float = 40.0

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "world", self.world.replace(OWN_PLAN, f"{RANDOM}{self.seed}"))

    @property
    def key(self) -> str:
        """Digest of all fields of the job: 16 hexadecimal digits."""
        return digest({name: each for name, each in asdict(self).items() if name not in _UNUSED})

    @property
    def identity(self) -> dict[str, Any]:
        """The fields that identify the job in a line of results."""
        names = ("world", "noise", "robots", "preset", "policy", "ablation", "laps", "seed")
        policy = (
            LAPS_POLICY if self.laps and self.policy == "frontier" else self.fault or self.policy
        )
        return {**{name: getattr(self, name) for name in names}, "policy": policy, "key": self.key}

    @property
    def title(self) -> str:
        """A description of the job in one line, for display."""
        parts = [
            self.world,
            f"{self.robots} robots" if self.robots > 1 else "",
            f"{100 * self.noise:g} cm",
            self.preset,
            self.ablation,
            str(self.identity["policy"]),
            f"seed {self.seed}",
            counted(self.laps, "lap") if self.laps else "",
        ]
        return ", ".join(part for part in parts if part)


@dataclass(frozen=True)
class Suite:
    """A suite of jobs, of which no two are equal. The digest is that of the jobs and of the content
    of their worlds.
    """

    name: str
    jobs: tuple[Job, ...]
    digest: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of a successful job: metrics and cost as in a run's ``result.json``.

    :mod:`benchmarks.suite.runner` adds ``job_s`` and ``job_cpu_s`` to ``cost``, of the whole job
    with its scores. ``config`` is a digest of the agent's settings, the robot, and the world.
    """

    metrics: dict[str, Metric]
    cost: dict[str, float]
    config: str


def digest(content: Any) -> str:
    """Digest of content that JSON can represent: 16 hexadecimal digits."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
