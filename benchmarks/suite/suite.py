"""Suite files: TOML files that define jobs. Unknown content raises an error and is never ignored."""

import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.suite.jobs import LOG, LOG_POLICY, RANDOM, Job, LogSource, digest
from benchmarks.suite.train_config import TrainConfig
from benchmarks.suite.work import check_log, contents, run_config
from limslam_agent.config.tables import built
from limslam_agent.safe_files import read_limited
from limslam_env.messages import described, one_line
from limslam_env.toml_text import parse_toml

FOLDER = Path(__file__).parent / "suites"
NO_ABLATION = "none"
MAX_SUITE_BYTES = 1_000_000
MAX_SEEDS = 100_000


@dataclass(frozen=True)
class Suite:
    """A suite of jobs.

    Attributes
    ----------
    name, description
        Name and description from the file.
    jobs
        All jobs; no two jobs are equal.
    digest
        Digest of the jobs, and of the content of the worlds and logs that they use.
    train
        Settings of the training by `python -m benchmarks train`; None without training.
    """

    name: str
    description: str
    jobs: tuple[Job, ...]
    digest: str
    train: TrainConfig | None = None


@dataclass(frozen=True)
class _Kind:
    """The valid values of a list."""

    name: str
    is_one: Callable[[Any], bool]


_TEXT = _Kind("texts", lambda value: isinstance(value, str) and bool(value))
_WHOLE = _Kind("whole numbers", lambda value: type(value) is int)
# The comparison is false for nan, and works for whole numbers that no float can hold.
_NUMBER = _Kind("numbers", lambda value: type(value) in {int, float} and abs(value) < 1e300)

_AXES: dict[str, tuple[str, _Kind, list[Any] | None]] = {
    "worlds": ("world", _TEXT, None),
    "noises": ("noise", _NUMBER, None),
    "robots": ("robots", _WHOLE, [1]),
    "presets": ("preset", _TEXT, ["paper"]),
    "policies": ("policy", _TEXT, ["frontier"]),
    "ablations": ("ablation", _TEXT, [NO_ABLATION]),
    "laps": ("laps", _WHOLE, [0]),
    "faults": ("fault", _TEXT, [None]),
}
"""For each list of a grid: the field of the job, the kind of values, and the default (None: the list is required)."""

_FAULT_KEYS = ("fault_time", "after_fault")
_SHARED = (*_FAULT_KEYS, "until", "max_time", "limit")
_LOG_AXES = ("noises", "presets", "ablations")


