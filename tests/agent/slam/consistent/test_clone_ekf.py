"""The filter with clones: equal to the dense filter and to least squares, honest, and sound after
many steps.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import chi2, kstest
from support.readings import Readings, compared, hit_points, keep_clones, observe

from limslam_agent.kernels.tables import LINES_FROM
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.clone_filter import difference, merge
from limslam_agent.slam.consistent.limits import EQUALITY_NOISE
from limslam_agent.slam.consistent.pending_readings import places_of
from limslam_agent.slam.core.encoder_ticks import jitter_of
from limslam_agent.slam.core.motion import Motion
from limslam_env import RobotSpec
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry

ROBOT = RobotSpec()  # beams on the rim at 90, 45, 15, -15, -45, -90 deg
LEFT = [0, 1]  # the beams at 90 and 45 deg
MOTION = np.diag([2e-6, 5e-7, 4e-5])
STEP = np.array([0.05, 0.002, 0.02])
STD = 0.02
places = st.floats(-4.0, 4.0)


def spread(size: int, seed: int, scale: float = 1e-4) -> FloatArray:
    """Some covariance (size, size) with correlations between all numbers."""
    root = np.random.default_rng(seed).normal(size=(size, size + 2))
    return scale * (root @ root.T) / size


def readings_of(clones: list[int], beams: list[int], ranges: FloatArray | None = None) -> Readings:
    """Readings by some of the robot's beams, each from its clone."""
    sources = np.column_stack((clones, beams))
    distances = np.zeros(len(beams)) if ranges is None else ranges
    return Readings(
        np.array(clones), ROBOT.beam_origins[beams], ROBOT.beam_angles[beams], distances, sources
    )


def driven(seed: int, clones: int = 8, pose: FloatArray | None = None) -> tuple[CloneEKF, Readings]:
    """A filter after a short drive, no two of its poses equal, and both left beams at each clone,
    still without ranges.

    The robot has moved on since the last clone, so the covariance has an inverse.
    """
    ekf = CloneEKF(np.zeros(3) if pose is None else pose)
    ekf.P[:3, :3] = spread(3, seed)
    numbers = []
    for _ in range(clones):
        numbers.append(ekf.clone())
        ekf.predict(Motion(STEP, MOTION))
    return ekf, readings_of([number for number in numbers for _ in LEFT], LEFT * clones)


def with_line(
    ekf: CloneEKF, line: FloatArray, anchor: FloatArray, seed: int, scale: float = 1e-4
) -> int:
    """Give the filter a line (d, theta) about an anchor, correlated with all else."""
    index = ekf.add_line(float(line[1]), anchor)
    ekf.x[3 + 2 * index] = line[0]
    part = slice(3 + 2 * index, 5 + 2 * index)
    ekf.P[part, part] = 0.0
    ekf.P[:] += spread(len(ekf.x), seed, scale)
    return index


def linear(seed: int) -> tuple[CloneEKF, Readings, int]:
    """A belief with errors so small that curvature does not count, and readings to be had of its
    only line.
    """
    ekf, readings = driven(seed)
    index = with_line(ekf, np.array([0.0, 1.6]), np.array([0.3, 0.7]), seed, 1e-4)
    ekf.P[:] *= 0.1
    return ekf, readings, index


# The textbook's dense filter: ranges worked out from the whole state by other means, derivatives by
# complex steps.


