"""Replays logs of simulated drives that were distorted as real logs are, and counts how many come
out right.

``OPENBLAS_NUM_THREADS=1 python tests/support/distorted_logs.py OUT --number 500 --seed 1`` makes 20
drives and so many logs of them, replays each by the command line, and prints a table. A log is
right if the error of its path, after alignment, is at most twice that of the same drive in a clean
table plus 2 cm; it is named if a message names the cause; else it is wrong. Logs whose cause has to
be named count as right only if it is named, and the option that the message names makes the path
right. OUT keeps the logs and ``results.json``. Seeds by which the program was tuned are not those
to report.
"""

import argparse
import json
import math
import multiprocessing
import re
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.command_line import limslam
from support.distortions import KINDS, Drive, Sheet, distorted, drawn_kinds, plain, write
from support.runs import Folder

from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_env import load_world
from limslam_env.metrics import trajectory_metrics
from limslam_env.robots import ROBOTS

_WORLDS = ("env1", "env2", "env3", "random:{}")
_NOISE = 0.02  # m
# The option that a message names, with its value
_REMEDY = re.compile(r"(--(?:columns|metres-per-tick|axle)) (\S+) reads the table so")
_LEAST_PERIOD = 0.02  # s between rows


@dataclass(frozen=True)
class Outcome:
    """What a replay of a log has come to.

    Attributes
    ----------
    log, drive, kinds
        The log's name, its drive, and its distortions.
    code
        Exit code.
    status
        The status in ``result.json``; empty without results.
    error, clean
        Errors of the path after alignment, m, of this log and of the clean one; NaN without one.
    mended
        The error with the option that a message names, m; NaN where there is none.
    is_named
        Whether a message names the cause.
    has_to_be_named
        Whether the cause has to be named.
    messages
        What stood on standard error.
    command
        The command.
    """

    log: str
    drive: str
    kinds: list[str]
    code: int
    status: str
    error: float
    clean: float
    mended: float
    is_named: bool
    has_to_be_named: bool
    messages: str
    command: str

    @property
    def verdict(self) -> str:
        """One of ``right``, ``named`` and ``wrong``, and ``silent`` for a wrong path that is
        ``ok``.
        """
        bound = 2.0 * self.clean + 0.02
        if self.code not in (0, 2):
            return "wrong"
        if self.has_to_be_named and not self.is_named:
            return "silent" if self.status == "ok" and not self.error <= bound else "wrong"
        if self.has_to_be_named:
            return "right" if self.mended <= bound else "named"
        if self.error <= bound:
            return "right"
        if self.status == "ok":
            return "silent"
        return "named" if self.is_named else "wrong"


def simulated(seed: int, seconds: float | None = None) -> Drive:
    """A drive of 60 to 150 s, or of some seconds, that explores a world."""
    generator = np.random.default_rng(seed)
    drawn = float(generator.uniform(60.0, 150.0))
    world = _WORLDS[seed % len(_WORLDS)].format(seed)
    robot_name = "four-beam-drone" if seed % 5 == 4 else "paper"
    config = RunConfig(
        world=world,
        noise=_NOISE,
        preset="consistent",
        seed=seed,
        max_time=drawn if seconds is None else seconds,
        robot=ROBOTS[robot_name](),
        until="seen",
    )
    episode = run_episode(config)
    ranges = episode.ranges[:, 0].astype(float)
    ranges[ranges >= config.robot.too_far] = np.inf
    return Drive(
        f"{world}-{robot_name}-{seed}",
        config.robot,
        robot_name,
        load_world(world).edges,
        episode.time,
        ranges,
        episode.wheels[:, 0].astype(float),
        episode.true[:, 0],
    )


def replayed(
    drive: Drive, sheet: Sheet, folder: Path, name: str, kinds: Sequence[str], clean: float
) -> Outcome:
    """Write a log, replay it by the command line, and compare its path with the truth."""
    arguments = write(sheet, folder, name)
    code, error, status, messages = _replayed(sheet.drive, arguments)
    mended = math.nan
    remedy = _REMEDY.search(messages)
    if sheet.cause and sheet.can_be_mended and remedy is not None:
        mended = _replayed(sheet.drive, [*arguments, *remedy.groups()])[1]
    elif sheet.cause and not sheet.can_be_mended:
        mended = 0.0
    words = (sheet.cause,) if sheet.cause else sheet.words
    is_named = any(word in messages for word in words)
    return Outcome(
        name,
        drive.name,
        list(kinds),
        code,
        status,
        error,
        clean,
        mended,
        is_named,
        bool(sheet.cause),
        messages,
        " ".join(["limslam replay", *arguments]),
    )


