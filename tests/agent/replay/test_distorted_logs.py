"""Logs of simulated drives that are written as hobby firmware and converters write them."""

from pathlib import Path

import numpy as np
import pytest
from support.distorted_logs import clean_error, main, replayed, simulated
from support.distortions import KINDS, Drive, distorted


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulated(0, seconds=20.0)


@pytest.fixture(scope="module")
def clean(drive: Drive) -> float:
    return clean_error(drive, by_poses=False)


@pytest.mark.parametrize("kinds", [["units_by_options"], ["ticks_per_row", "crlf"], ["late_rows"]])
def test_a_drive_is_as_right_as_from_a_clean_table(
    tmp_path: Path, drive: Drive, clean: float, kinds: list[str]
) -> None:
    sheet = distorted(drive, kinds, np.random.default_rng(0))
    outcome = replayed(drive, sheet, tmp_path, "log", kinds, clean)
    assert outcome.verdict == "right", outcome


def test_distortions_that_change_the_same_are_not_combined(drive: Drive) -> None:
    with pytest.raises(ValueError, match="crlf and tabs do not go together"):
        distorted(drive, ["crlf", "tabs"], np.random.default_rng(0))


@pytest.mark.slow
def test_no_distorted_log_is_wrong_in_silence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(tmp_path), "--number", str(len(KINDS)), "--drives", "6", "--seed", "3"])
    counts = capsys.readouterr().out.splitlines()[-1].split()
    assert counts[0] == "all"
    assert counts[5] == "0"
