"""A local map is found in another map, there and back and turned by any angle; ambiguous places are refused."""

import numpy as np
import pytest
from support.halls import HALL

from limslam_agent.grid.occupancy import GridView
from limslam_agent.places.decision import (
    LEAST_FORWARD,
    MATCH_HEADING_STD,
    MATCH_STD,
    agree,
    find_place,
    match_covariance,
)
from limslam_agent.places.matching import best_fits, judged, likely_turns
from limslam_agent.places.place_map import place_map
from limslam_env.geometry.se2 import compose, inverse, transform_points
from limslam_env.geometry.segment import distances

CORRIDOR = np.array([[0, 0, 12, 0], [0, 1.4, 12, 1.4]], dtype=float)


def in_frame(pose, segments):
    ends = transform_points(inverse(pose), segments.reshape(-1, 2))
    return ends.reshape(-1, 4)


def seen(segments, path, pose=(0.0, 0.0, 0.0), reach=1.5):
    """The map that beams of a length would draw from a path (n, 2), in the frame of a pose (3,)."""
    pose, path = np.array(pose), np.array(path, dtype=float)
    pieces = []
    for x1, y1, x2, y2 in segments:
        steps = np.linspace(0.0, 1.0, max(int(np.hypot(x2 - x1, y2 - y1) / 0.05), 2))
        points = np.array([x1, y1]) + steps[:, None] * np.array([x2 - x1, y2 - y1])
        near = np.hypot(*(points[:, None] - path).transpose(2, 0, 1)).min(axis=1) < reach
        if near.sum() > 4:
            first, last = points[near][0], points[near][-1]
            pieces.append([*first, *last])
    local, low = in_frame(pose, np.array(pieces)), np.full(2, -9.0)
    centres = low + 0.1 * (np.stack(np.meshgrid(np.arange(180), np.arange(180)), axis=-1).reshape(-1, 2) + 0.5)
    places = transform_points(pose, centres)
    free = (np.hypot(*(places[:, None] - path).transpose(2, 0, 1)).min(axis=1) < reach) & inside(places, segments)
    wall = distances(places, segments).min(axis=1) < 0.08
    return place_map(
        local, GridView(low, 0.1, np.where(wall & (free > -1), -1, free).reshape(180, 180).astype(np.int16))
    )


def inside(points, segments):
    """Points with an odd number of walls to their right, between closed walls; all points of an open corridor."""
    if len(segments) == len(CORRIDOR):
        return (points[:, 1] > 0.0) & (points[:, 1] < 1.4)
    (x1, y1, x2, y2), (x, y) = segments.T, points.T[..., None]
    straddles = (y1 > y) != (y2 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = (x2 - x1) * (y - y1) / (y2 - y1) + x1
    return np.sum(straddles & (x < crossing), axis=1) % 2 == 1


WHOLE = seen(HALL, [[1.5, 1.0], [3.0, 1.2], [5.3, 1.2], [1.6, 2.4], [1.5, 4.0]], reach=3.0)
PART = [[1.6, 0.9], [1.6, 1.8], [1.6, 2.8], [1.6, 3.6]]


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.3, np.pi / 2, 2.8, -1.9, np.pi])
def test_a_local_map_is_found_however_it_is_turned(turn):
    pose = np.array([1.6, 0.9, turn])
    decision = find_place(WHOLE, seen(HALL, PART, pose))
    assert decision.is_accepted, decision.refusal
    off = compose(inverse(pose), decision.fit.pose)
    assert np.hypot(*off[:2]) < 0.05
    assert abs(off[2]) < np.radians(2.0)
    assert decision.record["accepted"]
    assert decision.fit.forward == decision.fit.backward == 1.0


def test_the_way_back_is_the_inverse():
    local = seen(HALL, PART, np.array([1.6, 0.9, 0.7]))
    there, back = best_fits(WHOLE, local)[0], best_fits(local, WHOLE)[0]
    off = compose(there.pose, back.pose)
    assert np.hypot(*off[:2]) < 0.1
    assert abs(off[2]) < np.radians(2.0)
    assert (there.forward, there.backward) == pytest.approx((back.backward, back.forward), abs=0.05)


