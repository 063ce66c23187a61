"""Settings: presets, bounds, ablations, and the files of --config and --robot."""

import math
import os
import subprocess
import sys
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
from support.command_line import limslam, told
from support.runs import result_of

from limslam_agent import preset
from limslam_agent.cli.settings import (
    Given,
    ReplayOptions,
    RunOptions,
    run_config,
    run_options,
)
from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import (
    ABLATIONS,
    NO_GATE,
    PRESETS,
    GridConfig,
    PolicyConfig,
    PublishedConfig,
    ablated,
)
from limslam_agent.config.shared import HoughConfig
from limslam_agent.config.tables import SettingsError, read_toml, table_of, updated, write_toml
from limslam_agent.robot_file import robot_named
from limslam_env import NoiseConfig, NominalNoise, RobotSpec, load_world
from limslam_env.robots import ROBOTS
from limslam_env.worlds.formats.tables import world_toml

KINDS = {
    "consistent": ConsistentConfig,
    "paper": PublishedConfig,
    "odometry": PublishedConfig,
    "graph": ConsistentConfig,
}


def groups(settings):
    """All dataclasses in a dataclass, itself included."""
    inner = [getattr(settings, field.name) for field in fields(settings)]
    return [settings, *(group for each in inner if is_dataclass(each) for group in groups(each))]


def numbers(group):
    """The names of the plain numbers of a dataclass."""
    return [
        field.name for field in fields(group) if type(getattr(group, field.name)) in {int, float}
    ]


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_chooses_the_estimator_by_the_type_of_its_settings(name):
    config = preset(name, NominalNoise(0.03))
    assert type(config.estimator) is KINDS[name]
    assert (config.preset, config.noise.range_std) == (name, 0.03)


def test_an_unknown_preset_is_refused_with_the_known_ones():
    with pytest.raises(
        ValueError,
        match="no preset is called 'magic'; there are consistent, paper, odometry, graph",
    ):
        preset("magic")


@pytest.mark.parametrize("name", PRESETS)
def test_every_number_of_the_agent_has_bounds_that_its_default_keeps(name):
    checked = 0
    for group in groups(preset(name)):
        if isinstance(group, NominalNoise):
            continue  # it checks itself
        hints = get_type_hints(type(group), include_extras=True)
        for number in numbers(group):
            bounds = [extra for extra in hints[number].__metadata__ if isinstance(extra, Bounds)]
            assert len(bounds) == 1
            assert isinstance(group, Bounded)
            with pytest.raises(ValueError, match=f"^{number} must be a (whole )?number from"):
                replace(group, **{number: bounds[0].high * 2.0 + 1.0})
            with pytest.raises(ValueError, match=f"^{number} must be"):
                replace(group, **{number: math.nan})
            checked += 1
    assert checked >= 38


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_changes_one_setting(ablation):
    before = preset("paper")
    after = ablated(preset("paper"), ablation)
    changed = [
        (name, getattr(new, name))
        for old, new in zip(groups(before), groups(after), strict=True)
        for name in (field.name for field in fields(old))
        if not is_dataclass(getattr(old, name)) and getattr(old, name) != getattr(new, name)
    ]
    assert changed in (
        [("correct", False)],
        [("enabled", False)],
        [("max_end_gap", NO_GATE)],
        [("only_best", True)],
    )


def round_trip(settings, start, path):
    write_toml(path, table_of(settings), "settings")
    return updated(start, read_toml(path), str(path))


@pytest.mark.parametrize("name", PRESETS)
def test_settings_come_back_from_a_file_as_they_were(name, tmp_path):
    config = replace(
        preset(name, NominalNoise(1 / 3)),
        grid=GridConfig(cell=0.1 + 0.2),
        policy=PolicyConfig(speed=0.1),
    )
    config = replace(
        config, estimator=replace(config.estimator, hough=HoughConfig(r_step=math.pi / 100))
    )
    assert round_trip(config, preset(name), tmp_path / "agent.toml") == config


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_comes_back_from_a_file_as_it_was(name, tmp_path):
    assert round_trip(ROBOTS[name](), RobotSpec(), tmp_path / "robot.toml") == ROBOTS[name]()


