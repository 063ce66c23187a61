"""The scoreboard and its made-up logs."""

import dataclasses
import math

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks.scoreboard.board import read_board, run_scoreboard, size_of, table
from benchmarks.scoreboard.campus import campus_beams, campus_world
from benchmarks.scoreboard.compare import NOISE, compared, comparison_table
from benchmarks.scoreboard.drives import recorded_drive
from benchmarks.scoreboard.made_up_logs import (
    as_recorded,
    flight_log,
    known_relations,
    made_up_log,
    sparse_sensor,
    thinned,
    walls_of,
)
from benchmarks.scoreboard.measure import measure
from benchmarks.scoreboard.rows import Row, read_rows
from benchmarks.scoreboard.scores import at_the_end, scaled_error, while_driving
from benchmarks.scoreboard.worlds import world_of
from benchmarks.suite.faults import Fault, with_fault
from benchmarks.suite.person import ranges_to
from limslam_agent.logs.relations import relation_errors
from limslam_env import NoiseConfig, RobotSpec
from limslam_env.geometry import se2
from limslam_env.geometry.segment import distances

TINY = """
tuning_seed = 3
unused_seed = 5

[[row]]
name = "nominal"
kind = "drive"
worlds = ["square"]
seeds = 2
seconds = 12

[[row]]
name = "late"
kind = "drive"
worlds = ["square"]
seconds = 12
fault = "late"
"""


class OneAfterAnother:
    """Runs jobs in this process, and counts them."""

    def __init__(self):
        self.titles = []

    def run(self, jobs, work):
        for job in jobs:
            self.titles.append(job.title)
            yield job, work(job)


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


def drive(fault=None, *, seconds=20.0, **settings):
    row = Row("one", "drive", ("env1",), seconds=seconds, fault=fault, **settings)
    return recorded_drive(row, world_of("env1"), 3)


def cells(row, values, **others):
    return [
        {"row": row, "world": "w", "seed": seed, "ate_m": each, **others}
        for seed, each in enumerate(values)
    ]


def test_a_row_is_measured_once_and_compared_with_itself(tiny, tmp_path):
    rows = read_rows(tiny)
    engine = OneAfterAnother()
    folder = tmp_path / "out"
    first, summary, skipped = run_scoreboard(rows, ["nom*"], folder, engine)
    assert (summary.failures, skipped, len(engine.titles)) == ((), [], 2)
    board, _, _ = run_scoreboard(rows, [], folder, engine)
    assert len(engine.titles) == 3
    assert [cell["row"] for cell in board["cells"]] == ["nominal", "nominal", "late"]
    assert read_board(folder)["cells"] == board["cells"]
    assert board["cells"][:2] == first["cells"]
    for cell in board["cells"]:
        assert 0.0 < cell["ate_smoothed_m"] < 0.3
        assert cell["status"] == "ok"
    lines = table(board)
    assert "| 2 (2) |" in lines[5]
    assert sum(line.startswith(("| nominal | 2 |", "| late | 1 |")) for line in lines) == 2
    found = compared(board["cells"], board["cells"])
    assert [(each.row, each.ratios["ate_m"].value) for each in found] == [
        ("nominal", 1.0),
        ("late", 1.0),
        ("all", 1.0),
    ]
    assert comparison_table(found)[-1] == "no row is worse (2 rows compared)"


def test_an_exploration_is_measured_with_what_became_of_a_kidnapped_robot():
    row = Row("lost", "exploration", ("env1",), kidnapped=(20.0, 21.0), seconds=4.0)
    (job,) = row.cells(3)
    found = measure({"lost": row}, job)
    assert found.metrics["driven_s"] == pytest.approx(24.5, abs=1.0)
    assert found.metrics["placed"] in {0, 1}
    assert "ate_m" not in found.metrics
    assert found.cost.keys() == {"drive_cpu_s", "smoothing_cpu_s"}


