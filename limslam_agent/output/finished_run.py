"""Reads the folder of a finished run or replay."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count, takewhile
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.map_file import read_map_file
from limslam_agent.output.claims import OutputError, hidden, repair
from limslam_agent.output.run_folder import RESULT_FILE
from limslam_agent.output.tum import read_tum
from limslam_agent.safe_files import load_arrays, read_limited
from limslam_env.geometry import FloatArray
from limslam_env.messages import counted, one_line

MAP = "map.json"
LOG = "log.npz"
PICTURE = "map.png"
WORLD = "world.toml"
COVARIANCES = "covariance_est.npz"
UNPLACED = "map_unplaced.json"
_KINDS = {"estimated": "est", "odometry": "odometry", "true": "true", "smoothed": "smoothed"}


class FolderError(ValueError):
    """A folder is not a finished run, or a file in it cannot be read. The message says which and
    why.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


@dataclass(frozen=True, eq=False, repr=False)
class FinishedRun:
    """The content of a folder."""

    folder: Path
    result: dict[str, Any]  # content of ``result.json``
    segments: FloatArray  # Walls of the map (k, 4), m
    time: FloatArray  # (n,), s
    estimated: list[FloatArray]  # Estimated poses of each robot (n, 3), m and rad
    # Poses by odometry alone, true poses, and smoothed poses of each robot. Empty where they are
    # unknown.
    odometry: list[FloatArray]
    true: list[FloatArray]
    smoothed: list[FloatArray]
    # Covariances (n, 3, 3) of the estimated and of the smoothed poses of each robot. Empty where
    # they are unknown.
    covariances: list[FloatArray] = field(default_factory=list)
    smoothed_covariances: list[FloatArray] = field(default_factory=list)
    # Times of each log, s, where ``time`` is that of the first log only. Empty where all robots
    # have the same times.
    times: list[FloatArray] = field(default_factory=list)

    def __repr__(self) -> str:
        return f"<FinishedRun {str(self.folder)!r}: {self.title}>"

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        return (self.folder / PICTURE).read_bytes()

    def elapsed(self, number: int) -> FloatArray:
        """Time since a robot's first pose (n,), s."""
        time = self.times[number] if self.times else self.time
        return np.asarray(time - time[0])

    def with_one_time(self) -> "FinishedRun":
        """The run itself. Raises a FolderError if it is of two logs, of which each has times of its
        own.
        """
        if self.times:
            raise FolderError(
                f"{self.folder}: is of two logs with times of their own; use "
                f"{self.folder / 'log_0'}"
            )
        return self

    @property
    def metrics(self) -> dict[str, Any]:
        """The figures of the run by their names in ``docs/metrics.md``."""
        return dict(part_of(self.result, "metrics"))

    @property
    def is_replay(self) -> bool:
        """Whether the folder holds the replay of a log, not a run in a simulated world."""
        return "log" in self.config

    @property
    def config(self) -> dict[str, Any]:
        """The settings of the run."""
        return dict(part_of(self.result, "config"))

    @property
    def title(self) -> str:
        """The settings of the run in a few words."""
        config = self.config
        preset = config.get("preset") or part_of(config, "agent").get("preset", "")
        if self.is_replay:
            return ", ".join(filter(None, (str(config["log"]), str(preset))))
        settings = {"world": self.folder.name, **config, "preset": preset}
        return run_title(settings, len(self.estimated), self.result.get("seed"))


def run_title(config: Mapping[str, Any], robots: int, seed: object) -> str:
    """A run in a few words, from the ``config`` of its ``result.json``. Missing values are left
    out.
    """
    noise = config.get("noise")
    policy = str(config.get("policy", "frontier"))
    parts = (
        str(config["world"]),
        f"{robots} robots" if robots > 1 else "",
        # A damaged file may hold a whole number that no float can hold.
        f"range noise {100.0 * noise:g} cm"
        if isinstance(noise, int | float) and abs(noise) < 1e6
        else "",
        " ".join(filter(None, (str(config["preset"]), config.get("ablation")))),
        "" if policy == "frontier" else policy if ".py:" in policy else policy.replace("_", " "),
        counted(config["laps"], "lap") if config.get("laps") else "",
        f"seed {seed}" if seed is not None else "",
    )
    return ", ".join(filter(None, parts))


