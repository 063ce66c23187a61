"""The window, with SDL's dummy driver: nothing is seen, all else happens."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled, Error

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


@pytest.fixture(autouse=True)
def _with_a_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
