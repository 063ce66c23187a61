"""A plan of the mapping track: a drive is recorded, and a SLAM system makes a trajectory and a map of the recording.

The drive is made anew each time: a driver that knows the map and the true pose passes everything that can be seen and
comes back. It asks no estimator, so that every entry gets the same readings. Nothing is stored. An estimate may be in
any frame: it is moved so that its first pose is the true one.
"""

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np

from limslam_agent.arena.command import last_line, without_folders
from limslam_agent.arena.entry import Entry
from limslam_agent.arena.tracks import Plan
from limslam_agent.config.presets import preset
from limslam_agent.logs.log_reader import read_log
from limslam_agent.logs.recorded_log import write_npz
from limslam_agent.output.export import write_json
from limslam_agent.output.finished_run import COVARIANCES
from limslam_agent.output.run_folder import RESULT_FILE, new_folder
from limslam_agent.output.tum import write_tum
from limslam_agent.replay.replay import replay_log, write_replay
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.record import Episode
from limslam_agent.runs.results import versions
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.runs.score_files import ScoredFiles
from limslam_env.interface import NominalNoise

LOG, TABLE, TRAJECTORY, STATED, WALLS = "log.npz", "log.csv", "trajectory.tum", "covariances.txt", "map.json"
"""Files of a command: it gets the log and the table, and it writes the others. The covariances need not be written."""

ANSWER_WITHIN = 600.0
"""Longest wall-clock time of a command for one recording, s."""


def map_drive(entry: Entry, plan: Plan, folder: Path | None = None) -> dict[str, Any]:
    """Let an entry map a recorded drive. Returns metrics.

    Parameters
    ----------
    entry, plan
        Who maps what.
    folder
        Where the files of the entry are kept. None keeps nothing.

    Raises
    ------
    ValueError
        If the entry fails, or writes files that cannot be scored.
    """
    drive = _record(plan)
    with TemporaryDirectory(prefix="limslam-arena-") as name:
        place = Path(name)
        if folder is None:
            (place / "out").mkdir()
            return _mapped(entry, plan, drive, place, place / "out")
        with new_folder(folder, force=True) as new:
            metrics = _mapped(entry, plan, drive, place, new.beside)
            _keep_result(entry, new.beside / RESULT_FILE, metrics)
    return metrics


def _keep_result(entry: Entry, path: Path, metrics: dict[str, Any]) -> None:
    """Write the metrics. A file that a command has written under this name does not stay, whatever it is."""
    if entry.manifest.is_process:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
    if not path.is_file():
        write_json(path, {"metrics": metrics})


def _record(plan: Plan) -> Episode:
    config = RunConfig(
        plan.world, plan.noise, "odometry", plan.seed, plan.max_time, policy="tour", true_noise=plan.true_noise
    )
    return run_episode(config)


def _mapped(entry: Entry, plan: Plan, drive: Episode, place: Path, out: Path) -> dict[str, Any]:
    """Scores of what an entry makes of a recording, which is written into ``place``."""
    _write_recording(place, drive)
    work = _by_command if entry.manifest.is_process else _by_estimator
    # The truth gets a folder of its own, and only after the entry has ended: no entry finds it.
    with TemporaryDirectory(prefix="limslam-arena-") as name:
        true = Path(name) / "true.tum"
        try:
            files = work(entry, plan, place, out)
            write_tum(true, drive.time, drive.true[:, 0])
            return _scored(plan, drive, files, true, out)
        except ValueError as error:
            raise ValueError(without_folders(str(error), (place, out, true.parent))) from error


def _scored(plan: Plan, drive: Episode, files: tuple[Path, Path | None], true: Path, out: Path) -> dict[str, Any]:
    """Scores of an entry's trajectory and covariances (``files``), and of the map in its folder."""
    trajectory, covariances = files
    for path in (trajectory, out / WALLS):
        if not path.is_file():
            raise ValueError(f"the entry has written no {path.name}")
    scores = ScoredFiles(
        trajectory, true, None, covariances, "start", 1e-3, out / WALLS, plan.world, drive.config.robot
    ).scores()
    missing = len(drive.time) - int(scores["poses"] or 0)
    if missing:
        raise ValueError(f"{trajectory.name}: {missing} of {len(drive.time)} poses are missing")
    return {**scores, "ate_final_m": scores["ate_m"], "anees_final": scores.get("anees"), "lost": ""}


def _write_recording(place: Path, drive: Episode) -> None:
    """The readings as an array file and as a table, without anything true but the first pose."""
    ranges, wheels, robot = drive.ranges[:, 0], drive.wheels[:, 0], drive.config.robot
    write_npz(
        place / LOG, robot, time=drive.time, ranges=ranges, wheels=wheels, action=drive.actions[:, 0],
        start_pose=drive.true[0, 0],
    )  # fmt: skip
    names = [f"r_{angle:g}" for angle in np.degrees(robot.beam_angles).round(3)]
    header = ",".join(["t", "left", "right", *names])
    table = np.column_stack((drive.time, wheels, ranges))
    np.savetxt(place / TABLE, table, fmt="%.6g", delimiter=",", header=header, comments="")


def _by_estimator(entry: Entry, plan: Plan, place: Path, out: Path) -> tuple[Path, Path | None]:
    """A shipped estimator replays the log, as ``limslam replay`` does. Its trajectory and its covariances."""
    log = read_log(place / LOG)
    replay = replay_log(log, preset(entry.run, NominalNoise(plan.noise)))
    write_replay(out, replay, {"log": LOG}, {}, versions())
    smoothed = out / "trajectory_smoothed.tum"
    is_smoothed = smoothed.is_file() and replay.smoothed is not None and replay.smoothed.covariances is not None
    return (smoothed if is_smoothed else out / "trajectory_est.tum"), out / COVARIANCES


def _by_command(entry: Entry, plan: Plan, place: Path, out: Path) -> tuple[Path, Path | None]:
    """A command maps the recording. Its trajectory, and its covariances if there are some."""
    values = {"{python}": sys.executable, "{log}": place / LOG, "{table}": place / TABLE, "{out}": out,
              "{noise}": plan.noise}  # fmt: skip
    _call([str(values.get(word, word)) for word in entry.manifest.command], entry.folder)
    stated = out / STATED
    return out / TRAJECTORY, stated if stated.is_file() else None


def _call(words: Sequence[str], folder: Path) -> None:
    # What the process prints is not kept in memory: it can be of any length.
    with TemporaryFile() as errors:
        try:
            # The words are those of the entry's manifest. No shell reads them.
            done = subprocess.run(  # noqa: S603
                words, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=errors, timeout=ANSWER_WITHIN, check=False,
            )  # fmt: skip
        except OSError as error:
            raise ValueError(f"{words[0]}: cannot be started: {error.strerror or error}") from error
        except subprocess.TimeoutExpired:
            raise ValueError(f"{words[0]}: was not done after {ANSWER_WITHIN:g} s") from None
        if done.returncode:
            raise ValueError(f"{words[0]}: ended with exit code {done.returncode}: {last_line(errors)}")
