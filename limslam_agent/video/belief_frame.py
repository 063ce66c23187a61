"""What an agent believes at one moment of a video, as plain arrays in the world frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from limslam_env.geometry import FloatArray, IntArray, no_rows
from limslam_env.geometry.line import direction, normal
from limslam_env.geometry.se2 import transform_points

# A buffer that was carried past all bounds has no picture that could be looked at.
_MOST_R_BINS = 240


@dataclass(frozen=True)
class Event:
    """What became of an observed line.

    Attributes
    ----------
    kind
        ``"new"``: it became a wall; ``"again"``: a known wall was seen again; ``"loop"``: two walls are one.
    wall
        Number of that wall.
    other
        The older wall that ``wall`` is the same as, where a loop was closed.
    robot
        Who saw it; a loop is nobody's.
    """

    kind: Literal["new", "again", "loop"]
    wall: int
    other: int | None = None
    robot: int = 0

    @property
    def words(self) -> str:
        """A few words for a list."""
        if self.kind == "loop":
            return f"loop closed: {self.wall} = {self.other}"
        return f"new wall {self.wall}" if self.kind == "new" else f"wall {self.wall} seen again"

    @property
    def walls(self) -> tuple[int, ...]:
        """Numbers of the walls that it is about."""
        return (self.wall,) if self.other is None else (self.wall, self.other)


@dataclass(frozen=True, eq=False)
class BufferView:
    """A scan buffer.

    Attributes
    ----------
    robot, side
        Whose it is.
    points
        (p, 2), m, in the world.
    size
        How many points fill it.
    """

    robot: int
    side: Literal["left", "right"]
    points: FloatArray
    size: int


@dataclass(frozen=True, eq=False)
class HoughView:
    """The last extraction of lines.

    Attributes
    ----------
    time
        When it was, s.
    robot, side
        Whose buffer it was.
    points
        What voted (p, 2), m, in the world.
    votes
        (r bins, theta bins): votes for each line, r from the middle of the points and increasing, theta
        from 0 to pi in the robot's frame.
    r_reach
        r of the bins runs from minus to plus this, m.
    peaks
        The lines that won (k, 2): r (m) and theta (rad) on those axes.
    segments
        The same lines (k, 4), m, in the world, as far as their points reach.
    threshold
        How many votes a line needs.
    """

    time: float
    robot: int
    side: Literal["left", "right"]
    points: FloatArray
    votes: IntArray
    r_reach: float
    peaks: FloatArray
    segments: FloatArray
    threshold: int = 0


@dataclass(frozen=True, eq=False)
class BeliefFrame:
    """What is believed at one moment. Arrays are in the world frame, m and rad; there are n robots and k walls.

    Attributes
    ----------
    time
        Simulated, s.
    poses, covariances
        (n, 3) and (n, 3, 3).
    segments
        Walls of the map (k, 4).
    lines, line_covariances
        (r, theta) of each wall (k, 2), and its covariance (k, 2, 2).
    numbers
        What the walls are called in ``events`` (k,); 1, 2, ... if left out.
    unsure
        Numbers of the walls that have been seen too seldom to count; they are drawn thinner.
    grid_low, grid_cell, grid_values
        The occupancy grid as in ``occupancy.GridView``: lower left corner (2,), side of a cell, and values
        (rows, columns), positive for free, negative for occupied, 0 for unknown.
    frontier
        Centres of the frontier cells (m, 2).
    plans, goals
        For each robot the way it means to go (p, 2), and where to (2,) or None.
    paths
        For each robot the positions it believes to have been at (q, 2).
    buffers
        Two of each robot.
    hough
        The last extraction; None before the first.
    events
        What has happened since the frame before.

    Raises
    ------
    ValueError
        If the arrays of poses or walls are not equally many.
    """

    time: float
    poses: FloatArray
    covariances: FloatArray
    segments: FloatArray = field(default_factory=lambda: no_rows(4))
    lines: FloatArray = field(default_factory=lambda: no_rows(2))
    line_covariances: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    numbers: tuple[int, ...] | None = None
    unsure: frozenset[int] = frozenset()
    grid_low: FloatArray = field(default_factory=lambda: np.zeros(2))
    grid_cell: float = 0.10
    grid_values: IntArray = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int16))
    frontier: FloatArray = field(default_factory=lambda: no_rows(2))
    plans: Sequence[FloatArray] = ()
    goals: Sequence[FloatArray | None] = ()
    paths: Sequence[FloatArray] = ()
    buffers: Sequence[BufferView] = ()
    hough: HoughView | None = None
    events: Sequence[Event] = ()

    def __post_init__(self) -> None:
        if len(self.poses) != len(self.covariances):
            raise ValueError(f"{len(self.poses)} poses have {len(self.covariances)} covariances")
        counts = {len(self.segments), len(self.lines), len(self.line_covariances), len(self.names)}
        if len(counts) > 1:
            raise ValueError(f"walls have {sorted(counts)} segments, lines, covariances and numbers")

    @property
    def names(self) -> tuple[int, ...]:
        """The number of each wall (k,)."""
        return tuple(range(1, len(self.segments) + 1)) if self.numbers is None else self.numbers


def wall_bands(frame: BeliefFrame, sigmas: float = 2.0, samples: int = 9) -> FloatArray:
    """Outlines (k, 2 samples, 2), m, of where the walls may be, so many standard deviations to each side.

    A line that is moved by (dr, dtheta) moves by dr - s dtheta across itself at the distance s along it from the
    foot of the origin's perpendicular, so its variance there is P_rr - 2 s P_rt + s^2 P_tt: narrow where the wall
    was seen, wider beyond, like a bow tie.
    """
    lines, covariances = frame.lines, frame.line_covariances
    share = np.linspace(0.0, 1.0, samples)[None, :, None]
    ends = frame.segments.reshape(-1, 2, 2)
    places = ends[:, :1] * (1.0 - share) + ends[:, 1:] * share
    along = np.einsum("ksd,kd->ks", places, direction(lines))
    p_rr, p_rt, p_tt = (covariances[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    # Rounding can make a variance of nothing negative.
    half_width = sigmas * np.sqrt(np.maximum(p_rr - 2.0 * along * p_rt + along**2 * p_tt, 0.0))
    across = half_width[..., None] * normal(lines)[:, None]
    return np.concatenate((places + across, (places - across)[:, ::-1]), axis=1)


def hough_view(
    points: FloatArray,
    lines: FloatArray,
    ends: FloatArray,
    pose: FloatArray,
    *,
    time: float,
    side: Literal["left", "right"],
    robot: int = 0,
    r_step: float = 0.02,
    theta_bins: int = 90,
    threshold: int = 0,
) -> HoughView:
    """What an extraction of lines looks like.

    Parameters
    ----------
    points
        The buffer (p, 2), m, in the robot's frame.
    lines, ends
        The lines that won, (r, theta) in the robot's frame (k, 2), and their end points (k, 2, 2), m.
    pose
        Where the robot believed to be (3,).
    time, side, robot, threshold
        As in :class:`HoughView`.
    r_step
        Width of a bin of r, m: that of the estimator shows what it saw.
    theta_bins
        Bins of theta from 0 to pi.
    """
    # The estimator counts votes about the middle of the points, where r and theta hardly interact.
    centre = points.mean(axis=0) if len(points) else np.zeros(2)
    votes, reach = hough_image(points - centre, r_step, theta_bins)
    shifted = lines - np.column_stack((normal(lines) @ centre, np.zeros(len(lines))))
    segments = transform_points(pose, ends.reshape(-1, 2)).reshape(-1, 4)
    return HoughView(
        time, robot, side, transform_points(pose, points), votes, reach, _upper_half(shifted), segments, threshold
    )


def hough_image(points: FloatArray, r_step: float = 0.02, theta_bins: int = 90) -> tuple[IntArray, float]:
    """How many points (p, 2), m, lie on each line (r, theta), with theta from 0 to pi and r from -reach to reach.

    Returns
    -------
    votes
        (r bins, theta bins).
    reach
        m.
    """
    farthest = float(np.linalg.norm(points, axis=1).max()) if len(points) else 0.0
    step = max(r_step, 2.0 * farthest / _MOST_R_BINS)
    # An odd number of bins: the one in the middle lies about r = 0, where a wall through all points has its votes.
    half = math.ceil(farthest / step)
    theta = (np.arange(theta_bins) + 0.5) * (math.pi / theta_bins)
    r = points @ np.vstack((np.cos(theta), np.sin(theta)))
    rows = np.clip(np.round(r / step).astype(np.int64) + half, 0, 2 * half)
    bins = rows * theta_bins + np.arange(theta_bins)
    votes = np.bincount(bins.ravel(), minlength=(2 * half + 1) * theta_bins)
    return votes.reshape(2 * half + 1, theta_bins), (half + 0.5) * step


def _upper_half(lines: FloatArray) -> FloatArray:
    """The same lines (k, 2) with theta in [0, pi), as the votes have it; r may be negative."""
    turns = np.floor(lines[:, 1] / math.pi)
    return np.column_stack((np.where(turns % 2 == 0, lines[:, 0], -lines[:, 0]), lines[:, 1] - turns * math.pi))