@pytest.mark.parametrize(
    ("kind", "figures"),
    [
        ("second drive", {"ate_m", "placed", "status"}),
        ("two logs", {"ate_smoothed_m", "placed", "status"}),
    ],
)
def test_each_kind_of_row_has_its_figures(kind, figures):
    row = Row("one", kind, ("square",), seconds=10.0, biases=(0.05, -0.03))
    found = measure({"one": row}, row.cells(3)[0])
    assert figures <= found.metrics.keys()


def test_a_folder_is_for_one_estimator_and_one_file_of_rows(tiny, tmp_path, monkeypatch):
    rows = read_rows(tiny)
    run_scoreboard(rows, ["late"], tmp_path / "out", OneAfterAnother())
    with pytest.raises(ValueError, match="choose another folder"):
        run_scoreboard(rows, ["late"], tmp_path / "out", OneAfterAnother(), unused=True)
    monkeypatch.setattr("benchmarks.scoreboard.board.digest_of", lambda _: "another")
    with pytest.raises(ValueError, match="choose another folder"):
        run_scoreboard(rows, ["late"], tmp_path / "out", OneAfterAnother())


def test_rows_without_data_are_left_out(tmp_path, monkeypatch, tiny):
    monkeypatch.setenv("LIMSLAM_DATA", str(tmp_path / "absent"))
    log = Row("a log", "log", file="a.gz", relations="b.gz", beams=(0.0,))
    rows = dataclasses.replace(read_rows(tiny), row=(log,))
    board, summary, skipped = run_scoreboard(rows, [], tmp_path / "out", OneAfterAnother())
    assert (board["cells"], summary.jobs, skipped) == ([], 0, ["a log"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "tuning_seed"),
        ('tuning_seed = 1\nunused_seed = 2\n[[row]]\nname = "a"\nkind = "swim"', "kind"),
        (
            'tuning_seed = 1\nunused_seed = 2\n[[row]]\nname = "a"\nkind = "drive"\nwheels = 3',
            "wheels",
        ),
        ('tuning_seed = 1\nunused_seed = 2\n[[row]]\nname = "a"\nkind = "log"', "a log needs"),
        (
            (
                "tuning_seed = 1\nunused_seed = 2\n"
                '[[row]]\nname = "a"\nkind = "made-up log"\nrobots = 2'
            ),
            "robots",
        ),
        (TINY.replace('"late"\nkind', '"nominal"\nkind'), "a name of its own"),
    ],
)
def test_bad_rows_are_refused_in_one_line(text, words, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=words) as error:
        read_rows(path)
    assert "\n" not in str(error.value)
    assert "bad.toml" in str(error.value)


def test_a_pattern_that_matches_nothing_and_a_board_that_is_none_are_refused(
    tmp_path, monkeypatch, capsys
):
    (tmp_path / "no.json").write_text('{"cells": [{"row": "a"}]}')
    for arguments, words in (
        (["--rows", "drive*,zzz"], "'zzz'"),
        (["--against", str(tmp_path / "no.json")], "is no scoreboard"),
        (["--against", str(tmp_path / "absent")], "no scoreboard there"),
    ):
        monkeypatch.setattr(
            "sys.argv", ["benchmarks", "scoreboard", str(tmp_path / "out"), *arguments]
        )
        with pytest.raises(SystemExit, match="2"):
            command.main()
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        assert words in lines[0]


def test_the_shipped_rows_differ_between_the_seeds():
    rows = read_rows()
    jobs = [
        job.key
        for first in (rows.tuning_seed, rows.unused_seed)
        for row in rows.row
        for job in row.cells(first)
    ]
    # Recorded logs have no seed that could be another one, but their names say which seeds were
    # chosen.
    assert len(set(jobs)) == len(jobs)


