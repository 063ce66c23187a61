"""Settings: presets, bounds, ablations, and TOML tables."""

import math
from dataclasses import fields, is_dataclass, replace
from typing import get_type_hints

import pytest

from limslam_agent import AgentConfig, preset
from limslam_agent.cli.settings import Given, run_config, run_options
from limslam_agent.config.ablations import ABLATIONS, NO_GATE, ablated
from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import PRESETS, GridConfig, HoughConfig, PolicyConfig, PublishedConfig
from limslam_agent.config.tables import SettingsError, read_toml, table_of, updated, write_toml
from limslam_env import NominalNoise, RobotSpec
from limslam_env.robots import ROBOTS

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
    return [field.name for field in fields(group) if type(getattr(group, field.name)) in {int, float}]


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_chooses_the_estimator_by_the_type_of_its_settings(name):
    config = preset(name, NominalNoise(0.03))
    assert type(config.estimator) is KINDS[name]
    assert (config.preset, config.noise.range_std) == (name, 0.03)


def test_an_unknown_preset_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="no preset is called 'magic'; there are consistent, paper, odometry, graph"):
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
            with pytest.raises(ValueError, match=f"^{number} must be a number from"):
                replace(group, **{number: bounds[0].high * 2.0 + 1.0})
            with pytest.raises(ValueError, match=f"^{number} must be"):
                replace(group, **{number: math.nan})
            checked += 1
    assert checked >= 38


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_changes_one_setting(ablation):
    before, after = preset("paper"), ablated(preset("paper"), ablation)
    changed = [
        (name, getattr(new, name))
        for old, new in zip(groups(before), groups(after), strict=True)
        for name in (field.name for field in fields(old))
        if not is_dataclass(getattr(old, name)) and getattr(old, name) != getattr(new, name)
    ]
    assert changed in ([("correct", False)], [("enabled", False)], [("max_end_gap", NO_GATE)], [("only_best", True)])


def round_trip(settings, start, path):
    write_toml(path, table_of(settings), "settings")
    return updated(start, read_toml(path), str(path))


@pytest.mark.parametrize("name", PRESETS)
def test_settings_come_back_from_a_file_as_they_were(name, tmp_path):
    config = replace(preset(name, NominalNoise(1 / 3)), grid=GridConfig(cell=0.1 + 0.2), policy=PolicyConfig(speed=0.1))
    config = replace(config, estimator=replace(config.estimator, hough=HoughConfig(r_step=math.pi / 100)))
    assert round_trip(config, preset(name), tmp_path / "agent.toml") == config


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_comes_back_from_a_file_as_it_was(name, tmp_path):
    assert round_trip(ROBOTS[name](), RobotSpec(), tmp_path / "robot.toml") == ROBOTS[name]()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"speed": 1}, "f: agent.speed: there is no such setting; there are "),
        ({"grid": 3}, "f: agent.grid: must be a table, not 3"),
        ({"grid": {"cell": "big"}}, "f: agent.grid.cell: must be a number, not 'big'"),
        ({"grid": {"hit": 1.5}}, "f: agent.grid.hit: must be a whole number, not 1.5"),
        ({"estimator": {"merging": {"enabled": 1}}}, "f: agent.estimator.merging.enabled: must be true or false"),
        ({"estimator": {"pending": {"batch": 0}}}, "f: agent.estimator.pending: batch must be a number from 1 to"),
        ({"grid": {"cell": math.nan}}, "f: agent.grid: cell must be a number from"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_by_file_and_key(table, words):
    with pytest.raises(SettingsError, match=f"^{words}"):
        updated(AgentConfig(), table, "f: agent")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"beams": [{"x": 0.1, "y": 0.0}]}, r"f: robot.beams\[0\].angle: is missing"),
        ({"beams": [{"x": 0.1, "y": 0.0, "angle": 0, "side": "up"}]}, r"f: robot.beams\[0\].side: must be one of left"),
        ({"radius": -0.1}, "f: robot: a robot's radius must be positive, not -0.1"),
    ],
)
def test_a_robot_that_cannot_be_is_refused_by_file_and_key(table, words):
    with pytest.raises(SettingsError, match=f"^{words}"):
        updated(RobotSpec(), table, "f: robot")


def test_a_file_that_is_not_toml_is_refused_by_its_name(tmp_path):
    path = tmp_path / "broken.toml"
    for content in (b"a = ", b"\xff"):
        path.write_bytes(content)
        with pytest.raises(SettingsError, match=r"broken\.toml: is not TOML"):
            read_toml(path)
    with pytest.raises(SettingsError, match=r"missing\.toml: cannot be read"):
        read_toml(tmp_path / "missing.toml")


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
