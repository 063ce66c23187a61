"""The video of a run: what its pictures show, what is said, and that its file is whole or not
there.
"""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image as Pictures

from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.video import video
from limslam_agent.video.belief_frame import BeliefFrame, Event, hough_image, wall_bands
from limslam_agent.video.film import FPS, HEIGHT, WIDTH, Film
from limslam_agent.video.narration import SPEED
from limslam_agent.video.video import VideoError, video_file
from limslam_env.geometry import line as lines


def on_line(r, theta, positions, *, spread=0.0):
    points = lines.at(np.array([r, theta]), np.asarray(positions, dtype=float))
    return points + spread * lines.normal(np.array([r, theta]))


def frame_with(*, time=0.0, walls=(), poses=((0.0, 0.0, 0.0),), std=0.02, **more):
    """A belief with walls given as (r, theta, from, to) along the line."""
    landmarks = [
        Landmark(r, theta, np.diag([std**2, std**2]), on_line(r, theta, extent), 3, number)
        for number, (r, theta, *extent) in enumerate(walls)
    ]
    poses = np.array(poses)
    return BeliefFrame(time, poses, np.array([0.01**2 * np.eye(3)] * len(poses)), landmarks, **more)


# What is drawn: votes, bands.


@pytest.mark.parametrize("theta", np.radians([1.0, 133.0]))
def test_votes_peak_at_the_line_that_the_points_lie_on(theta):
    points = on_line(0.40, theta, np.linspace(-0.5, 0.5, 20))
    votes, reach = hough_image(points, r_step=0.05, theta_bins=90)
    row, column = np.unravel_index(votes.argmax(), votes.shape)
    assert votes.max() == 20
    found = np.array([(row + 0.5) / len(votes) * 2 * reach - reach, (column + 0.5) * math.pi / 90])
    assert np.abs(lines.distance(found, points)).max() < 0.06
    # A point votes once for each direction.
    np.testing.assert_array_equal(votes.sum(axis=0), 20)


def test_a_band_is_as_wide_as_the_line_may_be_off():
    line = np.array([1.0, 0.4])
    covariance = np.array([[4e-4, 3e-4], [3e-4, 9e-4]])
    (wall,) = frame_with(walls=[(*line, -1.0, 2.0)]).walls
    (band,) = wall_bands([replace(wall, covariance=covariance)], sigmas=2.0, samples=7)
    upper = band[:7]
    lower = band[7:][::-1]
    random = np.random.default_rng(0)
    moved = line + random.multivariate_normal(np.zeros(2), covariance, size=4000)
    for middle, half in zip(
        0.5 * (upper + lower), 0.5 * np.linalg.norm(upper - lower, axis=1), strict=True
    ):
        off = [float(lines.distance(one, middle[None])[0]) for one in moved]
        assert half == pytest.approx(2.0 * np.std(off), rel=0.06)


# The frame and the film.


class Collector:
    def __init__(self):
        self.frames = []

    def write(self, image, hold=0.0):
        assert image.shape == (HEIGHT, WIDTH, 3)
        assert image.dtype == np.uint8
        self.frames.append((image, hold))


def truth_picture():
    picture = np.full((640, 700, 3), 230, dtype=np.uint8)
    picture[:26] = (255, 0, 0)
    return picture


def test_a_film_has_a_frame_every_fifth_of_a_second_and_pauses_to_explain():
    collector = Collector()
    film = Film(collector, np.zeros(2), np.array([4.0, 4.0]), "a hall")
    steps = [0.1 * number for number in range(21)]
    due = []
    for time in steps:
        if film.is_due(time):
            due.append(time)
            events = [Event("new", 1)] if time == pytest.approx(1.0) else []
            film.add(
                truth_picture(),
                frame_with(time=time, walls=[(1.0, 0.0, 0.0, 2.0)], events=events),
                0.5,
            )
    film.finish("explored")
    np.testing.assert_allclose(due, np.arange(11) * (SPEED / FPS))
    holds = [hold for _, hold in collector.frames]
    # The start and the end. The first wall comes too soon after the start to be explained.
    assert sum(hold > 0 for hold in holds) == 2
    assert len(holds) == 11 + 2
    paused = collector.frames[0][0]
    # The strip with the caption changes its colour while the run stands still.
    assert (paused[650] != collector.frames[1][0][650]).any()
    for image, _ in collector.frames:
        assert not (image == np.array([255, 0, 0])).all(axis=2).any()


# The file.


