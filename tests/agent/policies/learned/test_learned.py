"""The learned policy: its weights, its network, and how it drives."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from support.beliefs import explored

from limslam_agent import Belief, FrontierPolicy, LearnedPolicy
from limslam_agent.config.presets import GridConfig, PolicyConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.policies.learned.learned import own_part
from limslam_agent.policies.learned.look_ahead import FULL
from limslam_agent.policies.learned.network import (
    LAYERS,
    DirectionNetwork,
    load_network,
    save_network,
)
from limslam_agent.policies.learned.polar_view import (
    AHEAD,
    CHANNELS,
    ViewConfig,
    expected_ranges,
    observe,
)
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_env import RobotSpec, World
from limslam_env.geometry import se2
from limslam_env.robots import four_beam_drone

ROBOT = RobotSpec()
VIEW = ViewConfig(directions=8, rings=4)


def network(view=VIEW, width=6, seed=0):
    generator = np.random.default_rng(seed)
    inputs = view.rows + 2
    shapes = {
        "first": (width, inputs, 5),
        "state": (width, 8),
        "second": (width, width, 3),
        "third": (width, width, 3),
    }
    weights = {}
    for layer, shape in {**shapes, "score": (1, width + inputs, 1)}.items():
        weights[f"{layer}.weight"] = generator.normal(size=shape).astype(np.float32)
        weights[f"{layer}.bias"] = generator.normal(size=shape[0]).astype(np.float32)
    return DirectionNetwork(weights, view)


def grid_of(text, cell=0.1):
    """A grid view of rows of text, the last one at the bottom: `.` free, `#` occupied, space
    unknown.
    """
    view = OccupancyGrid(GridConfig(cell=cell)).view
    rows = [
        [{".": 5, "#": -5, " ": 0}[sign] for sign in line]
        for line in reversed(text.strip("\n").split("\n"))
    ]
    return replace(view, low=np.zeros(2), values=np.array(rows, dtype=np.int16))


HALL = grid_of(
    """
####################
#...................
#...................
#...................
#...................
#...................
####################
"""
)


def belief(pose, grid=HALL, ranges=1.5):
    return Belief(
        np.array(pose, dtype=float), np.eye(3) * 1e-6, np.full(6, ranges), np.zeros((0, 4)), grid
    )


def test_weights_come_back_as_they_were(tmp_path):
    saved = network()
    save_network(tmp_path / "weights.npz", saved)
    loaded = load_network(tmp_path / "weights.npz")
    assert loaded.view == VIEW
    assert set(loaded.weights) == {
        f"{layer}.{part}" for layer in LAYERS for part in ("weight", "bias")
    }
    told = np.random.default_rng(1).random(VIEW.size(6)).astype(np.float32)
    np.testing.assert_array_equal(loaded.scores(told), saved.scores(told))


class Trap:
    """Runs when it is unpickled."""

    def __reduce__(self):
        return exec, ("raise SystemExit('executed')",)


@pytest.mark.parametrize(
    "kind", ["missing", "text", "pickle", "empty", "other", "misfit", "infinite"]
)
def test_what_is_no_network_is_refused_and_executes_nothing(kind, tmp_path):
    path = tmp_path / "weights.npz"
    held = network().weights
    view = np.array([8, 4, 0.15, 1.45])
    if kind == "text":
        path.write_text("weights", encoding="utf-8")
    elif kind == "pickle":
        np.savez(path, view=np.array([Trap()], dtype=object))
    elif kind == "empty":
        np.savez(path)
    elif kind == "other":
        np.savez(path, view=view)
    elif kind == "misfit":
        np.savez(path, view=view, **{**held, "second.weight": held["second.weight"][:, :3]})
    elif kind == "infinite":
        np.savez(path, view=view, **{**held, "score.bias": np.array([np.inf], dtype=np.float32)})
    with pytest.raises(ValueError, match="weights"):
        load_network(path)


def test_turning_what_is_seen_turns_the_scores_but_for_the_compass():
    blind = network()
    blind.weights["first.weight"][:, -2:] = blind.weights["score.weight"][:, -2:] = 0.0
    told = np.random.default_rng(2).random(VIEW.size(6)).astype(np.float32)
    size = 8 * VIEW.rows
    view = told[:size].reshape(-1, 8)
    rest = told[size:]
    turned = np.concatenate((np.roll(view, 3, axis=1).ravel(), rest))
    np.testing.assert_allclose(blind.scores(turned), np.roll(blind.scores(told), 3), atol=1e-4)


def test_torch_trains_what_numpy_runs():
    torch = pytest.importorskip("torch", reason="needs the extra rl")
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    from benchmarks.training.train import DirectionExtractor

    twin = DirectionExtractor(ViewConfig(), 8)
    told = np.random.default_rng(3).random((5, ViewConfig().size(6))).astype(np.float32)
    with torch.no_grad():
        scores, _ = twin(torch.as_tensor(told))
    mine = np.stack([twin.to_numpy().scores(row) for row in told])
    np.testing.assert_allclose(mine, scores.numpy(), atol=1e-5)


def test_the_view_turns_with_the_robot():
    pose = np.array([1.03, 0.35, 0.0])
    size = VIEW.rings * VIEW.directions
    looks = [
        observe(HALL, pose + np.array([0, 0, turn]), np.full(6, 1.5), ROBOT, VIEW)
        for turn in (0.0, math.pi / 2)
    ]
    first, second = (look[: CHANNELS * size].reshape(-1, VIEW.directions) for look in looks)
    np.testing.assert_allclose(second, np.roll(first, -2, axis=1), atol=1e-5)
    # Ahead lies the frontier: every ring gains there, until the unknown begins.
    gain = first.reshape(CHANNELS, VIEW.rings, VIEW.directions)[2]
    assert (gain[:, 0] > 0.5).all()
    assert (gain[:3, 4] < 0.0).all()


def ahead_of(grid, pose, view=VIEW):
    """What driving in each direction would show (AHEAD, directions)."""
    told = observe(grid, np.array(pose, dtype=float), np.full(6, 1.5), ROBOT, view)
    return told[CHANNELS * view.rings * view.directions : view.rows * view.directions].reshape(
        AHEAD, -1
    )


def test_driving_ahead_shows_what_the_beams_at_the_sides_will_see():
    # A hall whose upper half is unknown: whoever drives along it sees that half from the side.
    half = grid_of("\n".join([" " * 40] * 20 + ["." * 40] * 3 + ["#" * 40]))
    ahead = ahead_of(half, [1.05, 0.25, 0.0])
    far = ahead[-1]
    assert far[0] > 0.5
    # The longer the drive, the more it shows; the numbers of cells are shares of 50, 100 and 200.
    assert (np.diff(ahead * np.array(FULL)[:, None], axis=0) >= 0.0).all()
    # There is a wall below, so that nothing is driven there.
    assert far[6] == 0.0


def test_what_is_nearer_to_a_teammate_is_left_to_it():
    told = replace(belief([0.55, 0.35, 0.0]), other_poses=np.array([[1.55, 0.35, 0.0]]))
    grid = grid_of("\n".join([" " * 20] * 3 + ["." * 20] * 7))
    part = own_part(replace(told, grid=grid), ROBOT)
    assert (part.values[8, :10] == 0).all()
    assert (part.values[8, 11:] > 0).all()
    assert part.values[3, 15] < 0
    assert grid.values[3, 15] > 0


@pytest.mark.parametrize("turn", [0, 18])
def test_it_drives_where_the_network_says(turn):
    class Fixed:
        view = ViewConfig()
        readings = 6

        def scores(self, _):
            return np.eye(24)[turn] * 50.0

    policy = LearnedPolicy(ROBOT, PolicyConfig(), Fixed())
    pose = np.array([1.0, 0.55, 0.0])
    frontiers = FrontierPolicy(ROBOT, PolicyConfig(speed=ROBOT.max_wheel_speed, min_frontier=8))
    hall = grid_of("\n".join(["#" * 24, *["#" + "." * 23] * 10, "#" * 24]))
    turned = 0.0
    for step in range(80):
        told = belief(
            pose,
            grid=replace(hall, values=np.where(np.arange(24) < 12 + step // 8, hall.values, 0)),
        )
        np.testing.assert_array_equal(
            policy.act(told), frontiers.act(told), "the frontier explorer begins"
        )
    for _ in range(5):
        left, right = 0.03 * policy.act(belief(pose, grid=hall, ranges=1.5))
        turned += (right - left) / 0.16
        pose = se2.compose(pose, np.array([0.5 * (left + right), 0.0, (right - left) / 0.16]))
    assert turned == pytest.approx({0: 0.0, 6: math.pi / 2, 18: -math.pi / 2}[turn], abs=0.35)
    if turn == 0:
        assert pose[0] == pytest.approx(1.15)


@pytest.mark.parametrize("robot", [RobotSpec.lidar(36), four_beam_drone()])
def test_a_robot_with_other_beams_explores_a_narrow_corridor_to_its_end(robot):
    width = 0.64
    walls = [[0, 0, 3, 0], [3, 0, 3, width], [3, width, 0, width], [0, width, 0, 0]]
    world = World("corridor", (3.0, width), walls, starts=[[0.4, 0.3, 0.0]])
    policy = LearnedPolicy(robot)
    coverage, _ = explored(world, policy, 60.0, 0)
    assert coverage > 0.95
    assert policy.stop_reason == "explored: no frontier is left"


def test_a_network_for_other_beams_is_refused_before_the_start():
    trained = network()
    trained.weights["state.weight"] = np.zeros((6, 11), dtype=np.float32)
    with pytest.raises(ValueError, match="trained with 9 beams, which neither this robot with 36"):
        LearnedPolicy(RobotSpec.lidar(36), network=trained)


def test_what_beams_would_read_is_what_stands_in_the_map():
    ranges = expected_ranges(HALL, np.array([1.0, 0.35, 0.0]), ROBOT)
    # Walls lie 0.25 m to both sides, of which the rim takes 0.1 m; ahead, nothing is known.
    np.testing.assert_allclose(ranges[[0, 5]], 0.15, atol=0.051)
    assert ranges[2] == pytest.approx(0.15 / math.sin(math.radians(15.0)), abs=0.35)
    turned = expected_ranges(HALL, np.array([0.35, 0.35, math.pi]), ROBOT)
    assert turned[2] == turned[3] == pytest.approx(0.15, abs=0.06)


@pytest.mark.parametrize("policy", ["learned"])
def test_it_explores_a_room(policy):
    room = World(
        "room",
        (4.0, 3.0),
        [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0], [2, 0, 2, 1.6]],
        starts=[[1.0, 0.8, 0.4]],
    )
    episode = run_episode(
        RunConfig(room, noise=0.02, policy=policy, max_time=60.0, preset="odometry", until="seen")
    )
    assert episode.coverage[-1] > 0.95
    assert episode.is_finished
    again = run_episode(replace(episode.config, max_time=5.0))
    np.testing.assert_array_equal(again.actions, episode.actions[: len(again.actions)])


def test_running_it_loads_neither_torch_nor_numba():
    code = (
        "import sys, numpy as np\n"
        "from limslam_agent import LearnedPolicy, preset\n"
        "from limslam_env import RobotSpec\n"
        "LearnedPolicy(RobotSpec(), preset('consistent').policy)\n"
        "print({'torch', 'numba', 'pymunk'} & set(sys.modules))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "set()"
