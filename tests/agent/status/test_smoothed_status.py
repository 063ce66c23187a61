"""The status of a finished run, by what its smoother found."""

import numpy as np
import pytest

from limslam_agent.status.status import Status, final_status_scores, lost_since, smoothed_status

STEPS = 50


def path(aside=0.0, std=0.05, heading_std=0.01):
    """A straight drive of one robot, shifted to one side, with its covariances."""
    poses = np.zeros((STEPS, 1, 3))
    poses[:, 0, 0], poses[:, 0, 1] = np.linspace(0.0, 5.0, STEPS), np.linspace(0.0, aside, STEPS)
    return poses, np.broadcast_to(np.diag([std, std, heading_std]) ** 2, (STEPS, 1, 3, 3))


@pytest.mark.parametrize(
    ("share", "before", "level"),
    [
        (0.001, "lost", "ok"), (0.003, "ok", "ok"), (0.003, "unsure", "unsure"), (0.003, "lost", "lost"),
        (0.02, "ok", "unsure"), (0.05, "ok", "lost"),
    ],
)  # fmt: skip
def test_contradictions_of_the_smoothed_map_count(share, before, level):
    status = smoothed_status(share, path(), path(), while_driving=before)
    assert status.level == level
    assert bool(status.reason) == (level != "ok")
    assert level == "ok" or f"{100.0 * share:.2g} % of the readings contradict" in status.reason


@pytest.mark.parametrize(
    ("aside", "std", "level"),
    # A small correction, a large one of a filter that was certain, and a large one of a filter that said it was lost.
    [(0.1, 0.01, "ok"), (0.8, 0.05, "unsure"), (0.8, 1.0, "ok")],
)
def test_large_corrections_of_a_certain_filter_are_unsure(aside, std, level):
    filtered, smoothed = path(std=std), path(aside)
    status = smoothed_status(0.0, filtered, smoothed, while_driving="lost")
    assert status.level == level
    assert level == "ok" or "up to 0.80 m" in status.reason
    np.testing.assert_array_equal(smoothed[0], path(aside)[0])


def test_an_uncertain_smoothed_heading_is_unsure():
    status = smoothed_status(0.0, path(), path(heading_std=np.radians(6.0)), while_driving="ok")
    assert status == Status("unsure", "the smoothed heading's standard deviation reaches 6.0 deg")


def test_a_robot_that_was_lost_to_the_end_is_lost():
    since = lost_since(np.arange(10.0, 20.0), 4)
    assert since == 4.0
    assert lost_since(np.arange(10.0), None) is None
    lost = smoothed_status(0.0, path(), path(), while_driving="lost", lost_since=since)
    assert lost == Status("lost", "the place of the robot is unknown from 4 s on")


def test_the_scores_have_the_status_of_the_result_and_of_the_filter():
    levels = np.array([[0, 0], [0, 0], [0, 2], [2, 0], [0, 2]])
    scores = final_status_scores(Status(), Status("lost", "a jump"), 3.0 + np.arange(5.0), levels)
    assert scores == {
        "status": "ok", "status_reason": "", "status_note": "lost while driving, from 2 s to the end",
        "status_online": "lost", "status_online_reason": "a jump",
    }  # fmt: skip
