"""What the page holds: the same poses as the run, every association with the landmarks it was
compared with.
"""

import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.command_line import limslam
from support.inspection import data_in, inspected, short_run, unpacked

from limslam_agent.grid.occupancy import GridView
from limslam_agent.inspect import recorder
from limslam_agent.inspect.columns import packed
from limslam_agent.inspect.grid import FREE, OCCUPIED, UNKNOWN, GridChanges
from limslam_agent.output.finished_run import read_run
from limslam_env.geometry import se2

DECISIONS = {"new", "again", "waits"}


@pytest.fixture(scope="module")
def recording(page):
    return unpacked(data_in(page))


def test_frames_are_those_of_the_run(run_folder, recording):
    run, (arrays, meta) = read_run(run_folder), recording
    assert np.array_equal(arrays["time"], run.time)
    assert np.allclose(arrays["pose"][:, 0], run.estimated[0], atol=1e-5)
    assert np.allclose(arrays["true"][:, 0], run.true[0], atol=1e-5)
    assert np.allclose(arrays["smoothed"][:, 0], run.smoothed[0], atol=1e-5)
    stated = run.covariances[0][:, *np.triu_indices(3)]
    assert np.allclose(arrays["cov"][:, 0], stated, rtol=1e-3, atol=1e-9)
    assert meta["robots"] == 1
    assert meta["stride"] == 1


def test_nees_is_that_of_the_run(run_folder, recording):
    run, (arrays, _) = read_run(run_folder), recording
    row = 150
    error = run.estimated[0][row] - run.true[0][row]
    error[2] = se2.wrap_angle(error[2])
    expected = error @ np.linalg.solve(run.covariances[0][row], error) / 3.0
    assert arrays["nees"][row, 0] == pytest.approx(expected, rel=0.02)
    assert np.isnan(arrays["nees"][0, 0])  # the start is known


def test_readings_are_those_of_the_log(run_folder, recording):
    log, (arrays, meta) = np.load(run_folder / "log.npz"), recording
    ranges = arrays["ranges"][:, 0]
    seen = log["ranges"]
    is_far = seen >= [beam["max"] for beam in meta["beams"]]
    assert (ranges[is_far] == 65535).all()
    assert np.abs(ranges[~is_far] / 1000 - seen[~is_far]).max() < 6e-4


def test_each_reading_belongs_to_the_wall_that_it_was_given_to(recording):
    arrays, meta = recording
    used = sum(event["used"] for event in meta["events"] if event["kind"] in {"new", "again"})
    assert np.count_nonzero(arrays["owner"]) == used > 50
    walls = {event["wall"] for event in meta["events"] if event["kind"] in {"new", "again"}}
    assert set(np.unique(arrays["owner"])) - {0} <= walls
    owned = arrays["owner"] > 0
    assert (
        arrays["given"][owned] >= np.nonzero(owned)[0]
    ).all()  # no reading is given away before it was measured


def test_decisions_agree_with_the_values_that_they_show(recording):
    _, meta = recording
    decisions = [event for event in meta["events"] if event["kind"] in DECISIONS]
    limits = meta["limits"]
    assert {"new", "again"} <= {event["kind"] for event in decisions}
    for event in decisions:
        fits = [test for test in event["tests"] if not test["out"]]
        for test in event["tests"]:
            assert (test["d2"] is not None) == (test["out"] in {"", "gate"})
        if event["kind"] == "again":
            assert event["wall"] == min(fits, key=lambda test: test["d2"])["wall"]
        if event["kind"] == "new":
            assert all(
                test["d2"] is None or test["d2"] >= limits["far_gate"] for test in event["tests"]
            )
        if event["kind"] in {"new", "again"}:
            assert event["after"]["cov"][5] <= event["before"]["cov"][5]
        else:
            assert event["why"]


def test_frontiers_have_costs_and_the_goal_is_at_one_of_them(recording):
    arrays, meta = recording
    moment = 100
    goal = arrays["goal"][moment, 0]
    found = meta["frontiers"][arrays["frontier_index"][moment]]
    assert any(frontier["costs"][0] is not None for frontier in found)
    starts = arrays["frontier_starts"]
    cells = [
        arrays["frontier_cells"][starts[f["cells"]] : starts[f["cells"] + 1]] * meta["quantum"]
        for f in found
    ]
    assert np.hypot(*(np.concatenate(cells) - goal).T).min() < 0.5


@pytest.mark.parametrize("options", [("--robots", 2), ("--policy", "tour", "--laps", 1)])
def test_other_runs(tmp_path, options):
    folder = short_run(tmp_path / "run", "--max-time", 8, *options)
    done = inspected(folder, tmp_path / "page.html")
    assert done.returncode == 0, done.stderr
    assert "The poses equal" in done.stdout


