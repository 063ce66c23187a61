"""Tables: what is in them, what is missing in them, and that failures are never dropped."""

import json
import re
from dataclasses import asdict, replace

import numpy as np
import pytest

from benchmarks.analysis.tables import sheets, table
from benchmarks.suite.store import Row, read_rows
from limslam_agent.measurements.statistics import MISSING


def row(
    world="env1",
    noise=0.0,
    seed=0,
    *,
    robots=1,
    policy="frontier",
    laps=0,
    ablation=None,
    preset="paper",
    **other,
):
    """A row whose metrics are drawn from its seed; ``other`` are metrics, or fields of the row."""
    rng = np.random.default_rng([seed, robots, int(1000 * noise), len(world)])
    metrics = {
        "wall_f1": 0.9 - rng.uniform(0.0, 0.1) - noise,
        "wall_f1_aligned": 0.95 - rng.uniform(0.0, 0.05),
        "wall_f1_5cm": 0.7,
        "wall_recall": 0.9,
        "spurious_walls": int(100 * noise) + int(rng.integers(0, 2)),
        "doors_open": None,
        "ate_m": 0.1 + noise + rng.uniform(0.0, 0.05),
        "odometry_ate_m": 0.8,
        "anees": 2.0,
        "exploration_time_s": None if laps else 200.0 / robots + rng.uniform(0.0, 9.0),
        "coverage_true": 0.99,
        "association_right_share": 0.9,
        "heading_rmse_deg": 1.0,
        "odometry_heading_rmse_deg": 5.0,
        "stop_reason": "explored: no frontier is left",
        "time_to_50_s": 40.0,
        "time_to_90_s": 80.0,
        "time_to_95_s": 90.0,
        "path_m": 30.0,
        "collisions": 0,
    }
    fields = {name: other.pop(name) for name in list(other) if name in Row.__dataclass_fields__}
    key = f"{world}-{noise}-{robots}-{preset}-{policy}-{ablation}-{laps}-{seed}".replace(":", "_")
    made = Row(
        world=world,
        noise=noise,
        robots=robots,
        preset=preset,
        policy="laps" if laps else policy,
        ablation=ablation,
        laps=laps,
        seed=seed,
        metrics=metrics | other,
        cost={"job_s": 1.5, "slam_ms_median": 0.1},
        versions={"python": "3.11", "numpy": "2.0"},
        commit="0123456789abcdef",
        key=key,
    )
    return replace(made, **fields)


def failed(made, reason="RuntimeError: <boom> & 100% | over_there"):
    """The same job, failed."""
    return replace(made, metrics={}, cost={}, error=reason)


def grid(seeds=3, worlds=("env1", "env2"), noises=(0.0, 0.02), robots=(1, 2)):
    """Rows of every world, noise and number of robots."""
    return [
        row(world, noise, seed, robots=number)
        for world in worlds
        for noise in noises
        for number in robots
        for seed in range(seeds)
    ]


TIMES = "\N{MULTIPLICATION SIGN}"


def sheet(rows, title):
    return next((each for each in sheets(rows) if each.title == title), None)


def column(rows, title, heading):
    found = sheet(rows, title)
    return [cells[found.header.index(heading)] for cells in found.rows]


def test_the_grid_has_a_row_for_each_world_noise_and_number_of_robots():
    found = sheet(grid(), "Exploration")
    assert [cells[:3] for cells in found.rows] == [
        (world, noise, robots)
        for world in ("env1", "env2")
        for robots in ("1", "2")
        for noise in ("0 cm", "2 cm")
    ] + [("all", "all", "1"), ("all", "all", "2")]
    assert {
        "n",
        "F1 aligned",
        "F1",
        "F1 5 cm",
        "spurious walls",
        "ATE m",
        "ANEES",
        "time s",
        "covered",
    } <= set(found.header)


def test_failed_runs_are_counted_and_listed_and_in_no_median():
    rows = [row(seed=0, ate_m=0.1), row(seed=1, ate_m=0.3), failed(row(seed=2))]
    assert column(rows, "Exploration", "n") == ["2 (1)"]
    assert column(rows, "Exploration", "ATE m") == ["0.200"]
    assert column(rows, "Failures", "reason") == ["RuntimeError: <boom> & 100% | over_there"]
    assert "1 of 3 runs failed" in table(rows)


def test_what_was_not_measured_is_a_dash_and_never_0():
    rows = [
        row("env1", doors_open=None),
        row("env2", doors_open=1.0),
        row("env3", anees=float("nan")),
    ]
    assert column(rows, "Exploration", "doors open")[:3] == [MISSING, "1.00", MISSING]
    assert column(rows, "Exploration", "ANEES")[2] == MISSING
    assert "ATE / limit" not in sheet(rows, "Exploration").header
    limited = [*rows, row("env4", ate_over_limit=2.0)]
    assert column(limited, "Exploration", "ATE / limit")[:4] == [MISSING, MISSING, MISSING, "2.0"]


def test_a_value_that_only_some_runs_have_says_how_many():
    rows = [
        row(seed=seed, exploration_time_s=value)
        for seed, value in enumerate((100.0, None, 300.0, None))
    ]
    assert column(rows, "Exploration", "time s") == ["200 (2)"]


