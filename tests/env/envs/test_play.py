"""Driving by keyboard: what the keys ask for, and the loop around them, in a window that nobody sees."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from limslam_env.envs import play as play_module
from limslam_env.envs.play import play, wheel_speeds

KEYS = ["up", "down", "left", "right", "w", "a", "s", "d", "r", "q", "x"]
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


@pytest.fixture
def drive_with(pygame, monkeypatch):
    """Drive with keys that are pressed, or let go (with a minus), one at each step."""
    real = play_module.LimSlamEnv.step

    def drive(*script: str):
        poses, left = [], list(script)

        def step_and_press(env, action):
            result = real(env, action)
            poses.append(result[4]["pose"])
            if left and (name := left.pop(0)):
                kind = pygame.KEYUP if name[0] == "-" else pygame.KEYDOWN
                pygame.event.post(pygame.event.Event(kind, key=pygame.key.key_code(name.lstrip("-"))))
            return result

        monkeypatch.setattr(play_module.LimSlamEnv, "step", step_and_press)
        return play("env1", max_steps=len(script) + 1), np.array(poses)

    return drive


def test_held_keys_drive_the_robot(drive_with):
    drive, poses = drive_with("up", "", "", "", "", "")
    assert drive.time == pytest.approx(0.7)
    assert 0.0 < drive.coverage < 0.5
    assert np.hypot(*(poses[-1] - poses[0])[:2]) > 0.08
    assert math.isclose(poses[-1, 2], poses[0, 2], abs_tol=1e-6)


def test_a_restart_begins_anew(drive_with):
    drive, _ = drive_with("up", "", "", "-up", "r", "-r", "")
    assert drive.time < 0.45


def test_quitting_and_closing_the_window_end_the_drive(drive_with, pygame):
    drive, _ = drive_with("", "q", *[""] * 20)
    assert drive.time == pytest.approx(0.2)
    assert not pygame.display.get_init()