@pytest.mark.parametrize(
    ("table", "told", "seconds"),
    [
        ({}, {}, 1800.0),
        ({}, {"world": "random:3:40x30"}, 12000.0),
        ({"max_time": 90.0}, {"world": "random:3:40x30"}, 90.0),
    ],
)
def test_a_large_world_has_more_time_unless_it_is_told(table, told, seconds):
    given = Given(None, table, told)
    assert run_config(given, run_options(given)).max_time == seconds
    given = Given(None, table, {**told, "max_time": 50.0})
    assert run_config(given, run_options(given)).max_time == 50.0


SAME = {"log.npz", "map.json", "map.pgm", "map.yaml", "trajectory_est.tum", "run.toml"}


def given(tmp_path, text="", **options):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return Given.read(path, options)


def config_of(asked):
    return run_config(asked, run_options(asked))


def assert_same(first, second, names=SAME):
    for name in names:
        if name.endswith(".npz"):
            with np.load(first / name) as one, np.load(second / name) as other:
                assert set(one.files) == set(other.files)
                assert all(np.array_equal(one[key], other[key]) for key in one.files)
        else:
            assert (first / name).read_bytes() == (second / name).read_bytes(), name


@pytest.mark.parametrize(
    "options",
    [
        ("--noise", "0.02", "--seed", "3"),
        ("--preset", "paper", "--ablation", "no-end-gate", "--policy", "random"),
    ],
)
def test_the_file_of_a_run_repeats_it_to_the_bit(options, tmp_path):
    first = tmp_path / "first"
    second = tmp_path / "second"
    told("run", "--max-time", "15", *options, "--out", first)
    told("run", "--config", first / "run.toml", "--out", second)
    assert_same(first, second)
    one, other = (result_of(folder) for folder in (first, second))
    assert (one["metrics"], one["config"], one["seed"]) == (
        other["metrics"],
        other["config"],
        other["seed"],
    )


def test_a_run_with_settings_of_every_kind_is_repeated_by_its_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        "robots = 2\nmax_time = 5\nnoise = 0.01\n[robot]\nmax_wheel_speed = "
        "0.2\n[true_noise]\nwheel_mismatch = 0.01\n"
        "[agent.noise]\nrange_std = 0.03\n[agent.policy]\nspeed = "
        "0.1\n[agent.estimator.pending]\nbatch = 20\n"
    )
    first = tmp_path / "first"
    second = tmp_path / "second"
    told("run", "--config", path, "--out", first)
    told("run", "--config", first / "run.toml", "--out", second)
    assert_same(
        first,
        second,
        SAME - {"trajectory_est.tum"} | {"trajectory_est_0.tum", "trajectory_est_1.tum"},
    )
    written = tomllib.loads((first / "run.toml").read_text())
    assert written["agent"]["estimator"]["pending"]["batch"] == 20
    assert written["agent"]["noise"]["range_std"] == 0.03
    assert written["true_noise"]["wheel_mismatch"] == 0.01
    assert len(written["robot"]["beams"]) == 6


def test_a_run_in_a_world_of_a_file_can_be_handed_on_and_repeated(tmp_path):
    path = tmp_path / "plans" / "mine.toml"
    path.parent.mkdir()
    path.write_text(world_toml(load_world("square")), encoding="utf-8")
    first = tmp_path / "first"
    second = tmp_path / "second"
    told("run", "--world", path, "--ablation", "none", "--max-time", "3", "--out", first)
    assert tomllib.loads((first / "run.toml").read_text())["world"] == "world.toml"
    path.unlink()
    moved = first.rename(tmp_path / "moved")
    told("run", "--config", moved / "run.toml", "--out", second)
    assert_same(moved, second)


def wheel_table(folder):
    """A log of a drive along two walls, by ticks of 1 mm, and the file of its robot."""
    rows = [f"{100 * step},{25 * step},{25 * step},800,8190" for step in range(120)]
    (folder / "wheels.csv").write_text("\n".join(["t,left,right,r_-90,r_90", *rows]) + "\n")
    (folder / "robot.toml").write_text(
        "radius = 0.06\naxle = 0.115\nbeams_deg = [90, -90]\nmax_range = 2.0\n"
    )
    units = (
        "--metres-per-tick",
        "0.001",
        "--accumulated",
        "--range-unit",
        "mm",
        "--time-unit",
        "ms",
    )
    return folder / "wheels.csv", folder / "robot.toml", units


