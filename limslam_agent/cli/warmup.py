"""``limslam warmup``: compile all kernels now, so that no later run waits for them."""

import os
import subprocess
import sys
import time
from collections.abc import Callable

import typer


def warmup() -> None:
    """Compile everything that is compiled at its first use, and keep it on disk."""
    from limslam_env.messages import QUIET

    # Each step has its own line, which the kernels need not repeat.
    os.environ[QUIET] = "1"
    # The last step takes half of all the time, so it is done beside the others, and is found on
    # disk then. If that process fails, the step compiles its kernels here.
    beside = subprocess.Popen(  # noqa: S603 (this interpreter, and this module)
        [sys.executable, "-P", "-c", f"from {__name__} import STEPS; STEPS[{LAST!r}][1]()"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        for name, (seconds, step) in STEPS.items():
            typer.echo(f"{name:12}", nl=False)
            begin = time.perf_counter()
            typer.echo(f"{f'up to about {seconds} s ...':24}", nl=False)
            if name == LAST:
                beside.wait()
            step()
            typer.echo(f"done after {time.perf_counter() - begin:.1f} s")
    finally:
        beside.kill()
        beside.wait()


def _single() -> None:
    from limslam_agent.runs.episode import run_episode
    from limslam_agent.runs.run_config import RunConfig

    # Late beams are looked for after some seconds, and by then all else has been used.
    run_episode(RunConfig("square", max_time=30.0, until="seen"))


def _batch() -> None:
    import gymnasium as gym

    import limslam_env  # noqa: F401 (registers the ids)

    for world in ("square", "random"):
        envs = gym.make_vec("LimSlam-World-v0", num_envs=2, world=world)
        envs.reset(seed=0)
        envs.step(envs.action_space.sample())
        envs.close()


def _batch_slam() -> None:
    import numpy as np

    from limslam_agent.slam.batch.batch_slam import BatchSlam
    from limslam_env.interface import RobotSpec

    robot = RobotSpec()
    slam = BatchSlam(robot, num_envs=2, num_threads=1)
    slam.step(np.tile(robot.max_ranges, (2, 1)), np.zeros((2, 2)))
    slam.close()


def _smoothers() -> None:
    """Smooth a lap with the line smoother, and the same lap as a log of poses with the graph of
    local maps.
    """
    import numpy as np

    from limslam_agent.config.presets import preset
    from limslam_agent.logs.recorded_log import RecordedLog
    from limslam_agent.replay.replay import replay_log
    from limslam_agent.runs.episode import run_episode
    from limslam_agent.runs.run_config import RunConfig

    lap = run_episode(RunConfig("square", laps=1, until="seen"))
    _ = lap.smoothed
    log = RecordedLog(
        robot=lap.config.robot,
        time=lap.time,
        ranges=lap.ranges[:, 0].astype(np.float32),
        has_scan=np.ones(len(lap.time), dtype=np.bool_),
        start_pose=lap.odometry[0, 0],
        odometry=lap.odometry[:, 0],
    )
    replay_log(log, preset("graph"))


STEPS: dict[str, tuple[int, Callable[[], None]]] = {
    "simulator": (10, _single),
    "batch": (10, _batch),
    "smoothers": (10, _smoothers),
    "BatchSlam": (25, _batch_slam),
}
LAST = "BatchSlam"
"""What is compiled, by names: about how long that takes, s, and a function that uses it."""
