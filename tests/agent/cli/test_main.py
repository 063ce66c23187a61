"""The command line as a user meets it: exit codes, one line, and whole folders or none."""

import json
import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import typer
from support.bags import odometry, scan, write_bag
from support.command_line import limslam, refusal_of, refused, told
from support.runs import result_of

from limslam_agent import read_log
from limslam_agent.cli import warmup as warmup_module
from limslam_agent.terminal import run_command
from limslam_env import load_world

RUN_FILES = {
    "log.npz",
    "result.json",
    "trajectory_true.tum",
    "trajectory_est.tum",
    "map.json",
    "map.pgm",
    "map.yaml",
    "map.png",
    "run.toml",
    "world.toml",
    "covariance_est.npz",
    "trajectory_odometry.tum",
}

# One beam a quarter turn apart would do; 180 beams, one a degree from -90 on.
SCAN = "FLASER 180 " + " ".join(["2.00"] * 180)


def carmen_line(x, time):
    return f"{SCAN} {x} 0 0 {x} 0 0 {time} host {time}"


@pytest.fixture
def carmen_log(tmp_path):
    path = tmp_path / "corridor.log"
    path.write_text(
        "\n".join(carmen_line(0.05 * step, 100.0 + 0.1 * step) for step in range(80)) + "\n"
    )
    return path


@pytest.fixture(scope="module")
def short_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "short"
    told("run", "--noise", "0.02", "--max-time", "12", "--seed", "300", "--out", folder)
    return folder


def test_a_run_writes_its_whole_folder_and_nothing_beside_it(short_run):
    smoothed = {"trajectory_smoothed.tum", "map_online.json"}
    assert {path.name for path in short_run.iterdir()} == RUN_FILES | smoothed
    assert [path.name for path in short_run.parent.iterdir()] == ["short"]


def test_the_result_of_a_run_that_was_too_short_says_so(short_run):
    result = result_of(short_run)
    assert {"metrics", "cost", "config", "versions", "seed"} <= set(result)
    assert {"slam_ms_median", "slam_ms_p99", "speed_x_real_time", "peak_rss_mb"} <= set(
        result["cost"]
    )
    assert result["seed"] == 300
    assert result["metrics"]["stop_reason"].startswith("time")
    assert result["metrics"]["exploration_time_s"] is None


