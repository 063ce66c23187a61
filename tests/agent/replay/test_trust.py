"""Signals of a smoothed path that need no truth, and the status that follows from them."""

import numpy as np
import pytest

from limslam_agent.output.summary import replay_summary
from limslam_agent.replay.trust import PathSignals, crossings

ROOM = np.array([[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 3.0]])


def signals(driven=100.0, times=(), confirmed=0.5, contradicted=0.05, loops=20, bends=()):
    return PathSignals(driven, tuple(times), confirmed, contradicted, loops, tuple(bends))


def test_a_path_crosses_a_wall_only_inside_of_its_ends():
    along = np.array([[-1.0, -1.0], [-1.0, 1.0], [0.1, -1.0], [2.0, 1.0], [5.0, 1.0], [5.0, 4.0], [3.0, 4.0]])
    assert crossings(along, ROOM).tolist() == [False, False, True, True, False, False]
    assert not crossings(along, np.zeros((0, 4))).any()
    assert not crossings(along[:1], ROOM).any()


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (signals(), ""),
        (signals(times=(1.0, 2.0)), ""),
        (signals(driven=20.0, times=(1.0,)), ""),
        (signals(times=(1.0, 2.0, 3.0, 4.0)), "the path passes through walls at 4 places"),
        (signals(contradicted=0.2), "visits of a place contradict each other at 29% of the points"),
        (signals(confirmed=0.0, contradicted=0.0, loops=0), "no place was recognised again in 100 m"),
        (signals(driven=30.0, confirmed=0.0, contradicted=0.0, loops=0), ""),
        (signals(bends=(33.2, 91.0)), "the path is bent more than odometry and walls allow after 33, 91 s"),
    ],
)
def test_the_status_names_each_reason(found, words):
    assert (found.status.level, found.status.reason) == ("unsure" if words else "ok", words)


def test_odometry_is_better_only_if_it_crosses_fewer_walls_and_agrees_better():
    bent = signals(times=range(6), confirmed=0.3, contradicted=0.2)
    assert bent.is_worse_than(signals(times=(1.0,), confirmed=0.4, contradicted=0.1))
    assert not bent.is_worse_than(signals(times=(1.0,), confirmed=0.2, contradicted=0.2))
    assert not bent.is_worse_than(signals(times=range(5), confirmed=0.4, contradicted=0.1))
    assert not signals(times=(1.0,)).is_worse_than(signals(confirmed=0.9))


def test_the_summary_says_when_a_path_may_be_wrong():
    lines = replay_summary({"status": "lost", "status_reason": "why", **signals(times=(3.2, 250.0)).figures})
    assert lines[1:3] == [
        "            ok at the end",
        "            may be wrong where the path passes through walls, after 3, 250 s",
    ]
