"""A run that begins at an unknown place of an earlier map finds itself, and goes on in that map."""

import shutil

import numpy as np
import pytest
from support.command_line import limslam

from limslam_agent import Mapper, preset
from limslam_agent.grid.occupancy import GridView
from limslam_agent.output.export import write_map
from limslam_agent.output.summary import record_summary, run_summary
from limslam_agent.places.saved_map import SavedMap, SavedMapError, read_saved_map
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.slam.core.line_map import Landmark
from limslam_env import NominalNoise, RobotSpec, load_world
from limslam_env.geometry import se2, segment

NOISE = 0.02


def map_of(world):
    """A map as an earlier run would have left it: all walls, and the ground that a robot can
    reach.
    """
    segments = world.edges
    marks = []
    for number, (x1, y1, x2, y2) in enumerate(segments):
        theta = np.arctan2(x1 - x2, y2 - y1)
        r = x1 * np.cos(theta) + y1 * np.sin(theta)
        r, theta = (r, theta) if r >= 0.0 else (-r, float(se2.wrap_angle(theta + np.pi)))
        ends = np.array([[x1, y1], [x2, y2]])
        marks.append(
            Landmark(float(r), float(theta), np.diag([1e-4, 1e-5]), ends, 9, number, (number,))
        )
    low = np.floor(segments.reshape(-1, 2).min(axis=0) / 0.1)
    high = np.ceil(segments.reshape(-1, 2).max(axis=0) / 0.1)
    columns, rows = (high - low).astype(int)
    centres = 0.1 * (
        low
        + 0.5
        + np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    )
    reached = world.free_space(0.1)
    spaces = reached.centres(reached.region_of(world.starts[0][:2]))
    free = np.array([np.hypot(*(spaces - centre).T).min() < 0.2 for centre in centres])
    wall = segment.distances(centres, segments).min(axis=1) < 0.05
    values = np.where(wall, -4, np.where(free, 4, 0)).reshape(rows, columns).astype(np.int16)
    return SavedMap(segments, marks, GridView(0.1 * low, 0.1, values))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("saved")
    write_map(path, map_of(load_world("env3")))
    return path


@pytest.fixture(scope="module")
def episode(folder):
    return run_episode(RunConfig("env3", NOISE, seed=130, map=folder, max_time=60.0, until="seen"))


def test_a_map_is_read_as_it_was_written(folder):
    saved = map_of(load_world("env3"))
    read = read_saved_map(folder)
    np.testing.assert_array_equal(read.segments, saved.segments)
    np.testing.assert_array_equal(np.sign(read.grid.values), np.sign(saved.grid.values))
    np.testing.assert_allclose(read.grid.low, saved.grid.low)
    assert [(mark.r, mark.theta, mark.segments) for mark in read.landmarks] == [
        (mark.r, mark.theta, mark.segments) for mark in saved.landmarks
    ]


def test_a_run_finds_itself_in_an_earlier_map(episode):
    assert episode.in_prior_map
    (event, *_) = episode.places.records
    assert event["event"] == "found in the saved map"
    assert event["match"]["accepted"]
    off = np.hypot(*(episode.estimated - episode.true)[:, 0, :2].T)
    assert off.max() < 0.25
    level = episode.levels[:, 0]
    np.testing.assert_array_equal(level[: event["step"] + 1], 1)
    assert episode.smoothed is None


def test_the_walls_of_both_runs_are_one_map(episode):
    edges = load_world("env3").edges
    lengths = np.hypot(*(edges[:, 2:] - edges[:, :2]).T)
    found = episode.final_map.segments
    assert np.hypot(*(found[:, 2:] - found[:, :2]).T).sum() > 0.9 * lengths.sum()
    middles = 0.5 * (found[:, :2] + found[:, 2:])
    assert np.median(segment.distances(middles, edges).min(axis=1)) < 0.05


def test_another_building_does_not_fit(folder):
    settings = preset("graph", NominalNoise(NOISE))
    episode = run_episode(
        RunConfig(
            "env2",
            NOISE,
            seed=130,
            map=folder,
            max_time=30.0,
            until="seen",
            settings=settings,
        )
    )
    assert not episode.in_prior_map
    (event,) = episode.places.records
    assert (event["event"], bool(event["reason"])) == ("not found in the saved map", True)
    own = se2.transform_points(se2.inverse(episode.true[0, 0]), episode.true[:, 0, :2])
    assert np.hypot(*(episode.estimated[:, 0, :2] - own).T).max() < 0.3
    scores = score(episode)
    in_two_frames = (
        "ate_m",
        "anees",
        "ate_smoothed_m",
        "wall_f1",
        "wall_recall_online",
        "coverage_correct",
    )
    assert {scores[name] for name in in_two_frames} == {None}
    assert scores["wall_f1_aligned"] > 0.2
    assert [line for line in run_summary(scores, {}) if " m rms" in line] == [
        f"error       {scores['ate_aligned_m']:.3f} m rms when aligned"
    ]
    words = record_summary({"record": {"places": [{**event, "time_s": 30.0}]}})
    assert words[-1].endswith("the results are in the run's own frame")


def test_a_team_cannot_begin_in_a_map(folder):
    with pytest.raises(ValueError, match="only one robot"):
        Mapper(RobotSpec(), None, np.zeros((2, 3)), prior_map=read_saved_map(folder))
    with pytest.raises(ValueError, match="earlier run is for one robot"):
        RunConfig("env3", robots=2, map=folder)


def damage(name, content):
    def change(folder):
        (folder / name).write_text(content)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda folder: (folder / "map.json").unlink(), "cannot be read"),
        (lambda folder: (folder / "map.pgm").unlink(), "cannot be read"),
        (damage("map.json", "{"), "is not JSON"),
        (damage("map.json", "[]"), "does not hold the content that a run writes"),
        (damage("map.json", '{"segments": []}'), "is no map of limslam"),
        (damage("map.json", '{"segments": [], "landmarks": []}'), "has no walls"),
        (
            damage("map.json", '{"segments": [[0, 0, 1, NaN]], "landmarks": []}'),
            "must be finite",
        ),
        (
            damage("map.json", f'{{"segments": {[[0, 0, 1, 1]] * 20_001}, "landmarks": []}}'),
            "it has 20001 walls; at most 20000 are read",
        ),
        (
            damage("map.json", f'{{"segments": [], "landmarks": {[{}] * 20_001}}}'),
            "it has 20001 landmarks; at most 20000 are read",
        ),
        (damage("map.yaml", "resolution: a\norigin: [0, 0, 0]"), "is not as limslam writes it"),
        (damage("map.yaml", "resolution: 0\norigin: [0, 0, 0]"), "impossible"),
        (damage("map.pgm", "P5\n2 2\n255\nx"), "is not as limslam writes it"),
    ],
)
def test_damaged_maps_are_refused_in_one_line(folder, tmp_path, change, words):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    change(tmp_path)
    with pytest.raises(SavedMapError, match=words) as caught:
        read_saved_map(tmp_path)
    assert "\n" not in str(caught.value)
    answer = limslam("run", "--map", tmp_path, "--out", tmp_path / "out")
    assert answer.returncode == 2
    assert len(answer.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_none_is_refused(tmp_path):
    with pytest.raises(SavedMapError, match="is not a folder with a map"):
        read_saved_map(tmp_path / "nowhere")
