"""Driving the robot by keyboard in a window, in real time."""

from typing import NamedTuple

from gymnasium.error import Error

from limslam_env.envs.env import LimSlamEnv
from limslam_env.rendering.window import has_display
from limslam_env.worlds.formats.loading import WorldSource

CONTROLS = "arrows or WASD: drive    R: restart    Q: quit"
"""Help text of the window: the meaning of the keys."""

_AHEAD = {"up", "w"}
_BACK = {"down", "s"}
_LEFT = {"left", "a"}
_RIGHT = {"right", "d"}
_QUIT = {"q", "escape"}

# Wheel speeds, fractions of the maximum.
_TURN = 0.30
_CRUISE = 0.70
_BACKWARDS = 0.50


class Drive(NamedTuple):
    """The result of a drive: simulated time since the last restart, s, and the coverage since then,
    0 to 1.
    """

    time: float
    coverage: float


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


def play(world: WorldSource, *, max_steps: int | None = None) -> Drive:
    """Open a window in which the user drives a robot by keyboard, until it is closed or
    ``max_steps`` are driven.

    Raises
    ------
    ValueError
        If the world cannot be used.
    gymnasium.error.Error
        If pygame is missing, or there is no display.
    """
    env = LimSlamEnv(world, render_mode="human", coverage_goal=None)
    try:
        if not has_display():
            raise Error("there is no display to open a window on")
        return _drive(env, max_steps)
    finally:
        env.close()


def _drive(env: LimSlamEnv, max_steps: int | None) -> Drive:
    # Each reset and step is shown in the window, which then waits for a control period. So the
    # drive keeps real time.
    info = env.reset(seed=0)[1]
    driven = 0
    window = env.window
    if window is None:
        raise RuntimeError("the human render mode opened no window")
    window.message = CONTROLS
    while not window.closed and driven != max_steps:
        keys = window.pressed_keys()
        if window.closed or keys & _QUIT:
            break
        info = env.reset(seed=0)[1] if "r" in keys else env.step(wheel_speeds(keys))[4]
        driven = driven + 1
    return Drive(info["time"], info["coverage"])
