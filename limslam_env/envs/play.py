"""Driving the robot by keyboard in a window, in real time."""

from dataclasses import dataclass

from gymnasium.error import Error

from limslam_env.envs.env import LimSlamEnv
from limslam_env.interface import RobotSpec
from limslam_env.rendering.window import has_display
from limslam_env.worlds.formats.loading import WorldSource

CONTROLS = "arrows or WASD: drive    space: stop    R: restart    P: pause    H: this line    Q: quit"
"""Help text of the window: the meaning of the keys."""

_AHEAD, _BACK = {"up", "w"}, {"down", "s"}
_LEFT, _RIGHT = {"left", "a"}, {"right", "d"}
_QUIT = {"q", "escape"}

_TURN_ON_THE_SPOT = 0.30
_TURN_ON_THE_WAY = 0.30
_CRUISE = 0.70
_BACKWARDS = 0.50
_EASE = 0.25


@dataclass(frozen=True)
class Drive:
    """The result of a drive.

    Attributes
    ----------
    time
        Simulated time since the last restart, s.
    coverage
        Share of what can be seen that was seen since then, 0 to 1.
    """

    time: float
    coverage: float


def wheel_speeds(keys: frozenset[str]) -> tuple[float, float]:
    """Left and right wheel speed, fractions of the maximum, for the keys that are held.

    Ahead and back, left and right cancel each other. Space stops, whatever else is held. While driving, a turn is
    a wide curve, and going backwards, left and right stay left and right of the driver, as in a car.
    """
    if "space" in keys:
        return 0.0, 0.0
    ahead = bool(keys & _AHEAD) - bool(keys & _BACK)
    turn = bool(keys & _LEFT) - bool(keys & _RIGHT)
    if ahead == 0:
        return -_TURN_ON_THE_SPOT * turn, _TURN_ON_THE_SPOT * turn
    speed = 1.0 if ahead > 0 else -_BACKWARDS
    if turn == 0:
        return speed, speed
    speed, curve = _CRUISE * speed, _TURN_ON_THE_WAY * turn * ahead
    return speed - curve, speed + curve


def eased(speeds: tuple[float, float], wanted: tuple[float, float], most: float = _EASE) -> tuple[float, float]:
    """Speeds moved towards the target speeds, each by at most ``most``."""
    left, right = (now + min(max(goal - now, -most), most) for now, goal in zip(speeds, wanted, strict=True))
    return left, right


def play(
    world: WorldSource,
    *,
    robot: RobotSpec | None = None,
    sensor_noise: float = 0.0,
    seed: int = 0,
    max_steps: int | None = None,
) -> Drive:
    """Open a window in which the user drives a robot by keyboard, until the window is closed.

    Parameters
    ----------
    world
        Name of a shipped world, path of a world file, or a world.
    robot
        Body, wheels and beams; the default robot if left out.
    sensor_noise
        Standard deviation of the ranges, m.
    seed
        Of all noise. A restart repeats it.
    max_steps
        Steps (control periods) after which the drive ends; None for no end.

    Raises
    ------
    ValueError
        If an argument or the world cannot be used.
    gymnasium.error.DependencyNotInstalled
        If pygame is missing.
    gymnasium.error.Error
        If there is no display, or the seed cannot be used.
    """
    env = LimSlamEnv(world, robot=robot, sensor_noise=sensor_noise, render_mode="human", coverage_goal=None)
    try:
        if not has_display():
            raise Error("there is no display to open a window on")
        return _drive(env, seed, max_steps)
    finally:
        env.close()


@dataclass(frozen=True)
class _Mode:
    """The switches that keys toggle."""

    paused: bool = False
    helps: bool = True

    @property
    def message(self) -> str:
        if self.paused:
            return "paused    P: drive on    Q: quit"
        return CONTROLS if self.helps else ""

    def after(self, pressed: frozenset[str]) -> "_Mode":
        return _Mode(self.paused ^ ("p" in pressed), self.helps ^ ("h" in pressed))


def _drive(env: LimSlamEnv, seed: int, max_steps: int | None) -> Drive:
    # Each reset and step is shown in the window, which then waits for a control period. So the drive keeps real time.
    info = env.reset(seed=seed)[1]
    window = env.window
    if window is None:
        raise RuntimeError("the human render mode opened no window")
    mode, speeds, before, driven = _Mode(), (0.0, 0.0), frozenset[str](), 0
    while not window.closed and driven != max_steps:
        keys = window.pressed_keys()
        pressed, before = keys - before, keys
        if window.closed or pressed & _QUIT:
            break
        mode = mode.after(pressed)
        window.message = mode.message
        if "r" in pressed:
            info, speeds = env.reset(seed=seed)[1], (0.0, 0.0)
        elif mode.paused:
            env.render()
        else:
            speeds = (0.0, 0.0) if "space" in keys else eased(speeds, wheel_speeds(keys))
            info, driven = env.step(speeds)[4], driven + 1
    return Drive(info["time"], info["coverage"])
