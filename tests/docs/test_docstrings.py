"""The examples in the docstrings of public names run, and give what they say."""

import doctest
import inspect
import warnings

import pytest

import limslam_agent
import limslam_env

PUBLIC = [
    (package.__name__, name)
    for package in (limslam_env, limslam_agent)
    for name in package.__all__
    if callable(getattr(package, name))
]


@pytest.mark.parametrize(("package", "name"), PUBLIC)
def test_the_example_of_a_public_name_runs(package, name):
    thing = getattr({"limslam_env": limslam_env, "limslam_agent": limslam_agent}[package], name)
    finder = doctest.DocTestFinder(recurse=False)
    (test,) = finder.find(thing, name, module=inspect.getmodule(thing), globs={})
    assert test.examples, f"{package}.{name} has no example"
    lines = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test, out=lines.append)
    assert not lines, "".join(lines)
