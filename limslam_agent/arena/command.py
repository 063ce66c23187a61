"""A command as an actor: it speaks the line protocol of live robots over its standard input and
output.

The robot's side is the firmware of the emulated robots. Simulated time waits for the answer to each
telemetry line. So a command that always gives the same answers to the same lines drives the same
run, however slow the computer is.
"""

import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np

from limslam_agent.live.firmware import NM_PER_TICK, Firmware, ranges_in_mm, ticks
from limslam_agent.live.protocol import (
    LONGEST_LINE,
    OLDEST,
    BadLineError,
    Hello,
    Speeds,
    Stop,
    Telemetry,
    decode,
)
from limslam_agent.policies.policy import NOT_EXPLORED
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec

GREETING_WITHIN = 30.0
ANSWER_WITHIN = 5.0
"""Longest wall-clock times to wait for the greeting of a new process and for an answer, s."""

MOST_WAITING = 10_000
"""Largest number of lines of a process that wait to be read."""

_WATCHDOG_MS = 500
_LAST_BYTES = 4096  # of a file of errors
_ENDING = 2.0  # s, until a process that was told to end is killed


class CommandActor:
    """Drives one robot by a process of its own, which begins with each episode in a folder.

    Of the words of the command, ``{python}`` stands for this Python. The actor is done when the
    process has stopped the robot (``X``), which says that everything is explored. It is also done
    when the process has ended by itself with the exit code 0, which does not say so. ``user`` is
    the name of the user whose rights the process has, and None is the present user.
    """

    def __init__(
        self, words: Sequence[str], folder: Path, robot: RobotSpec, user: str | None = None
    ) -> None:
        self._words = [sys.executable if word == "{python}" else word for word in words]
        self._folder = folder
        self._robot = robot
        self._user = user
        self._link: _Process | None = None
        self._begin()

    def reset(self, start_pose: FloatArray, seed: int) -> None:
        """Start the process. Like the host of a real robot, it takes its first pose as it likes."""
        del start_pose, seed
        self.close()
        self._begin()
        self._link = _Process(self._words, self._folder, self._user)

    def _begin(self) -> None:
        period = round(1e3 * self._robot.control_period)
        hello = Hello(OLDEST, 1, "arena", len(self._robot.beams), NM_PER_TICK, period, _WATCHDOG_MS)
        self._firmware = Firmware(hello)
        self._step = 0
        self._travel = np.zeros(2)
        self.done = False
        self.stop_reason: str | None = None

    def act(self, observation: Observation) -> FloatArray:
        """Wheel speeds (2,) that the process answers.

        Raises
        ------
        ValueError
            If the process has failed, has ended without a greeting, or does not answer in time.
        """
        if self._link is None:
            raise ValueError("the command was not started")
        self._travel += np.asarray(observation["wheels"], dtype=float)
        seen = ranges_in_mm(np.asarray(observation["ranges"]), self._robot)
        now = self._step * self._firmware.hello.period_ms
        if not self._firmware.has_host:
            self._greet(self._link, now)
        lines = self._firmware.say(now, ticks(self._travel), seen)
        try:
            self._link.send(lines)
            self._hear_answer(self._link, now, lines)
        except _EndedError as error:
            if error.exit_code != 0:
                raise
            self.done = True
            self.stop_reason = f"the command has ended by itself: {NOT_EXPLORED}"
            self.close()
            return np.zeros(2)
        self._step += 1
        if self.done:
            self.close()
        speeds = np.array(self._firmware.speeds(now), dtype=float)
        return np.clip(1e-3 * speeds / self._robot.max_wheel_speed, -1.0, 1.0)

    def close(self) -> None:
        """End the process, if there is one."""
        if self._link is not None:
            self._link.end()
            self._link = None

    def _greet(self, link: "_Process", now: int) -> None:
        link.send(self._firmware.say(now, ticks(self._travel), ()))
        give_up = time.monotonic() + GREETING_WITHIN
        while not self._firmware.has_host:
            self._firmware.hear(link.line(give_up, "greet the robot", GREETING_WITHIN), now)

    def _hear_answer(self, link: "_Process", now: int, lines: Sequence[bytes]) -> None:
        numbers = [message.seq for message in map(decode, lines) if isinstance(message, Telemetry)]
        give_up = time.monotonic() + ANSWER_WITHIN
        while True:
            line = link.line(give_up, "answer", ANSWER_WITHIN)
            self._firmware.hear(line, now)
            try:
                message = decode(line)
            except BadLineError:  # a command may print its own words
                continue
            if isinstance(message, Stop):
                self.done = True
                self.stop_reason = "the command has stopped the robot"
                return
            if isinstance(message, Speeds) and message.answers == numbers[-1]:
                return


class _EndedError(ValueError):
    """A process has ended too early, with an exit code."""

    def __init__(self, message: str, exit_code: int | None) -> None:
        super().__init__(message)
        self.exit_code = exit_code