def test_files_agree_with_each_other(short_run):
    with np.load(short_run / "log.npz", allow_pickle=False) as log:
        arrays = {name: log[name] for name in log.files}
    rows = 121
    assert arrays["time"].shape == (rows,)
    assert arrays["ranges"].shape == arrays["wall_seen"].shape == (rows, 6)
    for name in ("true", "est"):
        table = np.loadtxt(short_run / f"trajectory_{name}.tum")
        assert table.shape == (rows, 8)
        np.testing.assert_allclose(np.linalg.norm(table[:, 4:], axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(
        np.loadtxt(short_run / "trajectory_true.tum")[:, 1:3], arrays["true_pose"][:, :2], atol=1e-6
    )
    content = json.loads((short_run / "map.json").read_text())
    assert len(content["segments"]) >= len(content["landmarks"]) > 0
    assert set(content["landmarks"][0]) == {"r", "theta", "cov", "ends", "observations", "segments"}
    header, size, depth = (short_run / "map.pgm").read_bytes().split(b"\n", 3)[:3]
    assert (header, depth) == (b"P5", b"255")
    columns, height = map(int, size.split())
    assert len((short_run / "map.pgm").read_bytes().split(b"\n", 3)[3]) == columns * height
    assert "free_thresh: 0.196" in (short_run / "map.yaml").read_text()


def test_a_runs_log_replays_to_the_same_trajectory(short_run, tmp_path):
    result = limslam("replay", short_run / "log.npz", "--out", tmp_path / "again")
    assert result.returncode == 0, result.stderr
    again = np.loadtxt(tmp_path / "again" / "trajectory_est.tum")
    np.testing.assert_array_equal(again, np.loadtxt(short_run / "trajectory_est.tum"))
    metrics = result_of(tmp_path / "again")["metrics"]
    told = result_of(short_run)["metrics"]
    assert metrics["ate_m"] == told["ate_m"]
    shared = metrics.keys() & told.keys()
    assert len(shared) >= 10
    assert {"ate_smoothed_m", "anees_smoothed"} <= shared
    assert {name: metrics[name] for name in shared} == {name: told[name] for name in shared}


def test_results_are_only_replaced_by_force(tmp_path):
    folder = tmp_path / "copy"
    folder.mkdir()
    (folder / "result.json").write_text("old")
    refused = limslam("run", "--max-time", "1", "--out", folder)
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert (folder / "result.json").read_text() == "old"
    told("run", "--max-time", "1", "--out", folder, "--force")
    assert {path.name for path in folder.iterdir()} == RUN_FILES


def test_force_never_replaces_what_is_no_run(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    result = limslam("run", "--max-time", "1", "--out", tmp_path, "--force")
    assert "does not hold the results of a run" in refusal_of(result)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "--noise", "much"), "--noise"),
        (("run", "--world", "atlantis"), "atlantis"),
        (("run", "--max-time", "0"), "--max-time must be a number from 0.001 to 1e+06, not 0.0"),
        (("run", "--policy", "magic"), "no policy is called 'magic'"),
        (("run", "--policy", "tour", "--robots", "2"), "for one robot"),
        (("run", "--policy", "random", "--laps", "2"), "not with 'random'"),
        (("run", "--kidnap-at", "0"), "not at 0 s"),
        (("run", "--kidnap-at", "5", "--robots", "2"), "one of several robots cannot be kidnapped"),
        (("run", "--unknown-starts", "--robots", "3"), "unknown starts are for two robots, not 3"),
        (
            ("run", "--unknown-starts", "--robots", "2", "--preset", "paper"),
            "with the preset graph",
        ),
        (
            ("run", "--unknown-starts", "--robots", "2", "--policy", "random"),
            "unknown starts are for the policy frontier",
        ),
        (("fly",), "fly"),
        (("replay", "missing.log"), "missing.log"),
        (("replay", "{log}", "--beams", "90,120"), "120"),
        (("replay", "{log}", "--max-range", "-1"), "-1"),
        (("replay", "{log}", "--odometry-noise", "1,2"), "--odometry-noise"),
        (("replay", "{log}", "--odometry-bias", "1,0"), "--odometry-bias"),
        (
            ("replay", "{log}", "--calibrate", "{log}", "--odometry-bias", "1"),
            "--odometry-bias and --calibrate",
        ),
        (
            ("replay", "{log}", "--calibrate", "{log}", "--relations", "{log}"),
            "relations that calibrate do not score",
        ),
        (("replay", "{log}", "--topics", "/odom"), "is not a ROS bag"),
        (
            ("replay", "{log}", "--noise", "20"),
            "--noise 20 m is more than the longest range of 3 m: is it in metres?",
        ),
    ],
)
def test_bad_arguments_get_one_line_and_leave_nothing(arguments, words, carmen_log, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    arguments = [part.replace("{log}", str(carmen_log)) for part in arguments]
    assert words in refused(*arguments, cwd=tmp_path)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    """Nobody can make a folder inside a file, and root can make one in any folder."""
    (tmp_path / "file").write_text("", encoding="utf-8")
    refused = limslam("run", "--max-time", "1", "--out", tmp_path / "file" / "run")
    assert "cannot be written" in refusal_of(refused)


def test_replay_of_a_corridor_finds_its_walls_and_is_scored(carmen_log, tmp_path):
    relations = tmp_path / "known.relations"
    relations.write_text("100.0 107.0 3.5 0 0 0 0 0\n")
    result = limslam(
        "replay",
        carmen_log,
        "--beams",
        "-90,-45,0,45,90",
        "--relations",
        relations,
        "--out",
        tmp_path / "out",
    )
    assert result.returncode == 0, result.stderr
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {
        "trajectory_est.tum",
        "map.json",
        "map.png",
        "map.pgm",
        "map.yaml",
        "result.json",
    } <= files
    table = np.loadtxt(tmp_path / "out" / "trajectory_est.tum")
    np.testing.assert_allclose(
        table[:, 0], 100.0 + 0.1 * np.arange(80), atol=1e-6
    )  # the log's own times
    metrics = result_of(tmp_path / "out")["metrics"]
    assert metrics["relation_error_m"] < 0.1
    assert metrics["raw_odometry_relation_error_m"] == pytest.approx(0.0, abs=1e-9)


def known_motions(path, seconds, metres):
    """Relations of the corridor's robot, each over one second: what it truly drove, 0.5 m by its
    own account.
    """
    path.write_text(
        "".join(f"{100 + at} {101 + at} {metres} 0 0 0 0 0.01\n" for at in range(seconds))
    )
    return path


def test_the_bias_comes_from_known_motions(carmen_log, tmp_path):
    relations = known_motions(tmp_path / "known.relations", 7, 0.525)
    others = known_motions(tmp_path / "other.relations", 3, 0.525)
    result = limslam(
        "replay",
        carmen_log,
        "--calibrate",
        relations,
        "--relations",
        others,
        "--out",
        tmp_path / "out",
    )
    assert result.returncode == 0, result.stderr
    assert "calibrated  1.146 +- " in result.stdout
    assert "scale 1.0500 +- " in result.stdout
    content = result_of(tmp_path / "out")
    metrics = content["metrics"]
    config = content["config"]
    assert metrics["calibration_turn_deg_per_m"] == pytest.approx(np.degrees(0.02), abs=1e-6)
    assert (metrics["calibration_relations"], metrics["relations"]) == (7, 3)
    assert metrics["odometry_relation_error_m"] < 0.01 < metrics["raw_odometry_relation_error_m"]
    assert config["agent"]["odometry"]["distance_scale"] == pytest.approx(1.05, abs=1e-4)
    assert config["calibration"] == "known.relations"


@pytest.mark.parametrize(("later", "words"), [(1e6, "none of its"), (6.0, "% of its")])
def test_relations_of_another_log_are_refused(carmen_log, tmp_path, later, words):
    relations = known_motions(tmp_path / "known.relations", 7, 0.4)
    rows = [line.split() for line in relations.read_text().splitlines() if not line.startswith("#")]
    moved = [
        " ".join([str(float(row[0]) + later), str(float(row[1]) + later), *row[2:]]) for row in rows
    ]
    relations.write_text("\n".join(moved) + "\n")
    said = refused(
        "replay",
        carmen_log,
        "--beams",
        "-90,90",
        "--relations",
        relations,
        "--out",
        tmp_path / "no",
    )
    assert f"{words} relations lie in the log's time: are they of another log?" in said


def test_a_table_and_a_bag_are_replayed_like_any_log(tmp_path):
    places = [0.05 * step for step in range(80)]
    table = tmp_path / "corridor.csv"
    rows = [f"{100 + 0.1 * step},{x},0,0,2,,2" for step, x in enumerate(places)]
    table.write_text("\n".join(["t,x,y,theta,r_-90,r_0,r_90", *rows]) + "\n")
    messages = []
    for step, x in enumerate(places):
        at = 100 + 0.1 * step
        messages += [
            odometry(at, x),
            odometry(at, 0.0, topic="/other"),
            scan(at, [2.0, np.inf, 2.0]),
        ]
    bag = write_bag(tmp_path, messages, "mcap", "corridor")
    for log, options in ((table, ()), (bag, ("--topics", "/odom"))):
        out = tmp_path / f"out-{log.suffix}"
        told("replay", log, *options, "--out", out)
        segments = np.array(json.loads((out / "map.json").read_text())["segments"])
        assert len(segments) == 2
        np.testing.assert_allclose(np.abs(segments[:, [1, 3]]), 2.0, atol=0.02)


def test_importing_the_command_line_is_light():
    heavy = "{'pymunk', 'numba', 'filterpy', 'cv2', 'matplotlib', 'rosbags', 'numpy', 'tomli_w'}"
    loaded = f"import sys, limslam_agent.__main__; print(sorted({heavy} & set(sys.modules)))"
    result = subprocess.run(
        [sys.executable, "-c", loaded], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


def test_two_robots_write_a_trajectory_each_and_their_log_is_refused_with_the_reason(tmp_path):
    told("run", "--max-time", "4", "--robots", "2", "--out", tmp_path / "run")
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert {
        "trajectory_true_0.tum",
        "trajectory_true_1.tum",
        "trajectory_est_0.tum",
        "trajectory_est_1.tum",
    } <= names
    refused = limslam("replay", tmp_path / "run" / "log.npz", "--out", tmp_path / "replay")
    assert refused.returncode == 2
    assert "is the log of 2 robots" in refused.stderr


def test_a_run_can_be_filmed(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    film = tmp_path / "run.mp4"
    told("run", "--max-time", "3", "--video", film, "--out", tmp_path / "run")
    assert film.stat().st_size > 10_000
    refused = limslam(
        "run", "--max-time", "3", "--video", tmp_path / "run.avi", "--out", tmp_path / "other"
    )
    assert refused.returncode == 2
    assert ".mp4" in refused.stderr
    assert not (tmp_path / "other").exists()


def test_ctrl_c_says_that_the_command_was_stopped(monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr("limslam_env.worlds.formats.loading.shipped_worlds", interrupted)
    result = limslam("worlds")
    assert (result.returncode, result.stdout, result.stderr) == (130, "", "limslam: stopped\n")


def test_a_bad_argument_ends_the_script_with_2_and_one_line(tmp_path):
    result = subprocess.run(
        [Path(sys.executable).with_name("limslam"), "run", "--noise", "-1"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == "limslam: --noise must be a number from 0 to 1000, not -1.0\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["random:x", "random:-1", "random:" + "9" * 5000])
def test_what_names_no_floor_plan_is_refused_in_a_short_line(name):
    with pytest.raises(ValueError, match="a seed is needed, as in random:17") as refusal:
        load_world(name)
    assert len(str(refusal.value)) < 200


def test_a_floor_plan_is_run_by_its_seed(tmp_path):
    code, out, _ = limslam(
        "run", "--world", "random:17", "--max-time", 1, "--out", tmp_path / "run"
    )
    assert code == 0
    assert "stopped" in out
    assert 'world = "random:17"' in (tmp_path / "run" / "run.toml").read_text()


def test_warming_up_says_what_it_does_and_ends_each_line(monkeypatch):
    done = []
    steps = {
        name: (seconds, lambda name=name: done.append(name))
        for name, (seconds, _) in warmup_module.STEPS.items()
    }
    monkeypatch.setattr(warmup_module, "STEPS", steps)
    monkeypatch.setattr(warmup_module, "LAST", "no step")
    monkeypatch.setenv("LIMSLAM_QUIET", "")
    code, out, error = limslam("warmup")
    assert (code, error) == (0, "")
    assert done == ["simulator", "batch", "smoothers", "BatchSlam"]
    assert [line.split()[0] for line in out.splitlines()] == done
    assert all("up to about" in line and "done after" in line for line in out.splitlines())


@pytest.mark.parametrize("name", ["simulator", "batch", "smoothers", "BatchSlam"])
def test_each_step_of_the_warm_up_runs(name):
    warmup_module.STEPS[name][1]()


SLOW = """
from limslam_env import kept_code
kept_code._SECONDS["slow"] = 7
import kernels
print(kernels.slow(1), kernels.slow(2))
"""
KERNELS = """
from limslam_env.compilation import entry
@entry
def slow(x):
    return x + 1
"""


@pytest.mark.parametrize(
    ("quiet", "first"), [("", "limslam: compiling 'slow', once, about 7 s\n"), ("1", "")]
)
def test_a_kernel_says_that_it_is_compiled_once_and_never_again(tmp_path, quiet, first):
    (tmp_path / "kernels.py").write_text(KERNELS)
    (tmp_path / "slow.py").write_text(SLOW)
    paths = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    environment = {
        **os.environ,
        "LIMSLAM_QUIET": quiet,
        "NUMBA_CACHE_DIR": str(tmp_path / "kept"),
        "PYTHONPATH": paths,
    }
    for expected in (first, ""):
        result = subprocess.run(
            [sys.executable, str(tmp_path / "slow.py")],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert (result.stdout, result.stderr) == ("2 3\n", expected)


def test_a_lack_of_memory_is_said_in_one_line(capsys):
    app = typer.Typer()

    @app.command()
    def fill(pages: int = 1 << 50) -> None:
        np.empty(pages)

    with patch("sys.argv", ["fill"]), pytest.raises(SystemExit) as ended:
        run_command(app, "fill")
    assert ended.value.code == 2
    message = capsys.readouterr().err
    assert message.startswith("fill: there is not enough memory for this: Unable to allocate ")
    assert message.count("\n") == 1


def test_a_run_with_the_heading_of_an_imu_is_kept_replayed_and_inspected(tmp_path):
    run = tmp_path / "run"
    again = tmp_path / "again"
    options = ("--noise", "0.02", "--max-time", "8", "--imu")
    finished = told("run", "--world", "env1", *options, "--out", run)
    assert "drift of the heading" in finished
    result = result_of(run)
    assert result["config"]["imu"] is True
    assert set(result["record"]["calibration"][0]) >= {"size", "scale", "drift", "drift_std"}
    assert np.isfinite(read_log(run / "log.npz").yaw).all()
    replayed = limslam("replay", run / "log.npz", "--noise", "0.02", "--out", again)
    assert "heading of the IMU: drift" in replayed.stdout
    paths = [np.loadtxt(folder / "trajectory_est.tum") for folder in (run, again)]
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-6)
    assert "The poses equal those" in limslam("inspect", run).stdout
    repeated = told("run", "--config", run / "run.toml", "--out", tmp_path / "repeated")
    assert "drift of the heading" in repeated
