"""When the smoother tries a calibration: what a rough range model looks like is no error of the wheels."""

from types import SimpleNamespace

import numpy as np
import pytest

from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.line_graph import smoother
from limslam_agent.slam.line_graph.problem import make_problem
from limslam_env.interface import NominalNoise, RobotSpec

COMMON = (-0.006, -0.006, -0.006, 0.006)
UNEVEN = (-0.01, 0.01, 0.0, 0.0)
CONE = RangeSensor(0.02, growth=0.013, cone=0.035)


@pytest.mark.parametrize(
    ("sensor", "found", "is_needed"),
    [
        (None, COMMON, True),
        (None, UNEVEN, True),
        (CONE, COMMON, False),
        (CONE, UNEVEN, True),
        (CONE, (0.0, 0.0, 0.02, 0.0), True),
        (CONE._replace(bias=0.015), COMMON, True),
    ],
)
def test_sensors_with_a_cone_need_relative_errors(monkeypatch, sensor, found, is_needed):
    steps = np.zeros((4, 1, 2)), np.full((4, 1, 6), 1.0)
    problem = make_problem(RobotSpec(), NominalNoise(0.02), np.zeros((1, 3)), *steps, None, None, sensor=sensor)
    # A robot knows its relative errors best.
    relative = np.array([[-1.0, 1.0, 0.0, 0.0], [-0.5, -0.5, 1.0, 0.0]])
    information, known = 1e7 * relative.T @ relative + 1e6 * np.eye(4), (0.0, 0.0, 0.0, problem.bias)

    def solve(sized, *_):
        covariance = np.zeros((6, 6))
        covariance[2:, 2:] = np.linalg.inv(information + sized.prior)
        calibration = np.add([covariance[2:, 2:] @ information @ found], known)
        factored = SimpleNamespace(first_shared=2, covariance=covariance)
        return SimpleNamespace(state=SimpleNamespace(calibration=calibration), factored=factored)

    monkeypatch.setattr(smoother, "solve", solve)
    monkeypatch.setattr(smoother, "is_contradicted", lambda *_: False)
    association = SimpleNamespace(state=None, labels=None)
    settled = smoother.Settled(problem, association, ())
    assert smoother._may_need_calibration(settled) == is_needed