def read_run(folder: str | PathLike[str]) -> FinishedRun:
    """Read a folder that ``limslam run`` or ``limslam replay`` has written.

    Results that a process was killed over while it replaced them are first put back in place. In a
    notebook, a run shows its map.

    Parameters
    ----------
    folder
        The folder.

    Returns
    -------
    FinishedRun
        ``metrics``, ``segments`` (k, 4), m, ``time`` (n,), s, and for each robot the poses (n, 3),
        m and rad, ``true``, ``estimated``, ``smoothed`` and ``odometry``, and ``covariances`` and
        ``smoothed_covariances`` (n, 3, 3). What is not known is empty.

    Raises
    ------
    FolderError
        If the folder does not exist, or one of its files is missing, damaged or inconsistent with
        the others.

    Examples
    --------
    >>> import tempfile
    >>> from limslam_agent import command, read_run
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     command(f"run --max-time 1 --preset odometry --out '{folder}/run'")
    ...     run = read_run(f"{folder}/run")
    method ...
    >>> run.true[0].shape, run.metrics["path_m"] < 0.3
    ((11, 3), True)
    """
    folder = Path(folder)
    _check_finished(folder)
    result = _read_json(folder / RESULT_FILE)
    segments = read_walls(folder / MAP)
    tables = {name: _trajectories(folder, kind) for name, kind in _KINDS.items()}
    estimated = tables["estimated"]
    if not estimated:
        raise FolderError(f"{folder}: there is no trajectory_est.tum")
    has_own_times = "logs" in part_of(result, "config")  # of two logs that were replayed together
    counts = [len(table if has_own_times else estimated[0]) for table in estimated]
    for name, found in tables.items():
        if found and [len(table) for table in found] != counts:
            raise FolderError(
                f"{folder}: the trajectories ({_KINDS[name]}) have other robots or times"
            )
    covariances, smoothed_covariances = _covariances(
        folder / COVARIANCES, len(estimated), len(estimated[0])
    )
    return FinishedRun(
        folder,
        result,
        segments,
        estimated[0][:, 0],
        **{name: [table[:, 1:] for table in found] for name, found in tables.items()},
        covariances=covariances,
        smoothed_covariances=smoothed_covariances,
        times=[table[:, 0] for table in estimated] if has_own_times else [],
    )


def _check_finished(folder: Path) -> None:
    """Refuse a folder without a finished run, after results that a killed process has left aside
    are put back.
    """
    if not folder.exists() and hidden(folder.absolute(), "old").exists():
        with suppress(OutputError, OSError):
            repair(folder.absolute())
    if not folder.is_dir():
        raise FolderError(
            f"{folder}: is not a folder"
            if folder.exists()
            else f"{folder}: there is no such folder"
        )
    if not (folder / RESULT_FILE).is_file():
        has_map = (folder / MAP).is_file() and (folder / PICTURE).is_file()
        picture = (
            f"; it holds the map of a live robot, which is drawn in {PICTURE}" if has_map else ""
        )
        raise FolderError(
            f"{folder}: does not hold a finished run: there is no {RESULT_FILE}{picture}"
        )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_limited(path))
    except (ValueError, RecursionError) as error:
        raise FolderError(f"{path}: is not JSON: {error}") from error
    except OSError as error:
        raise FolderError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not isinstance(content, dict):
        raise FolderError(f"{path}: does not hold the content that a run writes")
    return content


def part_of(content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A table of a ``result.json``. Empty if there is none."""
    part = content.get(name)
    return part if isinstance(part, dict) else {}


def read_walls(path: Path) -> FloatArray:
    """The walls (k, 4), m, of a ``map.json``. Raises a FolderError if the file cannot be read, has
    no walls in that form, or has too many.
    """
    try:
        return read_map_file(path)[1]
    except ValueError as error:
        raise FolderError(str(error)) from error


def _trajectories(folder: Path, kind: str) -> list[FloatArray]:
    """Tables (n, 4) of time, x, y and heading for each robot. Empty if there is no file."""
    single = folder / f"trajectory_{kind}.tum"
    several = takewhile(
        Path.is_file, (folder / f"trajectory_{kind}_{number}.tum" for number in count())
    )
    try:
        return [
            np.column_stack(read_tum(path)) for path in ([single] if single.is_file() else several)
        ]
    except ValueError as error:
        raise FolderError(str(error)) from error


def _covariances(path: Path, robots: int, steps: int) -> tuple[list[FloatArray], list[FloatArray]]:
    """Covariances (n, 3, 3) of each robot's estimated and smoothed poses. Earlier versions wrote no
    such file.
    """
    if not path.is_file():
        return [], []
    names = ("estimated", "smoothed")
    try:
        arrays = load_arrays(path, names)
        kinds = [np.asarray(arrays[name], dtype=float) for name in names if name in arrays]
    except (OSError, ValueError) as error:
        raise FolderError(f"{path}: is damaged: {error}") from error
    if not kinds or any(
        kind.shape != (steps, robots, 3, 3) or not np.isfinite(kind).all() for kind in kinds
    ):
        raise FolderError(f"{path}: its covariances do not fit the trajectories")
    estimated, smoothed = ([*kind.swapaxes(0, 1)] for kind in (*kinds, np.empty((0, 0, 3, 3)))[:2])
    return estimated, smoothed
