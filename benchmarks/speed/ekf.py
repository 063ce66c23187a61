"""How long one prediction and one update take, by the number of landmarks: ``python -m benchmarks.speed.ekf``.

The line filter is timed beside the dense filter of filterpy in the same run and on the same state, so that the ratio
holds on any machine. The bars are limits for the median of the line filter, in milliseconds.
"""

import math
import time

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.clone_filter import keep_clones, observe
from limslam_agent.slam.consistent.limits import HUBER
from limslam_agent.slam.consistent.pending_readings import places_of
from limslam_agent.slam.core.ekf import POSE, LineEKF
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import to_frame, to_frame_jacobians
from limslam_env.geometry.se2 import compose, compose_jacobians

BARS_MS = {50: 0.05, 200: 0.10, 500: 0.40}
"""Limits for prediction and one update, by number of landmarks, ms."""

CLONE_LANDMARKS, CLONE_BAR_MS = (20, 50, 200), 1.0
"""Numbers of landmarks for the consistent filter, and its limit for 200 of them, ms."""

BATCH = 4
RANGE_STD = 0.02
REPETITIONS = 1000
DENSE_SECONDS = 3.0
INCREMENT = np.array([0.02, 0.0, 0.01])
MOTION_COVARIANCE = np.diag([1e-6, 1e-7, 1e-5])
LINE_COVARIANCE = np.diag([1e-5, 1e-4])
OFF = np.array([1e-4, 1e-4])
"""Innovation of each observed line (m, rad). It is small, so that both filters keep the same linearisation."""


def line_filter(landmarks: int) -> LineEKF:
    """A filter with that many lines around the robot, each correlated with all others."""
    generator = np.random.default_rng(landmarks)
    ekf = LineEKF(np.zeros(POSE), 1e-4 * np.eye(POSE))
    for _ in range(landmarks):
        ekf.augment(np.array([generator.uniform(1.0, 5.0), generator.uniform(-math.pi, math.pi)]), LINE_COVARIANCE)
    return ekf


def dense_filter(ekf: LineEKF) -> ExtendedKalmanFilter:
    """The filter of filterpy in the same state."""
    dense = ExtendedKalmanFilter(dim_x=len(ekf.x), dim_z=2)
    dense.x, dense.P = np.array(ekf.x), np.array(ekf.P)
    return dense


def expected(state: FloatArray, columns: IntArray) -> FloatArray:
    """The expected observation of the line at ``columns`` of a state, in the robot's frame."""
    return to_frame(state[columns[POSE:]], state[:POSE])


def time_line_filter(ekf: LineEKF, repetitions: int) -> FloatArray:
    """Durations (s) of a prediction and an update by one line after the other."""
    durations = np.zeros(repetitions)
    for number in range(repetitions):
        index = number % ekf.num_lines
        columns = ekf.columns_of(index)
        seen = to_frame(ekf.x[columns[POSE:]], compose(ekf.pose, INCREMENT)) + OFF
        begun = time.perf_counter()
        ekf.predict(INCREMENT, MOTION_COVARIANCE)
        ekf.observe_line(seen, LINE_COVARIANCE, index)
        durations[number] = time.perf_counter() - begun
    return durations