def ranges_from(state: FloatArray, ekf: CloneEKF, readings: Readings, index: int) -> FloatArray:
    """Where rays cut a line, by Cramer's rule on both points' coordinates; works for complex
    numbers too.
    """
    first = 3 * (ekf.arrays.counts[LINES_FROM] // 3) + 2 * index
    offset = state[first]
    theta = state[first + 1]
    anchor = ekf.anchors[index]
    results = []
    for clone, (x, y), angle in zip(
        readings.clones, readings.origins, readings.angles, strict=True
    ):
        begin = (
            int(ekf.arrays.counts[LINES_FROM])
            + 2 * ekf.num_lines
            + 3 * int(places_of(ekf.arrays, np.array([clone]))[0])
        )
        px, py, heading = state[begin : begin + 3]
        start = (
            px + x * np.cos(heading) - y * np.sin(heading),
            py + x * np.sin(heading) + y * np.cos(heading),
        )
        ray = (np.cos(heading + angle), np.sin(heading + angle))
        foot = (anchor[0] + offset * np.cos(theta), anchor[1] + offset * np.sin(theta))
        along = (-np.sin(theta), np.cos(theta))
        gap = (foot[0] - start[0], foot[1] - start[1])
        results.append(
            (gap[0] * along[1] - gap[1] * along[0]) / (ray[0] * along[1] - ray[1] * along[0])
        )
    return np.array(results)


def derivative(function: Callable[[FloatArray], FloatArray], state: FloatArray) -> FloatArray:
    """The Jacobian (m, n) of an analytic function, exact to the last digits."""
    step = 1e-40
    columns = [function(state + 1j * step * unit).imag / step for unit in np.eye(len(state))]
    return np.column_stack(columns)


def dense_update(
    state: FloatArray,
    covariance: FloatArray,
    jacobian: FloatArray,
    difference: FloatArray,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Kalman's equations, the covariance in Joseph's form."""
    gain = covariance @ jacobian.T @ np.linalg.inv(jacobian @ covariance @ jacobian.T + noise)
    left = np.eye(len(state)) - gain @ jacobian
    return state + gain @ difference, left @ covariance @ left.T + gain @ noise @ gain.T


def world_moved(state: FloatArray, ekf: CloneEKF, motion: FloatArray) -> FloatArray:
    """The state after the whole world, but for the anchors, has moved (m, m) and turned (rad) about
    the first robot.
    """
    middle = state[:2]
    anchors = ekf.anchors
    moved = state.astype(motion.dtype)
    cos = np.cos(motion[2])
    sin = np.sin(motion[2])

    def point(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        x = x - middle[0]
        y = y - middle[1]
        return middle[0] + motion[0] + cos * x - sin * y, middle[1] + motion[1] + sin * x + cos * y

    of_lines = slice(
        int(ekf.arrays.counts[LINES_FROM]), int(ekf.arrays.counts[LINES_FROM]) + 2 * ekf.num_lines
    )
    for part in (slice(0, of_lines.start), slice(of_lines.stop, None)):
        for pose in moved[part].reshape(-1, 3):
            pose[:2] = point(pose[0], pose[1])
            pose[2] += motion[2]
    for line, (x, y) in zip(moved[of_lines].reshape(-1, 2), anchors, strict=True):
        foot_x, foot_y = point(x + line[0] * np.cos(line[1]), y + line[0] * np.sin(line[1]))
        line[1] += motion[2]
        line[0] = (foot_x - x) * np.cos(line[1]) + (foot_y - y) * np.sin(line[1])
    return moved


def with_the_world(state: FloatArray, ekf: CloneEKF) -> FloatArray:
    """How the state (n, 3) moves with the first robot when the whole world does."""
    return derivative(lambda motion: world_moved(state, ekf, motion), np.zeros(3))


def carrying(before: FloatArray, after: FloatArray, ekf: CloneEKF) -> FloatArray:
    """How errors (n, n) change that are kept beside the first robot's own while the state moves."""
    change = np.eye(len(before))
    change[:, :3] += with_the_world(after, ekf) - with_the_world(before, ekf)
    return change


def carried(
    covariance: NDArray[np.floating[Any]], before: FloatArray, after: FloatArray, ekf: CloneEKF
) -> FloatArray:
    """The covariance of such errors."""
    change = carrying(before, after, ekf)
    return np.asarray(change @ covariance @ change.T)


def measured(ekf: CloneEKF, readings: Readings, index: int, seed: int) -> Readings:
    """The readings with the ranges of a truth drawn from the belief, and with noise."""
    generator = np.random.default_rng(seed)
    truth = generator.multivariate_normal(ekf.x, ekf.P, method="eigh")
    noise = generator.normal(0.0, STD, len(readings.ranges))
    return readings._replace(ranges=ranges_from(truth, ekf, readings, index) + noise)


def assert_scaled(found: FloatArray, wanted: NDArray[np.floating[Any]], tolerance: float) -> None:
    """Two covariances are equal in units of their standard deviations."""
    scale = np.sqrt(np.diag(wanted))
    np.testing.assert_allclose(
        found / np.outer(scale, scale), wanted / np.outer(scale, scale), atol=tolerance
    )


# Clones.


@pytest.mark.parametrize("ticks", [(0.0, 0.0), (0.01, 0.02)])
def test_a_clone_is_its_pose_but_for_the_jitter_of_the_encoders(
    ticks: tuple[float, float],
) -> None:
    ekf, _ = driven(0, clones=3, pose=np.array([0.4, -0.2, 2.0]))
    with_line(ekf, np.array([0.1, 1.5]), np.array([0.3, 0.6]), 1)
    jitter = jitter_of(np.array(ticks), 0.16)
    ekf.predict(Motion(np.zeros(3), np.zeros((3, 3)), jitter=jitter))
    state = ekf.x.copy()
    covariance = ekf.P.copy()
    number = ekf.clone()
    assert (number, ekf.num_clones, ekf.num_lines) == (3, 4, 1)
    copied = np.vstack((np.eye(len(state)), np.eye(3, len(state))))
    expected = copied @ covariance @ copied.T
    by_jitter = se2.compose_jacobians(ekf.pose, np.zeros(3))[1]
    expected[-3:, -3:] += by_jitter @ jitter @ by_jitter.T
    np.testing.assert_allclose(ekf.x, copied @ state, atol=1e-15)
    np.testing.assert_allclose(ekf.P, expected, atol=1e-15)
    np.testing.assert_allclose(ekf.joint_pose_covariance, ekf.P[-3:, -3:], atol=1e-15)


# Observations.


@pytest.mark.parametrize("heading", [0.7, -3.0])
def test_one_iteration_without_huber_equals_the_dense_filter(heading: float) -> None:
    start = np.array([0.4, -0.2, heading])
    ekf, readings = driven(4, pose=start)
    wall = np.array([0.03, heading + 1.65])
    index = with_line(ekf, wall, se2.compose(start, np.array([0.3, 0.7, 0.0]))[:2], 3)
    with_line(ekf, np.array([0.2, -1.0]), np.array([2.0, 2.0]), 8)
    seen = measured(ekf, readings, index, 6)
    state = ekf.x.copy()
    covariance = ekf.P.copy()
    jacobian = derivative(lambda x: ranges_from(x, ekf, seen, index), state)
    off = seen.ranges - ranges_from(state, ekf, seen, index)
    wanted, left = dense_update(state, covariance, jacobian, off, STD**2 * np.eye(len(off)))
    left = carried(left, state, wanted, ekf)
    observe(ekf, seen, index, STD, 1, 0.0)
    turns = np.round((wanted[2] - ekf.x[2]) / (2.0 * math.pi))
    wanted[2] -= 2.0 * math.pi * turns
    np.testing.assert_allclose(ekf.x, wanted, atol=1e-10)
    np.testing.assert_allclose(ekf.P, left, atol=1e-12)
    assert -math.pi < ekf.pose[2] <= math.pi
    # There was something to correct, and the line beside was corrected with it.
    assert np.abs(ekf.x - state)[[5, 6]].min() > 1e-6


@pytest.mark.parametrize("seed", range(2))
def test_the_iterated_update_reaches_the_optimum_of_belief_and_readings_together(seed: int) -> None:
    ekf, readings = driven(seed)
    ekf.P[:] *= 30.0
    index = with_line(ekf, np.array([0.0, 1.6]), np.array([0.3, 0.7]), seed, 3e-3)
    seen = measured(ekf, readings, index, seed)
    prior = ekf.x.copy()
    covariance = ekf.P.copy()
    # Gauss and Newton in information form; errors of the belief are kept beside the robot's own
    # while the state moves.
    optimum = prior.copy()
    for _ in range(30):
        jacobian = derivative(lambda x: ranges_from(x, ekf, seen, index), optimum)
        known = np.linalg.inv(carried(covariance, prior, optimum, ekf))
        information = known + jacobian.T @ jacobian / STD**2
        off = seen.ranges - ranges_from(optimum, ekf, seen, index)
        optimum = optimum + np.linalg.solve(
            information, jacobian.T @ off / STD**2 - known @ (optimum - prior)
        )
    observe(ekf, seen, index, STD, 30, 0.0)
    np.testing.assert_allclose((ekf.x - optimum) / np.sqrt(np.diag(ekf.P)), 0.0, atol=1e-4)
    # And its covariance is that at the optimum.
    assert_scaled(ekf.P, np.linalg.inv(information), 1e-4)


def known_of_the_world(ekf: CloneEKF) -> FloatArray:
    """Information (3, 3) on where the whole world lies and how it is turned."""
    directions = with_the_world(ekf.x, ekf)
    return np.asarray(directions.T @ np.linalg.solve(ekf.P, directions))


@pytest.mark.parametrize(("heading", "iterations"), [(0.0, 1), (-3.0, 4)])
def test_readings_teach_nothing_of_how_the_whole_world_lies_and_is_turned(
    heading: float, iterations: int
) -> None:
    # No range changes when all of it is shifted and turned, however far corrections have moved the
    # Jacobians' places.
    start = np.array([0.4, -0.2, heading])
    ekf, readings = driven(4, pose=start)
    ekf.P[:] *= 10.0
    for seed, bearing in enumerate((1.65, 1.5)):
        with_line(
            ekf,
            np.array([0.03, heading + bearing]),
            se2.compose(start, np.array([0.3, 0.7, 0.0]))[:2],
            seed,
            1e-2,
        )
    known = known_of_the_world(ekf)
    moved = ekf.x.copy()
    for seed in range(6):
        observe(ekf, measured(ekf, readings, seed % 2, seed), seed % 2, STD, iterations, 0.0)
    assert np.abs(ekf.x - moved).max() > 0.05
    np.testing.assert_allclose(
        known_of_the_world(ekf), known, rtol=1e-6, atol=1e-6 * np.abs(known).max()
    )


# Whether readings are of a line.


def test_the_disagreement_is_distributed_as_chi_square_under_the_truth() -> None:
    ekf, readings, index = linear(0)
    values = [
        compared(ekf, measured(ekf, readings, index, seed), index, STD) for seed in range(400)
    ]
    assert np.mean(values) == pytest.approx(2.0, abs=0.3)
    assert kstest(values, chi2(2).cdf).pvalue > 0.01


# Lines in the world.


@settings(deadline=None, max_examples=200)
@given(
    st.one_of(st.floats(-3.0, 3.0), st.sampled_from([-2e-3, 2e-3])),
    st.floats(-10.0, 10.0),
    places,
    places,
    st.integers(0, 1000),
)
def test_lines_in_the_world_and_their_covariance_follow_from_the_anchored_ones(
    offset: float, theta: float, x: float, y: float, seed: int
) -> None:
    ekf = CloneEKF(np.zeros(3))
    with_line(ekf, np.array([0.3, 1.0]), np.array([1.0, 1.0]), seed)
    anchor = np.array([x, y])
    index = with_line(ekf, np.array([offset, theta]), anchor, seed + 1)

    def of_world(line: FloatArray) -> FloatArray:
        """Through two points of the anchored line, not by its formula."""
        foot = anchor + line[0] * np.array([math.cos(line[1]), math.sin(line[1])])
        return np.array([foot @ line_geometry.normal(line), line[1]])

    line = np.array([offset, theta])
    wanted = of_world(line)
    found = ekf.lines[index]
    assert found[0] >= 0.0
    assert -math.pi < found[1] <= math.pi
    # Through the origin itself the sign of r, and of its correlation, is a matter of taste.
    assume(abs(wanted[0]) > 1e-3)
    np.testing.assert_allclose(line_geometry.nearest_form(found, wanted), wanted, atol=1e-12)
    step = 1e-6
    columns = [
        line_geometry.nearest_form(line_geometry.normalise(of_world(line + unit)), found)
        - line_geometry.nearest_form(line_geometry.normalise(of_world(line - unit)), found)
        for unit in step * np.eye(2)
    ]
    jacobian = np.column_stack(columns) / (2.0 * step)
    part = ekf.P[5:7, 5:7]
    np.testing.assert_allclose(
        ekf.line_covariance(index), jacobian @ part @ jacobian.T, rtol=1e-6, atol=1e-9
    )


# Two lines that are one.


def seen_twice(theta: float, turned: bool, seed: int, scale: float = 1e-3) -> CloneEKF:
    """A wall that the filter holds twice, about two anchors 1.3 m apart along it, and a third
    line.
    """
    ekf, _ = driven(seed, clones=2)
    tangent = np.array([-math.sin(theta), math.cos(theta)])
    unit = np.array([math.cos(theta), math.sin(theta)])
    anchor = np.array([1.0, -0.5])
    other = np.array([1.0, -0.5]) + 1.3 * tangent + 0.04 * unit
    second = np.array([0.03, theta + 0.02 - math.pi]) if turned else np.array([-0.03, theta + 0.02])
    with_line(ekf, np.array([0.02, theta]), anchor, seed)
    with_line(ekf, np.array([0.1, -1.0]), np.array([3.0, 2.0]), seed + 1)
    with_line(ekf, second, other, seed + 2, scale)
    return ekf


def apart(state: FloatArray, ekf: CloneEKF, older: int, younger: int, turned: bool) -> FloatArray:
    """How the older line differs from the younger, about the younger's anchor; analytic."""
    (d, theta), (e, phi) = (state[3 + 2 * index : 5 + 2 * index] for index in (older, younger))
    between = ekf.anchors[older] - ekf.anchors[younger]
    moved = d + between[0] * np.cos(theta) + between[1] * np.sin(theta)
    angle = theta - phi
    angle -= (
        2.0 * math.pi * np.round((np.real(angle) + (math.pi if turned else 0.0)) / (2.0 * math.pi))
    )
    return np.array([-moved - e, angle + math.pi]) if turned else np.array([moved - e, angle])


@pytest.mark.parametrize(
    ("theta", "turned", "older", "younger"), [(0.3, False, 0, 2), (3.1, True, 2, 0)]
)
def test_the_difference_of_two_lines_and_its_covariance(
    theta: float, turned: bool, older: int, younger: int
) -> None:
    ekf = seen_twice(theta, turned, 1)
    off, covariance = difference(ekf.arrays, older, younger)
    np.testing.assert_allclose(off, apart(ekf.x, ekf, older, younger, turned), atol=1e-12)
    jacobian = derivative(lambda x: apart(x, ekf, older, younger, turned), ekf.x)
    np.testing.assert_allclose(covariance, jacobian @ ekf.P @ jacobian.T, atol=1e-12)
    assert np.abs(off).max() < 0.15


@pytest.mark.parametrize(
    ("theta", "turned", "older", "younger"), [(0.3, False, 0, 2), (3.1, True, 2, 0)]
)
def test_making_two_lines_one_equals_the_dense_update_by_their_being_equal(
    theta: float, turned: bool, older: int, younger: int
) -> None:
    ekf = seen_twice(theta, turned, 2)
    before = ekf.x.copy()
    covariance = ekf.P.copy()
    anchors = ekf.anchors.copy()
    off = apart(before, ekf, older, younger, turned)
    jacobian = derivative(lambda x: apart(x, ekf, older, younger, turned), before)
    exact = np.diag(EQUALITY_NOISE)
    wanted, left = dense_update(before, covariance, jacobian, -off, exact)
    # They are one now, but for what is not linear in the small angle between them.
    assert np.abs(apart(wanted, ekf, older, younger, turned)).max() < 0.02 * np.abs(off).max()
    left = carried(left, before, wanted, ekf)
    merge(ekf.arrays, older, younger, ekf, 1)
    gone = [3 + 2 * younger, 4 + 2 * younger]
    np.testing.assert_allclose(ekf.x, np.delete(wanted, gone), atol=1e-10)
    np.testing.assert_allclose(ekf.P, np.delete(np.delete(left, gone, 0), gone, 1), atol=1e-12)
    np.testing.assert_array_equal(ekf.anchors, np.delete(anchors, younger, axis=0))
    assert (ekf.num_lines, ekf.num_clones) == (2, 2)
    # All that is left is known better than before, or as well.
    covariance = carried(covariance, before, wanted, seen_twice(theta, turned, 2))
    shrunk = np.delete(np.delete(covariance, gone, 0), gone, 1) - ekf.P
    assert np.linalg.eigvalsh(shrunk).min() > -1e-12
    assert np.trace(shrunk) > 1e-6


@pytest.mark.parametrize("turned", [False, True])
def test_an_iterated_merge_teaches_nothing_of_how_the_whole_world_lies_and_is_turned(
    turned: bool,
) -> None:
    gained = []
    for iterations in (1, 3):
        ekf = seen_twice(0.3, turned, 2)
        known = known_of_the_world(ekf)
        merge(ekf.arrays, 0, 2, ekf, iterations)
        gained.append(np.abs(known_of_the_world(ekf) - known).max() / np.abs(known).max())
    assert gained[1] < 1e-4
    assert gained[1] < 0.1 * gained[0]


# Many steps.

ROOM = np.array([[1.5, 0.0], [1.2, 0.5 * math.pi], [1.5, math.pi], [1.2, -0.5 * math.pi]])


class _Wanderer:
    """A robot that goes round in a room of four walls, and a filter to which random things are
    done.
    """

    def __init__(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)
        self.truth = np.array([0.0, -0.6, 0.0])
        self.ekf = CloneEKF(self.truth)
        self.walls: list[int] = []  # which wall each landmark is
        self.clones: dict[int, FloatArray] = {}  # true poses
        self.done: dict[str, int] = {}
        self.born = self.merged = 0

    def do(self) -> None:
        """One random thing that can be done now."""
        choices = ["predict", "predict", "clone", "keep", "observe", "observe"]
        if len(self.walls) < 7:
            choices.append("add")
        if len(self.walls) > len(set(self.walls)):
            choices.append("merge")
        name = choices[int(self.generator.integers(len(choices)))]
        self.done[name] = self.done.get(name, 0) + 1
        getattr(self, name)()

    def predict(self) -> None:
        increment = np.array([0.03, 0.0, 0.05])
        self.truth = se2.compose(self.truth, increment)
        self.ekf.predict(
            Motion(increment + self.generator.normal(size=3) * np.sqrt(np.diag(MOTION)), MOTION)
        )

    def clone(self) -> None:
        self.clones[self.ekf.clone()] = self.truth

    def keep(self) -> None:
        most = int(self.generator.integers(2, 9))
        self.clones = {number: self.clones[number] for number in sorted(self.clones)[-most:]}
        keep_clones(self.ekf, set(self.clones))

    def observe(self) -> None:
        if self.walls:
            self._read(int(self.generator.integers(len(self.walls))))

    def add(self) -> None:
        wall = int(self.generator.integers(4))
        readings = self._readings(wall)
        # As the estimator does it: not before they say which way it runs, to three degrees.
        points = hit_points(
            np.array([self.clones[number] for number in readings.clones]).reshape(-1, 3), readings
        )
        along = points @ line_geometry.direction(ROOM[wall])
        if len(along) and math.radians(3.0) * np.linalg.norm(along - along.mean()) > STD:
            self.walls.append(wall)
            self.born += 1
            theta = float(ROOM[wall, 1] + self.generator.normal(0.0, 0.05))
            anchor = ROOM[wall, 0] * line_geometry.normal(ROOM[wall]) + self.generator.normal(
                0.0, 0.1
            )
            self._read(self.ekf.add_line(theta, anchor), iterations=4)

    def merge(self) -> None:
        twice = [index for index, wall in enumerate(self.walls) if wall in self.walls[:index]]
        younger = twice[int(self.generator.integers(len(twice)))]
        older = self.walls.index(self.walls[younger])
        off, covariance = difference(self.ekf.arrays, older, younger)
        # As the estimator does it: not before their directions are known to a few degrees, and they
        # agree.
        if (
            covariance[1, 1] < math.radians(4.0) ** 2
            and off @ np.linalg.solve(covariance, off) < 16.0
        ):
            merge(self.ekf.arrays, older, younger, self.ekf, 1)
            del self.walls[younger]
            self.merged += 1

    def _read(self, index: int, iterations: int = 2) -> None:
        readings = self._readings(self.walls[index])
        if len(readings.ranges):
            observe(self.ekf, readings, index, STD, iterations, 1.5)

    def _readings(self, wall: int) -> Readings:
        """What the clones' beams read of a wall, as if no other were in their way."""
        found: list[tuple[int, int, float]] = []
        for number, (x, y, heading) in self.clones.items():
            for beam in range(6):
                ox, oy = ROBOT.beam_origins[beam]
                angle = heading + ROBOT.beam_angles[beam]
                cosine = math.cos(angle - ROOM[wall, 1])
                px = x + ox * math.cos(heading) - oy * math.sin(heading)
                py = y + ox * math.sin(heading) + oy * math.cos(heading)
                free = (
                    ROOM[wall, 0] - px * math.cos(ROOM[wall, 1]) - py * math.sin(ROOM[wall, 1])
                ) / (cosine or 1.0)
                if cosine > 0.4 and 0.05 < free < 2.5:
                    found.append((number, beam, free + float(self.generator.normal(0.0, STD))))
        noisy = np.array([free for _, _, free in found])
        return readings_of(
            [number for number, _, _ in found], [beam for _, beam, _ in found], noisy
        )


@pytest.mark.parametrize("count", [5_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_the_covariance_stays_symmetric_and_positive_over_random_operations(count: int) -> None:
    wanderer = _Wanderer(7)
    ekf = wanderer.ekf
    asymmetry = 0.0
    for number in range(count):
        wanderer.do()
        assert len(ekf.x) == 3 + 2 * len(wanderer.walls) + 3 * len(wanderer.clones)
        if number % 50 == 49:
            asymmetry = max(asymmetry, float(np.abs(ekf.P - ekf.P.T).max()))
            assert np.linalg.eigvalsh(0.5 * (ekf.P + ekf.P.T)).min() > -1e-12
    assert asymmetry < 1e-12
    assert min(wanderer.done.values()) > count // 100
    assert wanderer.merged > count // 200
    # And it is still a filter: it knows where it is, and its walls.
    assert np.hypot(*(ekf.pose - wanderer.truth)[:2]) < 0.1
    true = ROOM[wanderer.walls]
    np.testing.assert_allclose(line_geometry.nearest_form(ekf.lines, true), true, atol=0.1)


def test_what_odometry_is_wrong_by_spreads_to_the_pose_as_the_dense_filter_has_it() -> None:
    prior = spread(3, 1)
    ekf = CloneEKF(np.array([[1.0, 2.0, 0.5], [0.0, 0.0, 0.0]]), prior)
    ekf.calibrate()
    ekf.P[:6, :6] = spread(6, 2)
    ekf.clone(1)
    by_calibration = spread(3, 3, scale=1.0)
    covariance = ekf.P.copy()
    before = ekf.x.copy()
    ekf.predict(Motion(STEP, MOTION, by_calibration), 1)
    by_pose, by_increment = se2.compose_jacobians(before[3:6], STEP)
    dense = np.eye(len(covariance))
    noise = np.zeros_like(covariance)
    dense[3:6, 3:6] = by_pose
    dense[3:6, 9:12] = by_increment @ by_calibration
    noise[3:6, 3:6] = by_increment @ MOTION @ by_increment.T
    np.testing.assert_allclose(ekf.P, dense @ covariance @ dense.T + noise, atol=1e-12)
    np.testing.assert_allclose(ekf.poses[1], se2.compose(before[3:6], STEP))
