"""Loop closing: when two landmarks are one wall, and what the filter makes of it."""

import numpy as np
import pytest
from support.drives import ranges_at

from limslam_agent import AgentConfig, LineSlam, preset
from limslam_agent.config.ablations import ablated
from limslam_agent.config.published import LoopClosingConfig, PublishedConfig
from limslam_env.geometry import FloatArray, se2, segment
from limslam_env.interface import NominalNoise, RobotSpec, beams_on_rim

CONFIG = LoopClosingConfig()


def wall(y: float, x1: float, x2: float) -> np.ndarray:
    return np.array([x1, y, x2, y])


ROBOT = RobotSpec(beams=beams_on_rim((90.0, 60.0, -60.0, -90.0), 0.1))


def test_without_loop_closing_there_are_no_closures_and_the_ablations_are_one_switch_each():
    base = preset("paper")
    assert not ablated(base, "no-loop-closing").estimator.closing.enabled
    assert not ablated(base, "no-ekf").estimator.filter.correct
    assert ablated(base, "no-end-gate").estimator.association.max_end_gap > 1e3
    assert ablated(base, "only-best-line").estimator.hough.only_best
    with pytest.raises(ValueError, match="no ablation is called 'no-brain'"):
        ablated(base, "no-brain")


def walled_loop() -> tuple[FloatArray, FloatArray]:
    """A round trip of a robot in a square corridor: true poses (n, 3), and the outer and inner walls (8, 4)."""
    corners = np.array([[0.6, 0.6], [3.4, 0.6], [3.4, 3.4], [0.6, 3.4]])
    poses = []
    for side in range(5):
        start, end = corners[side % 4], corners[(side + 1) % 4]
        heading = se2.wrap_angle(float(np.pi / 2 * side))
        poses += [[*place, heading] for place in np.linspace(start, end, 140, endpoint=False)]
        poses += [[*end, se2.wrap_angle(heading + turn)] for turn in np.linspace(0.0, np.pi / 2, 16, endpoint=False)]
    outer = segment.polygon_edges(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]))
    inner = segment.polygon_edges(np.array([[1.2, 1.2], [2.8, 1.2], [2.8, 2.8], [1.2, 2.8]]))
    return np.array(poses), np.vstack((outer, inner))


def sensed(poses: FloatArray, walls: FloatArray, drift: float) -> list[dict[str, FloatArray]]:
    """What the robot reads on the way; its wheels tell ``drift`` (rad per m) too much of a turn."""
    observations, before = [], poses[0]
    for pose in poses:
        ahead, _, turn = se2.compose(se2.inverse(before), pose)
        half = 0.5 * ROBOT.axle * (turn + drift * ahead)
        observations.append({"ranges": ranges_at(pose, walls, ROBOT), "wheels": np.array([ahead - half, ahead + half])})
        before = pose
    return observations


@pytest.mark.parametrize("drift", [0.012, -0.012])
def test_round_a_loop_old_walls_are_found_again_and_the_error_shrinks(drift):
    poses, walls = walled_loop()
    observations = sensed(poses, walls, drift)
    errors, slams = [], []
    for enabled in (True, False):
        estimator = PublishedConfig(closing=LoopClosingConfig(enabled=enabled))
        config = AgentConfig(estimator=estimator, noise=NominalNoise(0.005, 2e-4))
        slam = LineSlam(ROBOT, config, poses[0])
        for observation in observations:
            slam.step(observation)
        slams.append(slam)
        errors.append(np.hypot(*(slam.pose[:2] - poses[-1, :2])))
    closing, without = slams
    assert closing.closures, "no loop was closed, and the test shows nothing"
    assert not without.closures
    for closure in closing.closures:
        assert closure.older < closure.younger
        # Two that lie on each other already cannot come closer.
        assert closure.distance_after < max(closure.distance_before, 0.1)
        assert closure.offset_after <= closure.offset_before + 0.005
    assert errors[0] < 0.30
    assert errors[0] < errors[1] + 0.05
