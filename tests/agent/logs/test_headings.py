"""Headings of logs that do not turn as the wheels do."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.data import own_log

from limslam_agent import read_log

STEPS = 200


def log_with(path, yaw, turning=0.004):
    """The log of a robot whose wheels turn it to the left."""
    wheels = np.tile((0.02 - turning, 0.02 + turning), (STEPS, 1))
    np.savez(path, **{**own_log(STEPS), "wheels": wheels, "yaw": yaw})
    return read_log(path)


def heading(share=1.0):
    """The heading that turns by a share of the wheels' turn, rad."""
    return np.angle(np.exp(1j * share * 0.05 * np.arange(STEPS)))


@pytest.mark.parametrize("share", [0.7, 1.0, 1.4])
def test_a_heading_that_turns_about_as_the_wheels_do_is_used(share, tmp_path):
    log = log_with(tmp_path / "log.npz", heading(share))
    assert log.yaw is not None
    assert log.notes == ()


@pytest.mark.parametrize(
    ("yaw", "words"),
    [
        (np.degrees(heading()), "another unit"),
        (np.radians(heading()), "another unit"),
        (np.full(STEPS, 1.0), "not work"),
    ],
)
def test_a_heading_that_does_not_is_named_and_left_out(yaw, words, tmp_path):
    log = log_with(tmp_path / "log.npz", yaw)
    assert log.yaw is None
    (note,) = log.notes
    assert words in note


def test_a_heading_that_counts_clockwise_is_read_the_other_way(tmp_path):
    log = log_with(tmp_path / "log.npz", heading(-1.0))
    assert_allclose(log.yaw, heading())
    (note,) = log.notes
    assert "it counts clockwise, or left and right are exchanged" in note


def test_a_log_that_hardly_turns_says_nothing_of_its_heading(tmp_path):
    assert log_with(tmp_path / "log.npz", heading(-1.0), turning=1e-5).yaw is not None


def test_headings_with_gaps_are_compared_over_the_gaps(tmp_path):
    sparse = np.where(np.arange(STEPS) % 5 == 0, heading(), math.nan)
    assert log_with(tmp_path / "log.npz", sparse).yaw is not None
    turned = log_with(tmp_path / "log.npz", -sparse).yaw
    assert_allclose(turned[::5], heading()[::5])
