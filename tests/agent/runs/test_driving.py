"""Driving by keyboard: wheel speeds of keys, and ``limslam play`` with SDL's dummy driver."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.command_line import refused, told

from limslam_agent.runs import driving
from limslam_agent.runs.driving import wheel_speeds
from limslam_env.rendering.window import Window

KEYS = ["up", "down", "left", "right", "w", "a", "s", "d", "r", "q", "x"]
ARROWS = {"w": "up", "s": "down", "a": "left", "d": "right"}


def keys(*names: str) -> frozenset[str]:
    return frozenset(names)


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
def drive(pygame, monkeypatch, tmp_path):
    """Drive with keys that are pressed, or let go (with a minus), at pictures by their numbers. The
    folder of the drive, and its pictures.
    """

    def drive(script):
        pictures = []

        class Scripted(Window):
            def __init__(self, title, fps):
                super().__init__(title, 100.0 * fps)

            def show(self, image):
                super().show(image)
                pictures.append(image)
                name = script.get(len(pictures))
                if name == "close":
                    pygame.event.post(pygame.event.Event(pygame.QUIT))
                elif name:
                    kind = pygame.KEYUP if name[0] == "-" else pygame.KEYDOWN
                    codes = {"up": pygame.K_UP, "left": pygame.K_LEFT, "q": pygame.K_q}
                    code = codes[name.lstrip("-")]
                    pygame.event.post(pygame.event.Event(kind, key=code))

        monkeypatch.setattr(driving, "Window", Scripted)
        said = told("play", "--world", "square", "--out", tmp_path / "drive")
        assert not pygame.display.get_init()
        return tmp_path / "drive", pictures, said

    return drive


def test_a_drive_shows_the_map_and_keeps_a_folder_for_show_and_inspect(drive):
    folder, pictures, said = drive({1: "up", 20: "-up", 21: "left", 30: "q"})
    assert "the driver has ended the drive" in said
    poses = np.loadtxt(folder / "trajectory_true.tum")
    assert len(poses) == len(pictures) == 31
    assert np.hypot(*(poses[20, 1:3] - poses[0, 1:3])) > 0.3
    # The truth is on the left, the belief on the right, and both go on.
    width = pictures[0].shape[1]
    changed = np.abs(pictures[-1].astype(int) - pictures[0]).sum(axis=2) > 0
    parts = changed[80:580]
    assert parts[:, : width // 3].any()
    assert parts[:, 2 * width // 5 : 3 * width // 4].any()
    told("show", folder)
    assert "31 frames" in told("inspect", folder)


def test_closing_the_window_ends_the_drive(drive):
    folder, pictures, _ = drive({3: "close"})
    assert len(pictures) == 4
    assert (folder / "map.png").is_file()


def test_a_driver_is_for_one_robot_and_has_no_belief():
    assert "for one robot" in refused("run", "--policy", "keyboard", "--robots", 2)
    assert "does not act on a belief" in refused("live", "--udp", 9, "--policy", "keyboard")
