"""Segments: distances against dense sampling, evenly spaced samples, insides of polygons."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_env.geometry import se2
from limslam_env.geometry import segment as segment_geometry

coordinate = st.floats(-10.0, 10.0)
segment = st.tuples(coordinate, coordinate, coordinate, coordinate)
point = st.tuples(coordinate, coordinate)

L_SHAPE = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]])


@given(st.lists(point, min_size=1, max_size=4), st.lists(segment, min_size=1, max_size=4))
@settings(deadline=None)
def test_distances_agree_with_a_walk_along_each_segment(points, segments):
    points = np.array(points)
    segments = np.array(segments)
    found = segment_geometry.distances(points, segments)
    assert found.shape == (len(points), len(segments))
    fractions = np.linspace(0.0, 1.0, 2001)[:, None]
    for column, edge in enumerate(segments):
        walk = edge[:2] + fractions * (edge[2:] - edge[:2])
        nearest = np.linalg.norm(points[:, None] - walk[None], axis=-1).min(axis=1)
        half_gap = 0.5 * segment_geometry.lengths(edge[None])[0] / 2000
        assert (found[:, column] <= nearest + 1e-9).all()
        assert (found[:, column] >= nearest - half_gap - 1e-9).all()


@given(st.lists(segment, min_size=1, max_size=5), st.floats(0.05, 3.0))
@settings(deadline=None)
def test_samples_are_even_dense_enough_and_hold_both_ends(segments, spacing):
    segments = np.array(segments)
    points, owner = segment_geometry.sample(segments, spacing)
    assert len(points) == len(owner)
    assert (np.diff(owner) >= 0).all()
    for number, edge in enumerate(segments):
        own = points[owner == number]
        np.testing.assert_allclose(own[[0, -1]], edge.reshape(2, 2), atol=1e-12)
        gaps = np.linalg.norm(np.diff(own, axis=0), axis=1)
        assert gaps.max() <= spacing * (1.0 + 1e-6)
        assert np.ptp(gaps) < 1e-9
        # No more points than needed: one gap fewer would be too wide.
        assert len(gaps) == 1 or segment_geometry.lengths(edge[None])[0] / (
            len(gaps) - 1
        ) > spacing * (1.0 - 1e-6)


def test_a_length_that_is_a_multiple_of_the_spacing_gets_no_extra_sample():
    points, _ = segment_geometry.sample(np.array([[0.0, 0.0, 0.3, 0.0]]), 0.1)
    np.testing.assert_allclose(points[:, 0], [0.0, 0.1, 0.2, 0.3], atol=1e-12)


def test_polygon_edges_close_the_ring():
    edges = segment_geometry.polygon_edges(L_SHAPE)
    np.testing.assert_array_equal(edges[:, :2], L_SHAPE)
    np.testing.assert_array_equal(edges[:, 2:], np.vstack((L_SHAPE[1:], L_SHAPE[:1])))


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.5])
def test_inside_of_an_l_is_the_union_of_its_two_bars_however_it_is_turned(turn):
    points = np.random.default_rng(1).uniform(-1.0, 4.0, (5000, 2))
    x, y = points.T
    bars = (x > 0) & (y > 0) & (((x < 3) & (y < 1)) | ((x < 1) & (y < 3)))
    there = np.array([2.0, -1.0, turn])
    points = se2.transform_points(there, points)
    polygon = se2.transform_points(there, L_SHAPE)
    np.testing.assert_array_equal(segment_geometry.inside_polygon(points, polygon), bars)
