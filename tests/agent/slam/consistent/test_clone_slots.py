"""Slots that are left to later clones change nothing in what the filter knows."""

import numpy as np
import pytest
from support.readings import Readings, clone_covariance, clone_poses, observe

from limslam_agent.slam.consistent import clone_slots
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.clone_slots import CloneSlots
from limslam_env.interface import RobotSpec

ROBOT = RobotSpec()


def driven(steps=120):
    """A filter that has driven between two walls, with clones that came and went; and its clones."""
    random, ekf, held = np.random.default_rng(4), CloneEKF(np.zeros(3), np.diag([1e-4] * 3), (0.05, 0.2)), []
    for step in range(steps):
        ekf.predict(np.array([0.03, 0.0, random.normal(0.0, 0.02)]), 1e-6 * np.eye(3), 0, 1e-2 * np.eye(3))
        held.append(ekf.clone())
        if step % 10 == 9:
            side = step // 10 % 2
            line = side if ekf.num_lines > side else ekf.add_line(0.5 * np.pi, np.array([0.0, 1.0 - 2.0 * side]))
            clones, beams = np.array(held[-4:]), np.full(4, 5 * side)
            readings = Readings(
                clones, ROBOT.beam_origins[beams], ROBOT.beam_angles[beams], random.normal(0.9, 0.02, 4),
                np.column_stack((clones, beams)),
            )  # fmt: skip
            observe(ekf, readings, line, 0.02, 2, 1.5)
        if step % 7 == 6:
            held = sorted(random.permutation(held)[: random.integers(4, 30)].tolist())
            ekf.keep_clones(set(held))
    return ekf, np.array(held)


def test_a_filter_with_free_slots_knows_the_same(monkeypatch):
    plain, held = driven()
    monkeypatch.setattr(clone_slots, "_LARGE", 0)
    large, same = driven()
    assert held.tolist() == same.tolist()
    assert plain.num_clones == large.num_clones == len(held)
    assert len(plain.x) == plain.clones_from + 3 * len(held) < len(large.x)
    np.testing.assert_allclose(large.marginal(), plain.marginal(), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(large.x[: large.clones_from], plain.x[: plain.clones_from], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(clone_poses(large, held), clone_poses(plain, held), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(clone_covariance(large, held), clone_covariance(plain, held), rtol=0.0, atol=1e-9)
    assert large.calibration_evidence == pytest.approx(plain.calibration_evidence, abs=1e-6)


def test_the_slot_of_a_clone_that_is_gone_is_used_again():
    slots = CloneSlots()
    assert (slots.missing(119), slots.missing(120)) == (1, 12)
    slots.append(12)
    assert [slots.fill() for _ in range(3)] == [(0, 0), (1, 1), (2, 2)]
    assert not slots.keep({0, 2}, 120)
    assert slots.missing(120) == 0
    assert slots.fill() == (3, 1)
    assert slots.of(np.array([3, 0, 2])).tolist() == [1, 0, 2]
    assert slots.keep({2, 3}, 119)
    assert slots.close().tolist() == [2, 1]
    assert slots.of(np.array([2, 3])).tolist() == [0, 1]
    assert (len(slots), slots.missing(119), slots.next) == (2, 1, 4)
