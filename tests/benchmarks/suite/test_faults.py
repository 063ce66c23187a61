"""Faults of robots in suites: when they begin, what they alter, and what is said of the robot afterwards."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.suite.faults import Fault, fault_begins, fault_scores
from benchmarks.suite.jobs import Job
from benchmarks.suite.runner import run_job
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig

OK, UNSURE, LOST = 0, 1, 2


def episode_of(levels, errors, *, turned=0.0, kidnapped=True):
    """A run whose fault begins in its third step, with the status and the error (m) of each step."""
    steps = len(levels)
    estimated = np.column_stack((errors, np.zeros(steps), np.full(steps, turned)))
    return SimpleNamespace(
        time=0.1 * np.arange(steps), true=np.zeros((steps, 1, 3)), estimated=estimated[:, None],
        levels=np.array(levels)[:, None],
        config=SimpleNamespace(robot=SimpleNamespace(control_period=0.1), kidnap_at=0.2 if kidnapped else None),
    )  # fmt: skip


def scores(*args, **kwargs):
    found = fault_scores(episode_of(*args, **kwargs), 0.2)
    return {name.removeprefix("fault_"): value for name, value in found.items()}


def test_a_robot_that_is_noticed_and_placed():
    found = scores([OK, UNSURE, OK, UNSURE, LOST, LOST, UNSURE, UNSURE], [0, 0, 5, 5, 5, 5, 5, 0.4])
    assert found == pytest.approx({
        "at_s": 0.2, "alarms_before_s": 0.1, "doubted_s": 0.1, "lost_s": 0.2, "placed_s": 0.5, "wrong_place_s": 0.1,
        "wrong_place_ok_s": 0.0, "unnoticed_s": 0.1,
    })  # fmt: skip


def test_a_robot_that_is_never_noticed_is_ok_though_it_is_wrong():
    found = scores([OK] * 6, [0, 0, 5, 5, 5, 5])
    assert (found["doubted_s"], found["lost_s"], found["placed_s"]) == (None, None, None)
    assert found["unnoticed_s"] == pytest.approx(0.4)
    assert found["wrong_place_s"] == 0.0


def test_a_place_with_a_wrong_heading_is_a_wrong_place():
    found = scores([OK, OK, LOST, OK], [0, 0, 5, 0.1], turned=0.5)
    assert found["placed_s"] is None
    assert found["wrong_place_ok_s"] == pytest.approx(0.1)


def test_only_a_robot_that_was_carried_away_has_to_be_placed():
    assert scores([OK, OK, LOST, OK], [0, 0, 5, 0], kidnapped=False)["placed_s"] is None


def test_a_run_that_ends_before_its_fault_is_a_failure():
    with pytest.raises(ValueError, match=r"the exploration ended after 0.1 s, before the fault at 0.2 s"):
        scores([OK, OK], [0, 0])


def test_faults_begin_at_whole_steps_within_their_time():
    begins = [fault_begins(Job("env1", 0.0, fault="jump", fault_time=(60.0, 90.0), seed=seed)) for seed in range(50)]
    assert min(begins) >= 60.0
    assert max(begins) <= 90.0
    assert max(begins) - min(begins) > 20.0
    assert np.allclose(np.array(begins) * 10, np.round(np.array(begins) * 10))
    assert fault_begins(Job("env1", 0.0)) is None


def test_the_agent_gets_the_altered_readings():
    config = RunConfig("env1", 0.0, max_time=1.0)
    healthy = run_episode(config)
    faulty = run_episode(config, alter=Fault("jump", 0.5).altered)
    jumped = np.flatnonzero((faulty.wheels[:, 0] > 4.0).all(axis=1))
    assert jumped.tolist() == [5]
    np.testing.assert_array_equal(faulty.wheels[:5], healthy.wheels[:5])
    assert faulty.levels[5, 0] > healthy.levels[5, 0] == OK


def test_a_job_with_a_fault_says_what_became_of_it():
    outcome = run_job(
        Job("env1", 0.02, preset="consistent", until="walls", fault="jump", fault_time=(2.0, 3.0), after_fault=1.0)
    )
    assert 2.0 <= outcome.metrics["fault_at_s"] <= 3.0
    assert outcome.metrics["fault_doubted_s"] == 0.0
