"""Faults of a robot that begin in the middle of an exploration, and what became of the robot."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.suite.jobs import FAULTS, Job, Metric
from limslam_agent.runs.episode import Episode
from limslam_agent.status.status import LEVELS
from limslam_env.geometry import BoolArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import Observation, RobotSpec

DELAY = 10
"""Steps by which a beam is delayed: 1 s."""
RIGHT_PLACE, RIGHT_HEADING = 0.5, np.radians(15.0)
"""A robot is at the right place if its pose is not farther off, m and rad."""


@dataclass(eq=False)
class Fault:
    """One fault of a robot.

    Attributes
    ----------
    kind
        ``kidnapped``: the robot is carried to a random free place and turned, and its wheels do not turn. That is done
        by the run, and no reading is altered. ``reversed``: both wheels report the opposite of their travel.
        ``swapped``: each wheel reports the travel of the other one. ``delayed``: one beam reports its reading of a
        second ago. ``jump``: the wheels report 5 m once.
    begin
        Time at which the fault begins, s.
    seed
        Of the beam.
    """

    kind: str
    begin: float = 60.0
    seed: int = 0
    _late: deque[Any] = field(default_factory=deque)
    _has_begun: bool = False

    def altered(self, told: Observation, time: float) -> Observation:
        """The observation as the robot with the fault reports it."""
        ranges, wheels = told["ranges"], told["wheels"]
        self._late.append(ranges)
        old = self._late.popleft() if len(self._late) > DELAY else self._late[0]
        if time < self.begin - 1e-9:
            return told
        is_first, self._has_begun = not self._has_begun, True
        if self.kind == "delayed":
            beam = self.seed % len(ranges)
            ranges = np.where(np.arange(len(ranges)) == beam, old, ranges)
        if self.kind == "jump" and is_first:
            wheels = wheels + np.float32(5.0)
        change: dict[str, Callable[[Any], Any]] = {"reversed": lambda w: -w, "swapped": lambda w: w[::-1].copy()}
        return Observation(ranges=ranges, wheels=change.get(self.kind, lambda w: w)(wheels))


def fault_begins(job: Job) -> float | None:
    """When the fault of a job begins, s: at a whole step that the seed chooses. None for a healthy robot.

    Raises
    ------
    ValueError
        If there is no such fault, its times are no times, or the job is not the exploration of one robot.
    """
    if job.fault is None:
        return None
    if job.fault not in FAULTS:
        raise ValueError(f"no fault is called {job.fault!r}; there are {', '.join(FAULTS)}")
    if len(job.fault_time) != 2 or not 0.0 < job.fault_time[0] <= job.fault_time[1]:
        raise ValueError("fault_time: must be two times above 0 s, the earliest and the latest")
    if not job.after_fault > 0.0:
        raise ValueError(f"after_fault: must be above 0 s, not {job.after_fault:g}")
    if job.robots > 1 or job.laps:
        raise ValueError("faults are for one robot that explores")
    period = RobotSpec().control_period
    drawn = np.random.default_rng(job.seed).uniform(*job.fault_time)
    return round(round(drawn / period) * period, 6)


def fault_scores(episode: Episode, begin: float) -> dict[str, Metric]:
    """What became of a robot with a fault, by the names in ``docs/metrics.md``.

    Parameters
    ----------
    episode
        The run of one robot.
    begin
        Time at which the fault began, s.

    Raises
    ------
    ValueError
        If the run ended before the fault.
    """
    period = episode.config.robot.control_period
    first = round(begin / period)
    if len(episode.time) <= first:
        raise ValueError(f"the exploration ended after {episode.time[-1]:.1f} s, before the fault at {begin:g} s")
    true, estimated, level = episode.true[first:, 0], episode.estimated[first:, 0], episode.levels[first:, 0]
    is_right = (np.hypot(*(estimated - true)[:, :2].T) <= RIGHT_PLACE) & (
        np.abs(wrap_angle(estimated[:, 2] - true[:, 2])) <= RIGHT_HEADING
    )
    is_ok, is_lost = level == LEVELS.index("ok"), level == LEVELS.index("lost")
    is_wrong = np.maximum.accumulate(is_lost) & ~is_lost & ~is_right
    is_kidnapped = episode.config.kidnap_at is not None

    def after(found: BoolArray) -> float | None:
        return float(np.argmax(found) * period) if found.any() else None

    return {
        "fault_at_s": begin,
        "fault_alarms_before_s": float((episode.levels[:first, 0] > 0).sum() * period),
        "fault_doubted_s": after(~is_ok),
        "fault_lost_s": after(is_lost),
        "fault_placed_s": after(is_right & ~is_lost) if is_kidnapped else None,
        "fault_wrong_place_s": float(is_wrong.sum() * period),
        "fault_wrong_place_ok_s": float((is_wrong & is_ok).sum() * period),
        "fault_unnoticed_s": float((is_ok & ~is_right).sum() * period),
    }
