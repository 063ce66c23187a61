"""The leaderboard: the order of entries, and its page in a headless Chromium."""

import json
import re

import pytest
from support.arena import MANIFEST, made_entry, made_results
from support.browser import needs_chromium
from support.command_line import limslam, told

from limslam_agent.arena.leaderboard import board
from limslam_agent.arena.page import INSPECTOR, write_board
from limslam_agent.arena.results import RUNS
from limslam_agent.measurements.store import RESULTS

TIMES = {
    "Slow": dict.fromkeys(range(8), 200.0),
    "Fast": {plan: 100.0 + plan for plan in range(8)},
    "Wrong <b>": {**dict.fromkeys(range(6), 90.0), 6: 240.0, 7: 240.0},
}


REMOVED = "removed"


@pytest.fixture
def folders(tmp_path):
    made = []
    for name, times in TIMES.items():
        entry = made_entry(tmp_path / "entries" / name[:4], MANIFEST.format(name=name))
        made.append(made_results(tmp_path / name[:4], entry, times, claims=(7,)))
    return made


def test_the_mean_time_decides_and_lost_plans_cost_the_longest_time(folders):
    found = board(folders)
    assert [(each.name, each.place) for each in found.standings] == [
        ("Fast", 1),
        ("Wrong <b>", 2),
        ("Slow", 3),
    ]
    fast, wrong, slow = found.standings
    assert wrong.score.value == pytest.approx((6 * 90.0 + 2 * 240.0) / 8)
    assert (wrong.solved, wrong.claimed) == (6, 1)
    assert slow.score.low == slow.score.high == 200.0
    first = found.comparisons[0]
    assert (first.first, first.second, first.difference.count) == ("Fast", "Wrong <b>", 8)
    assert first.difference.value == pytest.approx(wrong.score.value - fast.score.value)


def test_equal_scores_share_a_place(tmp_path):
    made = []
    for name in ("First", "Second", "Third"):
        entry = made_entry(tmp_path / "entries" / name, MANIFEST.format(name=name))
        made.append(made_results(tmp_path / name, entry, {0: 100.0 if name != "Third" else 240.0}))
    found = board(made)
    assert [(each.name, each.place, each.score.value) for each in found.standings] == [
        ("First", 1, 100.0),
        ("Second", 1, 100.0),
        ("Third", 3, 240.0),
    ]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        *(
            ({name: REMOVED}, f"the metric {name} is missing")
            for name in ("lost", "touches", "plan_time_to_95_s", "anees_final")
        ),
        ({"plan_time_to_95_s": -1e99}, "the metric plan_time_to_95_s is -1e"),
        ({"plan_time_to_80_s": 241.0}, "the metric plan_time_to_80_s is 241"),
        ({"correct_coverage": 1.5}, "the metric correct_coverage is 1.5"),
        ({"ate_final_m": -0.1}, "the metric ate_final_m is -0.1"),
        ({"touches": "none"}, "the metric touches is 'none'"),
        ({"lost": None}, "the metric lost is None, and the others say ''"),
        ({"correct_coverage": 0.5}, "the others say 'claims to be done and is not'"),
        ({"correct_coverage": 0.5, "lost": "claims to be done and is not"}, "takes the longest"),
    ],
)
def test_rows_that_no_run_can_have_are_refused(folders, changes, reason):
    path = folders[0] / RESULTS
    first, *rest = path.read_text().splitlines()
    row = json.loads(first)
    metrics = {**row["metrics"], **changes}
    row["metrics"] = {name: each for name, each in metrics.items() if each != REMOVED}
    path.write_text("\n".join([json.dumps(row), *rest]) + "\n")
    with pytest.raises(ValueError, match=re.escape(reason)) as refusal:
        board(folders)
    assert "line 1: is no row of results" in str(refusal.value)


def test_entries_are_compared_on_the_plans_that_all_have_run(folders, tmp_path):
    entry = made_entry(tmp_path / "entries" / "few", MANIFEST.format(name="Few"))
    few = made_results(tmp_path / "few", entry, {6: 10.0, 40: 10.0})
    found = board([*folders, few])
    assert found.plans == [6]
    assert found.standings[0].name == "Few"
    assert found.standings[0].score.low is None