def test_policies_and_random_plans_have_their_tables():
    rows = [row(f"random:{plan}", 0.02, wall_f1_aligned=plan / 10) for plan in range(8)]
    assert column(rows, "Exploration", "world") == ["random plans"]
    assert column(rows, "Exploration", "n") == ["8"]
    assert sheet(rows, "Policies") is None
    rows += [row(f"random:{plan}", 0.02, policy="random", time_to_95_s=None) for plan in range(8)]
    assert column(rows, "Policies", "95 % s") == ["90", MISSING]
    assert len(column(rows, "Policies", "time s")) == 2


def test_no_rows_are_refused_in_one_line():
    with pytest.raises(ValueError, match=r"^no results: [^\n]*$"):
        table([])


def test_rows_without_the_keys_of_their_jobs_are_refused_by_their_line(tmp_path):
    lines = [
        {name: value for name, value in asdict(each).items() if name != "key"}
        for each in grid(seeds=2)
    ]
    (tmp_path / "old.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(
        ValueError, match=r"old.jsonl, line 1: is no row of results: [^\n]*key[^\n]*$"
    ):
        read_rows(tmp_path / "old.jsonl")


def test_outcomes_show_the_worst_runs_and_failures():
    ends = [(0.01, 200.0, 0.0, 0), (0.02, None, 3.0, 1), (0.14, 210.0, 0.0, 0)]
    rows = [
        row(
            world,
            seed=seed,
            preset="graph",
            ate_m=2 * ate,
            ate_smoothed_m=ate,
            anees_smoothed=10 * ate,
            exploration_time_s=time,
            lost_s=lost,
            status="lost" if lost else "ok",
            collisions=touched,
            wall_f1_aligned_5cm=1.0 - ate,
        )
        for world in ("env1", "env2")
        for seed, (ate, time, lost, touched) in enumerate(ends)
    ]
    title = "Outcomes of explorations"
    assert column(rows, title, "ended by itself") == ["2 of 3", "2 of 3", "4 of 6"]
    assert column(rows, title, "ok at the end") == ["2 of 3", "2 of 3", "4 of 6"]
    assert column(rows, title, "lost at some time") == ["1 of 3", "1 of 3", "2 of 6"]
    assert column(rows, title, "worst ATE m") == ["0.280"] * 3
    assert column(rows, title, "worst smoothed ATE m") == ["0.140"] * 3
    assert column(rows, title, "mean smoothed ANEES") == ["0.6"] * 3
    assert column(rows, title, "worst F1 aligned 5 cm") == ["0.86"] * 3
    assert sheet(grid(), title) is None


def test_faults_have_a_table_and_are_no_explorations():
    def robot(world, seed, policy="kidnapped", placed=12.0, wrong=0.0):
        return row(
            world,
            seed=seed,
            preset="graph",
            policy=policy,
            fault_doubted_s=0.5,
            fault_lost_s=9.0 + 2.0 * seed,
            fault_placed_s=placed,
            fault_wrong_place_s=wrong,
            fault_wrong_place_ok_s=0.0,
            fault_unnoticed_s=float(seed),
            fault_alarms_before_s=0.0,
            ate_smoothed_m=0.1 + wrong,
            status="ok",
        )

    rows = [
        robot("env2", 0),
        robot("env2", 1, placed=31.0),
        robot("random:7", 0, placed=None, wrong=2.0),
    ]
    assert column(rows, "Faults", "world") == ["env2", "random plans", "all"]
    assert column(rows, "Faults", "lost within 10 s") == ["1 of 2", "1 of 1", "2 of 3"]
    assert column(rows, "Faults", "placed within 30 s") == ["1 of 2", "0 of 1", "1 of 3"]
    assert column(rows, "Faults", "at a wrong place") == ["0 of 2", "1 of 1", "1 of 3"]
    assert column(rows, "Faults", "ok though wrong, at most s") == ["1.0", "0.0", "1.0"]
    heading = "ok at the end, smoothed ATE above 0.5 m"
    assert column(rows, "Faults", heading) == ["0 of 2", "1 of 1", "1 of 3"]
    assert sheet(rows, "Exploration") is None
    assert "placed after s" not in sheet([robot("env2", 0, "jump", placed=None)], "Faults").header


def test_ablations_are_compared_pair_by_pair():
    base = [row(noise=0.02, seed=seed, ate_m=1.0 + seed) for seed in range(4)]
    cut = [row(noise=0.02, seed=seed, ate_m=2.0 + 2 * seed, ablation="no-ekf") for seed in range(3)]
    rows = [*base, *cut, failed(row(noise=0.02, seed=3, ablation="no-ekf"))]
    title = "Other methods against the published one"
    assert column(rows, title, f"ATE, {TIMES}") == ["2.00"]
    assert (column(rows, title, "pairs"), column(rows, title, "left out")) == (["3"], ["1"])


def test_markdown_has_as_many_cells_in_each_line_of_a_table():
    text = table([*grid(), failed(row(seed=9))])
    blocks = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    assert len(blocks) == 3
    for block in blocks:
        counts = {len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}
        assert len(counts) == 1
    assert r"RuntimeError: \<boom> & 100% \| over_there" in text
