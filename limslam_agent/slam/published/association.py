"""Section 2.4: which landmark an observed line is. The association is a parameter of the method."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from limslam_agent.config.published import AssociationConfig
from limslam_agent.slam.core.diagnostics import CandidateTest
from limslam_agent.slam.core.line_comparison import apart, can_see
from limslam_agent.slam.published.features import ObservedLine
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import from_frame
from limslam_env.geometry.se2 import transform_points
from limslam_env.geometry.segment import distances


class Landmarks(NamedTuple):
    """All landmarks, in the world."""

    lines: FloatArray  # (r, theta) of each, (N, 2), m and rad
    segments: FloatArray  # between their end points (N, 4), m


class Match(NamedTuple):
    """What an observed line is: without landmarks, it is a new one."""

    landmarks: tuple[int, ...]  # those that it may be, nearest first; the first one is corrected
    tests: tuple[CandidateTest, ...] = ()  # of all landmarks, for diagnostics


Innovation = Callable[[ObservedLine, int], tuple[FloatArray, FloatArray]]
"""z - z_k (2,) of an observed line and landmark k, and Psi_k (2, 2)."""


class Associate(Protocol):
    """Decides which landmark a line is that a robot at a pose (3,) has observed."""

    def __call__(
        self, observed: ObservedLine, pose: FloatArray, landmarks: Landmarks, innovation: Innovation
    ) -> Match:
        """The landmarks that the line may be."""


@dataclass(frozen=True)
class PaperAssociation:
    """The paper's association, for beams that measure up to ``reach``, m, from the robot."""

    config: AssociationConfig
    reach: float

    def __call__(
        self, observed: ObservedLine, pose: FloatArray, landmarks: Landmarks, innovation: Innovation
    ) -> Match:
        """The landmarks that no exclusion eliminates, by their Mahalanobis distance (eq. 4)."""
        config = self.config
        line = from_frame(observed.line, pose)
        own = (observed.ends, observed.scan.origins, observed.scan.points)
        ends, origins, points = (transform_points(pose, each) for each in own)
        angles, offsets, gaps = off = apart(line, ends, *landmarks)
        reach = self.reach + config.range_slack
        passed = {
            "ends": gaps <= config.max_end_gap,  # else walls on one line are one (figure 2)
            "range": distances(pose[None, :2], landmarks.segments)[0] <= reach,
            "direction": (angles <= config.max_angle) & (offsets <= config.max_distance),
            "hidden": can_see(origins, points, landmarks.segments, reach, config.slack),
        }
        tests = []
        for index, (angle, offset, gap) in enumerate(np.transpose(off).tolist()):
            excluded = next((name for name, passes in passed.items() if not passes[index]), "")
            squared = np.nan
            if not excluded:
                y, psi = innovation(observed, index)
                squared = float(y @ np.linalg.solve(psi, y))  # eq. 4
                excluded = "gate" if squared > config.gate else ""
            tests.append(CandidateTest(index, excluded, angle, offset, gap, squared))
        possible = sorted((test.distance, test.landmark) for test in tests if not test.excluded)
        return Match(tuple(landmark for _, landmark in possible), tuple(tests))
