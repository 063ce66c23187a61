"""``python -m limslam_agent.live.emulator``: a simulated robot behind a serial port, UDP or topics
of ROS 2.
"""

import os
import select
import socket
import sys
import time
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

import typer

from limslam_agent.command_options import takes, with_told
from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.help import Help
from limslam_agent.live.transports import LineBuffer, datagrams
from limslam_agent.terminal import run_command

if TYPE_CHECKING:
    from limslam_agent.live.emulator.emulator import Emulator


_MOST_BYTES = 65536
_LAST_PORT = 65535

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)


@dataclass(frozen=True)
class Options(Bounded):
    """The options of the emulator."""

    udp: Annotated[int | None, Help(None, "Send to this UDP port of the host.")] = None
    host: Annotated[str, Help(None, "Address of the host.")] = "127.0.0.1"
    pty: Annotated[bool, Help(None, "Make a serial port, and print its name.")] = False
    ros2: Annotated[bool, Help(None, "Publish odom and a topic beam_N for each beam.")] = False
    world: Annotated[str, Help(None, "Name of a shipped world, random:SEED, or a world file.")] = (
        "env1"
    )
    robot: Annotated[str, Help(None, "Robot that ships with LimSLAM, or a TOML file.")] = "paper"
    noise: Annotated[float, Help(None, "Standard deviation of the ranges, m.")] = 0.02
    seed: Annotated[int, Help(None, "Random seed.")] = 0
    watchdog: Annotated[int, Help(None, "Time without a line after which the wheels stop, ms.")] = (
        500
    )
    speed: Annotated[
        float,
        Bounds(0.0, 1000.0),
        Help(None, "How much faster than real time. 0: as fast as the host answers."),
    ] = 1.0
    imu: Annotated[bool, Help(None, "Measure the heading, too.")] = False
    token: Annotated[
        str | None, Help(None, "Say this word in each hello, for a host with --token.")
    ] = None
    truth: Annotated[
        Path | None, Help(None, "File for the true poses, lines of t x y heading.")
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.udp is not None and not 1 <= self.udp <= _LAST_PORT:
            raise ValueError(f"udp must be a port from 1 to {_LAST_PORT}, not {self.udp}")


@app.command()
@takes(Options)
def emulate(**told: Any) -> None:
    """Emulate a robot until the process is ended."""
    from limslam_agent.live.emulator.emulator import Body, Emulator
    from limslam_agent.robot_file import robot_named
    from limslam_env.config import NoiseConfig
    from limslam_env.worlds.formats.loading import load_world

    options = with_told(Options(), told)
    body = Body(
        load_world(options.world),
        robot_named(options.robot),
        replace(NoiseConfig(), sensor_noise=options.noise),
        Path(options.robot).stem.replace("_", "-"),
        options.watchdog,
        options.seed,
        options.imu,
        options.token,
    )
    pace = body.robot.control_period / options.speed if options.speed else 0.0
    if (options.udp is not None) + options.pty + options.ros2 != 1:
        raise ValueError("either --udp PORT, --pty or --ros2 is needed")
    if options.ros2 and options.imu:
        raise ValueError("--imu goes with --udp and --pty: the topics of --ros2 have no heading")
    truth = options.truth
    with nullcontext() if truth is None else truth.open("w", encoding="utf-8", buffering=1) as file:
        if options.ros2:
            from limslam_agent.live.emulator.ros2 import RosRobot, serve

            serve(RosRobot(body), pace, file)
            return
        emulator = Emulator(body)
        port = PtyPort() if options.udp is None else UdpPort(options.host, options.udp)
        sys.stdout.write(f"{port.name}\n")
        sys.stdout.flush()
        run(emulator, port, pace, file)


class UdpPort:
    """A UDP socket that sends to a host's port."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)  # noqa: FBT003 (the name says it)
        self._host = (host, port)
        self.name = f"UDP {host}:{port}"

    def receive(self, timeout: float) -> list[bytes]:
        """The lines of all datagrams that have arrived."""
        return [
            line for data, _ in datagrams(self._socket, timeout) for line in LineBuffer().add(data)
        ]

    def send(self, line: bytes) -> None:
        """Send a line to the host."""
        with suppress(OSError):
            self._socket.sendto(line, self._host)


class PtyPort:
    """A serial port of the operating system, which a program opens by its name like any other. Not
    on Windows. Raises a ValueError if the operating system has no such ports.
    """

    def __init__(self) -> None:
        try:
            import pty
            import tty
        except ImportError:
            raise ValueError("this operating system has no pty: use --udp") from None
        self._robot_end, self._host_end = pty.openpty()
        tty.setraw(self._host_end)  # nothing is echoed, and no byte is changed
        os.set_blocking(self._robot_end, False)
        self.name = os.ttyname(self._host_end)
        self._lines = LineBuffer()

    def receive(self, timeout: float) -> list[bytes]:
        """The lines that have arrived."""
        select.select([self._robot_end], [], [], timeout)
        try:
            return self._lines.add(os.read(self._robot_end, _MOST_BYTES))
        except BlockingIOError:
            return []

    def send(self, line: bytes) -> None:
        """Send a line. It is lost if nobody reads and the buffer is full."""
        with suppress(BlockingIOError):
            os.write(self._robot_end, line)


def run(emulator: "Emulator", port: UdpPort | PtyPort, pace: float, truth: IO[str] | None) -> None:
    """Emulate for ever. A control period takes ``pace`` s, or with 0 as long as the host needs to
    answer.
    """
    from limslam_agent.live.emulator.emulator import ANSWER_WITHIN, LONELY_POLL

    due = time.monotonic()
    while True:
        lines = emulator.step()
        for line in lines:
            port.send(line)
        if truth is not None:
            truth.write(emulator.truth)
        now = time.monotonic()
        if pace:
            due = max(due + pace, now - pace)  # no attempt to catch up
        else:
            due = now + (ANSWER_WITHIN if emulator.firmware.awaits_answer else LONELY_POLL)
        left = due - now
        while True:
            for line in port.receive(max(left, 0.0)):
                emulator.hear(line)
            left = due - time.monotonic()
            if left <= 0.0 or not (pace or emulator.firmware.awaits_answer):
                break


def main() -> None:
    """Entry point. An error that the user can correct gives exit code 2 and one line."""
    run_command(app, "emulator", resource="port")


if __name__ == "__main__":
    main()
