"""Association: each exclusion alone keeps a pair apart that would pass without it, wherever the robot stands."""

import math
from dataclasses import replace

import numpy as np
import pytest

from limslam_agent.config.published import AssociationConfig
from limslam_agent.slam.core.diagnostics import CandidateTest
from limslam_agent.slam.core.ekf import LineEKF
from limslam_agent.slam.published import association
from limslam_agent.slam.published.association import ObservedLine, associate
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry

# Given here, not left to the defaults: the scenes are drawn around these gaps.
CONFIG = AssociationConfig(gate=100.0, max_end_gap=0.25, range_slack=0.25)
MAX_RANGE = 1.6
# Scenes are written down about a robot at the origin and then put anywhere: all round, behind the
# start, turned by more than 90 degrees, and such that the walls of the scenes pass close by the origin.
PLACES = [(2.0, -1.0, 2.5), (0.0, 0.499, 3.1)]


def sure(_line: FloatArray, _covariance: FloatArray, _landmark: int) -> tuple[FloatArray, FloatArray]:
    """An innovation that lets every pair through: only the exclusions decide."""
    return np.zeros(2), np.eye(2)


def observed(start: tuple[float, float], end: tuple[float, float], *beam_origins: tuple[float, float]) -> ObservedLine:
    """A wall seen from ``start`` to ``end`` in the robot's frame, by beams from straight before it unless said."""
    points = np.linspace(start, end, 10)
    line = line_geometry.through(np.array(start), np.array(end))
    toward = np.array([math.cos(line[1]), math.sin(line[1])])
    origins = np.array(beam_origins) if beam_origins else points - 0.4 * toward
    if len(origins) != len(points):
        origins = np.resize(origins, points.shape)
    return ObservedLine(line, 1e-4 * np.eye(2), points[[0, -1]], origins, points)


def landmarks(
    pose: FloatArray, *walls: tuple[float, float, float, float], opposite: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Lines (N, 2) and segments (N, 4) in the world of walls given in the robot's frame."""
    segments = np.array([se2.transform_points(pose, np.reshape(wall, (2, 2))).ravel() for wall in walls])
    lines = np.array([line_geometry.through(segment[:2], segment[2:]) for segment in segments])
    if opposite:
        lines = np.column_stack((-lines[:, 0], lines[:, 1] + math.pi))
        segments = segments[:, [2, 3, 0, 1]]
    return lines, segments


WALL_AHEAD = observed((0.0, 0.5), (0.6, 0.5))

# What is observed, the landmark, and the one exclusion that keeps them apart.
SCENES = {
    # Most beams meet the landmark lengthened by the slack of 0.5 m.
    "before a gap of 0.4 m": (observed((0.0, 0.5), (0.15, 0.5)), (-1.4, 0.5, -0.4, 0.5), "near_ends"),
    # Beside a long observation that its few last beams alone reach.
    "seen by too few": (observed((-1.2, 0.5), (0.6, 0.5)), (0.4, 0.6, 1.0, 0.6), "visible"),
    # Observed to the left and a landmark that is crossed on the right only.
    "behind the robot": (observed((-0.3, 0.15), (0.3, 0.15), (0.0, 0.1)), (-0.3, -0.15, 0.3, -0.15), "visible"),
    # Points of a long way back: their wall's continuation is near them, but out of sight from here.
    "out of range": (observed((-2.2, 0.5), (-1.8, 0.5)), (-3.5, 0.5, -2.4, 0.5), "in_range"),
    "turned by 30 degrees": (WALL_AHEAD, (0.05, 0.35, 0.55, 0.64), "alike"),
    "parallel, 0.5 m farther": (WALL_AHEAD, (0.0, 1.0, 0.6, 1.0), "alike"),
}  # fmt: skip
EXCLUSIONS = ("near_ends", "visible", "in_range", "alike")


def possible(tests: list[CandidateTest]) -> list[int]:
    """The landmarks that are not excluded, nearest first."""
    return [test.landmark for test in sorted(tests, key=lambda test: test.distance) if not test.excluded]


def matched(observation: ObservedLine, pose: FloatArray, lines: FloatArray, segments: FloatArray) -> list[int]:
    return possible(associate(observation, pose, lines, segments, sure, MAX_RANGE, CONFIG))


@pytest.mark.parametrize("opposite", [False, True], ids=["", "landmark in its other form"])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("scene", SCENES)
def test_one_exclusion_alone_keeps_the_pair_apart(
    scene: str, place: tuple[float, float, float], opposite: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    observation, wall, exclusion = SCENES[scene]
    pose = np.array(place)
    lines, segments = landmarks(pose, wall, opposite=opposite)
    assert matched(observation, pose, lines, segments) == []
    # Without any of the other three the pair is still ruled out, and without this one it goes through.
    for other in EXCLUSIONS:
        with monkeypatch.context() as patch:
            patch.setattr(association, other, lambda *_: np.array([True]))
            assert len(matched(observation, pose, lines, segments)) == (other == exclusion)


SEEN_AGAIN = {
    "beside": (WALL_AHEAD, (0.0, 0.5, 0.6, 0.5)),
    "its continuation": (WALL_AHEAD, (0.8, 0.5, 1.5, 0.5)),
    "part of it": (WALL_AHEAD, (-1.0, 0.5, 1.5, 0.5)),
    "askew": (observed((0.4, 0.9), (1.0, 0.3)), (0.5, 0.8, 0.9, 0.4)),
}


@pytest.mark.parametrize("opposite", [False, True], ids=["", "landmark in its other form"])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("scene", SEEN_AGAIN)
def test_a_wall_seen_again_passes_all_four(scene: str, place: tuple[float, float, float], opposite: bool) -> None:
    observation, wall = SEEN_AGAIN[scene]
    pose = np.array(place)
    lines, segments = landmarks(pose, wall, opposite=opposite)
    assert matched(observation, pose, lines, segments) == [0]


@pytest.mark.parametrize("place", PLACES)
def test_the_nearest_landmark_comes_first_and_the_gate_ends_the_list(place: tuple[float, float, float]) -> None:
    pose = np.array(place)
    walls = [(0.0, 0.5 + offset, 0.6, 0.5 + offset) for offset in (0.11, 0.02, -0.08, -0.3)]
    lines, segments = landmarks(pose, *walls)
    ekf = LineEKF(pose, 1e-12 * np.eye(3))
    for line in lines:
        ekf.augment(line_geometry.to_frame(line, pose), 1e-12 * np.eye(2))
    # The observation's sd is 2 cm: 0.11 m off is 30 in squared distance, 0.3 m is 225 and past the gate of 100.
    observation = replace(WALL_AHEAD, covariance=np.diag([4e-4, 1e-3]))
    found = associate(observation, pose, lines, segments, ekf.innovation, MAX_RANGE, CONFIG)
    assert possible(found) == [1, 2, 0]
    assert [test.distance for test in found] == pytest.approx([30.25, 1.0, 16.0, 225.0], rel=1e-3)
    gated = associate(observation, pose, lines, segments, ekf.innovation, MAX_RANGE, replace(CONFIG, gate=10.0))
    assert possible(gated) == [1]
