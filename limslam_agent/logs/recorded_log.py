"""The common form of all recorded logs, and the reader of the project's own ``log.npz``."""

import codecs
import gzip
import io
import math
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path
from typing import IO, Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from limslam_agent.logs.lost_reports import across
from limslam_agent.logs.odometry_breaks import OdometryBreak, odometry_breaks
from limslam_agent.readings import path_moved, settled
from limslam_agent.safe_files import load_arrays, open_regular
from limslam_env.geometry import BoolArray, FloatArray, se2
from limslam_env.geometry.numbers import LARGEST_COORDINATE
from limslam_env.interface import Observation, RobotSpec
from limslam_env.messages import one_line

FilePath: TypeAlias = str | PathLike[str]

GZIP_MAGIC = b"\x1f\x8b"
ZIP_MAGIC = b"PK\x03\x04"
# The longest known CARMEN line has about 4 kB. Without a limit, one "line" of a binary file could
# fill the memory.
LONGEST_LINE = 1 << 20

MOST_BEAMS = 4096
"""Most beams of a scan or columns of a table."""

MOST_UNPACKED = 16_000_000
LARGEST_RATIO = 16
"""Bytes of a gzip stream that are always unpacked, and how many times the size of the file may be
unpacked. A file of one megabyte could become one of a gigabyte.
"""

# m between two events. A longer motion is an error of the log, unless the rest of it is a drive.
LONGEST_JUMP = 50.0

_MAY_BE_MISSING = {"odometry", "wheels", "yaw"}  # as NaN
_LONGEST_TIME = 1e12  # s, 30,000 years; a float then still divides a millisecond


