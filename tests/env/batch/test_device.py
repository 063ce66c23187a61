"""The batch on a GPU, in numba's simulator of CUDA and as far as it can be compiled without a
GPU.
"""

import os
import subprocess
import sys

import gymnasium as gym
import pytest

# The simulator runs the kernel in Python and what it calls as on the processor: the results are the
# same bits.
COMPARED = """
import gymnasium as gym
import numpy as np
import limslam_env
from limslam_env import FloorPlanConfig, NoiseConfig, RobotSpec, SensorSpec

def compare(name, steps, **arguments):
    here, there = (
        gym.make_vec(name, num_envs=3, device=device, **arguments) for device in ("cpu", "cuda")
    )
    generator = np.random.default_rng(0)
    ours, theirs, ended = here.reset(seed=4), there.reset(seed=4), 0
    for step in range(steps):
        if step == 9:
            ours, theirs = here.reset(), there.reset()
        for part in (0, -1):
            for key, value in theirs[part].items():
                np.testing.assert_array_equal(value, ours[part][key], key)
        actions = generator.uniform(-0.3, 1.2, (3, 2)).astype(np.float32)
        ours, theirs = here.step(actions), there.step(actions)
        for value, expected in zip(theirs[1:4], ours[1:4]):
            np.testing.assert_array_equal(value, expected)
        ended += (ours[2] | ours[3]).sum()
    assert ended > 2
    for env in range(3):
        np.testing.assert_array_equal(there.seen(env), here.seen(env))

noise = NoiseConfig.sharp(sensor_noise=(0.01, 0.03), slip_rate=3.0, axle_mismatch=(-0.05, 0.05))
beams = tuple(SensorSpec(0.0, 0.0, 2.0 * beam, period=3, phase=beam) for beam in range(3))
robot = RobotSpec(beams=beams)
compare("LimSlam-Env1-v0", 13, noise=noise, max_episode_steps=4, robot=robot)
plans = FloorPlanConfig(width=3.0, height=3.0)
compare("LimSlam-World-v0", 14, world=plans, plans=3, sensor_noise=0.02, coverage_goal=0.2)

envs = gym.make_vec("LimSlam-Env1-v0", num_envs=2, device="cuda")
envs.reset(seed=0, options={"start": (1.0, 2.0, 0.5)})
for actions in (np.zeros((2, 3)), np.zeros((4, 2))):
    try:
        envs.step(actions)
    except ValueError as error:
        assert "2 rows of 2 numbers" in str(error)
    else:
        raise AssertionError
print("equal")
"""


def test_in_the_simulator_of_cuda_the_results_are_those_of_the_processor():
    pytest.importorskip("numba.cuda.simulator")
    surroundings = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1"}
    command = [sys.executable, "-c", COMPARED]
    done = subprocess.run(command, capture_output=True, text=True, env=surroundings, check=False)
    assert done.stdout == "equal\n", done.stderr


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"device": "tpu"}, ValueError, "'cpu' or 'cuda', not 'tpu'"),
        ({"device": "cuda", "autoreset_mode": "SameStep"}, TypeError, "autoreset_mode"),
    ],
)
def test_what_no_device_can_do_is_refused(arguments, error, words):
    pytest.importorskip("numba.cuda")
    with pytest.raises(error, match=words):
        gym.make_vec("LimSlam-Env1-v0", num_envs=2, **arguments)


def test_without_a_gpu_the_message_says_what_is_needed():
    cuda = pytest.importorskip("numba.cuda")
    if cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(RuntimeError, match="extra gpu"):
        gym.make_vec("LimSlam-Env1-v0", num_envs=2, device="cuda")