def test_the_file_of_a_replay_of_wheel_travel_repeats_it(tmp_path):
    log, robot, units = wheel_table(tmp_path)
    first = tmp_path / "first"
    second = tmp_path / "second"
    told("replay", log, "--robot", robot, *units, "--out", first)
    told("replay", "--config", first / "run.toml", "--out", second)
    assert_same(first, second, SAME - {"log.npz"})
    one = result_of(first)
    assert one["record"]["driven_m"] == pytest.approx(0.025 * 119)
    assert one["config"]["robot"]["axle"] == 0.115
    beams = one["config"]["robot"]["beams"]
    assert [(beam["y"], beam["max_range"]) for beam in beams] == [(-0.06, 2.0), (0.06, 2.0)]


def test_a_file_says_the_beams_of_a_laser_scanner_in_one_line(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text("radius = 0.2\naxle = 0.3\nlidar_beams = 360\nmax_range = 4.0\n")
    assert robot_named(str(path)) == RobotSpec.lidar(360, 4.0, radius=0.2, axle=0.3)
    assert robot_named("lidar") == RobotSpec.lidar()


@pytest.mark.parametrize(
    ("robot", "words"),
    [
        ("beams_deg = [0]\nlidar_beams = 9", "beams_deg and lidar_beams both describe the beams"),
        ("max_range = 2.0", "max_range goes with beams_deg or lidar_beams"),
        (
            "radius = 0.1\naxle = 0.1\nlidar_beams = 0",
            "the number of beams all around a robot must be a whole number from 1 to 4096, not 0",
        ),
        (
            "axle = -1.0",
            "--robot: robot.toml: a robot's axle must be a number from 0.001",
        ),
        ("axel = 0.1", "--robot: robot.toml: axel: there is no such setting"),
        (
            "beams_deg = [0]\nbeams = [{x = 0.0, y = 0.0, angle = 0.0}]",
            "beams and beams_deg both describe the beams",
        ),
        ("radius = 0.08\nbeams_deg = [90, -90]", "--robot: robot.toml: axle is missing"),
        ("beams = [{x = 0.1, y = 0.0}]", "robot.toml: beams[0].angle: is missing"),
        (
            "beams = [{x = 0.1, y = 0.0, angle = 0, side = 'up'}]",
            "robot.toml: beams[0].side: must be one of left",
        ),
    ],
)
def test_a_robots_file_that_cannot_be_used_is_refused(tmp_path, monkeypatch, robot, words):
    monkeypatch.chdir(tmp_path)
    Path("robot.toml").write_text(robot)
    with pytest.raises(SettingsError) as refused:
        robot_named("robot.toml")
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_sets_options_and_options_win_over_it(tmp_path):
    text = 'noise = 0.03\nseed = 7\npreset = "paper"\nlimit = true\nmax_time = 5'
    options = run_options(given(tmp_path, text, seed=8, limit=False))
    assert options == RunOptions(noise=0.03, seed=8, preset="paper", max_time=5.0, limit=False)


def test_noise_on_the_command_line_is_true_and_assumed(tmp_path):
    text = "noise = 0.01\n[agent.noise]\nrange_std = 0.03\nwheel_variance = 1e-4\n"
    by_file, by_option = (
        config_of(given(tmp_path, text, **options)) for options in ({}, {"noise": 0.04})
    )
    assert (by_file.noise, by_file.agent.noise.range_std) == (0.01, 0.03)
    assert (by_option.noise, by_option.agent.noise.range_std) == (0.04, 0.04)
    assert by_option.agent.noise.wheel_variance == 1e-4


def test_paths_of_a_file_are_relative_to_it(tmp_path):
    options = given(tmp_path, 'log = "logs/a.clf"\nrelations = "/known"').merged(ReplayOptions())
    assert (options.log, str(options.relations)) == (tmp_path / "logs" / "a.clf", "/known")
    assert run_options(given(tmp_path, 'world = "mine.yaml"')).world == str(tmp_path / "mine.yaml")
    assert run_options(given(tmp_path, 'world = "env2"')).world == "env2"
    assert run_options(given(tmp_path, 'world = "a.toml"', world="b.toml")).world == "b.toml"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("warp = 9", "mine.toml: warp: there is no such setting; there are world, noise"),
        ('seed = "many"', "mine.toml: seed: must be a whole number, not 'many'"),
        (
            '[agent.policy]\nuntil = "seen"',
            "mine.toml: agent.policy.until: is set as until, outside of all tables",
        ),
        ('policy = "magic"', "mine.toml: policy: no policy is called 'magic'"),
        (
            "[agent.estimator.buffer]\nsize = 3",
            "mine.toml: agent.estimator.buffer: there is no such setting",
        ),
        (
            "[true_noise]\nsensor_noise = 0.1",
            "mine.toml: true_noise.sensor_noise: there is no such setting",
        ),
        ("seed = ", "mine.toml: is not TOML"),
        ("[agent]\nspeed = 1", "mine.toml: agent.speed: there is no such setting; there are "),
        ("[agent]\ngrid = 3", "mine.toml: agent.grid: must be a table, not 3"),
        ("[agent.grid]\ncell = 'big'", "mine.toml: agent.grid.cell: must be a number, not 'big'"),
        ("[agent.grid]\ncell = nan", "mine.toml: agent.grid: cell must be a number from"),
        ("[agent.grid]\nhit = 1.5", "mine.toml: agent.grid.hit: must be a whole number, not 1.5"),
        (
            "[agent.estimator.merging]\nenabled = 1",
            "mine.toml: agent.estimator.merging.enabled: must be true or false",
        ),
        (
            "[agent.estimator.pending]\nbatch = 0",
            "agent.estimator.pending: batch must be a whole number from 1 to",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_by_file_and_key(text, words, tmp_path):
    with pytest.raises(ValueError, match=r".") as error:
        config_of(given(tmp_path, text))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_the_version_is_that_of_the_package():
    from importlib.metadata import version

    result = limslam("--version")
    assert (result.returncode, result.stdout) == (0, f"limslam {version('limslam')}\n")


def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise():
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    code = (
        "import os, sys; from limslam_agent.__main__ import main\n"
        "assert 'numpy' not in sys.modules\n"
        "sys.argv = ['limslam', '--version']\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        f"print(*(os.environ[name] for name in {names}))\n"
    )
    bare = {name: value for name, value in os.environ.items() if name not in names}
    for environment, words in (
        (bare, ["1", "1", "1"]),
        ({**bare, "OMP_NUM_THREADS": "2"}, ["1", "2", "1"]),
    ):
        result = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env=environment,
        )
        assert result.stdout.split()[2:] == words


def test_a_run_takes_a_robot_by_its_name_or_from_its_file(tmp_path):
    assert config_of(given(tmp_path, robot="e_puck")).robot == ROBOTS["e-puck"]()
    (tmp_path / "robot.toml").write_text("radius = 0.1\naxle = 0.2\n")
    told = config_of(Given.read(None, {"robot": str(tmp_path / "robot.toml")})).robot
    assert told == replace(RobotSpec(), axle=0.2)
    by_table = Given(tmp_path / "run.toml", {"robot": {"axle": 0.3}}, {"robot": "ring"})
    assert config_of(by_table).robot == ROBOTS["ring"]()


def test_the_errors_of_the_simulated_robot_are_options_that_win_over_the_file(tmp_path):
    text = "[true_noise]\nslip_rate = 0.2\nwheel_mismatch = 0.01\n"
    told = config_of(given(tmp_path, text, wheel_mismatch=0.02))
    assert told.true_noise == NoiseConfig(slip_rate=0.2, wheel_mismatch=0.02)
    assert told.agent.noise == NominalNoise(told.noise)  # the agent is not told


def test_odometry_noise_is_true_and_assumed(tmp_path):
    told = config_of(given(tmp_path, "[agent.noise]\nwheel_variance = 1e-3\n", odometry_noise=0.01))
    assert told.true_noise.wheel_variance == told.agent.noise.wheel_variance == pytest.approx(1e-4)


def test_sharp_sensors_leave_the_wheels_as_they_are(tmp_path):
    told = config_of(
        given(tmp_path, "[true_noise]\nslip_rate = 0.2\ndropout = 0.1\n", sharp=True)
    ).true_noise
    assert told == NoiseConfig.sharp(slip_rate=0.2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"robot": "magic"},
            "--robot: no robot is called 'magic'; there are paper, e-puck, four-beam-drone, ring",
        ),
        (
            {"wheel_mismatch": 3.0},
            "--wheel-mismatch: wheel_mismatch must be a number from -0.5 to 0.5",
        ),
        ({"odometry_noise": math.nan}, "--odometry-noise must be a number from 0 to 1, not nan"),
    ],
)
def test_an_option_of_the_simulated_robot_that_cannot_be_is_refused_by_its_name(
    options, words, tmp_path
):
    with pytest.raises(ValueError, match=r".") as error:
        config_of(given(tmp_path, **options))
    assert str(error.value).startswith(words)