def shipped_suites() -> list[str]:
    """Names of the suites that are shipped with the benchmarks."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load_suite(source: str, first_seed: int | None = None) -> Suite:
    """A suite by the name of a shipped suite, or by the path of a TOML file.

    With ``first_seed``, the seeds of each grid are moved so that this is the lowest one.

    Raises
    ------
    ValueError
        If there is no such suite, or the suite is invalid; the message names file and key.
    """
    path = FOLDER / f"{source}.toml" if source in shipped_suites() else Path(source)
    if path.suffix != ".toml":
        raise ValueError(
            f"no suite is called {source!r}; there are {', '.join(shipped_suites())}, or give a .toml file"
        )
    try:
        text = read_limited(path, MAX_SUITE_BYTES).decode("utf-8").replace("\r\n", "\n")
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    return parse_suite(text, path.name if path.parent == FOLDER else str(path), first_seed)


def parse_suite(text: str, label: str, first_seed: int | None = None) -> Suite:
    """A suite from the text of a TOML file; ``label`` is the name of the file in error messages.

    With ``first_seed``, the seeds of each grid are moved so that this is the lowest one.

    Raises
    ------
    ValueError
        If the text is not a valid suite, or one of its jobs cannot be run.
    """
    with _named(label):
        try:
            table = parse_toml(text)
        except ValueError as error:
            raise ValueError(f"not TOML: {error}") from error
        _check_keys(table, "a suite", {"name", "description"}, {"grid", "log", "train"})
        name, description = (_one(table, key, _TEXT) for key in ("name", "description"))
        if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
            raise ValueError(f"name: {name!r} must be made of letters, digits, - and _")
        if first_seed is not None and "grid" not in table:
            raise ValueError("--first-seed: there is no [[grid]], and so no seed to move")
        jobs = [*_jobs(table, "grid", partial(_grid, first_seed=first_seed)), *_jobs(table, "log", _log)]
        if not jobs:
            raise ValueError("holds no jobs: [[grid]] or [[log]] makes them")
        for title, count in Counter(job.title for job in jobs).items():
            if count > 1:
                raise ValueError(f"{count} jobs are the same to the tables: {title}")
        known = digest([sorted(job.key for job in jobs), contents(jobs)])
        return Suite(name, description, tuple(jobs), known, _train(table, jobs))


def _jobs(table: dict[str, Any], key: str, make: Callable[[dict[str, Any]], list[Job]]) -> Iterator[Job]:
    parts = table.get(key, [])
    if not (isinstance(parts, list) and all(isinstance(part, dict) for part in parts)):
        raise ValueError(f"{key}: must be tables, each under [[{key}]]")
    for number, part in enumerate(parts, 1):
        with _named(f"[[{key}]] {number}"):
            yield from make(part)


def _train(table: dict[str, Any], jobs: list[Job]) -> TrainConfig | None:
    if "train" not in table:
        return None
    config = built(TrainConfig, table["train"], "[train]")
    with _named("[train]"):
        config.check_apart(jobs)
    return config


def _grid(table: dict[str, Any], first_seed: int | None) -> list[Job]:
    needed = {key for key, (_, _, default) in _AXES.items() if default is None} | {"seeds"}
    _check_keys(table, "a grid", needed, {*_AXES, *_SHARED} - needed)
    axes = _axes(table, _AXES)
    axes["seed"] = _seeds(table["seeds"])
    if first_seed is not None:
        axes["seed"] = [first_seed + seed - min(axes["seed"]) for seed in axes["seed"]]
    shared = _fault_keys(table)
    if "until" in table:
        shared["until"] = _one(table, "until", _TEXT)
    if "max_time" in table:
        shared["max_time"] = float(_one(table, "max_time", _NUMBER))
        with _named("max_time"):
            run_config(Job("square", 0.0, max_time=shared["max_time"]))
    if "limit" in table:
        shared["limit"] = _one(table, "limit", _Kind("true or false", lambda value: isinstance(value, bool)))
    jobs = [Job(**dict(zip(axes, values, strict=True)), **shared) for values in itertools.product(*axes.values())]
    for job in {_combination(job): job for job in reversed(jobs)}.values():
        with _named(job.world):
            run_config(job)
    return jobs


def _fault_keys(table: dict[str, Any]) -> dict[str, Any]:
    """When the faults of a grid begin, and how long the robots drive after that."""
    shared: dict[str, Any] = {}
    if unused := [key for key in _FAULT_KEYS if key in table and "faults" not in table]:
        raise ValueError(f"{unused[0]}: goes with faults")
    if "faults" in table and "max_time" in table:
        raise ValueError("max_time: does not go with faults, after which robots drive for after_fault seconds")
    if "fault_time" in table:
        shared["fault_time"] = tuple(float(value) for value in _values(table, "fault_time", _NUMBER))
    if "after_fault" in table:
        shared["after_fault"] = float(_one(table, "after_fault", _NUMBER))
    return shared


def _combination(job: Job) -> Job:
    """Reduce a job to the fields whose combination must be checked.

    Seed and noise are compatible with every job. Fields that fit one random floor plan fit all random floor plans.

    Each world was checked separately before. A check takes long, and a grid may have hundreds of floor plans.
    """
    world = f"{RANDOM}0" if job.world.startswith(RANDOM) else job.world
    return replace(job, world=world, seed=0, noise=0.0)


def _log(table: dict[str, Any]) -> list[Job]:
    _check_keys(table, "a log", {"name", "file", "beams"}, {"relations", "max_range", "odometry_bias", *_LOG_AXES})
    axes = _axes({"noises": [0.02], **table}, {key: _AXES[key] for key in _LOG_AXES})
    known: dict[str, Any] = {key: _one(table, key, _TEXT) for key in ("name", "file", "relations") if key in table}
    known["beams"] = tuple(float(angle) for angle in _values(table, "beams", _NUMBER))
    if "max_range" in table:
        known["max_range"] = float(_one(table, "max_range", _NUMBER))
    if "odometry_bias" in table:
        known["odometry_bias"] = tuple(float(value) for value in _values(table, "odometry_bias", _NUMBER))
    source = LogSource(**known)
    check_log(source)
    return [
        Job(LOG + source.name, policy=LOG_POLICY, log=source, **dict(zip(axes, values, strict=True)))
        for values in itertools.product(*axes.values())
    ]


def _axes(table: dict[str, Any], known: dict[str, tuple[str, _Kind, list[Any] | None]]) -> dict[str, list[Any]]:
    """Values of each field of the job. Each value is checked separately, so that an error can name its key."""
    axes = {}
    for key, (name, kind, default) in known.items():
        values = default if default is not None and key not in table else _values(table, key, kind)
        with _named(key):
            meant = [_meant(key, value) for value in values]
            # The first floor plan of a range stands for all of them: a check takes long, and each run checks its own.
            for first, *_ in meant:
                run_config(replace(Job("square", 0.0), **{name: first}))
            axes[name] = list(itertools.chain.from_iterable(meant))
    return axes


def _meant(key: str, value: Any) -> list[Any]:
    """The values that a value in a file represents: ``random:0..99`` for 100 worlds, ``none`` for no ablation."""
    if key == "noises":
        return [float(value)]
    if key == "ablations" and value == NO_ABLATION:
        return [None]
    if key == "worlds" and (several := re.fullmatch(rf"{RANDOM}(\d{{1,6}})\.\.(\d{{1,6}})", value)):
        first, last = int(several[1]), int(several[2])
        if last < first:
            raise ValueError(f"{described(value)} names no floor plans: the last comes before the first")
        return [f"{RANDOM}{seed}" for seed in range(first, last + 1)]
    return [value]


def _seeds(value: Any) -> list[int]:
    if isinstance(value, dict):
        with _named("seeds"):
            _check_keys(value, "a range of seeds", {"first", "count"}, set())
            first, count = (_one(value, key, _WHOLE) for key in ("first", "count"))
            if first < 0 or count < 1:
                raise ValueError("first must be 0 or more, and count 1 or more")
            if count > MAX_SEEDS:
                raise ValueError(f"count is {described(count)}; a grid has up to {MAX_SEEDS} seeds")
            return list(range(first, first + count))
    seeds = _values({"seeds": value}, "seeds", _WHOLE)
    if min(seeds) < 0:
        raise ValueError(f"seeds: a seed is 0 or more, not {min(seeds)}")
    return seeds


def _values(table: dict[str, Any], key: str, kind: _Kind) -> list[Any]:
    values = table[key]
    if not isinstance(values, list) or not values or not all(kind.is_one(value) for value in values):
        raise ValueError(f"{key}: must be a list of {kind.name} with at least one in it, not {described(values)}")
    return values


def _one(table: dict[str, Any], key: str, kind: _Kind) -> Any:
    if not kind.is_one(table[key]):
        raise ValueError(f"{key}: must be {kind.name.removesuffix('s')}, not {described(table[key])}")
    return table[key]


def _check_keys(table: dict[str, Any], what: str, needed: set[str], optional: set[str]) -> None:
    if unknown := sorted(table.keys() - needed - optional):
        raise ValueError(f"unknown key {unknown[0]!r}; {what} has {', '.join(sorted(needed | optional))}")
    if missing := sorted(needed - table.keys()):
        raise ValueError(f"the key {missing[0]!r} is missing")


@contextmanager
def _named(label: str) -> Iterator[None]:
    """Prefix the message of an error with the name of its subject."""
    try:
        yield
    except ValueError as error:
        raise ValueError(one_line(f"{label}: {error}")) from error
