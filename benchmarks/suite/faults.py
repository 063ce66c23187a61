"""Faults of a robot, in closed loop or in a recorded drive, and what became of a robot in which one
began.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.suite.jobs import KIDNAPPED, Job, Metric
from limslam_agent.runs.record import Episode
from limslam_agent.status.status import LEVELS
from limslam_env.geometry import BoolArray, FloatArray, ReadingArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import Observation, RobotSpec

RIGHT_PLACE = 0.5
RIGHT_HEADING = np.radians(15.0)
"""A robot is at the right place if its pose is not farther off, m and rad."""

_OLDEST = 100  # steps; readings that are older are never reported
_BETWEEN_GAPS = 30.0  # s from the beginning of a gap to that of the next one


@dataclass(eq=False)
class Fault:
    """One fault of a robot, of a kind in :data:`FAULTS`, which alters what it reports from a time
    (s) on.

    The seed chooses the beam, and ``robot`` is without the fault. ``size`` is that of the kind
    where none is given. ``script`` has what happens in each step of a recorded drive: the turn
    (rad) that the wheels do not notice, or the ranges (n_beams,) to a person, m.
    """

    kind: str
    begin: float = 0.0
    seed: int = 0
    robot: RobotSpec = field(default_factory=RobotSpec)
    script: FloatArray = field(default_factory=lambda: np.zeros(0))
    size: float = math.nan
    step: int = field(default=-1, init=False)
    first_step: int | None = field(default=None, init=False)
    last: ReadingArray | None = field(default=None, init=False)
    """The ranges as they were reported in the step before; None before the fault."""

    def __post_init__(self) -> None:
        if math.isnan(self.size):
            self.size = FAULTS[self.kind].size
        self._earlier: deque[ReadingArray] = deque(maxlen=_OLDEST)
        self._generator = np.random.default_rng([self.seed, 3])

    @property
    def beam(self) -> int:
        """Number of the beam that has a fault of one beam."""
        return self.seed % len(self.robot.beams)

    @property
    def late(self) -> ReadingArray:
        """The readings of ``size`` seconds ago; of now where there were none yet."""
        age = round(self.size / self.robot.control_period)
        return self._earlier[-1 - age if len(self._earlier) > age else -1]

    @property
    def is_drawn(self) -> bool:
        """Whether a step is one of ``size`` steps, by chance. Asked once a step."""
        return bool(self._generator.random() * self.size < 1.0)

    @property
    def is_in_gap(self) -> bool:
        """Whether a step is in one of the gaps, of ``size`` seconds, that come again and again."""
        since = self.step * self.robot.control_period + self.seed % (0.5 * _BETWEEN_GAPS)
        return since % _BETWEEN_GAPS >= _BETWEEN_GAPS - self.size - 1e-9

    def altered(self, told: Observation, time: float) -> Observation:
        """The observation as the robot with the fault reports it; empty if it does not arrive.
        Called once a step.
        """
        self.step += 1
        self._earlier.append(told["ranges"])
        kind = FAULTS[self.kind]
        if time < self.begin - 1e-9 or kind.is_of_simulator:
            return told
        if self.first_step is None:
            self.first_step = self.step
        self.last = kind.ranges(self, told["ranges"].copy())
        wheels = kind.wheels(self, told["wheels"].copy())
        return Observation(ranges=self.last, wheels=wheels) if kind.arrives(self) else Observation()


Alteration = Callable[[Fault, ReadingArray], ReadingArray]
"""Makes of a copy of the ranges (n_beams,) or the wheel travel (2,) of a step those that are
reported.
"""


def _same(fault: Fault, values: ReadingArray) -> ReadingArray:
    del fault
    return values


def _of_one_beam(value: Callable[[Fault], Any]) -> Alteration:
    """One beam reads another value."""

    def alter(fault: Fault, ranges: ReadingArray) -> ReadingArray:
        ranges[fault.beam] = value(fault)
        return ranges

    return alter


def _of_walls(value: Alteration) -> Alteration:
    """Other values where a beam sees something."""
    return lambda fault, ranges: np.where(
        ranges < fault.robot.too_far, value(fault, ranges), ranges
    )


def _held(fault: Fault, ranges: ReadingArray) -> ReadingArray:
    is_held = (fault.step - np.arange(len(ranges))) % round(fault.size) != 0
    return ranges if fault.last is None else np.where(is_held, fault.last, ranges)


def _with_person(fault: Fault, ranges: ReadingArray) -> ReadingArray:
    np.minimum(ranges, fault.script[fault.step], out=ranges)
    return ranges


def _slipped(fault: Fault, wheels: ReadingArray) -> ReadingArray:
    # Turning to the left without notice means that the wheels report a turn to the right too
    # little.
    wheels += 0.5 * fault.robot.axle * fault.script[fault.step] * np.array([1.0, -1.0])
    return wheels


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: its size where none is given, what it does to ranges and wheel travel,
    whether a report arrives, and whether it is only for recorded drives or done by the simulator.
    """

    size: float = 0.0
    ranges: Alteration = _same
    wheels: Alteration = _same
    arrives: Callable[[Fault], bool] = lambda _: True
    is_recorded: bool = False
    is_of_simulator: bool = False