@pytest.mark.parametrize(
    ("seed", "times", "reason"),
    [(5, {0: 10.0}, "has other plans than"), (0, {50: 10.0}, "have no plan in common")],
)
def test_results_that_cannot_be_compared_are_refused(folders, tmp_path, seed, times, reason):
    entry = made_entry(tmp_path / "entries" / "other", MANIFEST.format(name="Other"))
    other = made_results(tmp_path / "other", entry, times, seed=seed)
    with pytest.raises(ValueError, match=reason):
        board([*folders, other])
    with pytest.raises(ValueError, match="is there twice"):
        board([folders[0], folders[0]])


def test_the_command_writes_the_page_and_a_table(folders, tmp_path):
    words = ("arena", "page", *folders, "--out", tmp_path / "board.html")
    finished = told(*words)
    assert "compared    8 of 100 plans" in finished
    assert "1      Fast" in finished
    assert limslam(*words).returncode == 2
    told(*words, "--force")


@pytest.fixture
def opened(chromium, folders, tmp_path):
    run = folders[1] / RUNS / "003"
    run.mkdir(parents=True)
    (run / INSPECTOR).write_text("<!doctype html><title>run 3</title><body data-state='ready'>")
    (folders[1] / RUNS / "004").mkdir()
    (tmp_path / "site").mkdir()
    write_board(tmp_path / "site" / "board.html", board(folders))
    chromium.open(tmp_path / "site" / "board.html")
    yield chromium
    assert chromium.errors == []
    assert chromium.requests == []


def column_of(opened, table, number):
    cells = (
        f"[...document.querySelectorAll('#{table} tbody tr')].map((row) => "
        f"row.cells[{number}].textContent)"
    )
    return opened.run(cells)


@needs_chromium
def test_the_page_shows_entries_runs_and_curves(opened):
    assert column_of(opened, "entries", 1) == ["Fast", "Wrong <b>", "Slow"]
    assert column_of(opened, "entries", 0) == ["1", "2", "3"]
    assert column_of(opened, "pairs", 0) == ["Fast", "Fast", "Wrong <b>"]
    assert column_of(opened, "pairs", 1) == ["Wrong <b>", "Slow", "Slow"]
    assert opened.run("plot.series.length") == 4
    drawn = (
        "new Set(new Uint32Array(plot.ctx.getImageData(0, 0, plot.ctx.canvas.width, "
        "300).data.buffer)).size"
    )
    assert opened.run(drawn) > 20
    # Wrong has solved six of its eight plans after 90 s, and no more at the end.
    assert opened.run("plot.data[2][plot.data[0].findIndex((time) => time >= 90)]") == 0.75
    assert opened.run("plot.data[2].at(-1)") == 0.75


@needs_chromium
def test_a_name_shows_the_runs_of_its_entry_and_a_run_opens_in_the_inspector(opened):
    opened.page.click("#entries tbody tr:nth-child(2) td:nth-child(2) button")
    assert opened.run("document.getElementById('runs-title').textContent") == "Runs of Wrong <b>"
    assert "lost: not explored in time" in column_of(opened, "runs", 5)
    opened.page.click("#entries tbody tr:nth-child(1) td:nth-child(2) button")
    assert "limslam inspect" in column_of(opened, "runs", 13)[4]
    headings = opened.run(
        "[...document.querySelectorAll('#runs th')].map((cell) => cell.innerText)"
    )
    assert headings[6:13] == [
        "80 % after, s",
        "95 % after, s",
        "Correct coverage",
        "ATE, m",
        "F1 at 5 cm",
        "NEES/3",
        "Touches",
    ]
    opened.page.click("#runs tbody tr:nth-child(4) a")
    opened.wait_for("document.title === 'run 3'")


@needs_chromium
def test_all_columns_fit_a_window_of_1280_pixels(opened):
    opened.page.set_viewport_size({"width": 1280, "height": 800})
    for table in ("entries", "runs", "pairs"):
        frame = f"document.getElementById('{table}').parentElement"
        assert opened.run(f"{frame}.scrollWidth <= {frame}.clientWidth"), table


@needs_chromium
def test_a_single_entry_has_no_comparisons(chromium, tmp_path):
    entry = made_entry(tmp_path / "entries" / "one", MANIFEST.format(name="One"))
    alone = made_results(tmp_path / "one", entry, {0: 120.0})
    write_board(tmp_path / "alone.html", board([alone]))
    chromium.open(tmp_path / "alone.html")
    assert not chromium.page.is_visible("#pairs-section")
    summary = chromium.page.inner_text("#summary")
    assert summary.startswith("1 plan,")
    assert "Intervals" not in summary
