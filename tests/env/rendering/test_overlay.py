"""What an agent hands over to be drawn: checked once, and then its own."""

import numpy as np
import pytest

from limslam_env import Overlay

POSE = np.array([1.0, 2.0, 0.5])


def test_empty_lists_are_no_rows():
    overlay = Overlay(segments=[], frontier=[], plan=[])
    assert (overlay.segments.shape, overlay.frontier.shape, overlay.plan.shape) == ((0, 4), (0, 2), (0, 2))


def test_lists_and_other_number_types_will_do():
    overlay = Overlay((1, 2, 0), np.eye(3, dtype=np.float32), [[0, 0, 1, 1]], [[1, 2], [3, 4]], [[5, 6]])
    for name in ("pose", "covariance", "segments", "frontier", "plan"):
        assert getattr(overlay, name).dtype == float
    np.testing.assert_array_equal(overlay.frontier, [[1.0, 2.0], [3.0, 4.0]])


def test_arrays_are_copies_that_nobody_can_write_to():
    given = {
        "pose": POSE.copy(), "covariance": np.eye(3), "segments": np.ones((2, 4)), "frontier": np.ones((3, 2)),
        "plan": np.ones((4, 2)),
    }  # fmt: skip
    before = {name: array.copy() for name, array in given.items()}
    overlay = Overlay(**given)
    for name, array in given.items():
        array[:] = -7.0
        np.testing.assert_array_equal(getattr(overlay, name), before[name])
        with pytest.raises(ValueError, match="read-only"):
            getattr(overlay, name)[:] = 0.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"pose": [1.0, 2.0]}, r"pose must have shape \(3\), not \(2,\)"),
        ({"pose": POSE, "covariance": np.eye(2)}, r"covariance must have shape \(3, 3\)"),
        ({"covariance": np.eye(3)}, "needs a pose"),
        ({"segments": np.zeros((2, 5))}, r"segments must have shape \(n, 4\), not \(2, 5\)"),
        ({"frontier": np.zeros((2, 3))}, "frontier must have shape"),
        ({"plan": [[0.0, 1.0], [2.0]]}, "plan must be an array of numbers"),
        ({"pose": [np.nan, 0.0, 0.0]}, "pose holds a number that is not finite"),
        ({"pose": POSE, "covariance": np.full((3, 3), np.inf)}, "covariance holds a number that is not finite"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_one_line(arguments, words):
    with pytest.raises(ValueError, match=words) as refusal:
        Overlay(**arguments)
    assert "\n" not in str(refusal.value)
