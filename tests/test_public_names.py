"""Public names of both packages."""

import importlib
import subprocess
import sys
from importlib.metadata import version

import pytest

import limslam_agent
import limslam_env


@pytest.mark.parametrize("name", limslam_agent.__all__)
def test_a_public_name_is_the_object_of_that_name(name):
    assert getattr(limslam_agent, name).__name__ == name


def test_dir_lists_the_public_names():
    assert dir(limslam_agent) == sorted(limslam_agent.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'mind'"):
        _ = limslam_agent.mind


def test_both_packages_have_the_version_of_the_distribution():
    assert limslam_agent.__version__ == limslam_env.__version__ == version("limslam")


def test_running_the_package_is_the_command():
    command = [sys.executable, "-m", "limslam_agent", "replay", "no_such_log.csv"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (
        2,
        "limslam: no_such_log.csv: cannot be read: No such file or directory\n",
    )


@pytest.mark.parametrize("name", limslam_env.__all__)
def test_every_public_name_is_there(name):
    value = getattr(limslam_env, name)
    assert name in dir(limslam_env)
    if hasattr(value, "__module__") and callable(value):
        assert getattr(importlib.import_module(value.__module__), name) is value


def test_other_names_are_not_there():
    with pytest.raises(AttributeError, match="'limslam_env' has no attribute 'Simulation'"):
        limslam_env.Simulation  # noqa: B018
