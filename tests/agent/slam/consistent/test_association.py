"""Which wall segments update a landmark that they disagree with, and what that does to a filter that is too sure."""

import math
from typing import Any

import numpy as np
import pytest
from support.batch_stages import estimator_after
from support.drives import ROBOT, drive, recorded, straight

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import preset
from limslam_agent.slam.batch.batch_slam import BatchSlam
from limslam_agent.slam.consistent.consistent import ConsistentEstimator, _Candidate
from limslam_agent.slam.consistent.limits import FAR_GATE
from limslam_agent.slam.consistent.segmentation import WallSegment
from limslam_agent.slam.core.diagnostics import Comparison
from limslam_agent.slam.slam import LineSlam
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import Observation

START = np.zeros(3)
CONFIG = preset("consistent")
GATE = ConsistentConfig().association.gate
WALL = np.array([[-1.0, 0.5, 5.0, 0.5]])
BACK_AND_FORTH = [*straight(3.0), *straight(-2.5), *straight(2.0)]
FALSE_TURN = range(len(straight(5.5)) + 1, len(straight(5.5)) + 5)


def misled(degrees: float) -> tuple[list[Observation], FloatArray]:
    """A drive along a wall that is known already, whose odometry turns by an angle that is none, and the last pose."""
    observations, poses = drive(WALL, START, BACK_AND_FORTH)
    each = 0.5 * ROBOT.axle * math.radians(degrees) / len(FALSE_TURN)
    for step in FALSE_TURN:
        observations[step]["wheels"] += np.array([-each, each], dtype=np.float32)
    return observations, poses[-1]


@pytest.mark.parametrize("degrees", [5.0, 6.0])
def test_a_filter_that_is_too_sure_is_corrected_by_the_only_wall_nearby(degrees: float) -> None:
    observations, pose = misled(degrees)
    heard = list[Comparison]()
    slam = LineSlam(ROBOT, CONFIG, START)
    slam.on_comparison = heard.append
    for seen in observations:
        slam.step(seen)
    assert np.abs(slam.pose - pose).max() < 0.005
    assert len(slam.all_landmarks) == 1
    # The first comparison after the false turn lies between the gates, and it is said that the landmark was taken.
    tests = [each.tests[0] for each in heard if each.step > FALSE_TURN[0]]
    refused = [test for test in tests if GATE < test.distance < FAR_GATE]
    assert refused
    assert refused[0].excluded == ""


def test_the_batch_is_corrected_alike() -> None:
    observations, _ = misled(6.0)
    slam, batch = LineSlam(ROBOT, CONFIG, START), BatchSlam(ROBOT, CONFIG, 1, num_threads=1, size=0)
    batch.reset(START[None])
    for seen in observations:
        slam.step(seen)
        beliefs = batch.step(seen["ranges"][None], seen["wheels"][None])
        np.testing.assert_allclose(beliefs.pose[0], slam.pose, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(beliefs.covariance[0], slam.covariance, rtol=0.0, atol=1e-6)
    assert batch.num_landmarks[0] == 1


def test_a_turn_beyond_the_far_gate_is_not_taken_back() -> None:
    observations, pose = misled(10.0)
    slam, _ = recorded(observations, CONFIG, START)
    assert abs(wrap_angle(float(slam.pose[2] - pose[2]))) > math.radians(5.0)


@pytest.mark.parametrize(
    ("squared", "changes", "outcome"),
    [
        ([12.0], {}, "update"),
        ([12.0, 30.0], {}, "update"),
        ([24.0, 25.0], {}, "update"),
        ([12.0, 24.0], {}, "wait"),
        ([26.0], {}, "new"),
        ([12.0], {"angle_std": math.radians(3.1)}, "wait"),
        ([12.0], {"count": 9}, "wait"),
        # Below the first gate none of this matters.
        ([8.0, 24.0], {"angle_std": math.radians(3.1), "count": 9}, "update"),
        # Of two walls that can be meant, the readings are taken for the likelier one.
        ([4.0, 8.0], {}, "update"),
    ],
)
def test_only_segments_without_another_meaning_pass_the_first_gate(
    monkeypatch: pytest.MonkeyPatch, squared: list[float], changes: dict[str, Any], outcome: str
) -> None:
    estimator, done = estimator_after(130), list[str]()
    candidates = [_Candidate(each, 0.0, 20, index) for index, each in enumerate(squared)]
    monkeypatch.setattr(ConsistentEstimator, "_candidates", lambda *_: candidates)
    monkeypatch.setattr(ConsistentEstimator, "_closes_loop", lambda *_: False)
    monkeypatch.setattr(ConsistentEstimator, "_observe", lambda *_: bool([done.append("update")]))
    monkeypatch.setattr(ConsistentEstimator, "_add", lambda *_: done.append("new"))
    # 10 readings for 2 cm of noise are enough for a new landmark.
    along = np.linspace(0.0, 1.0, changes.get("count", 10)) * 1.5
    points = np.column_stack((along, np.zeros_like(along)))
    segment = WallSegment(
        np.arange(len(points)), 0.5 * math.pi, points.mean(axis=0), points, 1.2, changes.get("angle_std", 0.01), along,
        along,
    )  # fmt: skip
    is_consumed = estimator._incorporate(0, 0, None, segment, is_complete=False)  # type: ignore[arg-type]
    assert done == ([] if outcome == "wait" else [outcome])
    assert is_consumed == (outcome != "wait")


@pytest.mark.parametrize(
    ("begin", "degrees", "std", "fits"),
    [
        (0.1, 7.0, 0.5, True),
        (0.1, 9.0, 0.5, False),
        # Inside the known ends, too, unless the direction of the piece is not known.
        (-0.6, 7.0, 0.5, True),
        (-0.6, 9.0, 0.5, False),
        (-0.6, 9.0, 4.6, True),
    ],
)
def test_a_piece_that_is_turned_like_another_facet_does_not_update(
    begin: float, degrees: float, std: float, fits: bool
) -> None:
    estimator = estimator_after(130)
    line, anchor = estimator._filter.anchored[0], estimator._filter.anchors[0]
    last, theta = estimator._map[0].extent.ends[1], float(line[1])
    tangent, normal = np.array([-math.sin(theta), math.cos(theta)]), np.array([math.cos(theta), math.sin(theta)])
    points = anchor + line[0] * normal + (last + np.linspace(begin, begin + 0.5, 20)[:, None]) * tangent
    # The direction of a line is the same when its normal is turned by half a circle.
    segment = WallSegment(
        np.arange(20), theta + math.radians(degrees) + math.pi, points.mean(axis=0), points, 0.45, math.radians(std),
        np.zeros(20), np.zeros(20),
    )  # fmt: skip
    assert estimator._fits(segment, _Candidate(8.0, 0.0, 20, 0)) == fits
