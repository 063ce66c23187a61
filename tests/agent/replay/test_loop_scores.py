"""Precision and recall of loops against known relations."""

import numpy as np
import pytest

from limslam_agent.logs.relations import Relations
from limslam_agent.replay.loop_scores import loop_scores
from limslam_agent.slam.graph.agreement import KEPT, NO_SUPPORT
from limslam_env.geometry import se2

LAP = 40
TIME = np.arange(2 * LAP + 1) * 2.0
TRUTH = [np.zeros(3)]
for _ in range(2 * LAP):
    TRUTH.append(se2.compose(TRUTH[-1], np.array([0.5, 0.0, 2.0 * np.pi / LAP])))
TRUTH = np.array(TRUTH)


def relation(first, second):
    return TIME[first], TIME[second], se2.between(TRUTH[first], TRUTH[second])


def relations_of(*pairs):
    starts, ends, motions = zip(*(relation(*pair) for pair in pairs), strict=True)
    return Relations(np.array(starts), np.array(ends), np.array(motions))


def loop(first, second, off=0.0, reason=KEPT):
    motion = se2.between(TRUTH[first], TRUTH[second]) + np.array([off, 0.0, 0.0])
    return {"first_time": TIME[first], "second_time": TIME[second], "relative": motion.tolist(), "reason": reason}


def test_right_and_wrong_loops_are_told_apart():
    known = relations_of((5, 45), (15, 55), (70, 30))
    loops = [loop(4, 46), loop(16, 55, off=2.0), loop(29, 69), loop(30, 70, reason=NO_SUPPORT), loop(10, 62)]
    found = loop_scores(loops, known, TIME, TRUTH)
    assert found == {
        "loops_judged": 3,
        "loops_precision": pytest.approx(2 / 3),
        "loops_recall": pytest.approx(2 / 3),
        "loops_right_but_left_out": 1,
    }


def test_without_relations_or_loops_nothing_is_judged():
    short = relations_of((5, 8))
    assert loop_scores([loop(4, 46)], short, TIME, TRUTH)["loops_precision"] is None
    assert loop_scores([loop(4, 46)], short, TIME, TRUTH)["loops_recall"] is None
    none = loop_scores([], relations_of((5, 45)), TIME, TRUTH)
    assert (none["loops_judged"], none["loops_precision"], none["loops_recall"]) == (0, None, 0.0)