def test_a_corridor_is_ambiguous():
    whole = seen(CORRIDOR, [[x, 0.7] for x in np.arange(1.5, 11.0, 0.5)])
    decision = find_place(whole, seen(CORRIDOR, [[4.0, 0.7], [5.0, 0.7], [6.0, 0.7]], (4.0, 0.7, 0.3)))
    assert not decision.is_accepted
    assert "ambiguous" in decision.refusal
    assert not decision.record["accepted"]


def test_a_symmetrical_building_is_ambiguous():
    both = np.vstack((HALL, HALL @ np.kron(np.eye(2), -np.eye(2)) + np.array([12.0, 9.0, 12.0, 9.0])))
    path = [[1.5, 1.0], [3.0, 1.2], [5.3, 1.2], [1.6, 2.4], [1.5, 4.0]]
    whole = seen(both, [*path, *(np.array([12.0, 9.0]) - np.array(path))], (6.0, 4.5, 0.0), reach=3.0)
    decision = find_place(whole, seen(HALL, PART))
    assert decision.refusal.startswith("ambiguous: another place has")
    assert decision.runner_up > 0.9


def test_walls_in_free_ground_are_contradictions():
    screen = np.array([[1.0, 1.5, 1.6, 1.5], [1.6, 1.5, 1.6, 2.0]])
    local = seen(HALL, PART)
    grid = GridView(local.low, local.cell, np.zeros(local.clear.shape, dtype=np.int16))
    with_screen = place_map(np.vstack((local.segments, screen)), grid)
    clean, screened = (judged(WHOLE, each, np.zeros(3)) for each in (local, with_screen))
    assert (clean.contradictions, clean.forward) == (0, 1.0)
    assert screened.contradictions >= 8
    assert screened.forward < LEAST_FORWARD
    assert "lie where the other map is free" in find_place(WHOLE, with_screen).refusal


def test_an_empty_map_is_nowhere():
    grid = GridView(np.zeros(2), 0.1, np.zeros((3, 3), dtype=np.int16))
    empty = place_map(np.zeros((0, 4)), grid)
    for pair in ((WHOLE, empty), (empty, WHOLE), (empty, empty)):
        decision = find_place(*pair)
        assert decision.fit is None
        assert not decision.is_accepted
        assert decision.record == {"accepted": False, "reason": "one of the maps has no walls"}


def test_turns_bring_walls_of_one_direction_together():
    local = seen(HALL, PART, (1.0, 1.0, 0.5))
    turns = likely_turns(WHOLE, local)
    np.testing.assert_allclose(np.sort((turns - 0.5) % (np.pi / 2)), 0.0, atol=np.radians(1.1))
    assert len(turns) == 4


def test_two_decisions_agree_on_one_place_only():
    local = seen(HALL, PART, (1.6, 0.9, 0.7))
    decision = find_place(WHOLE, local)
    moved = find_place(
        seen(HALL, [[1.5, 1.0], [3.0, 1.2], [5.3, 1.2], [1.6, 2.4], [1.5, 4.0]], (1.0, 0.0, 0.0), 3.0), local
    )
    assert agree(decision, decision, local)
    assert moved.is_accepted
    assert not agree(decision, moved, local)


def test_the_covariance_of_a_pose_grows_with_its_distance_from_the_local_map():
    local = seen(HALL, PART)
    decision = find_place(WHOLE, local)
    middle = np.append(transform_points(decision.fit.pose, local.points.mean(axis=0, keepdims=True))[0], 0.0)
    near, far = (match_covariance(middle[:2], middle + np.array([away, 0.0, 0.0])) for away in (0.0, 5.0))
    np.testing.assert_allclose(near, np.diag([MATCH_STD**2, MATCH_STD**2, MATCH_HEADING_STD**2]), atol=1e-12)
    assert far[1, 1] == pytest.approx(MATCH_STD**2 + 25.0 * MATCH_HEADING_STD**2)
    assert far[0, 0] == pytest.approx(MATCH_STD**2)
