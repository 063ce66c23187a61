"""The names that users import from `limslam_agent`, and what the package says when it is run."""

import subprocess
import sys

import pytest

import limslam_agent


@pytest.mark.parametrize("name", limslam_agent.__all__)
def test_a_public_name_is_the_object_of_that_name(name):
    assert getattr(limslam_agent, name).__name__ == name


def test_dir_lists_the_public_names():
    assert dir(limslam_agent) == sorted(limslam_agent.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'mind'"):
        _ = limslam_agent.mind


def test_running_the_package_is_the_command():
    command = [sys.executable, "-m", "limslam_agent", "replay", "no_such_log.csv"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (
        2,
        "limslam: no_such_log.csv: cannot be read: No such file or directory\n",
    )
