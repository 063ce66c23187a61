"""The window and driving by keyboard, with SDL's dummy driver: nothing is seen, all else
happens.
"""

import math
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled, Error
from hypothesis import given
from hypothesis import strategies as st

from limslam_env.envs import play as play_module
from limslam_env.envs.play import play, wheel_speeds
from limslam_env.rendering.window import Window

pytest.importorskip("pygame")

PICTURE = np.zeros((60, 200, 3), dtype=np.uint8)
PICTURE[:, 100:] = (10, 120, 250)


@pytest.fixture
def window(pygame):
    del pygame
    opened = Window("test", 1000.0)
    yield opened
    opened.close()


def screen(pygame) -> np.ndarray:
    return pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)


def press(pygame, key, kind="KEYDOWN"):
    pygame.event.post(pygame.event.Event(getattr(pygame, kind), key=key))


def test_a_picture_is_shown_as_it_is(window, pygame):
    window.show(PICTURE)
    np.testing.assert_array_equal(screen(pygame), PICTURE)
    assert pygame.display.get_caption()[0] == "test"
    assert not window.closed


def test_the_window_follows_the_size_of_the_pictures(window, pygame):
    window.show(PICTURE)
    window.show(PICTURE[:30, :80])
    assert pygame.display.get_surface().get_size() == (80, 30)
    # A view that is not contiguous is a picture too.
    np.testing.assert_array_equal(screen(pygame), PICTURE[:30, :80])


def test_pictures_come_no_faster_than_asked(pygame):
    del pygame
    window = Window("slow", 50.0)
    window.show(PICTURE)
    start = time.perf_counter()
    for _ in range(5):
        window.show(PICTURE)
    # pygame's clock counts whole milliseconds.
    assert time.perf_counter() - start > 5 * 0.019
    window.close()


def test_keys_are_held_until_they_are_let_go(window, pygame):
    window.show(PICTURE)
    assert window.pressed_keys() == frozenset()
    press(pygame, pygame.K_LEFT)
    press(pygame, pygame.K_w)
    assert window.pressed_keys() == window.pressed_keys() == {"left", "w"}
    press(pygame, pygame.K_LEFT, "KEYUP")
    assert window.pressed_keys() == {"w"}


def test_a_key_tapped_between_two_looks_is_not_missed(window, pygame):
    window.show(PICTURE)
    press(pygame, pygame.K_SPACE)
    press(pygame, pygame.K_SPACE, "KEYUP")
    window.show(PICTURE)
    assert window.pressed_keys() == {"space"}
    assert window.pressed_keys() == frozenset()


@pytest.mark.parametrize(
    "look", [lambda window: window.show(PICTURE), lambda window: window.pressed_keys()]
)
def test_closing_by_the_user_is_noticed_and_lasts(window, pygame, look):
    window.show(PICTURE)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    look(window)
    assert window.closed
    window.show(PICTURE)
    assert window.closed
    assert pygame.display.get_surface() is None
    assert window.pressed_keys() == frozenset()


def test_a_window_that_lost_its_place_leaves_the_others_alone(window, pygame):
    window.show(PICTURE)
    second = Window("second", 1000.0)
    second.show(PICTURE[:30])
    window.close()
    second.show(PICTURE[:30])
    assert pygame.display.get_surface().get_size() == (200, 30)
    second.close()


def test_a_message_stands_in_the_lower_margin(window, pygame):
    picture = np.full((100, 120, 3), 200, dtype=np.uint8)
    window.message = "arrows: drive   Q: quit"
    window.show(picture)
    changed = (screen(pygame) != picture).any(axis=2)
    assert not changed[:-30].any()
    assert (screen(pygame)[-22:].max(axis=2) < 150).any()
    window.message = ""
    window.show(picture)
    np.testing.assert_array_equal(screen(pygame), picture)


def test_without_pygame_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r"limslam\[play\]"):
        Window("test", 10.0)


def test_without_a_display_it_shows_pictures_to_nobody():
    code = (
        "import numpy as np; from limslam_env.rendering.window import Window, has_display; assert "
        "not has_display();"
        "window = Window('test', 100.0); window.show(np.zeros((20, 30, 3), np.uint8)); "
        "window.close()"
    )
    bare = {
        name: value
        for name, value in os.environ.items()
        if "DISPLAY" not in name and "SDL" not in name
    }
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=bare,
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


def test_an_unknown_driver_opens_no_window(monkeypatch, pygame):
    del pygame
    monkeypatch.setenv("SDL_VIDEODRIVER", "nonsense")
    with pytest.raises(Error, match="no window"):
        Window("test", 10.0).show(PICTURE)


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
        poses = []
        left = list(script)

        def step_and_press(env, action):
            result = real(env, action)
            poses.append(result[4]["pose"])
            if left and (name := left.pop(0)):
                kind = pygame.KEYUP if name[0] == "-" else pygame.KEYDOWN
                pygame.event.post(
                    pygame.event.Event(kind, key=pygame.key.key_code(name.lstrip("-")))
                )
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
