"""``python -m limslam_agent.live.emulator``: a simulated robot behind a serial port, UDP or topics
of ROS 2.
"""

from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from limslam_agent.command_options import takes
from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.help import Help
from limslam_agent.terminal import run_command, say

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)

_PORT = "Where the host finds the robot"
_ROBOT = "Robot and world"


@dataclass(frozen=True)
class EmulatorOptions(Bounded):
    """The options of the emulator."""

    udp: Annotated[
        int, Bounds(0, 65535), Help(_PORT, "Send to this UDP port of the host.", default=False)
    ] = 0
    host: Annotated[str, Help(_PORT, "Address of the host.")] = "127.0.0.1"
    pty: Annotated[bool, Help(_PORT, "Make a serial port, and print its name.")] = False
    ros2: Annotated[bool, Help(_PORT, "Publish odom and a topic beam_N for each beam.")] = False
    world: Annotated[
        str, Help(_ROBOT, "Name of a shipped world, random:SEED, or a world file.")
    ] = "env1"
    robot: Annotated[str, Help(_ROBOT, "Robot that ships with LimSLAM, or a TOML file.")] = "paper"
    noise: Annotated[float, Help(_ROBOT, "Standard deviation of the ranges, m.")] = 0.02
    seed: Annotated[int, Help(_ROBOT, "Random seed.")] = 0
    watchdog: Annotated[
        int, Help(_ROBOT, "Time without a line after which the wheels stop, ms.")
    ] = 500
    speed: Annotated[
        float,
        Bounds(0.0, 1000.0),
        Help(_ROBOT, "How much faster than real time. 0: as fast as the host answers."),
    ] = 1.0
    imu: Annotated[bool, Help(_ROBOT, "Measure the heading, too.")] = False
    token: Annotated[
        str | None, Help(_PORT, "Say this word in each hello, for a host with --token.")
    ] = None
    truth: Annotated[
        Path | None, Help(_ROBOT, "File for the true poses, lines of t x y heading.", default=False)
    ] = None


@app.command()
@takes(EmulatorOptions)
def emulate(**arguments: Any) -> None:
    """Emulate a robot until the process is ended."""
    from limslam_agent.live.emulator.emulator import Body, Emulator, run
    from limslam_agent.live.emulator.ports import PtyPort, RobotAtPort, UdpPort
    from limslam_agent.robot_file import robot_named
    from limslam_env.config import NoiseConfig
    from limslam_env.worlds.formats.loading import load_world

    chosen = {name: value for name, value in arguments.items() if value is not None}
    options = EmulatorOptions(**chosen)
    body = Body(
        load_world(options.world),
        robot_named(options.robot),
        replace(NoiseConfig(), sensor_noise=options.noise),
        name=Path(options.robot).stem.replace("_", "-"),
        watchdog_ms=options.watchdog,
        seed=options.seed,
        imu=options.imu,
        token=options.token,
    )
    pace = body.robot.control_period / options.speed if options.speed else 0.0
    if bool(options.udp) + options.pty + options.ros2 != 1:
        raise ValueError("either --udp PORT, --pty or --ros2 is needed")
    if options.ros2 and options.imu:
        raise ValueError("--imu goes with --udp and --pty: the topics of --ros2 have no heading")
    truth = options.truth
    with nullcontext() if truth is None else truth.open("w", encoding="utf-8", buffering=1) as file:
        if options.ros2:
            from limslam_agent.live.emulator.ros2 import ros_robot

            with ros_robot(body) as robot:
                run(robot, pace, file)
        port = UdpPort(options.host, options.udp) if options.udp else PtyPort()
        say(port.name)
        run(RobotAtPort(Emulator(body), port), pace, file)


def main() -> None:
    """Entry point. An error that the user can correct gives exit code 2 and one line."""
    run_command(app, "emulator", resource="port")


if __name__ == "__main__":
    main()
