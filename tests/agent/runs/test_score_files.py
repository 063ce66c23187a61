"""``limslam score``: scores from files equal those of a run, agree with evo, and do not depend on
the frame.
"""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.command_line import limslam, refused, told
from support.runs import read_poses, run, write_poses

from limslam_env.geometry import se2

MOVE = np.array([3.0, -2.0, 1.1])


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run(
        tmp_path_factory.mktemp("run") / "run", "--noise", 0.02, "--max-time", 20, "--seed", 300
    )


def scored(folder, *options):
    """The scores that the command writes."""
    told("score", *options, "--out", folder / "scores.json", "--force")
    return json.loads((folder / "scores.json").read_text())


def drive(seed=0, count=200):
    generator = np.random.default_rng(seed)
    true = np.zeros((count, 3))
    motions = np.column_stack(
        (np.full(count, 0.05), np.zeros(count), generator.normal(0.0, 0.1, count))
    )
    for step in range(1, count):
        true[step] = se2.compose(true[step - 1], motions[step])
    return true, true + generator.normal(0.0, 0.03, true.shape)


class TestScores:
    @pytest.mark.parametrize(
        ("path", "suffix"), [("trajectory_est.tum", ""), ("trajectory_smoothed.tum", "_smoothed")]
    )
    def test_files_of_a_run_have_the_scores_of_the_run(self, finished, tmp_path, path, suffix):
        folder = finished.path
        metrics = finished.metrics
        of_map = "map.json" if suffix else "map_online.json"
        scores = scored(
            tmp_path,
            "--true",
            folder / "trajectory_true.tum",
            "--est",
            folder / path,
            "--covariances",
            folder / "covariance_est.npz",
            "--map",
            folder / of_map,
            "--world",
            folder / "world.toml",
        )
        heading = "heading_smoothed_rmse_deg" if suffix else "heading_rmse_deg"
        for name, of_run in (
            ("ate_m", f"ate{suffix}_m"),
            ("heading_rmse_deg", heading),
            ("anees", f"anees{suffix}"),
        ):
            assert scores[name] == pytest.approx(metrics[of_run], rel=1e-3), name
        for name in ("wall_recall", "wall_f1", "wall_f1_5cm", "wall_f1_aligned", "spurious_m"):
            assert scores[name] == pytest.approx(
                metrics[name if suffix else f"{name}_online"], abs=2e-3
            ), name

    def test_a_moved_estimate_has_the_same_scores_when_it_is_aligned(self, finished, tmp_path):
        true, estimated = (finished.path / f"trajectory_{name}.tum" for name in ("true", "est"))
        write_poses(tmp_path / "moved.tum", finished.time, se2.compose(MOVE, read_poses(estimated)))
        for how in ("start", "path"):
            plain, moved = (
                scored(tmp_path, "--true", true, "--est", path, "--align", how)
                for path in (estimated, tmp_path / "moved.tum")
            )
            assert {name: moved[name] for name in plain} == pytest.approx(plain, abs=2e-6)
        assert (
            scored(tmp_path, "--true", true, "--est", tmp_path / "moved.tum", "--align", "none")[
                "ate_m"
            ]
            > 1.0
        )

    def test_covariances_turn_with_the_frame(self, tmp_path):
        true, estimated = drive()
        time = 0.1 * np.arange(len(true))
        roots = np.random.default_rng(1).normal(0.0, 0.03, (len(true), 3, 3))
        covariances = roots @ roots.swapaxes(1, 2) + 1e-4 * np.eye(3)
        cosine = np.cos(MOVE[2])
        sine = np.sin(MOVE[2])
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        write_poses(tmp_path / "true.tum", time, true)
        frames = [
            (estimated, covariances),
            (se2.compose(MOVE, estimated), turn @ covariances @ turn.T),
        ]
        anees = []
        for poses, stated in frames:
            write_poses(tmp_path / "est.tum", time, poses)
            rows = np.column_stack(
                (time, *(stated[:, i, j] for i in range(3) for j in range(i, 3)))
            )
            np.savetxt(tmp_path / "est.txt", rows, header="t xx xy xh yy yh hh")
            files = ("--true", tmp_path / "true.tum", "--est", tmp_path / "est.tum")
            anees.append(
                scored(tmp_path, *files, "--covariances", tmp_path / "est.txt", "--align", "path")[
                    "anees"
                ]
            )
        assert anees[1] == pytest.approx(anees[0], rel=1e-3)
        assert anees[0] > 0.0

    def test_agrees_with_evo_on_trajectories_of_other_rates(self, tmp_path):
        pytest.importorskip("evo")
        from evo.core import metrics as evo_metrics
        from evo.core import sync
        from evo.tools import file_interface

        true, estimated = drive(3)
        time = 0.1 * np.arange(len(true))
        write_poses(tmp_path / "true.tum", time, true)
        write_poses(tmp_path / "est.tum", time[5::3] + 0.004, estimated[5::3])
        ours = scored(tmp_path, "--true", tmp_path / "true.tum", "--est", tmp_path / "est.tum")
        pair = [
            file_interface.read_tum_trajectory_file(str(tmp_path / name))
            for name in ("true.tum", "est.tum")
        ]
        reference, estimate = sync.associate_trajectories(*pair, max_diff=0.01)
        error = evo_metrics.APE()
        error.process_data((reference, estimate))
        assert ours["ate_m"] == pytest.approx(
            error.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-6
        )
        assert ours["poses"] == reference.num_poses == 65
        assert ours["poses_unmatched"] == 0

    def test_the_heading_in_space_is_the_yaw(self, tmp_path):
        angles = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3))
        quaternions = 3.0 * Rotation.from_euler("ZYX", angles).as_quat()
        np.savetxt(
            tmp_path / "tilted.tum",
            np.column_stack((np.arange(20), np.zeros((20, 3)), quaternions)),
        )
        level = np.column_stack((np.zeros((20, 2)), angles[:, 0]))
        write_poses(tmp_path / "level.tum", np.arange(20.0), level)
        scores = scored(
            tmp_path,
            "--true",
            tmp_path / "level.tum",
            "--est",
            tmp_path / "tilted.tum",
            "--align",
            "none",
        )
        assert scores["heading_rmse_deg"] == pytest.approx(0.0, abs=1e-5)

    def test_poses_out_of_the_plane_get_a_word(self, tmp_path):
        true, _ = drive(count=50)
        x, y, heading = true.T
        nothing = np.zeros(50)
        half = 0.5 * heading
        in_space = {
            "flat": (x, y, nothing + 0.4, nothing, nothing, np.sin(half), np.cos(half)),
            "tilted": (x, y, 0.1 * x, nothing, np.sin(0.2 * x), nothing, np.cos(0.2 * x)),
            "camera": (x, nothing, y, nothing, -np.sin(half), nothing, np.cos(half)),
        }
        for name, columns in in_space.items():
            np.savetxt(tmp_path / f"{name}.tum", np.column_stack((np.arange(50.0), *columns)))
        files = {name: ("--true", "flat.tum", "--est", f"{name}.tum") for name in in_space}
        said = {
            name: limslam("score", *options, cwd=tmp_path).stderr for name, options in files.items()
        }
        assert said["flat"] == ""
        assert said["tilted"].startswith("limslam: warning: tilted.tum: z changes by 0.2")
        assert said["tilted"].endswith("their projection on the plane x-y is scored\n")
        assert said["camera"].startswith("limslam: warning: camera.tum: z changes by ")
        assert "is it in the axes of a camera?" in said["camera"]
        assert all(text.count("\n") <= 1 for text in said.values())

    def test_the_order_of_the_lines_says_nothing(self, tmp_path):
        true, estimated = drive()
        time = np.arange(len(true)) * 0.1
        rows = np.column_stack((time, np.tile([0.01, 0, 0, 0.01, 0, 0.01], (len(true), 1))))
        write_poses(tmp_path / "true.tum", time, true)
        found = []
        for name, order in (("in", slice(None)), ("reversed", slice(None, None, -1))):
            write_poses(tmp_path / f"{name}.tum", time[order], estimated[order])
            np.savetxt(tmp_path / f"{name}.txt", rows[order])
            files = "--est", tmp_path / f"{name}.tum", "--covariances", tmp_path / f"{name}.txt"
            found.append(scored(tmp_path, "--true", tmp_path / "true.tum", *files))
        assert found[0] == found[1]

    @pytest.mark.parametrize(
        ("scale", "of_time", "words"),
        [
            (1000.0, 1.0, "the estimated poses scatter by"),
            (1.0, 1000.0, "only 1 of 50 estimated poses have a true one at their time"),
        ],
    )
    def test_other_units_get_a_word(self, tmp_path, scale, of_time, words):
        true, estimated = drive(count=50)
        time = 0.1 * np.arange(50.0)
        write_poses(tmp_path / "true.tum", time, true)
        write_poses(tmp_path / "est.tum", of_time * time, estimated * [scale, scale, 1.0])
        done = limslam("score", "--true", "true.tum", "--est", "est.tum", cwd=tmp_path)
        assert words in done.stderr
        assert done.stderr.count("\n") == 1


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "reason"),
        [
            ((), "something to score is needed"),
            (("--est", "est.tum"), "needs something to compare with"),
            (("--map", "map.json"), "--map and --world go together"),
            (
                ("--est", "est.tum", "--true", "true.tum", "--align", "best"),
                "--align: none, start, path",
            ),
            (("--est", "est.tum", "--true", "late.tum"), "no pose has the time"),
            (("--est", "zero.tum", "--true", "true.tum"), "line 2 has a quaternion of length 0"),
            (("--est", "nan.tum", "--true", "true.tum"), "line 1 is not"),
            (
                ("--est", "est.tum", "--true", "true.tum", "--covariances", "one.txt"),
                "has 1 covariances",
            ),
            (
                ("--est", "est.tum", "--true", "true.tum", "--covariances", "bad.txt"),
                "line 1 is not t xx",
            ),
            (
                ("--est", "est.tum", "--true", "true.tum", "--covariances", "none.txt"),
                "the numbers at 3 s are no covariance",
            ),
            (("--est", "far.tum", "--true", "true.tum"), "at most 1e+07 m or rad, not 1e+300"),
            (("--map", "far.json", "--world", "env1"), "not 1e+300"),
            (("--map", "long.json", "--world", "env1"), "at most 20000 m are read"),
        ],
    )
    def test_one_line_says_why(self, tmp_path, monkeypatch, options, reason):
        monkeypatch.chdir(tmp_path)
        true, estimated = drive(count=5)
        write_poses(tmp_path / "true.tum", np.arange(5.0), true)
        write_poses(tmp_path / "late.tum", 100.0 + np.arange(5.0), true)
        write_poses(tmp_path / "est.tum", np.arange(5.0), estimated)
        (tmp_path / "one.txt").write_text("0 1 0 0 1 0 1\n")
        (tmp_path / "bad.txt").write_text("0 1 0 0\n")
        (tmp_path / "zero.tum").write_text("# a comment\n0 0 0 0 0 0 0 0\n")
        (tmp_path / "nan.tum").write_text("0 0 0 0 0 0 0 nan\n")
        (tmp_path / "far.tum").write_text("0 1e300 0 0 0 0 0 1\n")
        lines = [f"{t} {-1 if t == 3 else 1} 0 0 1 0 1" for t in range(5)]
        (tmp_path / "none.txt").write_text("\n".join(lines))
        for name, end in (("far", 1e300), ("long", 1e6)):
            (tmp_path / f"{name}.json").write_text(json.dumps({"segments": [[0, 0, end, 0]]}))
        assert reason in refused("score", *options)
