"""Entries on short plans."""

from dataclasses import replace
from pathlib import Path

import pytest
from support.arena import MANIFEST, made_entry
from support.markdown import ROOT

from limslam_agent.arena.tracks import plans_of


@pytest.fixture
def examples() -> Path:
    folder = ROOT / "examples" / "arena"
    if not folder.is_dir():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    return folder


@pytest.fixture
def short_plans():
    """Plans of two seconds."""
    return [replace(plan, max_time=2.0) for plan in plans_of()[:3]]


@pytest.fixture
def entry(tmp_path):
    return made_entry(tmp_path / "entry", MANIFEST.format(name="Short"))