def test_worse_rows_are_named_and_better_ones_are_not():
    old = [*cells("a", [0.1, 0.1, 0.1, 0.1]), *cells("b", [0.1, 0.2, 0.1, 0.2]), *cells("c", [0.1])]
    new = [
        *cells("a", [0.2, 0.21, 0.19, 0.2]),
        *cells("b", [0.05, 0.1, 0.05, 0.1]),
        *cells("c", [0.1]),
    ]
    found = {each.row: each for each in compared(old, new)}
    assert [bool(found[name].reasons) for name in "abc"] == [True, False, False]
    assert comparison_table(list(found.values()))[-1].startswith(
        "worse beyond noise: a (ate_m 2.00 ["
    )
    assert found["all"].pairs == 9
    # Noise of the scoreboard itself is no reason.
    assert not compared(old[:4], cells("a", [0.1 * math.exp(NOISE["ate_m"])] + 3 * [0.1]))[
        0
    ].reasons


def test_wrong_and_ok_at_the_end_false_alarms_and_failures_count():
    old = cells("a", [0.1] * 4, wrong_ok_end=0, false_alarm_s=0.0, placed=1, f1_5cm=0.9)
    assert (
        "1 failed"
        in compared(old, [*old[:3], {"row": "a", "world": "w", "seed": 3, "error": "no"}])[
            0
        ].reasons
    )
    for change, words in (
        ({"wrong_ok_end": 1}, "4 more wrong and ok at the end"),
        ({"false_alarm_s": 3.0}, "false_alarm_s +12 s"),
        ({"f1_5cm": 0.7}, "f1_5cm -0.200"),
    ):
        assert compared(old, [{**cell, **change} for cell in old])[0].reasons == (words,)
    # A robot of four that is not placed may be chance, and so may four seconds in one of them.
    assert not compared(old, [{**old[0], "placed": 0, "false_alarm_s": 4.0}, *old[1:]])[0].reasons


def test_a_covariance_that_is_too_large_is_not_worse():
    old = cells("a", [0.1] * 3, nees=0.9)
    new = cells("a", [0.1] * 3, nees=0.2)
    assert not compared(old, new)[0].reasons
    assert compared(old, cells("a", [0.1] * 3, nees=3.0))[0].reasons


def test_seconds_are_counted_by_hand_made_errors():
    time = np.arange(5.0)
    true = np.zeros((5, 1, 3))
    estimated = np.zeros((5, 1, 3))
    estimated[1:3, 0, 0] = 0.6
    levels = np.array([[1], [0], [1], [2], [0]])
    assert while_driving(time, true, estimated, levels) == {
        "wrong_ok_s": 1.0,
        "longest_wrong_ok_s": 1.0,
        "false_alarm_s": 2.0,
        "ok_s": 1.0,
        "off_ok_s": 1.0,
    }
    twice = while_driving(
        time, true, estimated + np.array([0.6, 0.0, 0.0]), np.array([[0], [0], [1], [0], [0]])
    )
    assert (twice["wrong_ok_s"], twice["longest_wrong_ok_s"]) == (3.0, 2.0)
    longer = 1.03 * estimated + np.array([4.0, 0.0, 0.0])
    assert scaled_error(estimated[:, 0], longer[:, 0]) == pytest.approx(0.0, abs=1e-9)
    assert at_the_end("ok", true, estimated)["wrong_ok_end"] == 0
    line = np.column_stack((np.linspace(0.0, 9.0, 5), np.zeros(5), np.zeros(5)))[:, None]
    bent = line + np.array([0.0, 3.0, 0.0]) * (np.arange(5) == 2)[:, None, None]
    assert at_the_end("ok", line, bent)["wrong_ok_end"] == 1
    assert at_the_end("unsure", line, bent)["wrong_ok_end"] == 0
    assert at_the_end("ok", line, line + np.array([5.0, 0.0, 0.0]))["wrong_ok_end"] == 0


def test_a_drive_depends_on_the_seed_and_not_on_the_noise():
    first = drive()
    again = drive()
    noisy = drive(noise=0.04, true_noise=NoiseConfig(dropout=0.1))
    assert np.array_equal(first.ranges, again.ranges)
    assert np.array_equal(first.true_pose, noisy.true_pose)
    assert not np.array_equal(first.ranges, noisy.ranges)


