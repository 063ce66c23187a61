"""Reads and writes trajectories as text, in the format of the TUM RGB-D benchmark: lines ``t x y z
qx qy qz qw``.
"""

import math
from pathlib import Path

import numpy as np

from limslam_agent.safe_files import read_limited
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.numbers import check_poses
from limslam_env.messages import one_line

# A robot on a floor rises by less, m, and is tilted by less, deg.
_LARGEST_RISE = 0.1
_LARGEST_TILT_DEG = 10.0
_FLAT = 0.2  # of the change of z: a smaller change of y means that the floor is the plane x-z


class TrajectoryError(ValueError):
    """A file does not hold a trajectory. The message says which file and why."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def write_tum(path: Path, time: FloatArray, poses: FloatArray) -> None:
    """Write a trajectory (n, 3) as TUM lines ``t x y z qx qy qz qw``, s and m."""
    half = 0.5 * poses[:, 2]
    zero = np.zeros(len(poses))
    table = np.column_stack(
        (time, poses[:, 0], poses[:, 1], zero, zero, zero, np.sin(half), np.cos(half))
    )
    np.savetxt(path, table, fmt="%.6f %.6f %.6f %.0f %.0f %.0f %.9f %.9f")


def suffix_of(robot: int, robots: int) -> str:
    """What the names of a robot's files end in: nothing for a single robot."""
    return f"_{robot}" if robots > 1 else ""


def trajectory_file(kind: str, robot: int, robots: int) -> str:
    """The name of the file of a robot's path of a kind, such as ``est``."""
    return f"trajectory_{kind}{suffix_of(robot, robots)}.tum"


def read_tum(path: Path) -> tuple[FloatArray, FloatArray]:
    """Times (n,), s, and poses in the plane (n, 3), m and rad, of a TUM file. Comments begin with
    ``#``.

    The heading of an orientation in space is its yaw, the first of the Euler angles z-y-x. Raises a
    ValueError if the file cannot be read, has a line with other fields or a quaternion of length 0,
    a coordinate that is too large, or no poses.
    """
    numbers, table = read_rows(path, "t x y z qx qy qz qw")
    if not len(table):
        raise TrajectoryError(f"{path}: is empty")
    is_turn = table[:, 4:].any(axis=1)
    if not is_turn.all():
        raise TrajectoryError(
            f"{path}: line {numbers[int(np.argmin(is_turn))]} has a quaternion of length 0"
        )
    poses = np.column_stack((table[:, 1:3], _yaw(table[:, 4:])))
    check_poses(f"{path}: coordinates", poses)
    return table[:, 0], poses


def out_of_plane(path: Path) -> list[str]:
    """Why the poses of a TUM file are more than their projection on the plane x-y, which is what
    :func:`read_tum` reads: a sentence, or nothing.
    """
    _, table = read_rows(path, "t x y z qx qy qz qw")
    if not len(table):
        return []
    squares = table[:, 4:] ** 2
    upright = 1.0 - 2.0 * squares[:, :2].sum(axis=1) / np.maximum(squares.sum(axis=1), 1e-12)
    tilt = math.degrees(math.acos(np.clip(upright.min(), -1.0, 1.0)))
    _, y, z = np.ptp(table[:, 1:4], axis=0).tolist()
    if z <= _LARGEST_RISE and tilt <= _LARGEST_TILT_DEG:
        return []
    found = f"{path}: z changes by {z:.2f} m, and poses are tilted by up to {tilt:.0f} deg"
    if z > _LARGEST_RISE and y < _FLAT * z:
        return [f"{found}, nearly without y: is it in the axes of a camera? x and y are scored"]
    return [f"{found}: their projection on the plane x-y is scored"]


def read_rows(path: Path, form: str) -> tuple[IntArray, FloatArray]:
    """Numbers of the lines (n,), counted from 1, and a table (n, k) of the finite numbers in them,
    by the order of the first number, the time.

    ``form`` names the k numbers of a line. Comments begin with ``#``. Raises a TrajectoryError if
    the file cannot be read, or a line has other fields.
    """
    numbers: list[int] = []
    rows: list[list[float]] = []
    width = len(form.split())
    try:
        lines = read_limited(path).decode("utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise TrajectoryError(
            f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error
    for number, line in enumerate(lines, start=1):
        text = line.partition("#")[0]
        if not text.strip():
            continue
        row = _numbers(text)
        if len(row) != width or not all(map(math.isfinite, row)):
            raise TrajectoryError(f"{path}: line {number} is not {form}")
        numbers.append(number)
        rows.append(row)
    table = np.array(rows).reshape(-1, width)
    order = np.argsort(table[:, 0], kind="stable")
    return np.array(numbers, dtype=int)[order], table[order]


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []


def _yaw(quaternions: FloatArray) -> FloatArray:
    """Yaw (n,), rad, of quaternions (n, 4) in the order x, y, z, w, which need not have the length
    1.
    """
    x, y, z, w = (quaternions / np.abs(quaternions).max(axis=1, keepdims=True)).T
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))
