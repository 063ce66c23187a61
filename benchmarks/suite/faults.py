"""Faults of a robot, in closed loop or in a recorded drive, and what became of a robot in which one
began.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from benchmarks.suite.jobs import FAULTS, Job, Metric
from limslam_agent.runs.record import Episode
from limslam_agent.status.status import LEVELS
from limslam_env.geometry import BoolArray, FloatArray, ReadingArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import Observation, RobotSpec

DRIVE_FAULTS = {**FAULTS, "turned beam": 5.0, "slips": 14.0}
"""Faults of recorded drives, and their sizes: ``turned beam``: one beam is mounted so many degrees
to the left, by the simulator; ``slips``: the robot turns by so many degrees, to either side, and
its wheels do not notice.
"""

RIGHT_PLACE, RIGHT_HEADING = 0.5, np.radians(15.0)
"""A robot is at the right place if its pose is not farther off, m and rad."""


@dataclass(eq=False)
class Fault:
    """One fault of a robot, of a kind in :data:`DRIVE_FAULTS`, which alters what it reports from a
    time (s) on.

    The seed chooses the beam, and ``robot`` is without the fault. ``slips`` has the turns (rad)
    that the wheels do not notice, by the number of the step.
    """

    kind: str
    begin: float = 0.0
    seed: int = 0
    robot: RobotSpec = field(default_factory=RobotSpec)
    slips: Mapping[int, float] = field(default_factory=dict)
    _earlier: deque[ReadingArray] = field(default_factory=deque)
    _steps: int = 0
    _has_begun: bool = False

    @property
    def size(self) -> float:
        """How large it is."""
        return DRIVE_FAULTS[self.kind]

    @property
    def beam(self) -> int:
        """Number of the beam that has a fault of one beam."""
        return self.seed % len(self.robot.beams)

    def altered(self, told: Observation, time: float) -> Observation:  # noqa: C901 (a case for each kind)
        """The observation as the robot with the fault reports it. Called once a step."""
        late = self._late(told["ranges"])
        step, self._steps = self._steps, self._steps + 1
        if time < self.begin - 1e-9:
            return told
        is_first, self._has_begun = not self._has_begun, True
        ranges, wheels = told["ranges"].copy(), told["wheels"].copy()
        if self.kind == "late":
            ranges = late
        elif self.kind == "delayed":
            ranges[self.beam] = late[self.beam]
        elif self.kind == "dead beam":
            ranges[self.beam] = self.robot.max_ranges[self.beam]
        elif self.kind == "stuck beam":
            ranges[self.beam] = self.size
        elif self.kind == "offset":
            ranges[ranges < self.robot.too_far] += self.size
        elif self.kind == "reversed":
            wheels = -wheels
        elif self.kind == "swapped":
            wheels = wheels[::-1]
        elif self.kind == "jump" and is_first:
            wheels += self.size
        elif self.kind == "slips":
            # Turning to the left without notice means that the wheels report a turn to the right
            # too little.
            wheels += 0.5 * self.robot.axle * self.slips.get(step, 0.0) * np.array([1.0, -1.0])
        return Observation(ranges=ranges, wheels=wheels)

    def _late(self, ranges: ReadingArray) -> ReadingArray:
        """The readings of ``size`` seconds ago; of now where there were none yet."""
        if self.kind not in {"late", "delayed"}:
            return ranges
        self._earlier.append(ranges)
        return (
            self._earlier.popleft()
            if len(self._earlier) > round(self.size / self.robot.control_period)
            else ranges
        )


def fault_begins(job: Job) -> float | None:
    """When the fault of a job begins, s: at a whole step that the seed chooses. None for a healthy
    robot.

    Raises
    ------
    ValueError
        If there is no such fault, its times are no times, or the job is not the exploration of one
        robot.
    """
    if job.fault is None:
        return None
    if job.fault not in FAULTS:
        raise ValueError(f"no fault is called {job.fault!r}; there are {', '.join(FAULTS)}")
    if not 0.0 < job.fault_time[0] <= job.fault_time[1]:
        raise ValueError("fault_time: must be two times above 0 s, the earliest and the latest")
    if not job.after_fault > 0.0:
        raise ValueError(f"after_fault: must be above 0 s, not {job.after_fault:g}")
    if job.robots > 1 or job.laps:
        raise ValueError("faults are for one robot that explores")
    period = RobotSpec().control_period
    drawn = np.random.default_rng(job.seed).uniform(*job.fault_time)
    return round(round(drawn / period) * period, 6)


def with_fault(
    fault: Fault, ranges: FloatArray, wheels: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Ranges (t, n_beams) and wheel travel (t, 2) of a recorded drive, as a robot with a fault
    reports them.
    """
    told = [
        fault.altered(Observation(ranges=seen, wheels=driven), time)
        for seen, driven, time in zip(ranges, wheels, times, strict=True)
    ]
    return np.array([each["ranges"] for each in told]), np.array([each["wheels"] for each in told])


def drawn_slips(steps: int, generator: np.random.Generator, count: int = 3) -> dict[int, float]:
    """Slips to either side, spread over a drive: turns (rad) by the numbers of their steps."""
    turns = math.radians(DRIVE_FAULTS["slips"]) * generator.choice((-1.0, 1.0), count)
    places = np.linspace(0.0, steps, count + 2)[1:-1].astype(int)
    return dict(
        zip((places + generator.integers(-50, 50, count)).tolist(), turns.tolist(), strict=True)
    )


def fault_scores(episode: Episode, begin: float) -> dict[str, Metric]:
    """What became of the robot of a run in which a fault began (s), by the names in
    ``docs/metrics.md``.

    Raises
    ------
    ValueError
        If the run ended before the fault.
    """
    period = episode.config.robot.control_period
    first = round(begin / period)
    if len(episode.time) <= first:
        raise ValueError(
            f"the exploration ended after {episode.time[-1]:.1f} s, before the fault at {begin:g} s"
        )
    true, estimated, level = (
        episode.true[first:, 0],
        episode.estimated[first:, 0],
        episode.levels[first:, 0],
    )
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
