"""How fast a run is: the parts of a step add up to less than the step, and the table has a row for each world."""

import pytest

from benchmarks.speed import run
from limslam_agent.slam.slam import LineSlam


def test_parts_of_a_step() -> None:
    step = LineSlam.step
    parts = run.parts_of_step("square", max_time=3.0)
    assert LineSlam.step is step
    assert set(parts) == {*run.PARTS, "all"}
    assert 0.0 < parts["SLAM"] < parts["observing, all of it"] < parts["all"]
    assert parts["deciding, all of it"] + parts["simulation"] < parts["all"]


def test_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    run.main(["--runs", "1", "--max-time", "2", "square"])
    heading, _, row = capsys.readouterr().out.splitlines()
    assert len(heading.split("|")) == len(row.split("|"))
    assert float(row.split("|")[2]) > 0.0
