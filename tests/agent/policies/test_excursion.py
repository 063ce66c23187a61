"""Excursions away from walls: when a robot comes back, and where to; and paths that stay near walls."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.beliefs import CELL, CLEAR, CONFIG, ROBOT, belief_of, grid_of, place

from limslam_agent import Belief, FrontierPolicy
from limslam_agent.grid.planner import routes
from limslam_agent.policies.excursion import Excursion
from limslam_agent.policies.targets import Target

# A hall of 20 x 12 m with a wall on the left, of which nothing else was seen yet.
FIELD = grid_of(*["#" + "." * 199] * 120)
WALL = np.array([[0.05, 0.0, 0.05, 12.0]])


def in_field(column: int, heading: float = 0.0, row: int = 60) -> Belief:
    return replace(belief_of(place(row, column, heading), FIELD), segments=WALL)


def target_at(begin: int, end: int, row: int = 60) -> Target:
    path = FIELD.centres(np.array([[row, column] for column in range(begin, end + 1)]))
    return Target(path[-1], path[-1], path[-1:], path, is_reachable=True)


def driven_to(excursion: Excursion, column: int, target: int) -> Target | None:
    """The last answer while a robot drives from the wall to a column, and has a target at another column."""
    answer = None
    for place_now in range(2, column + 1):
        belief = in_field(place_now)
        excursion.observe(belief)
        answer = excursion.way_back(belief, target_at(place_now, target))
        if answer is not None:
            break
    return answer


def test_a_robot_comes_back_to_the_wall_when_another_target_would_be_too_far() -> None:
    excursion = Excursion(ROBOT, CONFIG)
    assert driven_to(excursion, 40, 42) is None
    belief = in_field(40)
    back = excursion.way_back(belief, target_at(40, 80))
    assert back is not None
    assert not back.is_frontier
    assert back.goal[0] == pytest.approx(0.05 + 0.6, abs=CELL)
    # It keeps coming back, also when a near target appears.
    assert excursion.way_back(in_field(39), target_at(39, 40)) is not None


def test_a_target_that_is_far_from_all_walls_is_reached_all_the_same() -> None:
    assert driven_to(Excursion(ROBOT, CONFIG), 150, 150) is None


def test_a_wall_in_sight_ends_the_excursion() -> None:
    excursion = Excursion(ROBOT, CONFIG)
    driven_to(excursion, 40, 42)
    assert excursion.driven == pytest.approx(3.8)
    along = replace(in_field(4, heading=0.5 * np.pi), ranges=np.minimum(CLEAR, 0.3 / np.abs(np.sin(ROBOT.beam_angles))))
    excursion.observe(along)
    assert excursion.driven == 0.0


def test_the_policy_drives_back_and_then_explores_again() -> None:
    policy = FrontierPolicy(ROBOT, replace(CONFIG, longest_excursion=3.0))  # in a hall whose long walls are known
    hall = replace(
        FIELD, values=np.where(np.isin(np.arange(120), (0, 119))[:, None], -4, FIELD.values).astype(np.int16)
    )
    goals = []
    for column in [*range(6, 60), *range(59, 5, -1), *[6] * 6]:
        policy.act(replace(in_field(column), grid=hall))
        goals.append(math.nan if policy.goal is None else float(policy.goal[0]))
    assert goals[0] > 19.0
    assert goals[55] == pytest.approx(0.65, abs=CELL)
    assert goals[-1] > 19.0


def test_steps_far_from_walls_cost_three_times_as_much() -> None:
    grid = grid_of("#" * 100, *["." * 100] * 99)
    cost = routes(grid, place(60, 50)[:2], 0.1, 0.1, coast=2.5).cost
    assert cost[60, 60] == pytest.approx(3.0 * 10 * CELL)
    assert routes(grid, place(60, 50)[:2], 0.1, 0.1).cost[60, 60] == pytest.approx(10 * CELL)
    near = routes(grid, place(10, 50)[:2], 0.1, 0.1, coast=2.5).cost
    assert near[10, 60] == pytest.approx(10 * CELL)
