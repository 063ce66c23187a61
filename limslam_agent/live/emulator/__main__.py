"""``python -m limslam_agent.live.emulator``: a simulated robot behind a serial port, UDP or topics of ROS 2."""

import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

import typer

from limslam_agent.cli.terminal import run_command
from limslam_agent.live.protocol import BadLineError, Message, Speeds, Stop, Telemetry, decode

if TYPE_CHECKING:
    from limslam_agent.live.emulator.emulator import Emulator
    from limslam_agent.live.emulator.ports import Port

ANSWER_WITHIN = 2.0
"""Longest time for which an emulator without a fixed speed waits for the host's answer, s."""

_LONELY_POLL = 0.02  # s, between two steps of a robot that nobody has greeted

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)


@app.command()
def emulate(
    udp: Annotated[int | None, typer.Option(help="Send to this UDP port of the host.", show_default=False)] = None,
    host: Annotated[str, typer.Option(help="Address of the host.")] = "127.0.0.1",
    *,
    pty: Annotated[bool, typer.Option("--pty", help="Make a serial port, and print its name.")] = False,
    ros2: Annotated[bool, typer.Option("--ros2", help="Publish odom and a topic beam_N for each beam.")] = False,
    world: Annotated[str, typer.Option(help="Name of a shipped world, random:SEED, or a world file.")] = "env1",
    robot: Annotated[str, typer.Option(help="Robot that ships with LimSLAM, or a TOML file.")] = "paper",
    noise: Annotated[float, typer.Option(help="Standard deviation of the ranges, m.")] = 0.02,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 0,
    watchdog: Annotated[int, typer.Option(help="Time without a line after which the wheels stop, ms.")] = 500,
    speed: Annotated[float, typer.Option(help="How much faster than real time. 0: as fast as the host answers.")] = 1.0,
    truth: Annotated[
        Path | None, typer.Option(help="File for the true poses, lines of t x y heading.", show_default=False)
    ] = None,
) -> None:
    """Emulate a robot until the process is ended."""
    from limslam_agent.cli.settings import robot_named
    from limslam_agent.live.emulator.emulator import Body, Emulator
    from limslam_env.config import NoiseConfig
    from limslam_env.worlds.formats.loading import load_world

    if not 0.0 <= speed <= 1000.0:
        raise ValueError(f"--speed must be a number from 0 to 1000, not {speed:g}")
    errors = replace(NoiseConfig(), sensor_noise=noise)
    name = Path(robot).stem.replace("_", "-")
    body = Body(load_world(world), robot_named(robot), errors, name, watchdog, seed)
    pace = body.robot.control_period / speed if speed else 0.0
    if (udp is not None) + pty + ros2 != 1:
        raise ValueError("either --udp PORT, --pty or --ros2 is needed")
    with nullcontext() if truth is None else truth.open("w", encoding="utf-8", buffering=1) as file:
        if ros2:
            from limslam_agent.live.emulator.ros2 import RosRobot, serve

            serve(RosRobot(body), pace, file)
            return
        emulator, port = Emulator(body), _port(udp, host)
        sys.stdout.write(f"{port.name}\n")
        sys.stdout.flush()
        run(emulator, port, pace, file)


def run(emulator: "Emulator", port: "Port", pace: float, truth: IO[str] | None) -> None:
    """Emulate for ever. A control period takes ``pace`` s, or with 0 as long as the host needs to answer."""
    due, newest = time.monotonic(), -1
    while True:
        latest = newest
        for line in emulator.step():
            port.send(line)
            latest = max(latest, _number(line))
        if truth is not None:
            truth.write(emulator.truth)
        now = time.monotonic()
        if pace:
            due = max(due + pace, now - pace)  # no attempt to catch up
            _hear(emulator, port, due)
        elif latest > newest:
            _hear(emulator, port, now + ANSWER_WITHIN, latest)
        else:
            _hear(emulator, port, now + (0.0 if emulator.has_host else _LONELY_POLL))
        newest = latest


def _number(line: bytes) -> int:
    """The sequence number of telemetry. -1 for other lines, which the host does not answer."""
    message = _message(line)
    return message.seq if isinstance(message, Telemetry) else -1


def _message(line: bytes) -> Message | None:
    """The message of a line. None if the connection has damaged it."""
    try:
        return decode(line)
    except BadLineError:
        return None


def _hear(emulator: "Emulator", port: "Port", until: float, number: int | None = None) -> None:
    """Hear the host until a time, or until it answers the telemetry with a sequence number, or stops the robot."""
    is_done = False
    while not is_done:
        left = until - time.monotonic()
        lines = port.receive(max(left, 0.0))
        for line in lines:
            emulator.hear(line)
        is_done = left <= 0.0 or (number is not None and any(_is_answer(line, number) for line in lines))


def _is_answer(line: bytes, number: int) -> bool:
    message = _message(line)
    return isinstance(message, Stop) or (isinstance(message, Speeds) and message.answers >= number)


def _port(udp: int | None, host: str) -> "Port":
    from limslam_agent.live.emulator.ports import PtyPort, UdpPort

    return PtyPort() if udp is None else UdpPort(host, udp)


def main() -> None:
    """Entry point. An error that the user can correct gives exit code 2 and one line."""
    run_command(app, "emulator", resource="port")


if __name__ == "__main__":
    main()
