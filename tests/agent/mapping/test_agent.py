"""LimSlamAgent on a recorded list of observations: it gives the same actions every time, without a
simulator.
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from limslam_agent import AgentConfig, LimSlamAgent, preset
from limslam_env import LimSlamEnv, NominalNoise, Observation, RobotSpec
from limslam_env.geometry import FloatArray

ROBOT = RobotSpec()
CONFIG = preset("paper", NominalNoise(0.02))
STEPS = 400
Recording = tuple[FloatArray, list[Observation], FloatArray]


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Start pose, observations and the actions (n, 2) that an agent gave while they were recorded
    in Env1.
    """
    env = LimSlamEnv("env1", sensor_noise=0.02)
    observation, info = env.reset(seed=5)
    start = info["pose"].copy()
    agent = LimSlamAgent(ROBOT, CONFIG)
    agent.reset(start)
    seen = []
    actions = []
    for _ in range(STEPS):
        seen.append(observation)
        actions.append(np.array(agent.act(observation)))
        observation, _, _, _, info = env.step(actions[-1])
    assert np.hypot(*(info["pose"] - start)[:2]) > 0.5  # it went somewhere
    return start, seen, np.array(actions)


def replayed(agent: LimSlamAgent, recording: Recording) -> FloatArray:
    """The actions (n, 2) of an agent that was reset to the recording's start."""
    return np.array([agent.act(observation) for observation in recording[1]])


def fresh(recording: Recording, config: AgentConfig = CONFIG) -> LimSlamAgent:
    agent = LimSlamAgent(ROBOT, config)
    agent.reset(recording[0])
    return agent


def test_a_recorded_list_gives_the_recorded_actions_bit_for_bit_after_each_reset(
    recording: Recording,
) -> None:
    agent = fresh(recording)
    # Not because there is nothing to decide.
    assert len(np.unique(recording[2], axis=0)) > 50
    for observation in recording[1]:
        for array in observation.values():
            array.setflags(write=False)
    for seed in (None, 0, 7):
        agent.reset(recording[0], seed=seed)
        assert len(agent.snapshot().segments) == 0
        np.testing.assert_array_equal(agent.snapshot().pose, recording[0])
        assert replayed(agent, recording).tobytes() == recording[2].tobytes()


WITHOUT_PHYSICS = """
import sys
blocked = ["pymunk", "pygame", "mujoco", "Box2D", "gymnasium.envs.mujoco", "gymnasium.envs.box2d",
           "limslam_env.simulation.physics", "limslam_env.kernels.rays",
           "limslam_env.simulation.sensors", "limslam_env.simulation.simulation",
           "limslam_env.envs.env", "limslam_env.worlds.world"]
for name in blocked:
    sys.modules[name] = None  # importing it now raises ImportError
import numpy as np
from limslam_agent import LimSlamAgent, preset
from limslam_env import NominalNoise, RobotSpec

try:
    import pymunk
except ImportError:
    pass
else:
    raise SystemExit("pymunk could be imported: the test shows nothing")
log = np.load(sys.argv[1])
agent = LimSlamAgent(RobotSpec(), preset("paper", NominalNoise(0.02)))
agent.reset(log["start"])
steps = zip(log["ranges"], log["wheels"], strict=True)
actions = [agent.act({"ranges": r, "wheels": w}) for r, w in steps]
np.save(sys.argv[2], np.array(actions))
loaded = [name for name in blocked if sys.modules.get(name) is not None]
raise SystemExit(f"loaded after all: {loaded}" if loaded else 0)
"""


def test_it_acts_where_there_is_no_physics_to_import(recording: Recording, tmp_path: Path) -> None:
    start, observations, actions = recording
    log = tmp_path / "log.npz"
    answer = tmp_path / "actions.npy"
    np.savez(
        log,
        start=start,
        ranges=np.array([each["ranges"] for each in observations]),
        wheels=np.array([each["wheels"] for each in observations]),
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", WITHOUT_PHYSICS, str(log), str(answer)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert np.load(answer).tobytes() == actions.tobytes()


def arrays_of(snapshot: Any) -> dict[str, FloatArray]:
    """Every array that a snapshot hands out."""
    arrays = {name: getattr(snapshot, name) for name in ("pose", "covariance", "segments", "plan")}
    arrays |= {"grid.values": snapshot.grid.values, "grid.low": snapshot.grid.low}
    for number, landmark in enumerate(snapshot.landmarks):
        arrays |= {
            f"landmark {number} covariance": landmark.covariance,
            f"landmark {number} ends": landmark.ends,
        }
    return arrays


def after(recording: Recording, steps: int = 250) -> LimSlamAgent:
    agent = fresh(recording)
    for observation in recording[1][:steps]:
        agent.act(observation)
    assert len(agent.snapshot().segments) >= 2
    assert len(agent.snapshot().plan) >= 2
    return agent


def test_writing_into_a_snapshot_is_refused_or_does_not_reach_the_agent(
    recording: Recording,
) -> None:
    agent = after(recording)
    snapshot = agent.snapshot()
    before = {k: np.array(v) for k, v in arrays_of(agent.snapshot()).items()}
    for array in arrays_of(snapshot).values():
        if array.flags.writeable:
            np.add(array, 3, out=array)
    for name, array in arrays_of(agent.snapshot()).items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)
    assert (
        np.array([agent.act(o) for o in recording[1][250:300]]).tobytes()
        == recording[2][250:300].tobytes()
    )


def test_with_nowhere_to_go_it_stops_says_why_and_stands() -> None:
    # In a closet every beam reads 0.1 m while the robot turns on the spot by 20 degrees a step.
    travel = 0.5 * ROBOT.axle * np.radians(20.0)
    seen: Observation = {
        "ranges": np.full(6, 0.1, dtype=np.float32),
        "wheels": np.float32([-travel, travel]),
    }
    agent = LimSlamAgent(ROBOT, CONFIG)
    for _ in range(400):
        action = agent.act(seen)
        assert agent.done == (agent.stop_reason is not None)
        if agent.done:
            break
    assert agent.stop_reason is not None
    assert agent.stop_reason.startswith("explored")
    np.testing.assert_array_equal(action, [0.0, 0.0])
    np.testing.assert_array_equal(agent.act(seen), [0.0, 0.0])