def test_jitter_moves_readings_of_walls_only():
    plain = drive()
    shaken = drive(jitter=1e-4)
    free = plain.ranges >= plain.robot.too_far.astype(np.float32)
    assert np.array_equal(plain.ranges[free], shaken.ranges[free])
    assert np.isclose((shaken.ranges - plain.ranges)[~free].std(), 1e-4, rtol=0.2)


def test_faults_do_what_they_say():
    plain = drive()
    beam = 3
    assert np.array_equal(drive("late").ranges[1:], plain.ranges[:-1])
    one = drive("delayed").ranges
    half = len(one) // 2
    assert np.array_equal(one[half + 1 :, beam], plain.ranges[half - 9 : -10, beam])
    assert np.array_equal(np.delete(one, beam, axis=1), np.delete(plain.ranges, beam, axis=1))
    assert set(drive("dead beam").ranges[:, beam]) == {1.5}
    assert set(drive("stuck beam").ranges[:, beam].round(6)) == {np.float32(0.4)}
    assert np.allclose((drive("offset").ranges - plain.ranges)[plain.ranges < 1.4], 0.03, atol=1e-6)
    far = drive("offset", fault_size=0.1)
    share = drive("scale")
    seen = plain.ranges < 1.4
    assert np.allclose((far.ranges - plain.ranges)[seen], 0.1, atol=1e-6)
    assert np.allclose((share.ranges / plain.ranges)[seen], 1.03, atol=1e-5)
    assert np.array_equal(drive("late", fault_size=0.3).ranges[3:], plain.ranges[:-3])
    held = drive("repeats")
    assert np.array_equal(held.reported[beam:95:5, beam], held.reported[beam + 4 : 99 : 5, beam])
    assert (held.repeated / plain.ranges.size) > 0.5
    slips = drive("slips")
    turns = (slips.wheels - plain.wheels)[:, 1] - (slips.wheels - plain.wheels)[:, 0]
    assert np.count_nonzero(np.abs(turns) > 1e-9) == 3
    assert np.allclose(np.abs(turns).max() / slips.robot.axle, math.radians(14.0))
    turned = drive("turned beam")
    assert turned.robot == plain.robot
    assert not np.array_equal(turned.ranges[:, beam], plain.ranges[:, beam])


def test_reports_that_are_lost_take_their_travel_with_them():
    time = 0.1 * np.arange(600.0)
    ranges = np.ones((600, 6))
    wheels = np.full((600, 2), 0.02)

    def reported(kind):
        return with_fault(Fault(kind, seed=3), ranges, wheels, time)

    seen, told, arrives = reported("lost wheels")
    assert 15 <= (told == 0.0).all(axis=1).sum() <= 45
    assert (len(seen), arrives.all()) == (600, True)
    _, _, arrives = reported("lost reports")
    assert 15 <= (~arrives).sum() <= 45
    _, told, arrives = reported("gaps")
    assert told.sum() == pytest.approx(0.04 * arrives.sum())
    assert np.diff(time[arrives]).max() == pytest.approx(2.1)


def test_a_person_is_seen_in_front_of_the_walls():
    plain = drive()
    crowded = drive("person")
    nearer = crowded.ranges < plain.ranges
    assert 0.0 < nearer.mean() < 0.2
    assert np.array_equal(crowded.ranges[~nearer], plain.ranges[~nearer])
    robot = RobotSpec()
    poses = np.array([[0.0, 0.0, 0.5 * math.pi]])
    ahead = ranges_to(np.array([[0.0, 1.0]]), 0.2, robot, poses)
    assert np.isinf(ahead[0, [0, 5]]).all()
    aside = ranges_to(np.array([[1.0, 0.0]]), 0.2, robot, poses)
    assert aside[0, 5] == pytest.approx(0.7)


def test_a_standing_robot_stands_in_the_middle():
    log = drive(stands=30.0)
    assert (len(log), np.ptp(log.true_pose[101:400], axis=0).max()) == (501, 0.0)
    assert np.hypot(*np.diff(log.true_pose[401:, :2], axis=0).T).sum() > 0.5


