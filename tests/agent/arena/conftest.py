"""Entries on short plans."""

from pathlib import Path

import pytest
from support.arena import MANIFEST, made_entry
from support.arena import short_plans as plans_of_two_seconds
from support.markdown import ROOT


@pytest.fixture
def examples() -> Path:
    folder = ROOT / "examples" / "arena"
    if not folder.is_dir():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    return folder


@pytest.fixture
def short_plans():
    return plans_of_two_seconds()


@pytest.fixture
def entry(tmp_path):
    return made_entry(tmp_path / "entry", MANIFEST.format(name="Short"))
