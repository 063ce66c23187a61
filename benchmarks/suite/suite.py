"""Suite files: TOML files that define jobs. Unknown content raises an error and is never
ignored.
"""

import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence, Sized
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.suite.jobs import RANDOM, Job, Suite, digest
from benchmarks.suite.runner import contents, run_config
from limslam_agent.config.tables import built, read_toml
from limslam_env.messages import described, one_line

FOLDER = Path(__file__).parent / "suites"
NO_ABLATION = "none"
T = TypeVar("T")
MAX_JOBS = 5000
"""Most jobs of a suite."""


@dataclass(frozen=True)
class _Seeds:
    """Successive seeds."""

    first: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MAX_JOBS:
            raise ValueError(f"a grid has 1 to {MAX_JOBS} seeds, not {described(self.count)}")


@dataclass(frozen=True)
class _Grid:
    """A table ``[[grid]]``: a product of all its lists. Its keys are those of a job."""

    worlds: tuple[str, ...]
    noises: tuple[float, ...]
    seeds: tuple[int, ...] | _Seeds
    robots: tuple[int, ...] = (1,)
    presets: tuple[str, ...] = ("paper",)
    policies: tuple[str, ...] = ("frontier",)
    ablations: tuple[str, ...] = (NO_ABLATION,)
    laps: tuple[int, ...] = (0,)
    faults: tuple[str | None, ...] = (None,)
    fault_time: tuple[float, float] = (80.0, 120.0)
    after_fault: float = 40.0
    max_time: float = 1800.0
    until: str = "seen"
    limit: bool = False

    def jobs(self, first_seed: int | None) -> list[Job]:
        """The jobs, with seeds that are moved so that ``first_seed`` is the lowest one. One more
        than ``MAX_JOBS`` stands for all that are too many.
        """
        seeds = self.seeds
        chosen = (
            seeds if isinstance(seeds, tuple) else range(seeds.first, seeds.first + seeds.count)
        )
        moved = 0 if first_seed is None else first_seed - min(chosen, default=0)
        axes: dict[str, Sequence[Any]] = {
            "world": list(_first_jobs(each for world in self.worlds for each in _worlds(world))),
            "noise": self.noises,
            "robots": self.robots,
            "preset": self.presets,
            "policy": self.policies,
            "ablation": [None if each == NO_ABLATION else each for each in self.ablations],
            "laps": self.laps,
            "fault": self.faults,
            "seed": [seed + moved for seed in chosen],
        }
        fixed = ("fault_time", "after_fault", "max_time", "until", "limit")
        same: dict[str, Any] = {name: getattr(self, name) for name in fixed}
        return [
            Job(**dict(zip(axes, each, strict=True)), **same)
            for each in _first_jobs(itertools.product(*axes.values()))
        ]


@dataclass(frozen=True)
class _File:
    """A suite file."""

    name: str
    description: str
    grid: tuple[_Grid, ...]

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_-]+", self.name):
            raise ValueError(f"name: {self.name!r} must be made of letters, digits, - and _")


def shipped_suites() -> list[str]:
    """Names of the suites that are shipped with the benchmarks."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load_suite(source: str, first_seed: int | None = None) -> Suite:
    """A suite by the name of a shipped suite, or by the path of a TOML file.

    With ``first_seed``, the seeds of each grid are moved so that this is the lowest one.

    Raises
    ------
    ValueError
        If there is no such suite, the suite is invalid, or one of its jobs cannot be run; the
        message names the file.
    """
    path = FOLDER / f"{source}.toml" if source in shipped_suites() else Path(source)
    if path.suffix != ".toml":
        raise ValueError(
            f"no suite is called {source!r}; there are {', '.join(shipped_suites())}, or give a "
            ".toml file"
        )
    label = path.name if path.parent == FOLDER else str(path)
    file = built(_File, read_toml(path), label)
    with _named(label):
        jobs = list(_first_jobs(_checked(file.grid, first_seed)))
        _check_count(jobs)
        if not jobs:
            raise ValueError("holds no jobs")
        for title, count in Counter(job.title for job in jobs).items():
            if count > 1:
                raise ValueError(f"{count} jobs are the same to the tables: {title}")
        known = digest([sorted(job.key for job in jobs), contents(jobs)])
        return Suite(file.name, tuple(jobs), known)


def _checked(grids: tuple[_Grid, ...], first_seed: int | None) -> Iterator[Job]:
    """The jobs of grids, all of which can be run. Jobs that differ in their seeds only are checked
    once.
    """
    for number, grid in enumerate(grids, 1):
        with _named(f"[[grid]] {number}"):
            jobs = grid.jobs(first_seed)
            _check_count(jobs)
            for job in {_without_seed(job): job for job in reversed(jobs)}.values():
                with _named(job.title):
                    run_config(job)
            yield from jobs


def _without_seed(job: Job) -> Job:
    """A job without its seed. Each floor plan of a range stands for all of them, since a check
    takes long.
    """
    return replace(job, world=re.sub(rf"^{RANDOM}\d+", f"{RANDOM}0", job.world), seed=0)


def _first_jobs(jobs: Iterable[T]) -> Iterator[T]:
    """As many jobs as a suite can have, and one more."""
    return itertools.islice(jobs, MAX_JOBS + 1)


def _check_count(jobs: Sized) -> None:
    if len(jobs) > MAX_JOBS:
        raise ValueError(f"a suite has at most {MAX_JOBS} jobs, and these are more")


def _worlds(world: str) -> Iterable[str]:
    """The worlds that a text in a file stands for: ``random:0..99`` for 100 worlds."""
    several = re.fullmatch(rf"{RANDOM}(\d{{1,6}})\.\.(\d{{1,6}})", world)
    if several is None:
        return [world]
    first = int(several[1])
    last = int(several[2])
    if last < first:
        raise ValueError(
            f"worlds: {described(world)} names no floor plans: the last comes before the first"
        )
    return (f"{RANDOM}{seed}" for seed in range(first, last + 1))


@contextmanager
def _named(label: str) -> Iterator[None]:
    """Prefix the message of an error with the name of its subject."""
    try:
        yield
    except ValueError as error:
        raise ValueError(one_line(f"{label}: {error}")) from error
