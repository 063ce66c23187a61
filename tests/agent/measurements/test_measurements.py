"""Results in a folder, and statistics over them."""

import json
import math
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import pytest
from scipy import stats

from limslam_agent.measurements.statistics import (
    Estimate,
    estimate,
    geometric_ratio,
    holm,
    mean,
    median,
    number,
    paired,
    signed_rank,
)
from limslam_agent.measurements.store import (
    RESULTS,
    BaseStamp,
    Format,
    open_store,
    read_rows,
    read_stamp,
    rows_once,
)


@dataclass(frozen=True)
class Row:
    job: int
    metrics: dict[str, float | str | None]
    cost: dict[str, float] = field(default_factory=dict, compare=False)
    error: str | None = None


@dataclass(frozen=True)
class Stamp(BaseStamp):
    suite: str

    @property
    def identity(self):
        return {"another suite": self.suite}


FORM = Format("made-up results", "stamp.json", Stamp, Row, lambda row: row.job)
STAMP = Stamp({"python": "3.11", "numpy": "2.0"}, "abc", "tiny")
ROWS = [Row(0, {"ate_m": 0.1, "doors": None}, {"job_s": 1.0}), Row(1, {}, error="it broke")]


@pytest.fixture
def folder(tmp_path):
    """A folder with one good row and one failed one."""
    with open_store(FORM, tmp_path / "out", STAMP) as store:
        for row in ROWS:
            store.append(row)
    return tmp_path / "out"


def test_what_is_there_is_known_at_the_next_start(folder):
    assert read_rows(FORM, folder) == ROWS
    assert read_stamp(FORM, folder) == STAMP
    with open_store(FORM, folder, STAMP) as store:
        assert list(store.rows) == [0, 1]
    with open_store(FORM, folder, STAMP, keep=lambda row: row.error is None) as store:
        assert list(store.rows) == [0]
        store.append(replace(ROWS[1], error=None))
    assert [row.error for row in read_rows(FORM, folder)] == [None, None]


def test_a_torn_line_is_mended_wherever_it_was_torn(folder):
    content = (folder / RESULTS).read_bytes()
    for end in range(content.index(b"\n") + 1, len(content), 7):
        (folder / RESULTS).write_bytes(content[:end])
        assert read_rows(FORM, folder) == ROWS[:1], "those who only read leave the torn line out"
        with open_store(FORM, folder, STAMP) as store:
            store.append(ROWS[1])
        assert (folder / RESULTS).read_bytes() == content


def test_what_a_kill_left_half_written_is_removed(folder):
    left = folder / ".results.jsonl.limslam-new.jsonl"
    left.write_bytes(b"half")
    with open_store(FORM, folder, STAMP):
        assert not left.exists()


def refusal(folder, stamp=STAMP):
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(ValueError) as caught, open_store(FORM, folder, stamp):
        pass
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert str(caught.value).startswith(str(folder))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (replace(STAMP, suite="other"), "holds results of another suite: choose another folder"),
        (replace(STAMP, versions={"python": "3.11", "numpy": "2.1"}), "numpy 2.0, now 2.1"),
        (replace(STAMP, commit="abc-dirty"), "commit abc, now abc-dirty"),
    ],
)
def test_another_suite_version_or_commit_is_refused_with_the_reason(folder, changed, reason):
    assert reason in refusal(folder, changed)


def test_folders_of_something_else_and_two_at_once_are_refused(folder, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    assert "is not empty and holds no made-up results" in refusal(tmp_path / "mine")
    (folder / "stamp.json").write_text("[]")
    assert "is damaged" in refusal(folder)
    with open_store(FORM, tmp_path / "new", STAMP):
        assert "another run is writing there" in refusal(tmp_path / "new")


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("{", "no row"),
        ('{"speed": 1}', "no row"),
        ('{"job": "1", "metrics": {}}', "job is '1'"),
        ('{"job": 1, "metrics": {"x": []}}', "metrics is"),
        ('{"job": 1, "metrics": {"x": NaN}}', "NaN is no number of a result"),
        ('{"job": 1, "metrics": {"x": 1' + "0" * 400 + "}}", "is no number of a result"),
    ],
)
def test_a_line_that_is_no_row_is_refused_in_one_line_with_its_number(folder, line, reason):
    with (folder / RESULTS).open("a") as file:
        file.write(line + "\n")
    with pytest.raises(ValueError, match=r"results.jsonl, line 3: ") as caught:
        read_rows(FORM, folder)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_job_that_was_done_twice_is_counted_once_at_any_cost():
    again = replace(ROWS[0], cost={"job_s": 99.0})
    assert rows_once(FORM, [*ROWS, again]) == ROWS
    with pytest.raises(
        ValueError, match=r"two different rows claim the same job .*: their metrics differ"
    ):
        rows_once(FORM, [*ROWS, replace(again, metrics={})])


