"""A lost robot explores where it learns most about its place, and straight ahead rather than back."""

from dataclasses import replace

import numpy as np
import pytest
from support.beliefs import CONFIG, HALL, ROBOT, belief_of, grid_of, place

from limslam_agent.belief import Guess
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.policies.targets import next_target, search_cost
from limslam_agent.status.status import Status

LOST = Status("lost", "for a test")
HERE = place(4, 20)  # in the middle of a hall that is open to both sides
ENDS = frontier_cells(HALL, 3)
# An earlier map that knows the ground beyond one end of the hall, or beyond both; its cell 0, 0 is 2 m to the left.
LEFT = grid_of(*["." * 40 + "?" * 41] * 9)
BOTH = grid_of(*["." * 81] * 9)
FRAME = np.array([2.0, 0.0, 0.0])


def lost(*guesses, heading=np.pi / 2):
    pose = np.array([*HERE[:2], heading])
    return replace(belief_of(pose, HALL), status=LOST, guesses=guesses)


def costs(belief):
    """The least costs of the left and the right end of the hall."""
    cost, middle = search_cost(belief, ENDS), HALL.values.shape[1] // 2
    assert not cost[~ENDS].any()
    return cost[:, :middle][ENDS[:, :middle]].min(), cost[:, middle:][ENDS[:, middle:]].min()


def test_only_a_lost_robot_searches():
    assert not search_cost(replace(lost(Guess(FRAME, 2.0, LEFT)), status=Status()), ENDS).any()


def test_a_robot_goes_where_its_only_likely_place_predicts_something():
    left, right = costs(lost(Guess(FRAME, 2.0, LEFT)))
    assert left < right - 1.0
    everywhere = np.zeros(HALL.values.shape, dtype=bool)
    target = next_target(lost(Guess(FRAME, 2.0, LEFT), heading=1.3), everywhere, ROBOT, CONFIG)
    assert target.goal[0] < HERE[0], "although the other end is a little more ahead"


def test_a_robot_goes_where_two_likely_places_predict_different_things():
    """Both places predict free ground to the left, and only one does so to the right."""
    wall = grid_of(*["." * 55 + "#" * 26] * 9)
    left, right = costs(lost(Guess(FRAME, 2.0, BOTH), Guess(FRAME, 2.0, wall)))
    assert right < left - 0.5


def test_a_robot_without_a_guess_goes_on_ahead():
    left, right = costs(lost(heading=0.0))
    assert right < left - 1.0
    assert costs(lost(heading=np.pi)) == pytest.approx((right, left), abs=0.1)