def test_a_beam_has_the_cone_that_is_told():
    row = Row("one", "drive", ("env1",), cone=0.2)
    assert (row.robot.cone, row.true_noise.cone) == (0.2, 0.2)


@pytest.mark.parametrize("kind", ["pillars", "tables", "halls", "round"])
def test_a_robot_can_drive_in_a_room_of_each_kind(kind):
    world = world_of(f"{kind}:5")
    world.check(RobotSpec().radius)
    assert world.digest == world_of(f"{kind}:5").digest != world_of(f"{kind}:6").digest
    if kind == "tables":
        assert all(np.allclose(np.ptp(leg, axis=0), 0.04) for leg in world.obstacles)
    if kind == "round":
        assert len(world.walls) == 48


def test_a_bumping_robot_touches_walls():
    log = drive(bumps=True)
    assert np.hypot(*np.diff(log.true_pose[:, :2], axis=0).T).sum() > 2.0
    assert np.abs(log.wheels).sum() > np.hypot(*np.diff(log.true_pose[:, :2], axis=0).T).sum()


def test_the_size_of_sources_is_counted(tmp_path):
    path = tmp_path / "part.py"
    path.write_text(
        '"""A part."""\n\nONE = 1\nNAME = "a"\nPAIR = (2, "b")\n\n\ndef f(x):\n    """F."""\n    '
        "y = 3\n    return y\n"
    )
    assert size_of([path]) == {"tokens": 19, "lines": 11, "files": 1, "constants": 2}


@pytest.fixture(scope="module")
def ring():
    """A drive of 30 m in a ring."""
    return made_up_log(1, 30.0)


def test_the_walls_of_a_floor_are_its_borders():
    floor = np.zeros((40, 30), dtype=bool)
    floor[10:30, 5:15] = True
    walls = {tuple(np.round(wall, 6)) for wall in walls_of(floor).tolist()}
    assert walls == {(1, 0.5, 1, 1.5), (3, 0.5, 3, 1.5), (1, 0.5, 3, 0.5), (1, 1.5, 3, 1.5)}


def test_relations_are_those_of_the_true_path(ring):
    known = known_relations(ring)
    assert relation_errors(known, ring.time, ring.truth).translation.max() < 1e-4
    assert relation_errors(known, ring.time, ring.odometry).translation.mean() > 1e-3


def test_a_seed_gives_one_log(ring):
    again = made_up_log(1, 30.0)
    assert np.array_equal(again.ranges, ring.ranges)
    assert np.array_equal(again.odometry, ring.odometry)


def test_a_flight_is_short_and_a_campus_is_long():
    flight = flight_log(3, np.radians([0.0, 90.0, 180.0, -90.0]))
    assert 4.5 < np.hypot(*np.diff(flight.truth[:, :2], axis=0).T).sum() < 15.1
    assert as_recorded(flight, (0.0, 90.0, 180.0, -90.0), 4.0).ranges.shape[1] == 4
    world, way = campus_world(2)
    assert 90.0 < np.ptp(way, axis=0).max() < 250.0
    assert 800.0 < np.hypot(*np.diff(way, axis=0).T).sum() < 2500.0
    # The robot drives where nothing stands.
    middles = 0.5 * (way[1:] + way[:-1])
    assert distances(np.vstack((way, middles)), world.edges).min() > 0.25
    assert {len(campus_beams(seed)) for seed in range(4)} == {4, 6, 11, 36}


def test_few_readings_are_left_in_a_metre(ring):
    moves = se2.between(ring.odometry[:-1], ring.odometry[1:])
    hit = ring.ranges < 5.0
    driven = np.hypot(*moves[:, :2].T).sum()
    left = thinned(hit, moves, 40.0)
    assert left.sum() / driven == pytest.approx(40.0, rel=0.1)
    assert not (left & ~hit).any()
    sensors = [sparse_sensor(seed, 5.0, 40.0) for seed in range(32)]
    assert {len(beams) for beams, _ in sensors} == {4, 6, 8, 11}
    assert all(5.0 <= points <= 40.0 for _, points in sensors)
