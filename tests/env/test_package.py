"""The public names of the package."""

import importlib

import pytest

import limslam_env


@pytest.mark.parametrize("name", limslam_env.__all__)
def test_every_public_name_is_there(name):
    value = getattr(limslam_env, name)
    assert name in dir(limslam_env)
    if hasattr(value, "__module__") and callable(value):
        assert getattr(importlib.import_module(value.__module__), name) is value


def test_other_names_are_not_there():
    with pytest.raises(AttributeError, match="'limslam_env' has no attribute 'Simulation'"):
        limslam_env.Simulation  # noqa: B018
