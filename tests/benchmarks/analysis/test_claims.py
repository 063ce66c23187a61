"""The paper's claims, judged on rows for which the answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from support.benchmark_rows import DOORS, EDGES, failed, row, series_of, write_folder

from benchmarks.analysis.claims import CLAIMS, claims
from benchmarks.analysis.series import Series, distance, lap_errors, read_series
from benchmarks.analysis.tables import table
from benchmarks.suite.store import read_rows

SEEDS = range(8)


def verdict(rows, words, folder=None):
    found = [each for each in claims(rows, folder) if words in each.claim]
    assert len(found) == 1
    return found[0]


def outcomes(rows, words, folder=None):
    return verdict(rows, words, folder).outcome


def spread(seed):
    return 0.001 * seed


def test_every_claim_has_a_verdict_and_says_where_the_paper_makes_it():
    found = claims([row()])
    assert len(found) == len(CLAIMS) > 15
    assert all(each.source[0].isdigit() and each.evidence for each in found)
    assert len({each.claim for each in found}) == len(found)


def test_without_the_rows_for_it_nothing_was_tried():
    found = claims([row("elsewhere", 0.01, preset="other")])
    assert {each.outcome for each in found} == {"not tried in these rows"}


def test_other_presets_say_nothing_about_the_paper():
    rows = [row("env1", seed=seed, preset="other", spurious_walls=0) for seed in SEEDS]
    assert outcomes(rows, "env1, no noise") == "not tried in these rows"


def test_two_rows_are_too_few():
    rows = [row("env1", seed=seed, spurious_walls=0) for seed in range(5)]
    found = verdict(rows, "env1, no noise")
    assert (found.outcome, found.evidence) == ("not tried in these rows", "6 runs or pairs are needed")


@pytest.mark.parametrize(
    ("spurious", "f1", "outcome"), [(0, 0.95, "confirmed"), (3, 0.95, "partly"), (3, 0.5, "not confirmed")]
)
def test_a_clean_map(spurious, f1, outcome):
    rows = [row("env1", seed=seed, spurious_walls=spurious, wall_f1_aligned=f1) for seed in SEEDS]
    assert outcomes(rows, "env1, no noise") == outcome


@pytest.mark.parametrize(
    ("more", "outcome"),
    [([2] * 8, "confirmed"), ([0] * 8, "not confirmed"), ([-1] * 8, "not confirmed"),
     ([-1, 2, -2, 3, 0, 1, -3, 2], "undecided")],
)  # fmt: skip
def test_obstacles_that_grow_with_noise(more, outcome):
    rows = [row("env1", seed=seed, spurious_walls=5) for seed in SEEDS]
    rows += [row("env1", 0.04, seed, spurious_walls=5 + more[seed]) for seed in SEEDS]
    assert outcomes(rows, "env1: artificial obstacles") == outcome


def test_the_highest_noise_decides_and_all_are_shown():
    rows = [row("env1", noise, seed, spurious_walls=int(walls + seed % 2))
            for noise, walls in ((0.0, 1), (0.02, 1), (0.04, 9)) for seed in SEEDS]  # fmt: skip
    found = verdict(rows, "env1: artificial obstacles")
    assert found.outcome == "confirmed"
    assert "2 cm: 0.00 (n = 8)" in found.evidence
    assert "4 cm: +8.00 (n = 8)" in found.evidence


@pytest.mark.parametrize(
    ("ratio", "outcome"), [(0.45, "confirmed"), (0.8, "partly"), (1.3, "not confirmed")]
)  # fmt: skip
def test_the_time_is_halved(ratio, outcome):
    rows = [row(seed=seed, exploration_time_s=100.0) for seed in SEEDS]
    rows += [row(seed=seed, robots=2, exploration_time_s=100.0 * ratio + spread(seed)) for seed in SEEDS]
    found = verdict(rows, "halve the exploration time")
    assert found.outcome == outcome
    assert f"{ratio:.2f}" in found.evidence


def test_failures_are_told():
    rows = [row(seed=seed, exploration_time_s=100.0) for seed in SEEDS]
    rows += [row(seed=seed, robots=2, exploration_time_s=50.0) for seed in SEEDS[1:]] + [failed(row(robots=2))]
    assert "1 left out" in verdict(rows, "halve the exploration time").evidence
    assert "1 of 16 runs failed" in verdict(rows, "EKF improves the pose").evidence


@pytest.mark.parametrize(("without", "outcome"), [(0.3, "confirmed"), (0.1, "not confirmed")])
def test_what_a_part_is_worth(without, outcome):
    rows = [row(seed=seed, ate_m=0.2, wall_f1_aligned=0.8) for seed in SEEDS]
    rows += [
        row(seed=seed, ate_m=without + spread(seed), wall_f1_aligned=0.8 + (0.2 - without), ablation="no-loop-closing")
        for seed in SEEDS
    ]
    assert outcomes(rows, "Loop closing") == outcome


def test_the_filter_and_the_pose():
    better = [row(seed=seed, ate_m=0.1) for seed in SEEDS]
    assert outcomes(better, "EKF improves the pose") == "confirmed"
    worse = [row(seed=seed, ate_m=1.6) for seed in SEEDS]
    assert outcomes(worse, "EKF improves the pose") == "not confirmed"


@pytest.mark.parametrize(("is_open", "outcome"), [(1.0, "confirmed"), (0.5, "not confirmed")])
def test_the_door_without_series_is_that_all_doors_are_open(is_open, outcome):
    rows = [row("env2", seed=seed, doors_open=is_open) for seed in SEEDS]
    assert outcomes(rows, "one robot finds the door") == outcome
    assert "all doors" in verdict(rows, "one robot finds the door").evidence


@pytest.mark.parametrize("is_closed", [False, True])
def test_the_door_with_series_is_the_narrowest(tmp_path, is_closed):
    (tmp_path / "series").mkdir()
    rows = []
    for seed in SEEDS:
        made = row("env2", 0.02, seed, doors_open=0.5)
        series = series_of(made) | {"doors": np.vstack((DOORS, [[0.0, 0.0, 3.0, 0.0]]))}
        series["segments"] = DOORS if is_closed else EDGES[:1]
        np.savez(tmp_path / "series" / f"{seed}.npz", **series)
        rows.append(replace(made, series=f"series/{seed}.npz"))
    found = verdict(rows, "loses the door", tmp_path)
    assert found.outcome == ("confirmed" if is_closed else "not confirmed")
    assert f"narrowest door open in {0 if is_closed else 8} of 8" in found.evidence


def laps(folder, estimated):
    rows = [row("square", 0.02, seed, laps=4) for seed in SEEDS]
    write_folder(folder, rows)
    for made in read_rows(folder):
        series = series_of(made)
        series["estimated"] = estimated(series)
        np.savez(folder / made.series, **series)
    return read_rows(folder)


def test_errors_that_grow_without_the_filter_and_stay_with_it(tmp_path):
    rows = laps(tmp_path / "good", lambda series: series["true"] + 0.01)
    for words in ("error in x", "error in y", "error in heading"):
        assert outcomes(rows, words, tmp_path / "good") == "confirmed"
    assert outcomes(rows, "gains more", tmp_path / "good") == "confirmed"
    assert outcomes(rows, "error in x") == "not tried in these rows"


def test_a_filter_that_is_no_better_than_odometry_is_not_confirmed(tmp_path):
    rows = laps(tmp_path / "bad", lambda series: series["odometry"])
    for words in ("error in x", "error in y", "error in heading", "gains more"):
        assert outcomes(rows, words, tmp_path / "bad") == "not confirmed"


def test_a_filter_whose_error_grows_more_slowly_is_partly_right(tmp_path):
    rows = laps(tmp_path / "half", lambda series: 0.5 * (series["true"] + series["odometry"]))
    assert outcomes(rows, "error in x", tmp_path / "half") == "partly"


def test_errors_of_laps_by_hand():
    # Two laps of 2 m each, half a metre a step; the error in x is 0 in the first lap and 0.3 in the second.
    true = np.zeros((9, 1, 3))
    true[:, 0, 0] = 0.5 * np.arange(9)
    believed = true.copy()
    believed[4:, 0, 0] += 0.3
    believed[:, 0, 2] = 2 * np.pi
    series = Series(np.arange(9.0), believed, true, np.zeros((0, 4)), true)
    assert distance(series)[-1] == 4.0
    assert lap_errors(series, believed, 2) == pytest.approx(np.array([[0, 0, 0], [0.3, 0, 0]]))
    with pytest.raises(ValueError, match="too short"):
        lap_errors(series, believed, 40)


def test_a_log_has_no_errors():
    series = Series(np.arange(2.0), np.zeros((2, 1, 3)), np.zeros((2, 1, 3)), np.zeros((0, 4)))
    with pytest.raises(ValueError, match="no truth"):
        series.errors(series.estimated)


@pytest.mark.parametrize("damage", ["gone", "torn", "lacking", "shape"])
def test_damaged_series_are_refused_in_one_line(tmp_path, damage):
    made = row()
    write_folder(tmp_path / "run", [made])
    path = tmp_path / "run" / "series" / f"{made.key}.npz"
    if damage == "gone":
        path.unlink()
    elif damage == "torn":
        path.write_bytes(path.read_bytes()[:100])
    else:
        np.savez(path, **({"time": [0.0]} if damage == "lacking" else series_of(made) | {"true": np.zeros((5, 2))}))
    with pytest.raises(ValueError, match=rf"^[^\n]*{path.name}[^\n]*$"):
        read_series(tmp_path / "run", read_rows(tmp_path / "run")[0])


def test_the_verdicts_stand_under_the_tables():
    text = table([row("env1", seed=seed, spurious_walls=0) for seed in SEEDS])
    assert "Claims of the paper" in text
    assert "confirmed" in text
    assert "not tried in these rows" in text
