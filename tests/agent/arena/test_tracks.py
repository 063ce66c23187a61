"""Plans: made from a seed, in fixed shares, and each a world that a robot can drive in."""

from collections import Counter

import pytest

from limslam_agent.arena.tracks import COUNT, plans_of
from limslam_env import load_world


def test_a_seed_gives_its_own_plans_every_time():
    assert plans_of(7) == plans_of(7)
    assert len(plans_of(7)) == COUNT
    assert not {plan.world for plan in plans_of(7)} & {plan.world for plan in plans_of()}


@pytest.mark.parametrize("seed", [0, 12345])
def test_settings_have_their_shares(seed):
    plans = plans_of(seed)
    assert Counter(plan.robots for plan in plans) == {1: 70, 2: 30}
    assert Counter(plan.fault for plan in plans) == {"none": 55, "wheels": 15, "sharp": 15, "dropout": 15}
    assert {plan.noise for plan in plans} == {0.0, 0.02, 0.04}


def test_faults_are_in_the_simulator_and_not_in_what_is_told():
    plans = {plan.fault: plan for plan in plans_of()}
    assert abs(plans["wheels"].true_noise.wheel_mismatch) == 0.02
    assert plans["dropout"].true_noise.dropout == 0.1
    assert plans["sharp"].true_noise.fold_back > 0.0
    assert plans["none"].true_noise == type(plans["none"].true_noise)()


def test_worlds_can_be_driven_in():
    for plan in plans_of(3)[:5]:
        load_world(plan.world).check(0.10)