def time_dense_filter(dense: ExtendedKalmanFilter, repetitions: int, seconds: float) -> FloatArray:
    """As :func:`time_line_filter` with dense matrices: three durations or more, as many as fit in ``seconds``."""
    size = len(dense.x)
    durations: list[float] = []
    while len(durations) < repetitions and (len(durations) < 3 or sum(durations) < seconds):
        first = POSE + 2 * (len(durations) % ((size - POSE) // 2))
        columns = np.array([0, 1, 2, first, first + 1])
        seen = to_frame(dense.x[columns[POSE:]], compose(dense.x[:POSE], INCREMENT)) + OFF
        begun = time.perf_counter()
        dense_predict(dense)
        dense.update(seen, dense_jacobian, expected, LINE_COVARIANCE, args=(columns,), hx_args=(columns,))
        durations.append(time.perf_counter() - begun)
    return np.array(durations)


def dense_predict(dense: ExtendedKalmanFilter) -> None:
    """The prediction of filterpy, with the pose moved as the line filter moves it."""
    size = len(dense.x)
    moved = compose(dense.x[:POSE], INCREMENT)
    by_pose, by_increment = compose_jacobians(dense.x[:POSE], INCREMENT)
    dense.F, dense.Q = np.eye(size), np.zeros((size, size))
    dense.F[:POSE, :POSE] = by_pose
    dense.Q[:POSE, :POSE] = by_increment @ MOTION_COVARIANCE @ by_increment.T
    dense.predict()
    dense.x[:POSE] = moved


def dense_jacobian(state: FloatArray, columns: IntArray) -> FloatArray:
    """Derivative (2, n) of :func:`expected` by the whole state."""
    jacobian = np.zeros((2, len(state)))
    jacobian[:, columns] = np.hstack(to_frame_jacobians(state[columns[POSE:]], state[:POSE]))
    return jacobian


def clone_filter(landmarks: int) -> CloneEKF:
    """The consistent filter with that many lines around the robot, each correlated with the pose and all others."""
    generator = np.random.default_rng(landmarks)
    ekf = CloneEKF(np.zeros(POSE))
    ekf.P[:] = 1e-4 * np.eye(POSE)
    for _ in range(landmarks):
        towards = generator.uniform(-math.pi, math.pi)
        away = generator.uniform(0.5, 5.0) * np.array([math.cos(towards), math.sin(towards)])
        index, clone = ekf.add_line(towards, away), ekf.clone()
        _observe(ekf, [clone] * 3, away, towards + np.array([-0.3, 0.0, 0.3]), index)
        keep_clones(ekf.arrays, np.zeros(0))
    return ekf


def _observe(ekf: CloneEKF, clones: list[int], away: FloatArray, headings: FloatArray, index: int) -> None:
    """Update by ranges of beams from the origin to a line whose nearest point is ``away`` (2,), m."""
    readings = np.zeros((len(clones), 6))
    readings[:, 2] = headings
    readings[:, 3] = math.hypot(*away) / np.cos(headings - math.atan2(away[1], away[0]))
    places, variances = places_of(ekf.arrays, np.array(clones)), np.full(len(clones), RANGE_STD**2)
    observe(ekf.arrays, places, readings, index, variances, 2, HUBER)


def time_clone_filter(ekf: CloneEKF, repetitions: int) -> FloatArray:
    """Processor time (s) of a prediction and a clone, and at every fourth of twelve readings of one line."""
    durations, clones = np.zeros(repetitions), list[int]()
    still = np.zeros(POSE)
    for number in range(repetitions):
        index = number % ekf.num_lines
        begun = time.thread_time()
        ekf.predict(still, MOTION_COVARIANCE)
        clones.append(ekf.clone())
        if len(clones) == BATCH:
            line = ekf.lines[index]
            away, towards = line[0] * np.array([math.cos(line[1]), math.sin(line[1])]), float(line[1])
            headings = np.tile(towards + np.array([-0.3, 0.0, 0.3]), BATCH)
            _observe(ekf, np.repeat(clones, 3).tolist(), away, headings, index)
            keep_clones(ekf.arrays, np.zeros(0))
            clones = []
        durations[number] = time.thread_time() - begun
    return durations


def _time_consistent() -> None:
    print("\nthe consistent filter: prediction and clone, and a mean over four of them with twelve readings of a line")
    print(f"{'landmarks':>9} {'median ms':>11} {'mean ms':>9} {'bar ms':>7}")
    for landmarks in CLONE_LANDMARKS:
        ekf = clone_filter(landmarks)
        time_clone_filter(ekf, 100)
        each = 1000.0 * time_clone_filter(ekf, REPETITIONS)
        verdict = "ok" if each.mean() <= CLONE_BAR_MS else "MISSED"
        print(f"{landmarks:>9} {np.median(each):>11.4f} {each.mean():>9.4f} {CLONE_BAR_MS:>7.2f} {verdict:>6}")


def main() -> None:
    """Time the filters and print two tables."""
    print(f"prediction and one update: median of {REPETITIONS} (filterpy: of as many as fit into {DENSE_SECONDS:g} s)")
    print(f"{'landmarks':>9} {'LineEKF ms':>11} {'bar ms':>7} {'':>6} {'filterpy ms':>12} {'ratio':>7}")
    for landmarks, bar in BARS_MS.items():
        ekf = line_filter(landmarks)
        dense = dense_filter(ekf)
        # The first calls compile or load functions and warm the caches that later calls use.
        time_line_filter(ekf, 100)
        sparse_ms = 1000.0 * float(np.median(time_line_filter(ekf, REPETITIONS)))
        dense_ms = 1000.0 * float(np.median(time_dense_filter(dense, REPETITIONS, DENSE_SECONDS)))
        verdict = "ok" if sparse_ms <= bar else "MISSED"
        print(
            f"{landmarks:>9} {sparse_ms:>11.4f} {bar:>7.2f} {verdict:>6} {dense_ms:>12.3f} {dense_ms / sparse_ms:>7.0f}"
        )
    _time_consistent()


if __name__ == "__main__":
    main()
