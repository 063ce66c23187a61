"""The published estimator: buffers of points, association, and loop closing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.drives import ranges_at

from limslam_agent import AgentConfig, LineSlam, preset
from limslam_agent.config.presets import ablated
from limslam_agent.config.published import (
    AssociationConfig,
    BufferConfig,
    LoopClosingConfig,
    PublishedConfig,
)
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.motion import Motion
from limslam_agent.slam.published import Landmarks, Match, ObservedLine, PaperAssociation
from limslam_agent.slam.published.features import Scan, ScanBuffer
from limslam_agent.slam.published.filter import LineFilter
from limslam_env import NominalNoise, RobotSpec
from limslam_env.geometry import BoolArray, FloatArray, se2, segment
from limslam_env.geometry import line as line_geometry
from limslam_env.interface import beams_on_rim

ROBOT = RobotSpec()  # beams at 90, 45, 15, -15, -45, -90 deg; left are 0 and 1, right are 4 and 5
ALL = np.ones(6, dtype=bool)
RANGES = np.array([0.4, 0.6, 1.0, 1.1, 0.7, 0.5])


def moved(buffer: ScanBuffer, increment: FloatArray) -> None:
    buffer.move(Motion(increment, np.zeros((3, 3))))


def added(buffer: ScanBuffer, step: int, hits: BoolArray = ALL) -> list[Scan]:
    """The scans that a buffer hands on when it is told of a step in which all beams measured."""
    front = FrontEnd(ROBOT, NominalNoise())
    front.ranges, front.measured, front.hits, front.step = RANGES, ALL, hits, step
    return buffer.add(front)


def ends_in_world(pose: FloatArray, beams: list[int]) -> FloatArray:
    """Where the beams end, worked out beam by beam."""
    points = []
    for beam in beams:
        spec = ROBOT.beams[beam]
        heading = pose[2] + spec.angle
        origin = se2.transform_points(pose, np.array([[spec.x, spec.y]]))[0]
        points.append(origin + RANGES[beam] * np.array([math.cos(heading), math.sin(heading)]))
    return np.array(points)


increments = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.4, 0.4)).map(
    lambda motion: se2.arc(*motion)
)


@settings(deadline=None, max_examples=50)
@given(st.lists(increments, min_size=1, max_size=20))
def test_points_and_origins_stay_fixed_in_the_world_while_the_robot_moves(
    motions: list[FloatArray],
) -> None:
    pose = np.array([1.0, -2.0, 2.5])
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(size=100, max_gap=100.0))
    added(buffer, 0)
    ends = ends_in_world(pose, [0, 1])
    origins = se2.transform_points(pose, ROBOT.beam_origins[:2])
    for motion in motions:
        pose = se2.compose(pose, motion)
        moved(buffer, motion)
    np.testing.assert_allclose(se2.transform_points(pose, buffer.scan.points), ends, atol=1e-9)
    np.testing.assert_allclose(se2.transform_points(pose, buffer.scan.origins), origins, atol=1e-9)


STRAIGHT = np.array([0.02, 0.0, 0.0])


def test_a_buffer_is_handed_on_when_it_reaches_its_size_and_begins_anew() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(size=6))
    handed_on: list[list[Scan]] = []
    for step in range(6):
        moved(buffer, STRAIGHT)
        handed_on.append(added(buffer, step))
    sizes = [[len(scan.points) for scan in scans] for scans in handed_on]
    assert sizes == [[], [], [6], [], [], [6]]
    assert len(buffer.scan.points) == 0
    # The second scan holds nothing of the first.
    assert handed_on[5][0].readings[:, 0].tolist() == [3, 3, 4, 4, 5, 5]


def test_a_wall_that_has_ended_is_handed_on_after_the_gap_and_not_before() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(max_gap=0.25))
    added(buffer, 0, np.arange(6) == 0)
    handed_on = []
    for step in range(1, 20):
        moved(buffer, STRAIGHT)
        handed_on.append(added(buffer, step, ~ALL))
    assert [index for index, scans in enumerate(handed_on) if scans] == [12]
    np.testing.assert_allclose(handed_on[12][0].points, [[-0.26, 0.5]], atol=1e-12)
    assert len(buffer.scan.points) == 0


# Written here, not left to the defaults: the scenes are drawn around these gaps.
CONFIG = AssociationConfig(gate=100.0, max_end_gap=0.25, range_slack=0.25)
MAX_RANGE = 1.6
# Scenes are written down about a robot at the origin and then put anywhere: all round, behind the
# start, turned by more than 90 degrees, and such that the walls of the scenes pass close by the
# origin.
PLACES = [(2.0, -1.0, 2.5), (0.0, 0.499, 3.1)]


def sure(_observed: ObservedLine, _landmark: int) -> tuple[FloatArray, FloatArray]:
    """An innovation that lets every pair through: only the exclusions decide."""
    return np.zeros(2), np.eye(2)


def observed(
    start: tuple[float, float], end: tuple[float, float], *beam_origins: tuple[float, float]
) -> ObservedLine:
    """A wall seen from ``start`` to ``end`` in the robot's frame, by beams from straight before it
    unless said.
    """
    points = np.linspace(start, end, 10)
    line = line_geometry.through(np.array(start), np.array(end))
    toward = np.array([math.cos(line[1]), math.sin(line[1])])
    origins = np.array(beam_origins) if beam_origins else points - 0.4 * toward
    scan = Scan(points, np.resize(origins, points.shape))
    return ObservedLine(line, 1e-4 * np.eye(2), points[[0, -1]], scan)


def landmarks(
    pose: FloatArray, *walls: tuple[float, float, float, float], opposite: bool = False
) -> Landmarks:
    """Walls, which are written in the robot's frame, in the world."""
    segments = np.array(
        [se2.transform_points(pose, np.reshape(wall, (2, 2))).ravel() for wall in walls]
    )
    lines = np.array([line_geometry.through(segment[:2], segment[2:]) for segment in segments])
    if opposite:
        lines = np.column_stack((-lines[:, 0], lines[:, 1] + math.pi))
        segments = segments[:, [2, 3, 0, 1]]
    return Landmarks(lines, segments)