FAULTS = {
    KIDNAPPED: FaultKind(is_of_simulator=True),
    "reversed": FaultKind(wheels=lambda _, wheels: -wheels),
    "swapped": FaultKind(wheels=lambda _, wheels: wheels[::-1].copy()),
    "delayed": FaultKind(1.0, _of_one_beam(lambda fault: fault.late[fault.beam])),
    "jump": FaultKind(
        5.0, wheels=lambda fault, wheels: wheels + fault.size * (fault.step == fault.first_step)
    ),
    "late": FaultKind(0.1, lambda fault, _: fault.late.copy()),
    "dead beam": FaultKind(ranges=_of_one_beam(lambda fault: fault.robot.max_ranges[fault.beam])),
    "stuck beam": FaultKind(0.4, _of_one_beam(lambda fault: fault.size)),
    "offset": FaultKind(0.03, _of_walls(lambda fault, ranges: ranges + fault.size)),
    "scale": FaultKind(0.03, _of_walls(lambda fault, ranges: ranges * (1.0 + fault.size))),
    "repeats": FaultKind(5.0, _held),
    "lost wheels": FaultKind(
        20.0,
        wheels=lambda fault, wheels: np.zeros_like(wheels) if fault.is_drawn else wheels,
    ),
    "lost reports": FaultKind(20.0, arrives=lambda fault: not fault.is_drawn, is_recorded=True),
    "gaps": FaultKind(2.0, arrives=lambda fault: not fault.is_in_gap, is_recorded=True),
    "person": FaultKind(0.2, _with_person, is_recorded=True),
    "slips": FaultKind(14.0, wheels=_slipped, is_recorded=True),
    "turned beam": FaultKind(5.0, is_recorded=True, is_of_simulator=True),
}
"""All kinds of faults. In results of explorations, in the middle of which they can begin, they take
the policy's place.

``kidnapped``: the robot is carried to a random free place and turned, and its wheels do not turn.
That is done by the run, and no reading is altered. ``reversed``: both wheels report the opposite of
their travel. ``swapped``: each wheel reports the travel of the other one. ``jump``: the wheels
report so many metres once. ``lost wheels``: in one of so many steps, the wheels report no travel.

Of one beam, which the seed chooses: ``delayed``: it reports its reading of so many seconds ago;
``dead beam``: it sees nothing; ``stuck beam``: it always reads so many metres. Of all beams:
``late``: they report their readings of so many seconds ago; ``offset``: they read so many metres
too much; ``scale``: they read too much by such a share; ``repeats``: they measure in turns, and
each repeats its reading for so many steps.

In recorded drives only: ``lost reports``: one of so many reports does not arrive, and its travel is
never told; ``gaps``: nothing arrives for so many seconds, twice a minute; ``person``: somebody of
such a radius (m) walks through the building, and the beams see them; ``slips``: the robot turns by
so many degrees, to either side, and its wheels do not notice; ``turned beam``: one beam is mounted
so many degrees to the left, by the simulator.
"""


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
    can_begin = [name for name, kind in FAULTS.items() if not kind.is_recorded]
    if job.fault not in can_begin:
        raise ValueError(f"no fault is called {job.fault!r}; there are {', '.join(can_begin)}")
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
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Ranges (k, n_beams) and wheel travel (k, 2) of a recorded drive, as a robot with a fault
    reports them, and which of its steps (t,) arrive.
    """
    told = [
        fault.altered(Observation(ranges=seen, wheels=driven), time)
        for seen, driven, time in zip(ranges, wheels, times, strict=True)
    ]
    arrived = [each for each in told if each]
    return (
        np.array([each["ranges"] for each in arrived]),
        np.array([each["wheels"] for each in arrived]),
        np.array([bool(each) for each in told]),
    )


def drawn_slips(
    steps: int, generator: np.random.Generator, degrees: float, count: int = 3
) -> FloatArray:
    """Slips to either side, spread over a drive: turns (rad) of its steps (t,)."""
    turns = math.radians(degrees) * generator.choice((-1.0, 1.0), count)
    places = np.linspace(0.0, steps, count + 2)[1:-1].astype(int)
    slips = np.zeros(steps)
    slips[places + generator.integers(-50, 50, count)] = turns
    return slips


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
    true = episode.true[first:, 0]
    estimated = episode.estimated[first:, 0]
    level = episode.levels[first:, 0]
    is_right = (np.hypot(*(estimated - true)[:, :2].T) <= RIGHT_PLACE) & (
        np.abs(wrap_angle(estimated[:, 2] - true[:, 2])) <= RIGHT_HEADING
    )
    is_ok = level == LEVELS.index("ok")
    is_lost = level == LEVELS.index("lost")
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
