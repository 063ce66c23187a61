"""Driving by keyboard in a window, which shows the truth beside what the robot believes."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from gymnasium.error import Error

from limslam_agent.belief import Belief
from limslam_agent.inspect.recorder import Recorder
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.policies.policy import NO_PLAN
from limslam_agent.runs.recording import FilmedRun
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.video.film import Film
from limslam_env.canvas import Image
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry import FloatArray
from limslam_env.rendering.window import Window, has_display
from limslam_env.worlds.formats.loading import load_world

CONTROLS = "arrows or WASD: drive    Q: quit"
"""The meaning of the keys."""


_AHEAD = {"up", "w"}
_BACK = {"down", "s"}
_LEFT = {"left", "a"}
_RIGHT = {"right", "d"}
_QUIT = {"q", "escape"}

# Wheel speeds, fractions of the maximum.
_TURN = 0.30
_CRUISE = 0.70
_BACKWARDS = 0.50


def wheel_speeds(keys: frozenset[str]) -> tuple[float, float]:
    """Left and right wheel speed, fractions of the maximum, for the keys that are held.

    Ahead and back, left and right cancel each other. While driving, a turn is a wide curve, and
    going backwards, left and right stay left and right of the driver, as in a car.
    """
    ahead = bool(keys & _AHEAD) - bool(keys & _BACK)
    turn = bool(keys & _LEFT) - bool(keys & _RIGHT)
    if ahead == 0:
        return -_TURN * turn, _TURN * turn
    speed = 1.0 if ahead > 0 else -_BACKWARDS
    if turn == 0:
        return speed, speed
    curve = _TURN * turn * ahead
    return _CRUISE * speed - curve, _CRUISE * speed + curve


class Driver:
    """A policy that does what the keys say, and the window that has the keys."""

    def __init__(self, config: RunConfig) -> None:
        world = load_world(config.world)
        corners = world.edges.reshape(-1, 2)
        self.window = Window(f"LimSLAM: {world.name}", 1.0 / config.robot.control_period)
        self.stop_reason: str | None = None
        self.plan: FloatArray = NO_PLAN
        title = f"{world.name}    {CONTROLS}"
        film = Film(self, corners.min(axis=0), corners.max(axis=0), title, speed=1.0)
        self._view = FilmedRun(film)
        self._picture: Image | None = None

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) for the keys that are held."""
        del belief
        keys = self.window.pressed_keys()
        if self.window.closed or keys & _QUIT:
            self.stop_reason = "the driver has ended the drive"
            return np.zeros(2)
        return np.array(wheel_speeds(keys))

    def write(self, image: Image, hold: float = 0.0) -> None:
        """Take a picture of the film. Nothing is paused in a drive."""
        del hold
        self._picture = image

    def watch(
        self,
        recorder: Recorder,
        team: LimSlamTeam,
        env: LimSlamParallelEnv,
        time: float,
        coverage: float,
    ) -> None:
        """Show a step that was recorded, when a control period is over."""
        self._view.watch(recorder, team, env, time, coverage)
        if self._picture is not None:
            self.window.show(self._picture)


@contextmanager
def driving(config: RunConfig) -> Iterator[Driver]:
    """The driver of a run. The window closes with the context; a ValueError where none can be
    opened.
    """
    if not has_display():
        raise ValueError("there is no display to open a window on")
    try:
        driver = Driver(config)
        try:
            yield driver
        finally:
            driver.window.close()
    except Error as error:
        raise ValueError(str(error)) from error