def test_replays_and_logs(tmp_path, run_folder):
    replayed = tmp_path / "replay"
    assert (
        limslam(
            "replay", run_folder / "log.npz", "--preset", "consistent", "--out", replayed
        ).returncode
        == 0
    )
    done = inspected(replayed, tmp_path / "replay.html")
    assert "The poses equal" in done.stdout
    arrays, meta = unpacked(data_in(tmp_path / "replay.html"))
    assert "true" in arrays
    assert not meta["frontiers"]
    bare = inspected(run_folder / "log.npz", tmp_path / "bare.html")
    assert bare.returncode == 0, bare.stderr
    assert "check" not in bare.stdout
    settings = replayed / "run.toml"
    settings.write_text(
        f'other_log = "second.npz"\n{settings.read_text(encoding="utf-8")}', encoding="utf-8"
    )
    refused = inspected(replayed, tmp_path / "two.html")
    assert refused.returncode == 2
    assert "is of two logs; inspect one of them: limslam inspect " in refused.stderr


def test_poses_of_another_version_are_noticed(tmp_path, run_folder):
    folder = tmp_path / "run"
    shutil.copytree(run_folder, folder)
    path = folder / "trajectory_est.tum"
    lines = path.read_text(encoding="utf-8").splitlines()
    time, x, *others = lines[100].split()
    lines[100] = " ".join([time, str(float(x) + 0.01), *others])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = inspected(folder, tmp_path / "page.html")
    assert done.returncode == 0
    assert "The poses differ by up to 0.01" in done.stdout


def test_long_runs_keep_every_second_step(run_folder, monkeypatch, tmp_path):
    monkeypatch.setattr(recorder, "MOST_FRAMES", 130)
    done = inspected(run_folder, tmp_path / "page.html")
    assert "The poses equal" in done.stdout
    arrays, meta = unpacked(data_in(tmp_path / "page.html"))
    assert meta["stride"] == 2
    assert np.allclose(np.diff(arrays["time"]), 0.2)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: (folder / "run.toml").unlink(), "there is no run.toml"),
        (lambda folder: (folder / "log.npz").write_bytes(b"PK\x03\x04"), "log.npz"),
    ],
)
def test_damaged_folders_are_refused_in_one_line(tmp_path, run_folder, make, words):
    folder = tmp_path / "run"
    shutil.copytree(run_folder, folder)
    make(folder)
    done = inspected(folder, tmp_path / "page.html")
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "page.html").exists()


def test_targets_that_cannot_be_written_are_refused(tmp_path, run_folder, page):
    assert "a page ends in .html" in inspected(run_folder, tmp_path / "page.png").stderr
    assert "--force" in inspected(run_folder, page).stderr
    assert (
        "there is no such folder" in inspected(tmp_path / "nothing", tmp_path / "page.html").stderr
    )
    (tmp_path / "text.csv").write_text("nothing\n", encoding="utf-8")
    assert inspected(tmp_path / "text.csv", tmp_path / "page.html").returncode == 2


def test_what_is_packed_comes_out_again():
    arrays = {
        "odd": np.arange(3, dtype=np.uint8),
        "times": np.linspace(0.0, 1.0, 5),
        "empty": np.zeros((0, 2), np.int16),
        "strided": np.arange(12, dtype=np.float32).reshape(3, 4).T,
        "big": np.arange(2, dtype=">i4"),
    }
    found, meta = unpacked(packed(arrays, {"title": "Ü, <b> & </script>", "none": None}))
    assert meta == {"title": "Ü, <b> & </script>", "none": None}
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert np.array_equal(found[name], array), name


def restored(changes, cells):
    """The kinds of cells after some changes, as the page restores them."""
    for row, column, length, kind in changes.tolist():
        for place in range(column, column + length):
            cells[row, place] = kind
    return {place: kind for place, kind in cells.items() if kind != UNKNOWN}


def kinds_of(view):
    column, row = np.rint(view.low / view.cell).astype(int).tolist()
    found = np.where(view.values > 0, FREE, np.where(view.values < 0, OCCUPIED, UNKNOWN))
    return {
        (row + r, column + c): int(kind)
        for (r, c), kind in np.ndenumerate(found)
        if kind != UNKNOWN
    }


@given(st.integers(0, 10_000))
def test_the_changes_of_a_growing_and_moving_grid_restore_it(seed):
    draws = np.random.default_rng(seed)
    changes = GridChanges()
    cells = {}
    for _ in range(4):
        low = 0.1 * draws.integers(-5, 5, 2)
        values = draws.integers(-2, 3, draws.integers(1, 6, 2)).astype(np.int16)
        view = GridView(low, 0.1, values)
        cells = restored(changes.since_last(view), cells)
        assert cells == kinds_of(view)
    assert not len(changes.since_last(view))
