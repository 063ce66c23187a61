"""The content of one video frame: what an agent believes at one moment, in the world frame."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.diagnostics import PendingPoints
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray, IntArray, no_rows
from limslam_env.geometry.line import direction, normal
from limslam_env.geometry.se2 import transform_points

# Limit for buffers whose points have been moved very far apart by odometry.
_MOST_R_BINS = 240
_MM = 1e-3


@dataclass(frozen=True)
class Event:
    """The association of an observed line, or a loop closure."""

    # ``"new"``: the line became a wall. ``"again"``: the line is a known wall. ``"loop"``: two
    # walls are the same wall.
    kind: Literal["new", "again", "loop"]
    wall: int  # Number of the wall
    other: int | None = None  # For a loop, number of the older wall that is the same as ``wall``
    robot: int = 0  # Robot that saw the line. A loop belongs to no robot.

    @property
    def words(self) -> str:
        """A short text for a list."""
        if self.kind == "loop":
            return f"loop closed: {self.wall} = {self.other}"
        return f"new wall {self.wall}" if self.kind == "new" else f"wall {self.wall} seen again"

    @property
    def walls(self) -> tuple[int, ...]:
        """Numbers of the walls that the event is about."""
        return (self.wall,) if self.other is None else (self.wall, self.other)


@dataclass(frozen=True, eq=False)
class HoughView:
    """The latest extraction of lines."""

    time: float  # Time of the extraction, s
    robot: int
    side: Literal["left", "right"]
    points: FloatArray  # The points that voted (p, 2), m, in the world frame
    # Number of votes for each line (r bins, theta bins). r is measured from the mean of the points
    # and increases with the row. theta goes from 0 to pi in the robot's frame.
    votes: IntArray
    r_reach: float  # The bins of r go from minus this value to plus this value, m
    peaks: FloatArray  # The extracted lines (k, 2): r (m) and theta (rad) on the axes of ``votes``
    # The extracted lines (k, 4), m, in the world frame, cut to the extent of their points
    segments: FloatArray

    @classmethod
    def of(cls, extraction: Mapping[str, Any], time: float) -> "HoughView":
        """The view of an extraction as a recording has it (``limslam_agent.inspect.event_log``), at
        a time, s.

        The bins of r are those of the estimator, so that the votes are those that it saw.
        """
        points = _MM * np.array(extraction["points"], dtype=float).reshape(-1, 2)
        lines = np.array(extraction["lines"]).reshape(-1, 2)
        pose = np.array(extraction["pose"])
        # The estimator counts votes about the mean of the points, where r and theta are nearly
        # independent.
        centre = points.mean(axis=0) if len(points) else np.zeros(2)
        votes, reach = hough_image(points - centre, extraction["r_step"])
        shifted = lines - np.column_stack((normal(lines) @ centre, np.zeros(len(lines))))
        segments = transform_points(pose, np.array(extraction["ends"]).reshape(-1, 2)).reshape(
            -1, 4
        )
        return cls(
            time,
            extraction["robot"],
            extraction["side"],
            transform_points(pose, points),
            votes,
            reach,
            _upper_half(shifted),
            segments,
        )


@dataclass(frozen=True, eq=False)
class BeliefFrame:
    """What is believed at one moment. Arrays are in the world frame, m and rad. There are n
    robots.
    """

    time: float  # Simulated time, s
    poses: FloatArray  # (n, 3)
    covariances: FloatArray  # of the poses (n, 3, 3)
    walls: Sequence[
        Landmark
    ] = ()  # All landmarks. A wall is called by its number plus one, also in ``events``.
    # Names of provisional walls, which were seen too few times. They are drawn thinner.
    unsure: frozenset[int] = frozenset()
    grid: GridView | None = None  # Occupancy grid. None draws no grid.
    frontier: FloatArray = field(
        default_factory=lambda: no_rows(2)
    )  # Centres of the frontier cells (m, 2)
    # Each robot's planned path (p, 2) and its goal (2,) or None
    plans: Sequence[FloatArray] = ()
    goals: Sequence[FloatArray | None] = ()
    new_goals: Sequence[int] = ()  # Robots that have got another goal since the previous frame
    paths: Sequence[FloatArray] = ()  # Positions (q, 2) of each robot so far, as it estimated them
    # The points that wait for an extraction, two entries for each robot: the scan buffers
    buffers: Sequence[PendingPoints] = ()
    hough: HoughView | None = None  # The latest extraction of lines. None before the first.
    events: Sequence[Event] = ()  # Events since the previous frame
    warning: str = ""  # Why the estimate cannot be trusted, in words. Empty if it can.


def wall_bands(walls: Sequence[Landmark], sigmas: float = 2.0, samples: int = 9) -> FloatArray:
    """Outlines (k, 2 samples, 2), m, of the regions that contain the walls, ``sigmas`` standard
    deviations to each side.

    A change (dr, dtheta) of a line moves its points by dr - s dtheta across the line, where s is
    the distance along the line from the foot of the origin's perpendicular. The variance there is
    P_rr - 2 s P_rt + s^2 P_tt. The band is narrow where the wall was seen and wider beyond.
    """
    lines = np.array([(wall.r, wall.theta) for wall in walls]).reshape(-1, 2)
    covariances = np.array([wall.covariance for wall in walls]).reshape(-1, 2, 2)
    ends = np.array([wall.ends for wall in walls]).reshape(-1, 2, 2)
    share = np.linspace(0.0, 1.0, samples)[None, :, None]
    places = ends[:, :1] * (1.0 - share) + ends[:, 1:] * share
    along = np.einsum("ksd,kd->ks", places, direction(lines))
    p_rr, p_rt, p_tt = (covariances[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    # Rounding errors can make a variance of zero negative.
    half_width = sigmas * np.sqrt(np.maximum(p_rr - 2.0 * along * p_rt + along**2 * p_tt, 0.0))
    across = half_width[..., None] * normal(lines)[:, None]
    return np.concatenate((places + across, (places - across)[:, ::-1]), axis=1)


def hough_image(
    points: FloatArray, r_step: float = 0.02, theta_bins: int = 90
) -> tuple[IntArray, float]:
    """Number of points (p, 2), m, on each line (r, theta), with theta from 0 to pi and r from
    -reach to reach.

    Returns
    -------
    votes
        (r bins, theta bins).
    reach
        m.
    """
    farthest = float(np.linalg.norm(points, axis=1).max()) if len(points) else 0.0
    step = max(r_step, 2.0 * farthest / _MOST_R_BINS)
    # The number of bins is odd. The middle bin is centred at r = 0, where a wall through all points
    # gets its votes.
    half = math.ceil(farthest / step)
    theta = (np.arange(theta_bins) + 0.5) * (math.pi / theta_bins)
    r = points @ np.vstack((np.cos(theta), np.sin(theta)))
    rows = np.clip(np.round(r / step).astype(np.int64) + half, 0, 2 * half)
    bins = rows * theta_bins + np.arange(theta_bins)
    votes = np.bincount(bins.ravel(), minlength=(2 * half + 1) * theta_bins)
    return votes.reshape(2 * half + 1, theta_bins), (half + 0.5) * step


def _upper_half(lines: FloatArray) -> FloatArray:
    """The same lines (k, 2) with theta in [0, pi), as in the votes. r may be negative."""
    turns = np.floor(lines[:, 1] / math.pi)
    return np.column_stack(
        (np.where(turns % 2 == 0, lines[:, 0], -lines[:, 0]), lines[:, 1] - turns * math.pi)
    )
