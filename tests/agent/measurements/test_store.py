"""Results in a folder: nothing lost, nothing twice, nothing of another series of runs among them."""

import json
from dataclasses import asdict, dataclass, field, replace

import pytest

from limslam_agent.measurements.store import RESULTS, BaseStamp, Format, open_store, read_rows, read_stamp, rows_once


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
    with pytest.raises(ValueError, match=r"two different rows claim the same job .*: their metrics differ"):
        rows_once(FORM, [*ROWS, replace(again, metrics={})])


def test_results_that_are_not_there(folder, tmp_path):
    with pytest.raises(ValueError, match="no results there: No such file"):
        read_rows(FORM, tmp_path / "nowhere")
    assert len(json.loads((folder / "stamp.json").read_text())) == len(asdict(STAMP))
