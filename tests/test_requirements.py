"""The minimum versions in ``pyproject.toml`` agree with what the required packages require
themselves.
"""

import tomllib
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
if not PROJECT.is_file():
    pytest.skip("pyproject.toml is in a checkout", allow_module_level=True)

CONTENT = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
ALWAYS = {canonicalize_name(Requirement(each).name) for each in CONTENT["dependencies"]}
OURS = {
    canonicalize_name(each.name): each
    for part in (CONTENT["dependencies"], *CONTENT["optional-dependencies"].values())
    for each in map(Requirement, part)
}


def minimum(requirement):
    """The lower bound of a requirement; None if it has none."""
    bounds = [
        Version(each.version)
        for each in requirement.specifier
        if each.operator in {">=", "~=", "=="}
    ]
    return max(bounds, default=None)


def theirs(name):
    """What an installed package always requires of packages that the project names too."""
    try:
        listed = [Requirement(each) for each in requires(name) or []]
    except PackageNotFoundError:
        return []
    always = (each for each in listed if each.marker is None or each.marker.evaluate({"extra": ""}))
    return [each for each in always if canonicalize_name(each.name) in OURS]


@pytest.mark.parametrize("name", sorted(OURS))
def test_no_required_package_contradicts_a_minimum(name):
    for other in theirs(name):
        required = canonicalize_name(other.name)
        ours = minimum(OURS[required])
        needed = minimum(other)
        if ours is None:
            continue
        # An extra may need a newer version of a package than the project without that extra.
        if needed is None or needed <= ours:
            assert other.specifier.contains(ours), (
                f"{name} requires {other}, which forbids the minimum {ours}"
            )
        else:
            assert name not in ALWAYS, f"{name} requires {other}, and pyproject.toml says {ours}"
            assert required in ALWAYS, f"{name} requires {other}, and pyproject.toml says {ours}"


def test_every_runtime_requirement_has_a_minimum():
    assert [
        name for name in map(Requirement, CONTENT["dependencies"]) if minimum(name) is None
    ] == []


def test_locks_know_a_removed_file():
    """Before 3.21, two processes could hold a lock on the same path, one of them on a removed
    file.
    """
    assert minimum(OURS["filelock"]) >= Version("3.21")
