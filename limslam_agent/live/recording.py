"""What a robot has sent, in the order in which it was measured: the log of a session."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from limslam_agent.live.protocol import NOTHING_SEEN, Hello, Telemetry, difference
from limslam_agent.logs.recorded_log import RecordedLog, write_npz
from limslam_agent.logs.table_options import TOO_FAST
from limslam_agent.output.atomic_write import atomic_write
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec

MM = 1e-3

SAVED_EVERY = 30.0
"""Time between two copies of the log on disk during a session, s."""


class Row(NamedTuple):
    """One telemetry line in a frame that still holds when counters overflow and when the robot was
    restarted.
    """

    number: int  # Place in the log. Lost lines leave gaps.
    time: float  # Time of the measurement since the first row, s, by the robot's clock
    # Wheel travel since the first row, m
    left: float
    right: float
    # Readings (n_beams,), m. NaN where there is no new reading, and infinity where nothing was
    # seen.
    ranges: FloatArray
    yaw: float = math.nan  # Heading, rad. NaN where there is no new reading.
    is_late: bool = False  # Whether a later measurement had already arrived


class Recording:
    """The telemetry of a session.

    Attributes
    ----------
    newest
        The latest measurement. None at the start.
    doubled, late, implausible
        Numbers of telemetry lines that came twice, that came after a later one, and that no such
        robot can have sent: a wheel was far too fast, the clock stood still, or there is another
        number of beams.
    """

    def __init__(self, robot: RobotSpec, hello: Hello) -> None:
        # A reading that is sent is new, whatever the sensor's period is.
        beams = tuple(replace(beam, period=1, phase=0) for beam in robot.beams)
        self.robot = replace(robot, beams=beams, control_period=MM * hello.period_ms)
        self.doubled = self.late = self.implausible = 0
        self._metres = 1e-9 * hello.nm_per_tick
        self._rows: dict[int, Row] = {}
        self._actions: dict[int, FloatArray] = {}
        self.newest: Row | None = None
        self._origin: tuple[Telemetry, Row] | None = None

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def newest_seq(self) -> int:
        """Sequence number of the latest measurement, as the robot counts. 0 at the start."""
        return 0 if self._origin is None else self._origin[0].seq

    @property
    def lost(self) -> int:
        """Number of telemetry lines that have not arrived. Some may still arrive."""
        return max(self._rows) - min(self._rows) + 1 - len(self._rows) if self._rows else 0

    @property
    def period(self) -> float:
        """Median time between two measurements by the robot's clock, s. NaN for fewer than two."""
        rows = self._sorted()
        steps = [
            (after.time - before.time) / (after.number - before.number)
            for before, after in pairwise(rows)
        ]
        return float(np.median(steps)) if steps else math.nan

    def restart(self) -> None:
        """Begin with new counters, because the robot was switched on again. Its travel in between
        is not known.
        """
        self._origin = None

    def add(self, packet: Telemetry, gap: float = 0.0) -> Row | None:
        """Record telemetry. None if it is not believed, or was there before.

        ``gap`` is the time since the newest row, s, which counts only if the robot was switched on
        again.
        """
        row = self._placed(packet, gap)
        if row is None:
            return None
        if row.number in self._rows:
            self.doubled += 1
            return None
        if not self._is_plausible(row):
            self.implausible += 1
            return None
        self._rows[row.number] = row
        if row.is_late:
            self.late += 1
        else:
            # Counters of 32 bits are compared with the newest ones, so that they may overflow.
            self.newest = row
            self._origin = (packet, row)
        return row

    def observation(self, row: Row, before: Row | None) -> Observation:
        """What the agent is told: the ranges of a row, and the wheel travel since the row before,
        if there is one.
        """
        wheels = (
            np.zeros(2)
            if before is None
            else np.array([row.left - before.left, row.right - before.right])
        )
        observation: Observation = {"ranges": row.ranges, "wheels": wheels}
        if not math.isnan(row.yaw):
            observation["yaw"] = row.yaw
        return observation

    def note_action(self, row: Row, action: FloatArray) -> None:
        """Record the answer (2,) to a row, as fractions of the largest wheel speed."""
        self._actions[row.number] = action

    def log(self) -> RecordedLog:
        """All rows as a log, in the order of measurement, with those that came late in their
        places. Raises a ValueError if there are no rows.
        """
        rows = self._sorted()
        travel = np.array([(row.left, row.right) for row in rows]).reshape(-1, 2)
        times = np.array([row.time - rows[0].time for row in rows])
        ranges = np.array([row.ranges for row in rows])
        wheels = np.diff(travel, axis=0, prepend=travel[:1])
        yaw = np.array([row.yaw for row in rows])
        return RecordedLog(
            self.robot,
            times,
            ranges,
            np.ones(len(rows), dtype=np.bool_),
            wheels=wheels,
            yaw=None if np.isnan(yaw).all() else yaw,
        )

    def save(self, path: Path) -> None:
        """Write the rows as ``log.npz``, which ``limslam replay`` reads. Raises a ValueError if
        there are none, and an OSError if the file cannot be written.
        """
        log = self.log()
        nothing = np.zeros(2)
        actions = np.array([self._actions.get(number, nothing) for number in sorted(self._rows)])
        with atomic_write(path) as beside:
            write_npz(
                beside,
                log.robot,
                time=log.time,
                ranges=log.ranges,
                wheels=log.wheels,
                action=actions,
                start_pose=log.start_pose,
                **({} if log.yaw is None else {"yaw": log.yaw}),
            )

    def _sorted(self) -> list[Row]:
        return [self._rows[number] for number in sorted(self._rows)]

    def _placed(self, packet: Telemetry, gap: float) -> Row | None:
        """The row of telemetry, with its counters continued from the newest row."""
        if len(packet.ranges) != len(self.robot.beams):
            self.implausible += 1
            return None
        ranges = np.array([_metres(each) for each in packet.ranges])
        yaw = math.nan if packet.yaw is None else math.radians(1e-3 * packet.yaw)
        if self._origin is None:
            last = self.newest
            if last is None:
                return Row(0, 0.0, 0.0, 0.0, ranges, yaw)
            after = last.time + max(gap, self.robot.control_period)
            return Row(last.number + 1, after, last.left, last.right, ranges, yaw)
        before, row = self._origin
        steps = difference(packet.seq, before.seq)
        return Row(
            row.number + steps,
            row.time + MM * difference(packet.time_ms, before.time_ms),
            row.left + self._metres * difference(packet.left, before.left),
            row.right + self._metres * difference(packet.right, before.right),
            ranges,
            yaw,
            is_late=steps < 0,
        )

    def _is_plausible(self, row: Row) -> bool:
        """Whether the robot can have driven from the newest row to this one, or back to it."""
        last = self.newest
        if last is None or self._origin is None:
            return True
        elapsed = (row.time - last.time) * (-1.0 if row.is_late else 1.0)
        farthest = TOO_FAST * self.robot.max_wheel_speed * (elapsed + self.robot.control_period)
        travel = max(abs(row.left - last.left), abs(row.right - last.right))
        return elapsed > 0.0 and travel <= farthest


@contextmanager
def kept(
    recording: Recording, path: Path, report: Callable[[], None]
) -> Iterator[Callable[[], None]]:
    """Keep a copy of the log on disk, so that no error and no loss of power costs more than half a
    minute.

    The copy is removed when the context ends without an error. Otherwise it has all rows, and
    ``report`` is called.

    Yields
    ------
    Callable
        To be called often. It writes the copy when it is due.
    """
    last = time.monotonic()

    def save_if_due() -> None:
        nonlocal last
        if time.monotonic() - last >= SAVED_EVERY:
            recording.save(path)
            last = time.monotonic()

    try:
        yield save_if_due
    except BaseException:
        if len(recording):
            recording.save(path)
            report()
        raise
    path.unlink(missing_ok=True)


def _metres(reading: int | None) -> float:
    if reading is None:
        return math.nan
    return math.inf if reading == NOTHING_SEEN else MM * reading