class _Process:
    """A process whose output is read line by line, with a time limit. It is the first of a session
    of its own, so that what it starts ends with it.
    """

    def __init__(self, words: Sequence[str], folder: Path, user: str | None) -> None:
        self._errors = TemporaryFile()  # noqa: SIM115 (it lives as long as the process)
        try:
            # The words are those of the entry's manifest. No shell reads them.
            self._process = subprocess.Popen(  # noqa: S603
                list(words),
                cwd=folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                start_new_session=True,
                **rights_of(user),
            )
        except OSError as error:
            self._errors.close()
            raise ValueError(f"{words[0]}: cannot be started: {error.strerror or error}") from error
        assert self._process.stdin is not None  # noqa: S101 (it is a pipe)
        assert self._process.stdout is not None  # noqa: S101 (it is a pipe)
        self._input = self._process.stdin
        # A process that writes without end has to wait, and does not answer in time.
        self._lines: queue.Queue[bytes] = queue.Queue(MOST_WAITING)
        threading.Thread(
            target=_read_lines, args=(self._process.stdout, self._lines), daemon=True
        ).start()

    def send(self, lines: Sequence[bytes]) -> None:
        """Write lines. A process that does not read them is killed, because writing waits for it
        without a limit.
        """
        is_late = threading.Event()

        def kill() -> None:
            is_late.set()
            self._kill()

        timer = threading.Timer(ANSWER_WITHIN, kill)
        timer.start()
        try:
            self._input.write(b"".join(lines))
            self._input.flush()
        except OSError as error:
            if is_late.is_set():
                raise ValueError(
                    f"the command did not read its input within {ANSWER_WITHIN:g} s"
                ) from None
            raise self._has_ended() from error
        finally:
            timer.cancel()

    def line(self, give_up: float, task: str, limit: float) -> bytes:
        """The next line of the process.

        Raises
        ------
        ValueError
            If there is none in time, or the process has ended.
        """
        late = ValueError(f"the command did not {task} within {limit:g} s")
        left = give_up - time.monotonic()
        if left < 0.0:  # also where lines wait: a process that writes without end does not answer
            raise late
        try:
            line = self._lines.get(timeout=left)
        except queue.Empty:
            raise late from None
        if not line:
            raise self._has_ended()
        return line

    def _has_ended(self) -> _EndedError:
        """The reason of a process that has ended too early, with the last line of its errors."""
        with suppress(subprocess.TimeoutExpired):  # it has only closed its output
            self._process.wait(_ENDING)
        last = last_line(self._errors)
        return _EndedError(
            f"the command has ended without stopping the robot{': ' if last else ''}{last}",
            self._process.returncode,
        )

    def end(self) -> None:
        """Close the input of the process, which ends it. A process that goes on is killed, and so
        is all that it has started.
        """
        with suppress(OSError):  # what was written cannot be read any more
            self._input.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_ENDING)
        self._kill()
        self._process.wait()
        self._errors.close()

    def _kill(self) -> None:
        if sys.platform == "win32":
            self._process.kill()
            return
        with suppress(OSError):  # all have ended
            os.killpg(self._process.pid, signal.SIGKILL)


def rights_of(user: str | None) -> dict[str, Any]:
    """The arguments of a new process that has the rights of a user.

    Raises
    ------
    ValueError
        If there is no such user, or this process may not start processes of other users.
    """
    if user is None:
        return {}
    if sys.platform == "win32" or os.geteuid() != 0:
        raise ValueError("only root can run a command as another user")
    import pwd

    try:
        return {"user": user, "group": pwd.getpwnam(user).pw_gid, "extra_groups": []}
    except KeyError as error:
        raise ValueError(f"there is no user {user!r}") from error


def _read_lines(output: IO[bytes], lines: "queue.Queue[bytes]") -> None:
    """Put lines into a queue as they come. An empty line is the end of the output."""
    with output:
        while line := output.readline(LONGEST_LINE):
            lines.put(line)
    lines.put(b"")


def last_line(errors: IO[bytes]) -> str:
    """The last line that a process has written to a file of errors. Of a long file only the end is
    read.
    """
    errors.seek(max(errors.seek(0, os.SEEK_END) - _LAST_BYTES, 0))
    return errors.read(_LAST_BYTES).decode(errors="replace").strip().rpartition("\n")[2]


def without_folders(text: str, folders: Iterable[Path]) -> str:
    """A message without the folders of its paths, so that the same failure has the same message in
    every run.
    """
    names = {str(each) for folder in folders for each in (folder, folder.resolve())}
    for name in sorted(names, key=len, reverse=True):
        text = re.sub(rf"{re.escape(name)}(?![\w-])", ".", text.replace(name + os.sep, ""))
    return text.replace(sys.executable, "{python}")
