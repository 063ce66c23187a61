"""The status of robots with faults that begin in the middle of an exploration, and of a healthy robot."""

import numpy as np
import pytest
from support.faults import Fault, steps_with

BEGIN, NOISE = 30.0, 0.02


@pytest.mark.parametrize(
    ("kind", "world", "seed"),
    [("kidnapped", "env2", 1), ("reversed", "env3", 1), ("swapped", "env1", 1), ("jump", "env2", 3)],
)
def test_a_fault_is_noticed_within_ten_seconds(kind, world, seed):
    levels = []
    agent, rows = steps_with(Fault(kind, BEGIN, seed), world, NOISE, 10.0, seed=seed, note=levels)
    before, after = levels[: round(BEGIN / 0.1)], levels[round(BEGIN / 0.1) :]
    assert set(before) == {"ok"}
    assert {"unsure", "lost"} & set(after)
    assert len(rows) == len(levels)
    assert agent.status_reason or agent.status == "ok"


def test_the_uncertainty_of_a_kidnapped_robot_outgrows_its_error():
    agent, rows = steps_with(Fault("kidnapped", BEGIN, 1), "env2", NOISE, 25.0, seed=1, finds_places=False)
    error = np.hypot(*(rows[-1]["pose"] - agent.snapshot().pose)[:2])
    snapshot = agent.snapshot()
    assert error > 1.0
    assert (agent.status, snapshot.status) == ("lost", "lost")
    assert snapshot.status_reason == snapshot.statuses[0].reason == agent.status_reason != ""
    assert np.sqrt(snapshot.covariance[0, 0] + snapshot.covariance[1, 1]) > error
    np.testing.assert_array_equal(agent.mapper.belief.covariance, snapshot.covariance)
    assert agent.mapper.belief.status == snapshot.statuses[0]
    assert np.trace(agent.slam.covariance) < 1.0