def _replayed(drive: Drive, arguments: list[str]) -> tuple[int, float, str, str]:
    """Exit code, error after alignment (m), status, and messages."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        try:
            finished = limslam("replay", *arguments, "--out", out)
        except Exception as error:  # noqa: BLE001 - a traceback is a wrong outcome, and goes on
            return 1, math.nan, "", f"{type(error).__name__}: {error}"
        if finished.returncode != 0:
            return finished.returncode, math.nan, "", finished.stderr
        result = Folder(out)
        metrics = result.metrics
        status = str(metrics.get("smoothed_status", metrics["status"]))
        return 0, _error(drive, result), status, finished.stderr


def _error(drive: Drive, result: Folder) -> float:
    """Error of the best path of a replay, m, after alignment, by the times of its rows."""
    smoothed = result.path / "trajectory_smoothed.tum"
    poses = result.poses("smoothed" if smoothed.is_file() else "est")
    time = result.time - result.time[0]
    true_time = drive.time - drive.time[0]
    rows = np.searchsorted(true_time, time - 0.5 * _LEAST_PERIOD).clip(max=len(true_time) - 1)
    found = trajectory_metrics(drive.true[rows], poses)["ate_aligned_m"]
    return math.nan if found is None else found


def clean_error(drive: Drive, *, by_poses: bool) -> float:
    """Error of the replay of the clean table of a drive, m."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = write(plain(drive, by_poses=by_poses), Path(folder), "clean")
        return _replayed(drive, arguments)[1]


@dataclass(frozen=True)
class Task:
    """The logs of one drive: the seed of the drive and its length, s, or None; the folder; the
    number and the distortions of each log; and the seed of the distortions.
    """

    drive: int
    seconds: float | None
    folder: Path
    logs: list[tuple[int, list[str]]]
    seed: int


def _outcomes_of(task: Task) -> list[Outcome]:
    """The outcomes of all logs of one drive."""
    drive = simulated(task.drive, task.seconds)
    clean: dict[bool, float] = {}
    found = []
    for number, kinds in task.logs:
        sheet = distorted(drive, kinds, np.random.default_rng([task.seed, number]))
        by_poses = sheet.odometry.startswith("poses")
        if by_poses not in clean:
            clean[by_poses] = clean_error(drive, by_poses=by_poses)
        found.append(
            replayed(drive, sheet, task.folder, f"log{number:03d}", kinds, clean[by_poses])
        )
        outcome = found[-1]
        said = f"{outcome.log} {outcome.verdict:6} {','.join(kinds)} {outcome.error:.3f} m\n"
        sys.stdout.write(said)
        sys.stdout.flush()
    return found


def table(outcomes: Sequence[Outcome]) -> str:
    """Counts of verdicts by distortion. A log counts for each of its distortions."""
    lines = [f"{'distortion':20} logs right named wrong silent  error  clean (medians, m)"]
    for kind in [*KINDS, "all"]:
        chosen = [each for each in outcomes if kind == "all" or kind in each.kinds]
        if not chosen:
            continue
        verdicts = [each.verdict for each in chosen]
        counts = [verdicts.count(each) for each in ("right", "named", "wrong", "silent")]
        errors = [each.error for each in chosen if math.isfinite(each.error)]
        middle = float(np.median(errors)) if errors else math.nan
        clean = float(np.median([each.clean for each in chosen]))
        right, named, wrong, silent = counts
        lines.append(
            f"{kind:20} {len(chosen):4} {right:5} {named:5} {wrong:5} {silent:6} "
            f"{middle:6.3f} {clean:6.3f}"
        )
    return "\n".join(lines)


def tasks(
    folder: Path,
    number: int,
    seed: int,
    kinds: Sequence[str],
    drives: int,
    seconds: float | None = None,
) -> list[Task]:
    """The logs of each drive: each distortion in turn, with none to two others."""
    generator = np.random.default_rng(seed)
    logs: dict[int, list[tuple[int, list[str]]]] = {}
    for log in range(number):
        chosen = drawn_kinds(kinds[log % len(kinds)], kinds, 3, generator)
        logs.setdefault(int(generator.integers(drives)), []).append((log, chosen))
    return [
        Task(1000 * seed + drive, seconds, folder, each, seed)
        for drive, each in sorted(logs.items())
    ]


def main(arguments: Iterable[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0] if __doc__ else "")
    parser.add_argument("out", type=Path, help="folder for the logs and results.json")
    parser.add_argument("--number", type=int, default=500, help="number of logs")
    parser.add_argument("--drives", type=int, default=20, help="number of drives")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, help="length of each drive; 60 to 150 without it")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    options = parser.parse_args(None if arguments is None else list(arguments))
    options.out.mkdir(parents=True, exist_ok=True)
    work = tasks(
        options.out,
        options.number,
        options.seed,
        options.kinds,
        options.drives,
        options.seconds,
    )
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        outcomes = [each for found in pool.imap(_outcomes_of, work) for each in found]
    records = [{**asdict(each), "verdict": each.verdict} for each in outcomes]
    (options.out / "results.json").write_text(json.dumps(records, indent=1), encoding="utf-8")
    sys.stdout.write(table(outcomes) + "\n")


if __name__ == "__main__":
    main()