def test_results_that_are_not_there(folder, tmp_path):
    with pytest.raises(ValueError, match="no results there: No such file"):
        read_rows(FORM, tmp_path / "nowhere")
    assert len(json.loads((folder / "stamp.json").read_text())) == len(asdict(STAMP))


RNG = np.random.default_rng(3)


def test_medians_and_means_by_hand():
    assert median([4.0, 1.0, 3.0, 2.0]).value == 2.5
    assert mean([4.0, 1.0, 4.0]).value == 3.0
    assert median([]) is None
    assert median([7.0, 7.0]) == Estimate(7.0, None, None, 2)
    assert median([7.0, 7.0, 7.0]) == Estimate(7.0, 7.0, 7.0, 3)


def test_intervals_are_those_of_scipy_up_to_the_drawing():
    values = RNG.normal(50.0, 10.0, 100)
    for ours, statistic in ((median(values), np.median), (mean(values), np.mean)):
        theirs = stats.bootstrap(
            (values,), statistic, method="percentile", rng=RNG
        ).confidence_interval
        assert ours.value == pytest.approx(statistic(values), rel=1e-12)
        assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=0.5)
    assert median(values) == median(values)


def test_intervals_of_the_median_hold_the_truth_about_as_often_as_they_say():
    found = [median(values) for values in RNG.normal(size=(400, 15))]
    covered = np.mean([each.low <= 0.0 <= each.high for each in found])
    assert 0.90 <= covered <= 0.99


def test_only_the_first_axis_is_resampled():
    # Columns that differ among themselves say nothing about other rows.
    found = estimate(
        lambda drawn: drawn.mean(axis=(1, 2)), np.tile(np.linspace(0.0, 1.0, 9), (3, 1))
    )
    assert found.low == pytest.approx(found.value) == found.high


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (Estimate(0.123, 0.1, 0.2, 9), "0.12 [0.10, 0.20]"),
        (Estimate(0.123, None, None, 2), "0.12"),
        (Estimate(0.123, 0.1231, 0.1232, 9), "0.12"),
        (Estimate(-0.001, -0.2, 1e6, 9), "0.00 [-0.20, 1e+06]"),
    ],
)
def test_estimates_as_text(found, text):
    assert found.text(2) == text
    assert number(None, 2) == "\N{EN DASH}"


def test_pairs_by_hand():
    first = {1: 1.0, 2: 2.0, 3: None, 4: 4.0, 5: 0.0}
    second = {1: 2.0, 2: 6.0, 3: 1.0, 5: 3.0, 6: 1.0}
    found = paired(first, second)
    assert (found.first.tolist(), found.second.tolist()) == ([1.0, 2.0, 0.0], [2.0, 6.0, 3.0])
    assert (found.left_out, found.unpaired) == (1, 2)
    assert found.difference.value == 3.0
    assert (found.ratio.value, found.ratio.count) == (2.5, 2)
    assert paired({1: 1.0}, {2: 1.0}).difference is None


def test_ratios_are_geometric_means_with_two_standard_errors():
    found = geometric_ratio([1.0, 2.0], [2.0, 2.0], 0.0)
    # The logarithms are ln 2 and 0, so their standard deviation is ln 2 / sqrt(2), and two standard
    # errors are ln 2.
    assert np.allclose(
        [found.value, found.low, found.high], [math.sqrt(2.0), math.sqrt(0.5), 2.0 * math.sqrt(2.0)]
    )
    alone = geometric_ratio([1.0], [1.5], 0.1)
    assert np.allclose(
        [alone.value, alone.low, alone.high], [1.5, 1.5 * math.exp(-0.2), 1.5 * math.exp(0.2)]
    )
    assert geometric_ratio([], [], 0.1) is None


def test_differences_are_tested():
    assert signed_rank(np.full(15, 3.0)) < 0.001
    assert signed_rank(np.zeros(5)) is None


def test_p_values_are_corrected_for_the_number_of_tests():
    assert holm([0.01, None, 0.04, 0.03]) == pytest.approx([0.03, None, 0.06, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []
