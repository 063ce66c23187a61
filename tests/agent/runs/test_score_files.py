"""``limslam score``: scores from files equal those of a run, agree with evo, and do not depend on the frame."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.command_line import invoke

from limslam_agent.cli.score import score
from limslam_agent.output.tum import TrajectoryError, read_tum, write_tum
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import write_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.runs.score_files import matched, read_pairs, trajectory_scores
from limslam_env.geometry import se2

MOVE = np.array([3.0, -2.0, 1.1])


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return folder, write_episode(folder, run_episode(RunConfig("env1", 0.02, max_time=20.0, seed=300)))


def drive(seed=0, count=200):
    generator = np.random.default_rng(seed)
    true = np.zeros((count, 3))
    motions = np.column_stack((np.full(count, 0.05), np.zeros(count), generator.normal(0.0, 0.1, count)))
    for step in range(1, count):
        true[step] = se2.compose(true[step - 1], motions[step])
    return true, true + generator.normal(0.0, 0.03, true.shape)


class TestScores:
    @pytest.mark.parametrize(("path", "suffix"), [("trajectory_est.tum", ""), ("trajectory_smoothed.tum", "_smoothed")])
    def test_files_of_a_run_have_the_scores_of_the_run(self, finished, tmp_path, path, suffix):
        folder, result = finished
        of_map = "map.json" if suffix else "map_online.json"
        invoke(score,
            "--true", folder / "trajectory_true.tum", "--est", folder / path,
            "--covariances", folder / "covariance_est.npz", "--map", folder / of_map, "--world", folder / "world.toml",
            "--out", tmp_path / "scores.json",
        )  # fmt: skip
        scores, metrics = json.loads((tmp_path / "scores.json").read_text()), result["metrics"]
        heading = "heading_smoothed_rmse_deg" if suffix else "heading_rmse_deg"
        for name, of_run in (("ate_m", f"ate{suffix}_m"), ("heading_rmse_deg", heading), ("anees", f"anees{suffix}")):
            assert scores[name] == pytest.approx(metrics[of_run], rel=1e-3), name
        for name in ("wall_recall", "wall_f1", "wall_f1_5cm", "wall_f1_aligned", "spurious_m"):
            assert scores[name] == pytest.approx(metrics[name if suffix else f"{name}_online"], abs=2e-3), name

    def test_a_moved_estimate_has_the_same_scores_when_it_is_aligned(self, finished, tmp_path):
        folder, _ = finished
        time, poses = read_tum(folder / "trajectory_est.tum")
        write_tum(tmp_path / "moved.tum", time, se2.compose(MOVE, poses))
        true = folder / "trajectory_true.tum"
        plain, moved = (
            read_pairs(true, path, None) for path in (folder / "trajectory_est.tum", tmp_path / "moved.tum")
        )
        for how in ("start", "path"):
            first, second = (trajectory_scores(pairs.moved(pairs.alignment(how))) for pairs in (plain, moved))
            assert second == pytest.approx(first, abs=2e-6)
        assert trajectory_scores(moved)["ate_m"] > 1.0

    def test_covariances_turn_with_the_frame(self, tmp_path):
        true, estimated = drive()
        time = 0.1 * np.arange(len(true))
        generator = np.random.default_rng(1)
        roots = generator.normal(0.0, 0.03, (len(true), 3, 3))
        covariances = roots @ roots.swapaxes(1, 2) + 1e-4 * np.eye(3)
        cosine, sine = np.cos(MOVE[2]), np.sin(MOVE[2])
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        frames = {
            "first": (estimated, covariances),
            "second": (se2.compose(MOVE, estimated), turn @ covariances @ turn.T),
        }
        write_tum(tmp_path / "true.tum", time, true)
        scores = {}
        for name, (poses, stated) in frames.items():
            write_tum(tmp_path / f"{name}.tum", time, poses)
            rows = np.column_stack((time, *(stated[:, i, j] for i in range(3) for j in range(i, 3))))
            np.savetxt(tmp_path / f"{name}.txt", rows, header="t xx xy xh yy yh hh")
            pairs = read_pairs(tmp_path / "true.tum", tmp_path / f"{name}.tum", tmp_path / f"{name}.txt")
            scores[name] = trajectory_scores(pairs.moved(pairs.alignment("path")))
        assert scores["second"]["anees"] == pytest.approx(scores["first"]["anees"], rel=1e-3)
        assert scores["first"]["anees"] > 0.0

    def test_agrees_with_evo_on_trajectories_of_other_rates(self, tmp_path):
        pytest.importorskip("evo")
        from evo.core import metrics as evo_metrics
        from evo.core import sync
        from evo.tools import file_interface

        true, estimated = drive(3)
        time = 0.1 * np.arange(len(true))
        write_tum(tmp_path / "true.tum", time, true)
        write_tum(tmp_path / "est.tum", time[5::3] + 0.004, estimated[5::3])
        ours = json.loads(self.written(tmp_path))
        pair = [file_interface.read_tum_trajectory_file(str(tmp_path / name)) for name in ("true.tum", "est.tum")]
        reference, estimate = sync.associate_trajectories(*pair, max_diff=0.01)
        error = evo_metrics.APE()
        error.process_data((reference, estimate))
        assert ours["ate_m"] == pytest.approx(error.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-6)
        assert ours["poses"] == reference.num_poses == 65
        assert ours["poses_unmatched"] == 0

    def written(self, folder):
        invoke(score, "--true", folder / "true.tum", "--est", folder / "est.tum", "--out", folder / "scores.json")
        return (folder / "scores.json").read_text()


class TestMatchedTimes:
    def test_nearest_within_the_difference_in_either_order(self):
        long, short = np.array([0.0, 0.1, 0.2, 0.3]), np.array([0.104, 0.25, 0.296])
        for first, second in ((long, short), (short, long)):
            indices = matched(first, second, 0.01)
            np.testing.assert_array_equal(first[indices[0]].round(1), second[indices[1]].round(1))
            assert len(indices[0]) == 2


class TestTum:
    def test_the_heading_in_space_is_the_yaw(self, tmp_path):
        angles = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3))
        quaternions = Rotation.from_euler("ZYX", angles).as_quat()
        rows = np.column_stack((np.arange(20), np.zeros((20, 3)), 3.0 * quaternions))
        np.savetxt(tmp_path / "a.tum", rows)
        np.testing.assert_allclose(read_tum(tmp_path / "a.tum")[1][:, 2], angles[:, 0], atol=1e-12)

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("0 1 2 3\n", "line 1 is not t x y z"),
            ("# a comment\n0 0 0 0 0 0 0 0\n", "line 2 has a quaternion of length 0"),
            ("0 0 0 0 0 0 0 nan\n", "line 1 is not"),
        ],
    )
    def test_files_that_are_refused(self, tmp_path, text, reason):
        (tmp_path / "a.tum").write_text(text)
        with pytest.raises(TrajectoryError, match=reason):
            read_tum(tmp_path / "a.tum")


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "reason"),
        [
            ((), "something to score is needed"),
            (("--est", "est.tum"), "needs something to compare with"),
            (("--map", "map.json"), "--map and --world go together"),
            (("--est", "est.tum", "--true", "true.tum", "--align", "best"), "--align: none, start, path"),
            (("--est", "est.tum", "--true", "late.tum"), "no pose has the time"),
            (("--est", "est.tum", "--true", "true.tum", "--covariances", "one.txt"), "has 1 covariances"),
            (("--est", "est.tum", "--true", "true.tum", "--covariances", "bad.txt"), "line 1 is not t xx"),
        ],
    )
    def test_one_line_says_why(self, tmp_path, monkeypatch, options, reason):
        monkeypatch.chdir(tmp_path)
        true, estimated = drive(count=5)
        write_tum(tmp_path / "true.tum", np.arange(5.0), true)
        write_tum(tmp_path / "late.tum", 100.0 + np.arange(5.0), true)
        write_tum(tmp_path / "est.tum", np.arange(5.0), estimated)
        (tmp_path / "one.txt").write_text("0 1 0 0 1 0 1\n")
        (tmp_path / "bad.txt").write_text("0 1 0 0\n")
        with pytest.raises(ValueError, match=reason) as refused:
            invoke(score, *options)
        assert "\n" not in str(refused.value)
