"""The filter finds by itself what odometry is wrong by: in the square, and on a robot's log."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from support.command_line import limslam
from support.data import data_folder
from support.drives import FOUR_BEAMS, laps_of_square

from limslam_agent import AgentConfig, LineSlam, preset, read_log, replay_log
from limslam_agent.config.consistent import SelfCalibrationConfig
from limslam_agent.config.presets import self_calibrating
from limslam_env import NominalNoise
from limslam_env.geometry import FloatArray

COUNTED = np.array([1.006, 0.994])
"""What encoders count over what wheels turn: the left one is taken for larger than it is, the right for smaller."""


def config(noise: float, *, enabled: bool) -> AgentConfig:
    settings = preset("consistent", NominalNoise(noise))
    return self_calibrating(settings, "always" if enabled else "never")


def after_laps(noise: float) -> tuple[LineSlam, float]:
    """The mapping half after two laps with uneven wheels, and its position's RMS error, m."""
    log = laps_of_square(noise, seed=5, laps=2.0)
    slam, errors = LineSlam(FOUR_BEAMS, config(noise, enabled=True), log.poses[0]), []
    for seen, true in zip(log.observations, log.poses, strict=True):
        slam.step({**seen, "wheels": (COUNTED * seen["wheels"]).astype(np.float32)})
        errors.append(float(np.sum((slam.pose[:2] - true[:2]) ** 2)))
    return slam, math.sqrt(np.mean(errors))


@pytest.mark.parametrize("noise", [0.02])
def test_uneven_wheels_are_found_out(noise: float) -> None:
    slam, error = after_laps(noise)
    assert slam.odometry_calibration is not None
    factors, covariance = slam.odometry_calibration
    true = 1.0 / COUNTED - 1.0
    uneven, std = np.array([-1.0, 1.0, 0.0]), math.sqrt(covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1])
    assert std < 0.2 * (true[1] - true[0])
    assert uneven @ np.array(factors) == pytest.approx(true[1] - true[0], abs=3.0 * std)
    assert error < 0.3


def test_each_robot_has_wheels_of_its_own() -> None:
    start: FloatArray = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    slam = LineSlam(FOUR_BEAMS, config(0.02, enabled=True), start)
    ranges = FOUR_BEAMS.max_ranges.astype(np.float32)
    for _ in range(10):
        slam.step(*({"ranges": ranges, "wheels": np.full(2, travel, dtype=np.float32)} for travel in (0.02, 0.03)))
    np.testing.assert_allclose(slam.poses, [[0.2, 0.0, 0.0], [1.3, 0.0, 0.0]], atol=1e-6)
    # Farther driven, less sure of where: each by its own wheels' size alone.
    # The noise alone would give a ratio of 1.5, and the size alone 2.25.
    assert slam.covariances[1][0, 0] > 1.8 * slam.covariances[0][0, 0]


@pytest.mark.parametrize("name", ["size_std", "uneven_std", "axle_std"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_what_is_known_beforehand_must_make_sense(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        SelfCalibrationConfig(**{name: value})


@pytest.mark.slow
def test_a_real_robots_odometry_is_found_to_turn() -> None:
    log = read_log(data_folder() / "fr079" / "fr079_raw.clf.gz", [90, 54, 18, -18, -54, -90], 5.0)
    found = replay_log(log, config(0.02, enabled=True)).self_calibration
    assert found is not None
    figures = found.figures
    # Hand-checked relations say 0.99 deg/m.
    assert 0.6 < figures["self_calibration_turn_deg_per_m"] < 1.2
    assert figures["self_calibration_turn_std_deg_per_m"] < 0.2
    assert figures["self_calibration_scale"] == pytest.approx(1.0, abs=0.02)


def test_replay_tells_what_it_found(tmp_path: Path) -> None:
    table = tmp_path / "corridor.csv"
    rows = [f"{0.1 * step:.1f},{0.025 * step:.3f},0,0,0.8,0.9" for step in range(200)]
    table.write_text("\n".join(["t,x,y,theta,r_-90,r_90", *rows]) + "\n")
    (tmp_path / "settings.toml").write_text('[agent.estimator.self_calibration]\ncalibrate = "always"\n')
    config = ["--preset", "consistent", "--config", str(tmp_path / "settings.toml")]
    arguments = ["replay", str(table), *config, "--out", str(tmp_path / "out")]
    assert limslam(*arguments).returncode == 0
    metrics = json.loads((tmp_path / "out" / "result.json").read_text())["metrics"]
    assert abs(metrics["self_calibration_turn_deg_per_m"]) < 0.5
    assert 0.0 < metrics["self_calibration_turn_std_deg_per_m"] < 1.0
