"""The line smoother: its factors, its optimum, the readings it reassigns, and the map of its
lines.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from support.drives import ROBOT, room
from support.smoother_runs import (
    ROUND,
    WALLS,
    WHEEL_VARIANCE,
    noisy_filtered,
    noisy_run,
    position_error,
    state_from_motions,
    true_labels,
)

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.kernels.beams import read_share
from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.line_graph.association import merge, reassociate, solve_labels
from limslam_agent.slam.line_graph.map import lasting, smoothed_map, tally
from limslam_agent.slam.line_graph.merging import (
    ELSEWHERE,
    LEAST_SHARE,
    NEGATIVE,
    POSITIVE,
    SURE,
    THICKEST,
    THINNEST,
    Lines,
    board_evidence,
    merge_lines,
    prior_odds,
    wall_kinds,
)
from limslam_agent.slam.line_graph.motions import motion_jacobians, motions_between
from limslam_agent.slam.line_graph.new_lines import faces
from limslam_agent.slam.line_graph.problem import (
    CALIBRATION_PRIOR,
    RELATIVE_PRIOR,
    expected,
    make_problem,
    state_from_poses,
)
from limslam_agent.slam.line_graph.run import beside
from limslam_agent.slam.line_graph.smoother import settle, smooth_run, smooth_with_unknown_start
from limslam_agent.slam.line_graph.solution import solve
from limslam_env import NominalNoise
from limslam_env.geometry import FloatArray, se2, segment


def smoothed(problem, poses):
    return solve_labels(problem, state_from_motions(problem), true_labels(problem, poses)).solution


def nees(true, estimated, covariances):
    error = true - estimated
    error[..., 2] = se2.wrap_angle(error[..., 2])
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariances, error[..., None])[..., 0])


@pytest.mark.parametrize("turn", [0.0, 1e-5, 0.3, -1.2])
def test_derivatives_of_motions_are_differences(turn):
    poses = np.array([[0.3, -0.2, 0.7], [0.35, -0.17, 0.7 + turn]])
    found = motion_jacobians(poses)[0]
    for column in range(6):
        change = np.zeros((2, 3))
        change.flat[column] = 1e-6
        ends = [motions_between(poses + sign * change)[0] for sign in (1.0, -1.0)]
        assert found[:, column] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-6)


def test_derivatives_of_reports_are_differences():
    problem, _ = noisy_run(4)
    motions = problem.motions + 1e-3
    calibration = np.array([[0.02, -0.01, 0.03, 0.0, 0.0]])
    reports, by_motion, by_errors = problem.reports(motions, calibration)
    for column, unit in enumerate(1e-6 * np.eye(5)[:3]):
        more, less = (problem.reports(motions, calibration + each)[0] for each in (unit, -unit))
        np.testing.assert_allclose(by_errors[..., column], (more - less) / 2e-6, atol=1e-9)
    for column, unit in enumerate(1e-3 * np.eye(3)):
        moved = problem.reports(motions + unit, calibration)[0]
        wanted = np.broadcast_to(by_motion[..., column], moved.shape)
        np.testing.assert_allclose((moved - reports) / 1e-3, wanted, atol=1e-9)


def test_derivatives_by_bias_and_scale_are_differences():
    problem, poses = noisy_run(4)
    state = state_from_motions(problem)
    labels = true_labels(problem, poses)
    state = replace(
        solve_labels(problem, state, labels).state, calibration=np.array([[0, 0, 0, 0.02, 0.03]])
    )
    found = expected(problem, state, labels)
    met = replace(problem.readings, distances=found.ranges)
    lengths = problem.true(met, state.calibration)
    for column, wanted in ((3, np.ones(len(labels))), (4, lengths)):
        change = 1e-6 * np.eye(5)[[column]]
        ends = [
            expected(problem, replace(state, calibration=state.calibration + each), labels).ranges
            for each in (change, -change)
        ]
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(wanted, abs=1e-6)
    change = 1e-6 * np.eye(3)[0]
    ends = [
        expected(problem, replace(state, poses=state.poses + each), labels).ranges
        for each in (change, -change)
    ]
    assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(found.by_pose[:, 0], abs=1e-6)


def test_a_solution_ends_with_a_small_step():
    problem, poses = noisy_run(4)
    labels = true_labels(problem, poses)
    begin = solve_labels(problem, state_from_motions(problem), labels).state
    begin = begin.moved(1e-3 * np.ones_like(begin.motions), 0.0, 0.0)
    coarse, fine, best = (
        solve(problem, begin, labels, last).state.poses for last in (0.1, 1e-3, 1e-9)
    )
    assert np.abs(fine - best).max() < 1e-5 < np.abs(coarse - best).max() < 0.02


def test_covariances_are_those_of_a_dense_solution():
    problem, poses = noisy_run(4)
    first = solve_labels(problem, state_from_motions(problem), true_labels(problem, poses))
    # The equations are linearised at the state before the last step, which is the optimum here.
    solution = solve(problem, first.state, first.labels)
    covariances = solution.of_poses
    # The same equations, with nothing eliminated: numerical derivatives of all residuals by all
    # poses and lines.
    state = solution.state
    labels = true_labels(problem, poses)
    steps = problem.steps
    count = len(state.lines)
    jacobians = motion_jacobians(state.poses[0])
    wanted = expected(problem, state, labels)
    whole = np.zeros((3 * steps + 2 * count, 3 * steps + 2 * count))
    for step in range(steps - 1):
        own = slice(3 * step, 3 * step + 6)
        jacobian = problem.roots[0, step] @ jacobians[step]
        whole[own, own] += jacobian.T @ jacobian
    for k in np.flatnonzero(solution.weights):
        place = 3 * problem.readings.places[k]
        line = 3 * steps + 2 * labels[k]
        columns = np.r_[place : place + 3, line : line + 2]
        row = np.append(wanted.by_pose[k], wanted.by_line[k])
        whole[np.ix_(columns, columns)] += np.outer(row, row) / problem.range_std**2
    dense = np.linalg.inv(whole[3:, 3:])
    for step in (1, steps // 2, steps - 1):
        block = slice(3 * step - 3, 3 * step)
        assert covariances[0, step] == pytest.approx(dense[block, block], rel=1e-3, abs=1e-12)
    # The joint covariance of the last pose and the lines, from which a renewal goes on.
    nodes = solution.graph.nodes
    columns = np.append(nodes.columns("poses")[-1], nodes.columns("lines"))
    joint = solution.covariance(columns)
    assert joint == pytest.approx(dense[3 * steps - 6 :, 3 * steps - 6 :], rel=1e-3, abs=1e-9)


def test_errors_are_as_large_as_the_covariances_say():
    mean = []
    for seed in range(12):
        problem, poses = noisy_run(seed)
        solution = smoothed(problem, poses)
        covariances = solution.of_poses
        mean.append(
            nees(poses[0, 30:], solution.state.poses[0, 30:], covariances[0, 30:]).mean() / 3.0
        )
    # The mean of 12 runs of strongly correlated poses: chi-square of about 36 degrees of freedom,
    # over 36.
    assert 0.5 < np.mean(mean) < 1.6


def test_a_range_bias_is_found():
    problem, poses = noisy_run(7, noise=0.0, prior=CALIBRATION_PRIOR)
    biased = problem.readings.distances + 0.015
    object.__setattr__(problem.readings, "distances", biased)
    assert smoothed(problem, poses).state.calibration[0, 3] == pytest.approx(0.015, abs=0.004)


CONFIG = SmootherConfig()
FOUND = RangeSensor(0.01, growth=0.02, cone=0.03, bias=0.04)


def widened(problem, poses, width):
    """The problem with the readings of beams with an opening angle."""
    state = state_from_poses(np.moveaxis(poses, 0, 1))
    labels = true_labels(problem, poses)
    cosines = expected(problem, solve_labels(problem, state, labels).state, labels).cosines
    shares = [read_share(cosine, width) for cosine in cosines.tolist()]
    return replace(
        problem, readings=replace(problem.readings, distances=problem.readings.distances * shares)
    )


def associated(run, sensor=None):
    """A run of one robot, with a filter that was right about the walls, too."""
    problem = make_problem(run)
    labels = true_labels(problem, np.moveaxis(run.poses, 1, 0))
    sources = np.column_stack((problem.readings.places, problem.readings.beams))
    records = [
        AssociationRecord(wall, is_new=True, readings=sources[labels == wall])
        for wall in range(labels.max() + 1)
    ]
    noise = NominalNoise(0.02, WHEEL_VARIANCE)
    return replace(run, noise=noise, associations=records, sensor=sensor)


def test_the_sensor_that_the_filter_found_is_taken_over():
    problem, poses = noisy_run(6, 0.0)
    rough = replace(problem, sensor=FOUND).stds * np.random.default_rng(6).standard_normal(
        len(problem.readings)
    )
    wide = widened(problem, poses, FOUND.cone).readings
    run = associated(noisy_filtered(6, 0.0), FOUND)
    ranges = run.ranges.copy()
    ranges[wide.places, 0, wide.beams] = wide.distances + FOUND.bias + rough
    found = settle(replace(run, ranges=ranges), CONFIG)
    assert found.problem.sensor == FOUND
    assert found.state.calibration[0, 3] == pytest.approx(0.0, abs=0.01)
    assert position_error(found.state, poses) < 0.02


@pytest.mark.parametrize(("bias", "scale"), [(0.09, 0.0), (0.02, 0.024)])
def test_a_map_of_corrected_readings_is_not_contradicted(bias, scale):
    """A scale of 3 %, of which the filter has found its share of four fifths."""
    run = associated(noisy_filtered(6, places=[*ROUND, *ROUND]))
    poses = np.moveaxis(run.poses, 1, 0)
    sensor = RangeSensor(0.02, bias=bias, scale=scale, scale_std=scale)
    longer = np.minimum(bias + run.ranges * (1.0 + 1.25 * scale), ROBOT.max_ranges)
    seen = longer < ROBOT.too_far
    told = replace(run, ranges=longer, sensor=sensor)
    found = smooth_run(told, CONFIG)
    assert found.contradictions < 0.01
    assert found.ranges[seen] == pytest.approx(
        run.ranges[seen] * (1.0 + 1.25 * scale) / (1.0 + scale), abs=0.02
    )
    if scale:
        left, right, _, _, excess = found.calibration[0]
        assert excess == pytest.approx(scale, abs=0.003)
        assert (left + right) / 2.0 == pytest.approx(0.25 * scale, abs=0.003)
        far = np.hypot(*poses[0, :, :2].T - poses[0, 0, :2, None]).argmax()
        away = poses[0, far, :2] - poses[0, 0, :2]
        along = away / np.hypot(*away)
        std = np.sqrt(along @ found.covariances[far, 0, :2, :2] @ along)
        assert std > 0.007 * np.hypot(*away)


def test_poses_with_coarse_encoders_are_about_as_wrong_as_believed():
    run = associated(noisy_filtered(6))
    tick = 0.01
    totals = np.cumsum(run.wheels, axis=0) + np.random.default_rng(6).uniform(0.0, tick, 2)
    wheels = np.diff(np.floor(totals / tick) * tick, axis=0, prepend=np.zeros((1, 1, 2)))
    found = smooth_run(replace(run, wheels=wheels), CONFIG)
    errors = (found.poses - run.poses)[1:, 0]
    errors[:, 2] = se2.wrap_angle(errors[:, 2])
    assert np.hypot(*errors[:, :2].T).mean() < 0.1
    assert (
        np.einsum(
            "ti,ti->t", errors, np.linalg.solve(found.covariances[1:, 0], errors[..., None])[..., 0]
        ).mean()
        < 6.0
    )


def test_two_runs_with_known_turns_are_smoothed_as_one():
    run = associated(noisy_filtered(6), RangeSensor(0.02, turns=(0.01,) * 6))
    smoothed = smooth_with_unknown_start(beside(run, run, np.zeros(3)), CONFIG)
    assert smoothed.robot.beam_angles == pytest.approx(ROBOT.beam_angles + 0.01)


def test_constant_errors_are_estimated_only_where_they_are_significant():
    even = associated(noisy_filtered(4, places=[*ROUND, *ROUND]))
    assert smooth_run(even, CONFIG).calibration is None
    uneven = associated(noisy_filtered(4, mismatch=0.02, places=[*ROUND, *ROUND]))
    found = smooth_run(uneven, CONFIG)
    assert found.calibration[0, :2] == pytest.approx([-0.02, 0.02], abs=0.006)
    assert smooth_run(uneven, SmootherConfig("never")).calibration is None


def test_rough_sensors_have_relative_errors_only():
    """What a wide beam reads looks like a common error of all sizes with a bias."""
    run = noisy_filtered(4, mismatch=0.02, places=[*ROUND, *ROUND])
    found = settle(associated(run, RangeSensor(0.02, growth=1e-3)), CONFIG)
    assert found.problem.prior is RELATIVE_PRIOR
    assert found.state.calibration[0] == pytest.approx([-0.02, 0.02, 0.0, 0.0, 0.0], abs=0.01)


def agreeing(found, wanted):
    """Share of the used readings whose line holds mostly readings of the same wall."""
    used = found.labels >= 0
    pairs = np.zeros((found.labels.max() + 1, wanted.max() + 1), dtype=int)
    np.add.at(pairs, (found.labels[used], wanted[used]), 1)
    return pairs.max(axis=1).sum() / used.sum()


@pytest.mark.parametrize("noise", [0.0, 0.04])
def test_a_wrong_match_is_taken_back(noise):
    problem, poses = noisy_run(1, noise)
    wanted = true_labels(problem, poses)
    wrong = wanted.copy()
    of_right_wall = np.flatnonzero(wanted == 1)
    wrong[of_right_wall[: len(of_right_wall) // 4]] = 0
    begin = state_from_motions(problem)
    bent = solve_labels(problem, begin, wrong)
    mended = reassociate(problem, begin, wrong)
    best = solve_labels(problem, begin, wanted)
    assert position_error(bent.state, poses) > 3.0 * position_error(best.state, poses)
    assert position_error(mended.state, poses) < 1.5 * position_error(best.state, poses)
    assert agreeing(mended, wanted) > 0.99
    assert (mended.labels >= 0).mean() > 0.9


def test_lines_of_one_wall_are_merged():
    problem, poses = noisy_run(2)
    wanted = true_labels(problem, poses)
    halves = 2 * wanted + (problem.readings.places > problem.steps // 2)
    begin = solve_labels(problem, state_from_motions(problem), halves)
    assert len(begin.state.lines) > 4
    found, has_merged, _ = merge(begin)
    assert has_merged
    assert len(found.state.lines) == 4
    assert agreeing(found, wanted) == 1.0


def test_readings_that_the_filter_did_not_use_are_used():
    problem, poses = noisy_run(4)
    wanted = true_labels(problem, poses)
    few = np.where(np.arange(len(wanted)) % 5 == 0, wanted, -1)
    found = reassociate(problem, state_from_motions(problem), few)
    assert (found.labels >= 0).mean() > 0.9
    assert agreeing(found, wanted) > 0.99


def polygon(corners: int, across: float) -> FloatArray:
    """A pillar (k, 4), m, in the middle of the room."""
    angles = 2.0 * np.pi * np.arange(corners + 1) / corners + 0.3
    points = np.array([1.5, 1.2]) + 0.5 * across * np.column_stack((np.cos(angles), np.sin(angles)))
    return np.hstack((points[:-1], points[1:]))


@pytest.mark.parametrize(
    ("corners", "across", "noise", "share"),
    [(4, 0.3, 0.0, 0.9), (8, 0.3, 0.0, 0.9), (6, 0.3, 0.02, 0.9), (4, 0.2, 0.04, 0.7)],
)
def test_the_faces_of_a_pillar_are_drawn_and_nothing_else(
    corners: int, across: float, noise: float, share: float
) -> None:
    walls = np.vstack((WALLS, polygon(corners, across)))
    problem, poses = noisy_run(5, noise, walls=walls)
    labels = true_labels(problem, poses, walls)
    known = np.where(labels < len(WALLS), labels, -1)
    _, segments = smoothed_map(reassociate(problem, state_from_motions(problem), known))
    faces, _ = segment.sample(walls[len(WALLS) :], 0.02)
    assert (segment.distances(faces, segments).min(axis=1) < 0.05).mean() > share
    drawn, _ = segment.sample(segments, 0.02)
    assert (segment.distances(drawn, walls).min(axis=1) < 0.05).mean() > 0.95


def test_five_readings_are_no_line() -> None:
    problem, poses = noisy_run(5)
    found = solve_labels(problem, state_from_motions(problem), true_labels(problem, poses))
    wall = np.flatnonzero(found.labels == 0)
    assert faces(problem, found.state, wall)
    assert not faces(problem, found.state, wall[:5])


UNSEEN = [np.inf, -np.inf]


def parallel(behind, second, std=0.01, *, turned=False):
    """Two lines along the x axis, the first read from y > 0, and the second, ``behind`` m below,
    from a side.
    """
    lines = np.array([[0.0, 0.5 * np.pi], [0.0, -0.5 * np.pi if turned else 0.5 * np.pi]])
    anchors = np.array([[0.3, 0.0], [0.5, -behind]])
    seen = np.array([[UNSEEN, UNSEEN], [UNSEEN, UNSEEN]])
    seen[0, POSITIVE] = seen[1, 1 - second if turned else second] = [-1.0, 1.0]
    return Lines(lines, anchors, seen, np.diag([std**2, 1e-4] * 2))


def merged(behind, std, second=NEGATIVE, kinds=(0.0, 0.0), *, turned=False):
    lines = parallel(behind, second, std, turned=turned)
    return merge_lines(lines, kinds), lines


@pytest.mark.parametrize("turned", [False, True])
def test_a_board_is_one_line_and_a_wall_two(turned):
    has_merged, lines = merged(0.002, 0.01, turned=turned)
    assert has_merged
    assert lines.merged_into.tolist() == [1, 1]
    assert (lines.seen[1, :, 0] < lines.seen[1, :, 1]).all()
    assert not merged(0.13, 0.06, turned=turned)[0]
    # The same difference, seen from one side, is a matter of chi-square alone.
    assert merged(0.13, 0.06, POSITIVE, turned=turned)[0]


@pytest.mark.parametrize("turned", [False, True])
def test_merged_lines_meet_where_both_say(turned):
    _, lines = merged(0.02, 0.02, POSITIVE, turned=turned)
    heights = lines.anchors[:, 1] + lines.lines[:, 0] * np.sin(lines.lines[:, 1])
    assert heights == pytest.approx([-0.01, -0.01], abs=1e-4)
    assert lines.covariance[2, 2] == pytest.approx(0.5 * 0.02**2, rel=0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_lengths_of_boards_and_walls(turned):
    lines = parallel(0.2, NEGATIVE, turned=turned)
    lines.covariance = np.diag([1e-4, 1e-6] * 2)
    assert wall_kinds(lines) == (0.0, pytest.approx(1.8))
    lines.seen[0, NEGATIVE] = [0.0, 0.7]
    assert wall_kinds(lines)[0] == pytest.approx(0.7)


@pytest.mark.parametrize("behind", [-0.1, 0.0, 0.06, 0.2, 0.4])
@pytest.mark.parametrize("std", [0.02, 0.1, 0.6])
def test_the_evidence_is_the_ratio_of_the_likelihoods(behind: float, std: float) -> None:
    of_walls = quad(
        lambda thick: norm.pdf(behind, thick, std), THINNEST, THICKEST, points=[behind]
    )[0]
    wanted = norm.pdf(behind, 0.0, std) / (of_walls / (THICKEST - THINNEST) + ELSEWHERE)
    assert board_evidence(behind, std**2) == pytest.approx(math.log(wanted), rel=1e-6, abs=1e-6)


def test_a_building_has_mostly_one_kind_of_walls() -> None:
    vague = board_evidence(0.1, 0.3**2)
    assert vague + prior_odds(10.0, 0.0) > SURE
    assert vague + prior_odds(10.0, 10.0) < SURE
    assert prior_odds(0.0, 0.0) == pytest.approx(0.0)
    assert prior_odds(0.0, 100.0) == pytest.approx(math.log(LEAST_SHARE))


def truth(seed, noise=0.02, **changes):
    problem, poses = noisy_run(seed, noise, **changes)
    labels = true_labels(
        problem, poses, **({"walls": changes["walls"]} if "walls" in changes else {})
    )
    return solve_labels(problem, state_from_motions(problem), labels)


def test_beams_that_go_through_a_wall_are_counted():
    found = truth(3)
    assert not tally(found)[1].any()
    moved = found.state.lines.copy()
    line = found.state.lines[0]
    anchor = found.state.anchors[0]
    moved[0, 0] += 0.4 if anchor @ [np.cos(line[1]), np.sin(line[1])] < 1.0 else -0.4
    wrong = replace(
        found, solution=replace(found.solution, state=replace(found.state, lines=moved))
    )
    assert tally(wrong)[1].sum() > 100


def test_what_did_not_last_is_no_wall():
    found = truth(3)
    problem = found.problem
    readings = found.problem.readings
    middle = len(found.state.flat_poses) // 2
    stood = np.flatnonzero((readings.places >= middle) & (readings.places < middle + 40))
    short = readings.distances.copy()
    short[stood] = np.minimum(short[stood], 0.3)
    labels = np.where(short < readings.distances, found.labels.max() + 1, found.labels)
    seen = replace(problem, readings=replace(readings, distances=short))
    someone = solve_labels(seen, found.state, labels)
    cleared = lasting(someone)
    assert len(cleared.state.lines) < len(someone.state.lines)
    assert not (cleared.labels[short < readings.distances] >= 0).any()


def test_a_wide_beam_draws_a_wall_where_it_has_read_it():
    found = truth(3)
    sensor = found.problem.sensor._replace(cone=math.radians(12.0))
    along = found.along
    wide = replace(found, problem=replace(found.problem, sensor=sensor)).along
    poses = found.state.flat_poses[found.problem.readings.places]
    used = found.labels >= 0
    lines = found.state.lines[found.labels]
    anchors = found.state.anchors[found.labels]
    tangents = np.column_stack((-np.sin(lines[:, 1]), np.cos(lines[:, 1])))
    feet = ((poses[:, :2] - anchors) * tangents).sum(axis=1)
    assert (np.abs(wide - feet) <= np.abs(along - feet) + ROBOT.radius)[used].all()
    assert np.abs(wide - along)[used].max() > 0.1


def test_the_map_has_the_walls_and_leaves_the_door_open():
    walls = np.vstack((room(0.0, 0.0, 3.0, 2.4)[1:], [[0.0, 0.0, 1.2, 0.0], [1.7, 0.0, 3.0, 0.0]]))
    found = truth(9, 0.02, walls=walls)
    joined = reassociate(found.problem, found.state, found.labels)
    landmarks, segments = smoothed_map(joined)
    low = segments[np.abs(segments[:, [1, 3]]).max(axis=1) < 0.1]
    covered = [min(x1, x2) < 1.45 < max(x1, x2) for x1, _, x2, _ in low]
    assert len(low) == 2
    assert not any(covered)
    assert len(segments) == 5
    assert sorted(row for mark in landmarks for row in mark.segments) == [0, 1, 2, 3, 4]
    for mark in landmarks:
        ends = segments[list(mark.segments)].reshape(-1, 2)
        assert np.abs(ends @ [np.cos(mark.theta), np.sin(mark.theta)] - mark.r).max() < 1e-9


def test_landmarks_lie_where_their_covariances_say():
    squared = []
    for seed in range(6):
        found = truth(20 + seed, 0.02)
        for mark in smoothed_map(found)[0]:
            wanted = min(
                TRUE_LINES,
                key=lambda line, mark=mark: abs(line[0] - mark.r) + abs(turn(line[1], mark.theta)),
            )
            off = np.array([mark.r - wanted[0], turn(mark.theta, wanted[1])])
            squared.append(off @ np.linalg.solve(mark.covariance, off))
    assert 0.4 < np.mean(squared) / 2.0 < 2.0


TRUE_LINES = [
    (0.0, -0.5 * np.pi),
    (0.0, 0.5 * np.pi),
    (3.0, 0.0),
    (2.4, 0.5 * np.pi),
    (0.0, 0.0),
    (0.0, np.pi),
]


def turn(first, second):
    return (first - second + np.pi) % (2.0 * np.pi) - np.pi
