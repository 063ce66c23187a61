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


def test_running_the_package_says_what_it_is_and_names_the_command():
    result = subprocess.run([sys.executable, "-m", "limslam_agent"], capture_output=True, text=True, check=True)
    assert "limslam run" in result.stdout
    assert len(result.stdout.splitlines()) < 10