class LogError(ValueError):
    """A file cannot be used. The message is one line, ``<file>: what and where``."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


@contextmanager
def naming(path: FilePath, errors: tuple[type[Exception], ...] = (ValueError,)) -> Iterator[None]:
    """Turn a ValueError, or other errors about a file, and an OSError into a LogError that names
    the file.
    """
    try:
        yield
    except LogError:
        raise
    except errors as error:
        raise LogError(f"{fspath(path)}: {error}") from error
    except OSError as error:
        raise LogError(f"{fspath(path)}: cannot be read: {error.strerror or error}") from error


_UNUSED_YAW = "the heading beside the poses of the odometry is not used"


@dataclass(frozen=True, eq=False)
class RecordedLog:
    """A run as the robot recorded it, with one row for each event, in the order of the file.

    Attributes
    ----------
    robot
        Description of the robot, with the beams that were chosen.
    time
        Times of the log (n,), s. They may step back a little.
    ranges
        (n, n_beams) float32, m, as `limslam_agent.readings` defines them: a beam's maximum where
        nothing was seen, and NaN where there is no reading, or none that is new. They are given as
        the sensors report them.
    has_scan
        (n,) bool. Where False, the event has odometry only, and its ranges are the maxima.
    start_pose
        Pose of the robot at the first event (3,), m, m, rad, in the frame of the estimate, which is
        that pose itself where no other is given.
    odometry
        Absolute odometry poses (n, 3), m, m, rad, in a frame of their own, or None.
    wheels
        Left and right wheel travel since the previous event (n, 2), m, or None; NaN where it is not
        known. A log has either odometry or wheels.
    wheel_variances
        Variances (n, 2) of the travel beyond the noise of encoders, m^2. If left out, the travel
        that is missing is taken from the speeds around.
    true_pose
        True poses (n, 3), m, m, rad, for scoring only, or None.
    yaw
        Heading by an inertial measurement unit (n,), rad, counter-clockwise, in a frame of its own;
        NaN where it has no reading. None without such a sensor.
    notes
        What the reader has found and done, a line each, for the user: lines that were left out,
        times that were moved.
    gaps
        Events before which there was no odometry for a while.
    breaks
        The motions that the odometry poses do not tell: jumps and gaps.
    columns
        How each column of a table was read, a line each.
    header
        The names that ``--columns`` has for the columns of a table, in its order.
    missing
        What missing readings mean, one of ``limslam_agent.readings.MEANINGS``.
    reported
        The ranges (n, n_beams), m, as the sensors report them.
    repeated
        How many readings repeat another one. They are NaN in ``ranges``.
    readings_notes
        What was found about missing and repeated readings, a line each, for the user.

    Raises
    ------
    ValueError
        If a shape does not fit the others, or a number other than a range is not finite or too
        large.
    """

    robot: RobotSpec
    time: FloatArray
    ranges: NDArray[Any]
    has_scan: BoolArray
    start_pose: FloatArray = field(default_factory=lambda: np.zeros(3))
    odometry: FloatArray | None = None
    wheels: FloatArray | None = None
    true_pose: FloatArray | None = None
    yaw: FloatArray | None = None
    notes: tuple[str, ...] = ()
    gaps: tuple[int, ...] = ()
    wheel_variances: FloatArray | None = None
    columns: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    missing: str = "auto"
    breaks: tuple[OdometryBreak, ...] = field(init=False, default=())
    reported: NDArray[Any] = field(init=False)
    repeated: int = field(init=False)
    readings_notes: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        count = self.time.size
        if count == 0:
            raise ValueError("holds no events")
        if (self.odometry is None) == (self.wheels is None):
            raise ValueError("needs either odometry or wheels")
        widths = {"odometry": 3, "wheels": 2, "true_pose": 3, "ranges": len(self.robot.beams)}
        for name in ("time", "has_scan", "start_pose", "yaw", *widths):
            array = getattr(self, name)
            if array is not None:
                shape = (count, widths[name]) if name in widths else (count,)
                _check(name, array, (3,) if name == "start_pose" else shape)
        if self.wheels is not None and self.wheel_variances is None:
            # The travel that is missing is taken from the speeds around.
            travel, variances, notes = across(self.wheels, self.time, self.gaps, self.robot)
            self._set(wheels=travel, wheel_variances=variances, notes=(*self.notes, *notes))
        if self.odometry is not None:
            if self.yaw is not None and _UNUSED_YAW not in self.notes:
                self._set(notes=(*self.notes, _UNUSED_YAW))
            self._break(self.odometry)
        moved = path_moved(self._motions())
        found = settled(self.ranges, self.has_scan, self.robot, moved, self.missing)
        readings = np.where(self.has_scan[:, None], found.readings, self.robot.max_ranges)
        self._set(
            reported=self.ranges,
            ranges=readings.astype(np.float32),
            repeated=int(found.repeated.sum()),
            readings_notes=found.notes,
        )

    def _set(self, **fields: object) -> None:
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def _break(self, odometry: FloatArray) -> None:
        """Find the breaks of the odometry. Raises a ValueError if it jumps elsewhere."""
        breaks = odometry_breaks(self.time, odometry, self.gaps)
        self._set(breaks=breaks)
        jumps = np.hypot(*np.diff(odometry[:, :2], axis=0).T)
        jumps[[each.row - 1 for each in breaks]] = 0.0
        if np.any(jumps > LONGEST_JUMP):
            row = int(np.argmax(jumps > LONGEST_JUMP)) + 1
            raise ValueError(
                f"odometry jumps by {jumps[row - 1]:.3g} m in row {row}: is it in metres?"
            )

    def _motions(self) -> FloatArray:
        """The motion (n, 3) of each event since the event before, in the robot's frame, m, m, rad:
        zero after a jump of the odometry.
        """
        motions = np.zeros((len(self), 3))
        if self.odometry is not None:
            motions[1:] = se2.between(self.odometry[:-1], self.odometry[1:])
            motions[[each.row for each in self.breaks if each.is_jump]] = 0.0
        elif self.wheels is not None:
            motions[1:, 0] = self.wheels[1:].mean(axis=1)
            motions[1:, 2] = np.diff(self.wheels[1:], axis=1)[:, 0] / self.robot.axle
        return motions

    def taken(self, missing: str) -> "RecordedLog":
        """The same log with its missing readings taken as ``missing`` says. Raises a ValueError if
        that is unknown.
        """
        return replace(self, ranges=self.reported, missing=missing)

    def __len__(self) -> int:
        """Number of events."""
        return self.time.size

    @property
    def continuous_odometry(self) -> FloatArray | None:
        """The odometry poses (n, 3) with a robot that stays where it is at a jump."""
        if self.odometry is None or not self.breaks:
            return self.odometry
        poses = self.odometry.copy()
        for each in self.breaks:
            if each.is_jump:
                frame = se2.compose(poses[each.row - 1], se2.inverse(poses[each.row]))
                poses[each.row :] = se2.compose(frame, poses[each.row :])
        return poses

    def observations(self) -> Iterator[Observation]:
        """The observation of each event, in new arrays.

        Yields
        ------
        Observation
            ``ranges`` (n_beams,) float32, m, with ``wheels`` (2,) float32, m, or with ``odometry``
            (3,) float64. The odometry is the motion since the previous event in the robot's frame
            at that event. It is zero at the first event and after a jump, where a robot has most
            likely stayed. An event without a scan has no ``ranges``.
        """
        motions = self._motions()
        for row in range(len(self)):
            observation: Observation = {}
            if self.odometry is not None:
                observation["odometry"] = motions[row].copy()
            elif self.wheels is not None:
                observation["wheels"] = self.wheels[row].astype(np.float32)
                if self.wheel_variances is not None and self.wheel_variances[row].any():
                    observation["wheel_variances"] = self.wheel_variances[row]
            if self.yaw is not None:
                observation["yaw"] = float(self.yaw[row])
            if self.has_scan[row]:
                observation["ranges"] = self.ranges[row].astype(np.float32)
            yield observation


def read_npz(path: FilePath) -> RecordedLog:
    """Read the ``log.npz`` of a run's folder. A row is a step, and row 0 is the observation at the
    reset.

    Parameters
    ----------
    path
        A zip file of ``time`` (n,), s, ``ranges`` (n, n_beams), m, ``wheels`` (n, 2), m, ``action``
        (n, 2), ``start_pose`` (3,), and ``robot``, the text of :meth:`RobotSpec.to_json`. That of a
        robot with an inertial measurement unit has ``yaw`` (n,), rad. The log of a simulated run
        also has the truth: ``true_pose`` (n, 3) after each step, and ``wall_seen`` (n, n_beams).
        Pickled objects are refused.

    Raises
    ------
    LogError
        If the file cannot be read, is cut short or is not such a zip file; if an array is missing,
        or one of the two arrays of the truth; or if an array has a wrong shape or holds something
        other than finite numbers. Ranges may be infinite, NaN or negative, as
        `limslam_agent.readings` defines.
    """
    with naming(path):
        arrays = _load_arrays(path)
        robot = _robot_of(arrays["robot"])
        check_beams(len(robot.beams))
        count = arrays["time"].size
        if arrays["ranges"].ndim == 3:
            robots = arrays["ranges"].shape[1]
            raise ValueError(
                f"is the log of {robots} robots; only the log of one robot can be replayed"
            )
        _check("action", arrays["action"], (count, 2))
        if "wall_seen" in arrays:
            _check("wall_seen", arrays["wall_seen"], (count, len(robot.beams)))
        fields: dict[str, Any] = {name: arrays[name] for name in _FIELDS if name in arrays}
        for name, array in fields.items():
            if array.dtype.kind not in "fiu":
                raise ValueError(f"{name} does not hold numbers")
            fields[name] = array.astype(np.float64)
        return RecordedLog(robot, has_scan=np.ones(count, dtype=np.bool_), **fields)


def write_npz(path: Path, robot: RobotSpec, **arrays: Any) -> None:
    """Write a ``log.npz``: the arrays that :func:`read_npz` names, and the description of the
    robot.
    """
    np.savez_compressed(path, robot=np.array(robot.to_json()), **arrays)


def check_beams(count: int) -> None:
    """Raise a ValueError if there are more beams than ``MOST_BEAMS``."""
    if count > MOST_BEAMS:
        raise ValueError(f"a scan has {count} beams, more than {MOST_BEAMS}")


def first_bytes(path: FilePath, count: int) -> bytes:
    """The first ``count`` bytes of a file, or fewer if it is shorter. Raises a LogError if it
    cannot be read.
    """
    with naming(path), open_regular(Path(path)) as file:
        return file.read(count)


def numbered_lines(path: FilePath) -> Iterator[tuple[int, bytes]]:
    """The lines of a text file one at a time. A gzip file is recognised by its first bytes.

    Yields
    ------
    tuple
        Number of the line, counted from 1, and the line's bytes with the newline, which may only be
        missing at the end.

    Raises
    ------
    LogError
        If the file cannot be read, its gzip stream is cut short, damaged or too large, or it is not
        a text file.
    """
    number = unpacked = 0
    with naming(path), open_regular(Path(path)) as raw:
        largest = max(MOST_UNPACKED, LARGEST_RATIO * Path(path).stat().st_size)
        is_packed = raw.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        raw.seek(0)
        file: IO[bytes] = cast("IO[bytes]", gzip.GzipFile(fileobj=raw)) if is_packed else raw
        try:
            for text in _lines_of(file):
                number += 1
                line = text
                if number > 1 and b"\0" in text:
                    line = text.strip(b"\0")  # a card that lost its power leaves zeros
                if b"\0" in line or len(line) >= LONGEST_LINE:
                    raise ValueError(f"line {number}: this is not a text file")
                yield number, line.removeprefix(codecs.BOM_UTF8) if number == 1 else line
                unpacked += len(line)
                if is_packed and unpacked > largest:
                    raise ValueError(
                        f"line {number}: the gzip stream has more than {unpacked / 1e6:.0f} MB, "
                        f"{LARGEST_RATIO} times the size of the file: unpack it first"
                    )
        except EOFError as error:
            raise ValueError(f"line {number + 1}: cut short: the gzip stream ends here") from error
        except (gzip.BadGzipFile, zlib.error) as error:
            raise ValueError(f"line {number + 1}: the gzip stream is damaged: {error}") from error


def _lines_of(file: IO[bytes]) -> Iterator[bytes]:
    """The lines of a text, whatever ends them, with a newline. A text in UTF-16 becomes UTF-8."""
    is_utf16 = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    file.seek(0)
    read_as, write_as = ("utf-16", "utf-8") if is_utf16 else ("latin-1", "latin-1")
    with io.TextIOWrapper(file, encoding=read_as, errors="replace") as text:
        while line := text.readline(LONGEST_LINE):
            yield line.encode(write_as, "replace")


def read_lines(path: FilePath, take: Callable[[bytes], None]) -> None:
    """Hand the lines of a text file to a function, one after the other. Raises a LogError as
    :func:`numbered_lines` does; and where the function raises a ValueError, with the number of the
    line, and whether the file ends within it.
    """
    for number, line in numbered_lines(path):
        try:
            take(line)
        except ValueError as error:
            cut = "" if line.endswith(b"\n") else "cut short: "
            raise LogError(f"{fspath(path)}: line {number}: {cut}{error}") from error


def is_number(field: str | bytes) -> bool:
    """Whether a field of a text can be read as a number, finite or not."""
    try:
        float(field)
    except ValueError:
        return False
    return True


def parse_range(field: bytes, what: str) -> float:
    """A range from a field of a text. It may be infinite, NaN or negative, as
    `limslam_agent.readings` defines. Raises a ValueError if the field is not a number. The message
    begins with ``what``.
    """
    if not is_number(field):
        raise ValueError(f"{what} is not a number: {field.decode('ascii', 'replace')[:40]!r}")
    return float(field)


def parse_number(field: bytes, what: str) -> float:
    """A finite number from a field of a text. Raises a ValueError if the field is not a finite
    number. The message begins with ``what``.
    """
    value = parse_range(field, what)
    if not math.isfinite(value):
        raise ValueError(f"{what} is {field.decode('ascii', 'replace')[:40]}, not a finite number")
    return value


_TRUTH = ("true_pose", "wall_seen")
_FIELDS = ("time", "ranges", "start_pose", "wheels", "true_pose", "yaw")
_ARRAYS = ("time", "ranges", "wheels", "action", *_TRUTH, "robot", "start_pose")


def _load_arrays(path: FilePath) -> dict[str, NDArray[Any]]:
    if first_bytes(path, len(ZIP_MAGIC)) != ZIP_MAGIC:
        raise ValueError("is not an .npz file")
    arrays = load_arrays(Path(path), (*_ARRAYS, "yaw"), math.inf)
    missing = [name for name in _ARRAYS if name not in arrays]
    if not {"time", "wheels"} & arrays.keys():
        raise ValueError("is a zip file, and no log.npz of a run: replay what is packed in it")
    # The log of a live robot has no truth at all.
    if missing and missing != list(_TRUTH):
        raise ValueError(f"has no {' and no '.join(missing)}")
    return arrays


def _robot_of(text: NDArray[Any]) -> RobotSpec:
    if text.shape != () or text.dtype.kind != "U":
        raise ValueError("robot is not a text")
    try:
        return RobotSpec.from_json(str(text))
    except ValueError as error:
        raise ValueError(f"robot: {error}") from error


def _check(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Refuse an array of another shape, and numbers that are not finite where they must be."""
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, not {shape}")
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} does not hold numbers")
    if name == "ranges":
        return
    bad = np.isinf(array) if name in _MAY_BE_MISSING else ~np.isfinite(array)
    if bad.any():
        raise ValueError(
            f"{name} holds something that is not a finite number in row {np.argwhere(bad)[0, 0]}"
        )
    largest = _LONGEST_TIME if name == "time" else LARGEST_COORDINATE
    if np.any(np.abs(array, dtype=float) > largest):
        raise ValueError(f"{name} holds a number above {largest:g}: is it in metres or seconds?")
