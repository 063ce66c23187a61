"""The video of a run: what its pictures show, what is said, and that its file is whole or not there."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image as Pictures

from limslam_agent.output import style as video_style
from limslam_agent.slam.core.diagnostics import PendingPoints
from limslam_agent.video import belief_panels, video
from limslam_agent.video.belief_frame import BeliefFrame, Event, hough_image, hough_view, wall_bands
from limslam_agent.video.belief_picture import draw_belief
from limslam_agent.video.film import FPS, HEIGHT, WIDTH, Film, Scene, compose, cropped_truth, layout_for
from limslam_agent.video.narration import SPEED, Caption, Narrator
from limslam_agent.video.video import VideoError, video_file
from limslam_env.geometry import line as lines
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec
from limslam_env.rendering.rendering import RenderState, render
from limslam_env.worlds.formats.loading import load_world

SIDE = 400
WINDOW = (np.array([-2.0, -1.0]), np.array([2.0, 3.0]))


def on_line(r, theta, positions, *, spread=0.0):
    points = lines.at(np.array([r, theta]), np.asarray(positions, dtype=float))
    return points + spread * lines.normal(np.array([r, theta]))


def frame_with(*, time=0.0, walls=(), poses=((0.0, 0.0, 0.0),), std=0.02, **more):
    """A belief with walls given as (r, theta, from, to) along the line."""
    parameters = np.array([wall[:2] for wall in walls]).reshape(-1, 2)
    segments = np.array([on_line(*wall[:2], wall[2:]).ravel() for wall in walls]).reshape(-1, 4)
    covariances = np.array([np.diag([std**2, std**2])] * len(walls)).reshape(-1, 2, 2)
    poses, more = np.array(poses), {"numbers": tuple(range(1, len(walls) + 1)), **more}
    return BeliefFrame(
        time, poses, np.array([0.01**2 * np.eye(3)] * len(poses)), segments, parameters, covariances, **more
    )


def pixel(image, x, y, window=WINDOW):
    scale = image.shape[1] / (window[1] - window[0])[0]
    column, row = int((x - window[0][0]) * scale), int(image.shape[0] - (y - window[0][1]) * scale)
    return tuple(image[row, column].tolist())


def is_near(colour, other, tolerance=40):
    return sum(abs(a - b) for a, b in zip(colour, other, strict=True)) < tolerance


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


@pytest.mark.parametrize("theta", np.radians([-170.0, 0.0, 60.0]))
def test_the_rings_lie_on_the_peaks_of_the_votes_all_round(theta):
    line, pose = np.array([0.8, theta]), np.array([1.0, 2.0, 0.7])
    points = on_line(*line, np.linspace(0.2, 1.2, 25))
    view = hough_view(points, line[None], points[None, [0, -1]], pose, time=3.0, side="left", threshold=8)
    (r, angle) = view.peaks[0]
    assert 0.0 <= angle < math.pi
    row = min(int((r + view.r_reach) / (2 * view.r_reach) * len(view.votes)), len(view.votes) - 1)
    column = int(angle / math.pi * view.votes.shape[1])
    # Next to the peak, which may fall on the border of two bins; 0 and 180 degrees are neighbours, with r turned round.
    around = [
        view.votes[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2],
        view.votes[::-1][max(row - 1, 0) : row + 2, -1:] if column == 0 else np.zeros((1, 1)),
    ]
    assert max(part.max() for part in around) >= 22
    np.testing.assert_allclose(view.points, transform_points(pose, points))
    np.testing.assert_allclose(view.segments[0].reshape(2, 2), transform_points(pose, points[[0, -1]]))


def test_a_band_is_as_wide_as_the_line_may_be_off():
    line, covariance = np.array([1.0, 0.4]), np.array([[4e-4, 3e-4], [3e-4, 9e-4]])
    frame = replace(frame_with(walls=[(*line, -1.0, 2.0)]), line_covariances=covariance[None])
    (band,) = wall_bands(frame, sigmas=2.0, samples=7)
    upper, lower = band[:7], band[7:][::-1]
    random = np.random.default_rng(0)
    moved = line + random.multivariate_normal(np.zeros(2), covariance, size=4000)
    for middle, half in zip(0.5 * (upper + lower), 0.5 * np.linalg.norm(upper - lower, axis=1), strict=True):
        off = [float(lines.distance(one, middle[None])[0]) for one in moved]
        assert half == pytest.approx(2.0 * np.std(off), rel=0.06)


# The right half.


def test_walls_cells_frontiers_and_robots_are_drawn_where_they_are():
    values = np.zeros((10, 10), dtype=np.int16)
    values[2, 3], values[5, 6] = 20, -20
    frame = frame_with(
        walls=[(1.0, 0.0, 0.0, 2.0)],
        poses=[(-1.5, 2.5, 0.0), (1.7, -0.7, 2.0)],
        grid_low=np.array([-1.0, -0.5]),
        grid_values=values,
        frontier=np.array([[-1.5, 0.0]]),
    )
    image = draw_belief(frame, (SIDE, SIDE), WINDOW)
    assert image.shape == (SIDE, SIDE, 3)
    assert is_near(pixel(image, 1.0, 0.5), video_style.WALL)
    assert is_near(pixel(image, -1.0 + 0.35, -0.5 + 0.25), video_style.FREE, 5)
    assert is_near(pixel(image, -1.0 + 0.65, -0.5 + 0.55), video_style.OCCUPIED, 5)
    assert is_near(pixel(image, -1.0 + 0.75, -0.5 + 0.55), video_style.UNKNOWN, 5)
    assert pixel(image, -1.5, 0.0)[0] < 150
    assert is_near(pixel(image, -1.5, 2.57), video_style.ROBOTS[0], 60)
    assert is_near(pixel(image, 1.7, -0.63), video_style.ROBOTS[1], 60)


def test_walls_that_are_spoken_of_glow_and_those_of_a_loop_are_linked():
    walls = [(1.0, 0.0, 0.0, 2.0), (-1.0, 0.0, 0.0, 2.0)]
    frame = frame_with(walls=walls, numbers=(4, 9), poses=[(-1.7, -0.7, 0.0)])
    calm = draw_belief(frame, (SIDE, SIDE), WINDOW)
    one = draw_belief(replace(frame, events=[Event("again", 9)]), (SIDE, SIDE), WINDOW)
    loop = draw_belief(replace(frame, events=[Event("loop", 9, 4)]), (SIDE, SIDE), WINDOW)

    def glow(image, x, y):
        column, row = int((x + 2.0) * 100), int(SIDE - (y + 1.0) * 100)
        part = image[row - 4 : row + 5, column - 4 : column + 5].reshape(-1, 3).tolist()
        return any(is_near(colour, video_style.GLOW, 20) for colour in part)

    assert [glow(calm, x, 0.4) for x in (1.0, -1.0)] == [False, False]
    assert [glow(one, x, 0.4) for x in (1.0, -1.0)] == [False, True]
    assert [glow(loop, x, y) for x, y in ((1.0, 0.4), (-1.0, 0.4), (0.5, 1.0))] == [True, True, True]


def test_a_belief_past_all_bounds_can_be_drawn():
    frame = frame_with(
        walls=[(1e9, 0.3, -1e9, 1e9)],
        poses=[(1e7, -1e8, 4.0)],
        std=1e5,
        plans=[np.array([(0.0, 0.0), (1e12, 1e12)])],
        goals=[np.array([1e12, 1e12])],
        buffers=[PendingPoints(0, "left", np.array([(1e9, 0.0)]), 30)],
    )
    frame = replace(frame, covariances=np.array([np.diag([1e10, -1e-20, 1e3])]))
    assert draw_belief(frame, (SIDE, SIDE), WINDOW).shape == (SIDE, SIDE, 3)


# The panels.


def test_peaks_are_ringed_in_the_heat_map():
    points = np.vstack((on_line(0.5, 0.3, np.linspace(-0.5, 0.5, 15)), on_line(0.6, 1.9, np.linspace(-0.5, 0.5, 15))))
    found = np.array([(0.5, 0.3), (0.6, 1.9)])
    ends = np.array([points[[0, 14]], points[[15, 29]]])
    view = hough_view(points, found, ends, np.zeros(3), time=0.0, side="right")
    panel = belief_panels.draw_hough(view, 260, 250)
    for colour in video_style.PEAKS[:2]:
        assert (np.abs(panel.astype(int) - colour).sum(axis=2) < 30).any()
    assert belief_panels.draw_hough(None, 260, 250).shape == (250, 260, 3)


# What is said.


def test_a_status_that_is_not_ok_is_told():
    narrator = Narrator()
    narrator.hear(frame_with())
    reason = "lost: 9 of 90 readings contradict the map"
    said = [narrator.hear(frame_with(time=0.2 * step, warning=reason))[-1].caption for step in range(1, 30)]
    assert f"The estimate is {reason}." in {caption.headline for caption in said}


def test_a_caption_stays_until_it_could_be_read_but_a_loop_comes_sooner():
    narrator = Narrator()
    narrator.hear(frame_with())
    captions = []
    for step in range(1, 200):
        events = [Event("again", step)] if step != 64 else [Event("loop", 64, 1)]
        told = narrator.hear(frame_with(time=(SPEED / FPS) * step, events=events))
        captions.append(told[-1].caption.headline)
    changes = [number for number in range(1, len(captions)) if captions[number] != captions[number - 1]]
    held = np.diff(changes) / FPS  # s of the video
    assert held.min() >= 0.65
    assert np.median(held) >= 1.75
    told_of_loop = [number + 1 for number, caption in enumerate(captions) if "Close the loop" in caption]
    assert 64 <= told_of_loop[0] <= 64 + 0.75 * FPS
    assert len(told_of_loop) >= 1.75 * FPS


def test_the_list_of_events_names_robots_and_counts_what_is_repeated():
    narrator = Narrator()
    two = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]
    narrator.hear(frame_with(poses=two, new_goals=[0]))
    for time in (0.2, 0.4, 0.6):
        narrator.hear(frame_with(time=time, poses=two, events=[Event("again", 3, robot=1)]))
    narrator.hear(frame_with(time=0.8, poses=two, events=[Event("loop", 5, 3)]))
    assert narrator.hear(frame_with(time=9.0, poses=two))[-1].caption.headline.startswith("Close the loop: wall 5 is")
    assert [words for _, _, words in narrator.log] == [
        "loop closed: 5 = 3", "robot 2: wall 3 seen again, 3 times", "robot 1: drives to a frontier",
    ]  # fmt: skip


# The frame and the film.


@pytest.mark.parametrize(("aspect", "robots"), [(0.2, 1), (1.0, 2), (1.7, 8), (6.0, 1)])
def test_the_parts_of_a_frame_fit_and_do_not_overlap(aspect, robots):
    layout = layout_for(aspect, robots)
    boxes = [layout.truth, layout.belief, layout.buffers, layout.hough, layout.log]
    page = np.zeros((HEIGHT, WIDTH), dtype=int)
    for left, top, width, height in boxes:
        assert min(left, top) >= 0
        assert min(width, height) > 30
        part = page[top : top + height, left : left + width]
        assert part.shape == (height, width)
        part += 1
    assert page.max() == 1
    assert layout.truth[2:] == layout.belief[2:]
    assert layout.truth[2] / layout.truth[3] == pytest.approx(aspect, rel=0.06)


@pytest.mark.parametrize("name", ["env2"])
def test_both_halves_show_the_same_place_at_the_same_scale(name):
    world = load_world(name)
    robot = RobotSpec()
    pose = np.array(world.starts[:1])
    nothing = np.full((1, len(robot.beams)), -1)
    picture = render(RenderState(world, robot, pose, nothing, np.full(nothing.shape, 0.05), [], 0.0, 0.0))
    corners = world.edges.reshape(-1, 2)
    cropped, window = cropped_truth(picture, corners.min(axis=0), corners.max(axis=0))
    height, width = cropped.shape[:2]
    assert width / height == pytest.approx(float(np.divide(*(window[1] - window[0]))), rel=0.005)
    belief = frame_with(poses=pose, std=1e-4)
    belief = replace(
        belief, segments=world.edges, lines=np.array([lines.through(edge[:2], edge[2:]) for edge in world.edges]),
        line_covariances=np.zeros((len(world.edges), 2, 2)), unsure=frozenset(range(1, len(world.edges) + 1)),
        numbers=tuple(range(1, len(world.edges) + 1)),
    )  # fmt: skip
    drawn = draw_belief(belief, (width, height), window)
    walls = is_dark(cropped)
    believed = np.abs(drawn.astype(int) - video_style.UNKNOWN).sum(axis=2) > 60
    believed[is_robot(drawn)] = False
    near = cv2.dilate(walls.astype(np.uint8), np.ones((5, 5))) > 0
    assert believed.sum() > 500
    assert near[believed].mean() > 0.95
    # The caption of the simulation's own picture is left out.
    assert not walls[: round(0.02 * height)].any()


def is_dark(image):
    return image.max(axis=2) < 110


def is_robot(image):
    blue = (image[..., 2].astype(int) - image[..., 0]) > 40
    return cv2.dilate(blue.astype(np.uint8), np.ones((25, 25))) > 0


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
            film.add(truth_picture(), frame_with(time=time, walls=[(1.0, 0.0, 0.0, 2.0)], events=events), 0.5)
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


def test_several_robots_and_a_wide_world_fit_in_a_frame():
    truth = np.full((300, 700, 3), 230, dtype=np.uint8)
    poses = [(0.3 * number, 0.0, 0.0) for number in range(8)]
    buffers = [PendingPoints(robot, side, np.zeros((9, 2)), 30) for robot in range(8) for side in ("left", "right")]
    frame = frame_with(poses=poses, buffers=buffers, time=3599.94, plans=[np.zeros((0, 2))] * 8, goals=[None] * 8)
    scene = Scene(
        Caption((0,), "Headline", "Explanation"),
        "t" * 300,
        [(float(n), "new", "w" * 90) for n in range(30)],
        0.5,
        WINDOW,
    )
    assert compose(truth, frame, scene).shape == (HEIGHT, WIDTH, 3)


# The file.


def moving(number, width=320, height=180):
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
    with video_file(path, FPS) as writer:
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
    with video_file(path, 25) as writer:
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
    with pytest.raises(VideoError, match="--force"), video_file(path, FPS):
        pass
    folder = tmp_path / "folder.gif"
    folder.mkdir()
    with pytest.raises(VideoError, match="folder"), video_file(folder, FPS, force=True):
        pass
    with video_file(path, FPS, force=True) as writer:
        writer.write(moving(0))
        assert path.read_text() == "old"
    assert path.read_bytes().startswith(b"GIF8")


def test_without_an_encoder_an_mp4_is_refused_with_what_to_install(tmp_path, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(video.importlib, "import_module", missing)
    with pytest.raises(VideoError, match=r"pip install 'limslam\[video\]'"), video_file(tmp_path / "film.mp4", FPS):
        pass


def film(path, frames, failure=None):
    """Write frames, and fail then."""
    if path.suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg")
    with video_file(path, FPS) as writer:
        for frame in frames:
            writer.write(frame)
        if failure is not None:
            raise failure


@pytest.mark.parametrize("suffix", ["mp4", "gif"])
@pytest.mark.parametrize("failure", [KeyboardInterrupt, RuntimeError, SystemExit])
def test_nothing_is_left_of_a_run_that_was_stopped(tmp_path, suffix, failure):
    with pytest.raises(failure):
        film(tmp_path / f"film.{suffix}", [moving(0)], failure)
    assert list(tmp_path.iterdir()) == []


def test_a_video_without_a_frame_is_none(tmp_path):
    with pytest.raises(VideoError, match="there are no frames"), video_file(tmp_path / "film.gif", FPS):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", ["mp4", "gif"])
def test_frames_must_be_frames_of_one_size(tmp_path, suffix):
    path = tmp_path / f"film.{suffix}"
    with pytest.raises(VideoError, match="first"):
        film(path, [moving(0), moving(0, width=322)])
    with pytest.raises(VideoError, match="even sides"):
        film(path, [moving(0, width=321)])
    assert list(tmp_path.iterdir()) == []


def test_an_encoder_that_fails_says_why(tmp_path, monkeypatch):
    program = tmp_path / "ffmpeg"
    program.write_text("#!/bin/sh\necho 'no space for films' >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr(video, "_ffmpeg", lambda: str(program))
    with pytest.raises(VideoError, match="no space for films"):
        film(tmp_path / "film.mp4", [moving(number % 20, 1280, 720) for number in range(40)])
    assert [one.name for one in tmp_path.iterdir()] == ["ffmpeg"]
