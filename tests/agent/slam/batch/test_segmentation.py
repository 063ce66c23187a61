"""The batch splits readings into the wall segments that the plain segmentation finds."""

import numpy as np
import pytest
from support.batch_stages import NOISE, cached, estimator_after, spec, state_from

from limslam_agent.kernels import measurement
from limslam_agent.slam.batch import segmentation
from limslam_agent.slam.batch.segmentation import ANGLE_STD, EXTENT, MIDDLE_X, MIDDLE_Y, THETA
from limslam_agent.slam.batch.state import CLONES, LINES
from limslam_agent.slam.consistent.beam_model import Readings, expected_ranges, hit_points
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.consistent.segmentation import wall_segments
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.core.line_fit import fit_line
from limslam_env.geometry import FloatArray, IntArray

split, predicted, ends, turned = (
    cached(segmentation.wall_segments), cached(measurement.predict_ranges), cached(measurement.hit_points),
    cached(measurement.towards),
)  # fmt: skip


@pytest.fixture(scope="module")
def estimator() -> ConsistentEstimator:
    return estimator_after(120)


def readings_of_walls(
    estimator: ConsistentEstimator, shape: str, seed: int, cone: float = 0.0
) -> tuple[Readings, FloatArray]:
    """Readings, as rows of the batch too, that beams of the estimator's clones would take of a wall of some shape."""
    generator, clones = np.random.default_rng(seed), estimator._filter._clones.numbers
    chosen = np.sort(generator.choice(clones, 40))
    poses = estimator._filter.clone_poses(chosen)
    origins, angles = generator.normal(0.0, 0.05, (40, 2)), generator.uniform(0.9, 2.2, 40)
    flat = Readings(chosen, origins, angles, np.ones(40), np.zeros((40, 2), dtype=np.int64), cone=cone)
    middle = poses[:, :2].mean(axis=0)
    heading = poses[:, 2].mean() + 0.5 * np.pi
    line, anchor = np.array([0.0, heading]), middle + 0.8 * np.array([np.cos(heading), np.sin(heading)])
    ranges = expected_ranges(poses, flat, line, anchor).ranges
    bent = np.arange(40) > 20
    if shape == "corner":
        ranges = ranges - 0.5 * bent * np.linspace(-0.4, 0.4, 40)
    if shape == "end":
        ranges = ranges + 0.12 * (np.arange(40) > 34)
    ranges = ranges + NOISE * generator.standard_normal(40)
    rows = np.column_stack((origins, angles, ranges, np.full(40, cone)))
    return flat._replace(ranges=ranges), rows


def places_of(estimator: ConsistentEstimator, readings: Readings) -> IntArray:
    return estimator._filter.places(readings.clones)


@pytest.mark.parametrize("shape", ["straight", "corner", "end"])
@pytest.mark.parametrize(("seed", "cone"), [(0, 0.0), (1, 0.0), (2, 0.0), (0, 0.1), (1, 0.25)])
def test_segments(estimator: ConsistentEstimator, shape: str, seed: int, cone: float) -> None:
    readings, rows = readings_of_walls(estimator, shape, seed, cone)
    ekf, members = state_from(estimator).filter, np.arange(40)
    poses = estimator._filter.clone_poses(readings.clones)
    line = fit_line(hit_points(poses, readings), NOISE).line
    points = hit_points(poses, readings.towards(line[1], poses[:, 2]))
    expected = wall_segments(readings, members, line, estimator._filter, NOISE)
    found, own = split(ekf, places_of(estimator, readings), rows, points, members, line, spec().settings[0])
    assert len(own) == len(expected)
    for row, these, segment in zip(found, own, expected, strict=False):
        np.testing.assert_array_equal(these, segment.members)
        told = [row[THETA], row[MIDDLE_X], row[MIDDLE_Y], row[EXTENT], row[ANGLE_STD]]
        wanted = [segment.theta, *segment.middle, segment.length, segment.angle_std]
        np.testing.assert_allclose(told, wanted, rtol=0.0, atol=1e-9)


def test_the_readings_bend(estimator: ConsistentEstimator) -> None:
    counts = []
    for shape in ("straight", "corner", "end"):
        readings, _ = readings_of_walls(estimator, shape, 0)
        points = hit_points(estimator._filter.clone_poses(readings.clones), readings)
        line = fit_line(points, NOISE).line
        found = wall_segments(readings, np.arange(40), line, estimator._filter, NOISE)
        counts.append(sum(len(segment.members) for segment in found))
    assert counts[0] == 40
    assert min(counts[1:]) < 40


@pytest.mark.parametrize("cone", [0.0, 0.1])
def test_beam_model(estimator: ConsistentEstimator, cone: float) -> None:
    readings, rows = readings_of_walls(estimator, "straight", 3, cone)
    ekf, places = state_from(estimator).filter, places_of(estimator, readings)
    start, poses = POSE + 2 * int(ekf.counts[LINES]), estimator._filter.clone_poses(readings.clones)
    assert ekf.counts[CLONES] == estimator._filter.num_clones
    line, anchor, out = np.array([0.1, 0.7]), np.array([1.0, -2.0]), np.empty((40, 7))
    predicted(ekf.x, start, places, rows, np.arange(40), tuple(line), tuple(anchor), out)
    expected = expected_ranges(poses, readings, line, anchor)
    together = np.column_stack((expected.ranges, expected.by_pose, expected.by_line, expected.cosines))
    np.testing.assert_allclose(out, together, rtol=1e-9, atol=1e-9)
    points = ends(ekf.x, start, places, rows, rows[:, 3])
    np.testing.assert_allclose(points, hit_points(poses, readings), rtol=0.0, atol=1e-12)
    rays = turned(ekf.x, start, places, rows, 0.7)
    np.testing.assert_allclose(rays[:, 2], readings.towards(0.7, poses[:, 2]).angles, rtol=0.0, atol=1e-12)
    assert not rays[:, 4].any()
