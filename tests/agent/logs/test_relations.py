"""The error over relations: worked by hand, its edges, and the known figures of raw odometry."""

import gzip
import math
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.data import data_folder
from support.data import refusal as refused

from limslam_agent import read_log
from limslam_agent.logs.relations import (
    RelationErrors,
    Relations,
    read_relations,
    relation_errors,
    summary,
)

HALF = math.pi / 2
refusal = partial(refused, read=read_relations)


def relations(*rows):
    """Relations from rows t1, t2, x, y, yaw."""
    table = np.array(rows)
    return Relations(table[:, 0], table[:, 1], table[:, 2:])


# Files


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_relations_are_read_plain_and_packed(write, pack):
    text = (
        b"# t1 t2 x y z roll pitch yaw\n1.5 2.5 0.1 -0.2 9 8 7 0.3\n\n3 4 1 2 0 0 0 -1 # a note\n"
    )
    read = read_relations(write(pack(text)))
    assert_array_equal(read.start_time, [1.5, 3.0])
    assert_array_equal(read.end_time, [2.5, 4.0])
    assert_array_equal(read.relative, [[0.1, -0.2, 0.3], [1.0, 2.0, -1.0]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"# head\n0 1 0 0 0 0 0 0\n1 2 0 0 0 0 0\n", "line 3: 7 fields where 8 are needed"),
        (b"1 2 nan 0 0 0 0 0\n", "line 1: x is nan"),
        (b"1 2 0 0 0 0 0 left\n", "line 1: yaw is not a number: 'left'"),
        (b"# nothing\n", "has no relations"),
        (bytes(100), "line 1: this is not a text file"),
        (gzip.compress(b"0 1 0 0 0 0 0 0\n" * 50, mtime=0)[:-10], "cut short"),
    ],
)
def test_files_that_hold_no_relations_are_refused(write, text, words):
    assert words in refusal(write(text))


# The definition


def test_a_case_worked_by_hand():
    # Ahead 2 m, then a left turn on the spot. The relation says: 2 m ahead, 0.5 m to the left,
    # turned by 80 degrees.
    poses = np.array([[1.0, 1.0, HALF], [1.0, 3.0, math.pi]])
    known = relations((0.0, 10.0, 2.0, 0.5, math.radians(80.0)))
    errors = relation_errors(known, np.array([0.0, 10.0]), poses)
    assert errors.translation == pytest.approx([0.5])
    assert np.degrees(errors.rotation) == pytest.approx([10.0])


def test_the_pose_within_a_tenth_of_a_second_is_taken_as_it_is():
    time = np.array([0.0, 1.0, 2.0])
    poses = np.array([[0.0, 0, 0], [1.0, 0, 0], [5.0, 0, 0]])
    errors = relation_errors(
        relations((0.09, 1.92, 5.0, 0.0, 0.0), (0.0, 1.05, 1.0, 0.0, 0.0)), time, poses
    )
    assert_allclose(errors.translation, 0.0, atol=1e-12)


def test_between_poses_the_earlier_one_is_moved_on_by_odometry():
    # The estimate faces up, odometry believes that it faces right: the motion is taken in the
    # robot's own frame. 0.8 s is nearer to the second pose, but not near enough.
    time = np.array([0.0, 1.0])
    poses = np.array([[10.0, 10.0, HALF], [99.0, 99.0, 0.0]])
    odometry = np.array([[3.0, 0.0, 0.0], [5.0, 0.0, 0.4]])
    known = relations((0.0, 0.25, 0.5, 0.0, 0.1), (0.0, 0.8, 1.6, 0.0, 0.32))
    errors = relation_errors(known, time, poses, odometry)
    assert_allclose([errors.translation, errors.rotation], 0.0, atol=1e-12)


def test_times_may_step_back():
    time = np.array([0.0, 2.0, 1.0, 3.0])
    poses = np.array([[0.0, 0, 0], [2.0, 0, 0], [1.0, 0, 0], [3.0, 0, 0]])
    errors = relation_errors(
        relations((1.0, 2.0, 1.0, 0.0, 0.0), (0.5, 1.5, 1.0, 0.0, 0.0)), time, poses, poses
    )
    assert_allclose(errors.translation, 0.0, atol=1e-12)


def test_relations_outside_the_log_are_left_out_and_counted():
    time = np.array([10.0, 20.0])
    poses = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    known = relations(
        (9.1, 20.9, 1.0, 0.0, 0.0),
        (8.9, 20.0, 1.0, 0.0, 0.0),
        (10.0, 21.1, 1.0, 0.0, 0.0),
        (21.1, 10.0, 1.0, 0.0, 0.0),
    )
    errors = relation_errors(known, time, poses, poses)
    assert errors.unmatched == 3
    assert_allclose(errors.translation, [0.0], atol=1e-12)


# The figures


def test_the_summary_tells_the_loops_apart():
    is_loop = np.array([False, False, True])
    rotation = np.radians([10.0, 20.0, 60.0])
    errors = RelationErrors(np.array([1.0, 3.0, 8.0]), rotation, is_loop, unmatched=2)
    assert summary(errors) == {
        "relation_error_m": pytest.approx(4.0),
        "relation_error_std_m": pytest.approx(math.sqrt(26.0 / 3.0)),
        "relation_error_deg": pytest.approx(30.0),
        "relation_error_std_deg": pytest.approx(math.sqrt(1400.0 / 3.0)),
        "relations": 3,
        "loop_relation_error_m": pytest.approx(8.0),
        "loop_relation_error_std_m": 0.0,
        "loop_relation_error_deg": pytest.approx(60.0),
        "loop_relation_error_std_deg": 0.0,
        "loop_relations": 1,
        "relations_unmatched": 2,
    }


@pytest.mark.parametrize(
    ("log", "file", "errors", "count"),
    [
        ("fr079/fr079_raw.clf.gz", "fr079/fr079.relations.gz", (6.51, 13.7, 30.3), 1685),
        ("csail/mit-csail.clf.gz", "csail/csail_pseudo.relations.gz", (8.23, 9.38, 15.5), 750),
    ],
)
def test_raw_odometry_has_its_known_error(log, file, errors, count):
    recorded = read_log(data_folder() / log, (0.0,), 5.0)
    known = read_relations(data_folder() / file)
    figures = summary(relation_errors(known, recorded.time, recorded.odometry, recorded.odometry))
    names = ("relation_error_m", "relation_error_std_m", "relation_error_deg")
    assert [figures[name] for name in names] == pytest.approx(errors, rel=0.02)
    assert (figures["relations"], figures["relations_unmatched"]) == (count, 0)


def test_an_offline_mappers_trajectory_has_its_known_error():
    folder = data_folder() / "fr079"
    reference = np.loadtxt(folder / "fr079_reference.txt.gz")
    known = read_relations(folder / "fr079.relations.gz")
    figures = summary(relation_errors(known, reference[:, 0], reference[:, 1:]))
    assert figures["relation_error_m"] == pytest.approx(0.058, abs=0.001)
    # The published 0.71 is with the nearest pose always; 102 of the 3370 moments are 0.10 to 0.19 s
    # from any pose, and moving on to them, as the definition wants, makes it 0.73.
    assert figures["relation_error_deg"] == pytest.approx(0.71, abs=0.03)


def test_a_gzip_stream_that_grows_out_of_proportion_is_refused(write):
    text = b"# a comment\n" * 1_400_000
    packed = gzip.compress(text)
    assert len(packed) < 1_000_000
    assert "the gzip stream has more than 16 MB" in refusal(write(packed))
    assert len(read_relations(write(text, b"0 1 0 0 0 0 0 0\n")).start_time) == 1
