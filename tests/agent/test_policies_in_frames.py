"""Explorers keep what they have settled in a map that was moved, and in the map that a robot was lost from."""

import numpy as np

from limslam_agent.team import LimSlamTeam
from limslam_env.interface import RobotSpec


def policies_after(team: LimSlamTeam, frame: int, map_number: int) -> list[object]:
    team.mapper.frame, team.mapper.map_number = frame, map_number
    team._renew_in_another_frame()
    return list(team.policies)


def test_only_a_new_map_has_new_policies() -> None:
    team = LimSlamTeam(RobotSpec(), num_robots=1)
    (first,) = team.policies
    assert policies_after(team, 1, 0) == [first], "a renewal has moved the map"
    (local,) = policies_after(team, 2, 1)
    assert local is not first, "the robot is lost, and has a local map"
    assert policies_after(team, 3, 0) == [first], "it has found its place in the map that it was lost from"
    team.reset(np.zeros((1, 3)))
    assert policies_after(team, 1, 0) != [first]