WALL_AHEAD = observed((0.0, 0.5), (0.6, 0.5))

# What is observed, the landmark, and the one exclusion that keeps them apart.
SCENES = {
    # Most beams meet the landmark lengthened by the slack of 0.5 m.
    "before a gap of 0.4 m": (observed((0.0, 0.5), (0.15, 0.5)), (-1.4, 0.5, -0.4, 0.5), "ends"),
    # Beside a long observation that its few last beams alone reach.
    "seen by too few": (observed((-1.2, 0.5), (0.6, 0.5)), (0.4, 0.6, 1.0, 0.6), "hidden"),
    # Observed to the left and a landmark that is crossed on the right only.
    "behind the robot": (
        observed((-0.3, 0.15), (0.3, 0.15), (0.0, 0.1)),
        (-0.3, -0.15, 0.3, -0.15),
        "hidden",
    ),
    # Points of a long way back: their wall's continuation is near them, but out of sight from here.
    "out of range": (observed((-2.2, 0.5), (-1.8, 0.5)), (-3.5, 0.5, -2.4, 0.5), "range"),
    "turned by 30 degrees": (WALL_AHEAD, (0.05, 0.35, 0.55, 0.64), "direction"),
    "parallel, 0.5 m farther": (WALL_AHEAD, (0.0, 1.0, 0.6, 1.0), "direction"),
    "beside": (WALL_AHEAD, (0.0, 0.5, 0.6, 0.5), ""),
    "its continuation": (WALL_AHEAD, (0.8, 0.5, 1.5, 0.5), ""),
    "part of it": (WALL_AHEAD, (-1.0, 0.5, 1.5, 0.5), ""),
    "askew": (observed((0.4, 0.9), (1.0, 0.3)), (0.5, 0.8, 0.9, 0.4), ""),
}


@pytest.mark.parametrize("opposite", [False, True], ids=["", "landmark in its other form"])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("scene", SCENES)
def test_an_exclusion_keeps_a_pair_apart_and_a_wall_seen_again_passes_all(
    scene: str, place: tuple[float, float, float], opposite: bool
) -> None:
    observation, wall, exclusion = SCENES[scene]
    pose = np.array(place)
    known = landmarks(pose, wall, opposite=opposite)
    match = PaperAssociation(CONFIG, MAX_RANGE)(observation, pose, known, sure)
    assert match.landmarks == (() if exclusion else (0,))
    assert [test.excluded for test in match.tests] == [exclusion]


@pytest.mark.parametrize("place", PLACES)
def test_the_nearest_landmark_comes_first_and_the_gate_ends_the_list(
    place: tuple[float, float, float],
) -> None:
    pose = np.array(place)
    walls = [(0.0, 0.5 + offset, 0.6, 0.5 + offset) for offset in (0.11, 0.02, -0.08, -0.3)]
    known = landmarks(pose, *walls)
    ekf = LineFilter(pose)
    ekf.P = 1e-12 * np.eye(3)
    for line in known.lines:
        exact = WALL_AHEAD._replace(
            line=line_geometry.to_frame(line, pose), covariance=1e-12 * np.eye(2)
        )
        ekf.augment(exact)
    # The observation's sd is 2 cm: 0.11 m off is 30 in squared distance, 0.3 m is 225 and past the
    # gate of 100.
    observation = WALL_AHEAD._replace(covariance=np.diag([4e-4, 1e-3]))
    match = PaperAssociation(CONFIG, MAX_RANGE)(observation, pose, known, ekf.innovation)
    assert match.landmarks == (1, 2, 0)
    assert [test.distance for test in match.tests] == pytest.approx(
        [30.25, 1.0, 16.0, 225.0], rel=1e-3
    )
    narrow = PaperAssociation(replace(CONFIG, gate=10.0), MAX_RANGE)
    assert narrow(observation, pose, known, ekf.innovation).landmarks == (1,)


