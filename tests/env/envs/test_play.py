"""Driving by keyboard: what the keys ask for, and the loop around them."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from limslam_env.envs import play as play_module
from limslam_env.envs.play import CONTROLS, Drive, eased, play, wheel_speeds

KEYS = ["up", "down", "left", "right", "w", "a", "s", "d", "space", "r", "p", "h", "q", "x"]
ARROWS = {"w": "up", "s": "down", "a": "left", "d": "right"}


def keys(*names: str) -> frozenset[str]:
    return frozenset(names)


@pytest.fixture(autouse=True)
def _with_a_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def test_ahead_is_full_speed_and_back_is_slower():
    assert wheel_speeds(keys("up")) == (1.0, 1.0)
    left, right = wheel_speeds(keys("down"))
    assert left == right
    assert -1.0 < left < 0.0


def test_left_turns_left_on_the_spot_and_right_is_its_mirror():
    left, right = wheel_speeds(keys("left"))
    assert left == -right < 0.0
    assert wheel_speeds(keys("right")) == (right, left)


def test_backwards_left_stays_left_as_in_a_car():
    left, right = wheel_speeds(keys("down", "left"))
    assert right < left <= 0.0
    assert wheel_speeds(keys("down", "right")) == (right, left)


@given(st.frozensets(st.sampled_from(KEYS)))
def test_speeds_are_within_bounds_and_letters_are_arrows(held):
    speeds = wheel_speeds(held)
    assert all(-1.0 <= speed <= 1.0 for speed in speeds)
    assert wheel_speeds(frozenset(ARROWS.get(key, key) for key in held)) == speeds


speed = st.floats(-1.0, 1.0)


@given(st.tuples(speed, speed), st.tuples(speed, speed))
def test_speeds_change_gently_and_arrive(now, wanted):
    after = eased(now, wanted, 0.25)
    for before, goal, value in zip(now, wanted, after, strict=True):
        assert abs(value - before) <= 0.25 + 1e-12
        assert abs(value - goal) <= max(abs(before - goal) - 0.25, 0.0) + 1e-12
    for _ in range(8):
        after = eased(after, wanted, 0.25)
    assert after == pytest.approx(wanted, abs=1e-12)


class FakeWindow:
    """A window whose keys are written down beforehand; then its user closes it."""

    def __init__(self, script):
        self.script, self.messages, self.message, self.closed = list(script), [], "", False

    def pressed_keys(self):
        if not self.script:
            self.closed = True
            return frozenset()
        return frozenset(self.script.pop(0))


class FakeEnv:
    """Writes down what is asked of it; like the real one it shows every reset and every step."""

    def __init__(self, script):
        self.window, self.calls, self.actions, self.steps = FakeWindow(script), [], [], 0

    def __call__(self, world, **arguments):
        self.arguments = {"world": world, **arguments}
        return self

    def reset(self, *, seed):
        self.calls.append(f"reset {seed}")
        self.show()
        self.steps = 0
        return {}, self.info()

    def step(self, action):
        self.calls.append("step")
        self.show()
        self.actions.append(action)
        self.steps += 1
        return {}, 0.0, False, False, self.info()

    def info(self):
        return {"time": 0.1 * self.steps, "coverage": 0.01 * self.steps}

    def render(self):
        self.calls.append("render")
        self.show()

    def show(self):
        self.window.messages.append(self.window.message)

    def close(self):
        self.calls.append("close")


@pytest.fixture
def drive_with(monkeypatch):
    def drive(script, **arguments):
        env = FakeEnv(script)
        monkeypatch.setattr(play_module, "LimSlamEnv", env)
        return env, play("env1", **arguments)

    return drive


def test_it_resets_steps_and_closes_the_environment(drive_with):
    env, drive = drive_with([()] * 3, sensor_noise=0.02, seed=4)
    assert env.calls == ["reset 4", "step", "step", "step", "close"]
    assert drive == Drive(pytest.approx(0.3), pytest.approx(0.03))
    assert env.arguments == {
        "world": "env1", "robot": None, "sensor_noise": 0.02, "render_mode": "human", "coverage_goal": None,
    }  # fmt: skip


def test_the_robot_gathers_speed_and_stops_at_once(drive_with):
    env, _ = drive_with([("up",)] * 5 + [("up", "space")])
    speeds = [action[0] for action in env.actions]
    assert speeds == [*sorted(speeds[:5]), 0.0]
    assert speeds[0] < 0.5
    assert speeds[4] == 1.0


@pytest.mark.parametrize("key", ["q", "escape"])
def test_quitting_ends_the_drive(drive_with, key):
    env, _ = drive_with([(), (key,), ()])
    assert env.calls.count("step") == 1
    assert env.calls[-1] == "close"


def test_pausing_stops_time_but_not_the_pictures(drive_with):
    env, drive = drive_with([("up",), ("p",), ("p",), (), ("up",), ("p",), ("up",)])
    # Held for two looks, the key counts once.
    assert env.calls.count("step") == 3
    assert env.calls.count("render") == 4
    assert len(env.window.messages) == 8
    assert drive.time == pytest.approx(0.3)
    assert [message.startswith("paused") for message in env.window.messages[1:]] == [False] + [True] * 4 + [False] * 2


def test_a_restart_begins_anew_with_the_same_seed_at_rest(drive_with):
    env, drive = drive_with([("up",)] * 5 + [("r",), ("up",)], seed=7)
    assert [call for call in env.calls if call.startswith("reset")] == ["reset 7"] * 2
    assert env.actions[-1] == env.actions[0]
    assert drive.time == pytest.approx(0.1)


def test_the_controls_are_shown_until_they_are_hidden(drive_with):
    env, _ = drive_with([(), ("h",), ("h",), (), ("h",)])
    assert env.window.messages[1:] == [CONTROLS, "", "", "", CONTROLS]
    for key in ("arrows", "WASD", "R", "P", "space", "Q", "H"):
        assert key in CONTROLS


def test_importing_it_loads_no_pygame():
    code = "import sys, limslam_env.envs.play; print('pygame' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout == "False\n"


# With the real environment and a window that nobody sees.


def test_a_drive_in_a_real_window_is_in_real_time_and_sees_something(pygame, monkeypatch):
    times = []
    real = play_module.LimSlamEnv.step

    def timed_step(env, action):
        times.append(pygame.time.get_ticks())
        return real(env, action)

    monkeypatch.setattr(play_module.LimSlamEnv, "step", timed_step)
    drive = play("env1", max_steps=6)
    assert drive.time == pytest.approx(0.6)
    assert 0.0 < drive.coverage < 0.5
    # The control period is 100 ms; a busy machine may take longer.
    assert np.median(np.diff(times)) >= 95
    assert not pygame.display.get_init()


def test_closing_the_real_window_ends_the_drive(pygame, monkeypatch):
    real = play_module.LimSlamEnv.step

    def step_and_close(env, action):
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        return real(env, action)

    monkeypatch.setattr(play_module.LimSlamEnv, "step", step_and_close)
    drive = play("env1", max_steps=50)
    assert drive.time < 0.5


def test_held_keys_drive_the_real_robot(pygame, monkeypatch):
    poses = []
    real = play_module.LimSlamEnv.step

    def step_and_press(env, action):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_UP))
        result = real(env, action)
        poses.append(result[4]["pose"])
        return result

    monkeypatch.setattr(play_module.LimSlamEnv, "step", step_and_press)
    play("env1", max_steps=8)
    way = np.array(poses)
    assert np.hypot(*(way[-1] - way[0])[:2]) > 0.08
    assert math.isclose(way[-1, 2], way[0, 2], abs_tol=1e-6)