SIZE = 320, 180


def moving(number):
    width, height = SIZE
    image = np.full((height, width, 3), (250, 250, 249), dtype=np.uint8)
    image[40:80, 4 * number : 4 * number + 40] = (205, 48, 66)
    return image


def decoded(path):
    capture = cv2.VideoCapture(str(path))
    frames = []
    while (read := capture.read())[0]:
        frames.append(read[1][..., ::-1])
    rate = capture.get(cv2.CAP_PROP_FPS)
    capture.release()
    return frames, rate


def test_an_mp4_holds_the_frames_and_their_colours(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "film.mp4"
    with video_file(path, FPS, SIZE) as writer:
        for number in range(10):
            writer.write(moving(number))
        writer.write(moving(10), hold=0.4)
        assert not path.exists()
    frames, rate = decoded(path)
    assert len(frames) == 10 + 10
    assert rate == pytest.approx(FPS)
    assert frames[0].shape == (180, 320, 3)
    np.testing.assert_allclose(frames[15][60, 60], (205, 48, 66), atol=12)
    np.testing.assert_allclose(frames[15][120, 200], (250, 250, 249), atol=6)
    assert [one.name for one in tmp_path.iterdir()] == ["film.mp4"]
    # Players want H.264 in 4:2:0, and the index in front of the pictures.
    data = path.read_bytes()
    assert b"avc1" in data
    assert data.index(b"moov") < data.index(b"mdat")


def test_a_gif_plays_at_the_speed_of_the_frames(tmp_path):
    path = tmp_path / "deep" / "film.gif"
    with video_file(path, 25, SIZE) as writer:
        for number in range(50):
            writer.write(moving(number))
        writer.write(moving(50), hold=3.0)
        assert not path.exists()
    assert [one.name for one in path.parent.iterdir()] == ["film.gif"]
    with Pictures.open(path) as gif:
        durations = []
        for number in range(gif.n_frames):
            gif.seek(number)
            durations.append(gif.info["duration"])
        last = np.asarray(gif.convert("RGB"))
    assert sum(durations) == pytest.approx(2000 + 3000, abs=150)
    assert len(durations) <= 2 * 8.5 + 1
    assert tuple(last[60, 210]) == (205, 48, 66)


def test_a_file_that_is_there_is_only_replaced_by_force(tmp_path):
    path = tmp_path / "film.gif"
    path.write_text("old")
    with pytest.raises(ValueError, match="--force"), video_file(path, FPS, SIZE):
        pass
    folder = tmp_path / "folder.gif"
    folder.mkdir()
    with pytest.raises(ValueError, match="folder"), video_file(folder, FPS, SIZE, force=True):
        pass
    with video_file(path, FPS, SIZE, force=True) as writer:
        writer.write(moving(0))
        assert path.read_text() == "old"
    assert path.read_bytes().startswith(b"GIF8")


def test_without_an_encoder_an_mp4_is_refused_with_what_to_install(tmp_path, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(video.importlib, "import_module", missing)
    with (
        pytest.raises(VideoError, match=r'pip install "limslam\[video\]"'),
        video_file(tmp_path / "film.mp4", FPS, SIZE),
    ):
        pass


def film(path, frames, failure=None):
    """Write frames, and fail then."""
    if path.suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg")
    with video_file(path, FPS, SIZE) as writer:
        for frame in frames:
            writer.write(frame)
        if failure is not None:
            raise failure


@pytest.mark.parametrize(("suffix", "failure"), [("mp4", KeyboardInterrupt), ("gif", RuntimeError)])
def test_nothing_is_left_of_a_run_that_was_stopped(tmp_path, suffix, failure):
    with pytest.raises(failure):
        film(tmp_path / f"film.{suffix}", [moving(0)], failure)
    assert list(tmp_path.iterdir()) == []


def test_a_video_without_a_frame_is_none(tmp_path):
    with (
        pytest.raises(VideoError, match="there are no frames"),
        video_file(tmp_path / "film.gif", FPS, SIZE),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_an_encoder_that_fails_says_why(tmp_path, monkeypatch):
    program = tmp_path / "ffmpeg"
    program.write_text("#!/bin/sh\necho 'no space for films' >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr(video, "_ffmpeg", lambda: str(program))
    with pytest.raises(VideoError, match="no space for films"):
        film(tmp_path / "film.mp4", [moving(number % 50) for number in range(400)])
    assert [one.name for one in tmp_path.iterdir()] == ["ffmpeg"]