FOUR_BEAMS = RobotSpec(beams=beams_on_rim((90.0, 60.0, -60.0, -90.0), 0.1))


def test_the_ablations_are_one_switch_each() -> None:
    base = preset("paper")
    assert not ablated(base, "no-loop-closing").estimator.closing.enabled
    assert not ablated(base, "no-ekf").estimator.filter.correct
    assert ablated(base, "no-end-gate").estimator.association.max_end_gap > 1e3
    assert ablated(base, "only-best-line").estimator.hough.only_best
    with pytest.raises(ValueError, match="no ablation is called 'no-brain'"):
        ablated(base, "no-brain")


def walled_loop() -> tuple[FloatArray, FloatArray]:
    """A round trip of a robot in a square corridor: true poses (n, 3), and the outer and inner
    walls (8, 4).
    """
    corners = np.array([[0.6, 0.6], [3.4, 0.6], [3.4, 3.4], [0.6, 3.4]])
    poses = []
    for side in range(5):
        start = corners[side % 4]
        end = corners[(side + 1) % 4]
        heading = se2.wrap_angle(float(np.pi / 2 * side))
        poses += [[*place, heading] for place in np.linspace(start, end, 140, endpoint=False)]
        poses += [
            [*end, se2.wrap_angle(heading + turn)]
            for turn in np.linspace(0.0, np.pi / 2, 16, endpoint=False)
        ]
    outer = segment.polygon_edges(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]))
    inner = segment.polygon_edges(np.array([[1.2, 1.2], [2.8, 1.2], [2.8, 2.8], [1.2, 2.8]]))
    return np.array(poses), np.vstack((outer, inner))


def sensed(poses: FloatArray, walls: FloatArray, drift: float) -> list[dict[str, FloatArray]]:
    """What the robot reads on the way; its wheels tell ``drift`` (rad per m) too much of a turn."""
    observations = []
    before = poses[0]
    for pose in poses:
        ahead, _, turn = se2.compose(se2.inverse(before), pose)
        half = 0.5 * FOUR_BEAMS.axle * (turn + drift * ahead)
        observations.append(
            {
                "ranges": ranges_at(pose, walls, FOUR_BEAMS),
                "wheels": np.array([ahead - half, ahead + half]),
            }
        )
        before = pose
    return observations


@pytest.mark.parametrize("drift", [0.012, -0.012])
def test_round_a_loop_old_walls_are_found_again_and_the_error_shrinks(drift):
    poses, walls = walled_loop()
    observations = sensed(poses, walls, drift)
    errors = []
    slams = []
    for enabled in (True, False):
        estimator = PublishedConfig(closing=LoopClosingConfig(enabled=enabled))
        config = AgentConfig(estimator=estimator, noise=NominalNoise(0.005, 2e-4))
        slam = LineSlam(FOUR_BEAMS, config, poses[0])
        for observation in observations:
            slam.step(observation)
        slams.append(slam)
        errors.append(np.hypot(*(slam.pose[:2] - poses[-1, :2])))
    closing, without = slams
    assert closing.closures, "no loop was closed, and the test shows nothing"
    assert not without.closures
    assert {record.is_new for record in closing.associations} == {False, True}
    for closure in closing.closures:
        assert closure.older < closure.younger
        # Two that lie on each other already cannot come closer.
        assert closure.distance_after < max(closure.distance_before, 0.1)
        assert closure.offset_after <= closure.offset_before + 0.005
    assert errors[0] < 0.30
    assert errors[0] < errors[1] + 0.05


def test_another_association_takes_the_place_of_the_papers():
    def all_new(observed, pose, landmarks, innovation):
        assert len(observed.scan.points) >= 2
        assert pose.shape == (3,)
        for index in range(len(landmarks.lines)):
            assert [part.shape for part in innovation(observed, index)] == [(2,), (2, 2)]
        return Match(())

    poses, walls = walled_loop()
    slam = LineSlam(FOUR_BEAMS, preset("paper"), poses[0], associate=all_new)
    for observation in sensed(poses[:300], walls, 0.0):
        slam.step(observation)
    assert len(slam.associations) > 4
    assert all(record.is_new for record in slam.associations)
    with pytest.raises(ValueError, match="only the published method"):
        LineSlam(FOUR_BEAMS, preset("graph"), associate=all_new)
