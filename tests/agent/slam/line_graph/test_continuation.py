"""Drives that go on without the filter, and the map that is drawn from a solution."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.drives import ROBOT, room
from support.smoother_runs import (
    ROUND,
    START,
    WALLS,
    WHEEL_VARIANCE,
    noisy_drive,
    noisy_run,
    position_error,
    state_from_motions,
    true_labels,
)

from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.line_graph.continuation import continued, straight_runs
from limslam_agent.slam.line_graph.problem import (
    CALIBRATION_PRIOR,
    Readings,
    first_steps,
    make_problem,
)
from limslam_agent.slam.line_graph.reassociation import reassociate, solve_labels
from limslam_agent.slam.line_graph.smoothed_map import smoothed_map, tally
from limslam_agent.slam.line_graph.smoother import FilteredRun, smooth_run
from limslam_env.geometry.se2 import compose
from limslam_env.interface import NominalNoise


def truth(seed, noise=0.02, **changes):
    problem, poses = noisy_run(seed, noise, **changes)
    labels = true_labels(problem, poses, **({"walls": changes["walls"]} if "walls" in changes else {}))
    return problem, poses, solve_labels(problem, state_from_motions(problem), labels)


def test_beams_that_go_through_a_wall_are_counted():
    problem, _, found = truth(3)
    assert tally(problem, found).contradictions == 0
    moved = found.state.lines.copy()
    line, anchor = found.state.lines[0], found.state.anchors[0]
    moved[0, 0] += 0.4 if anchor @ [np.cos(line[1]), np.sin(line[1])] < 1.0 else -0.4
    wrong = replace(found, solution=replace(found.solution, state=replace(found.state, lines=moved)))
    assert tally(problem, wrong).contradictions > 100


def test_unread_walls_come_back():
    problem, _, found = truth(6)
    pieces = straight_runs(problem, found.state, found.labels == 2, 8)
    assert set(pieces[found.labels != 2]) == {-1}
    assert (pieces[found.labels == 2] >= 0).mean() > 0.7


def test_the_map_has_the_walls_and_leaves_the_door_open():
    walls = np.vstack((room(0.0, 0.0, 3.0, 2.4)[1:], [[0.0, 0.0, 1.2, 0.0], [1.7, 0.0, 3.0, 0.0]]))
    problem, _, found = truth(9, 0.02, walls=walls)
    joined = reassociate(problem, found.state, found.labels)
    landmarks, segments = smoothed_map(problem, joined)
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
        problem, _, found = truth(20 + seed, 0.02)
        for mark in smoothed_map(problem, found)[0]:
            wanted = min(TRUE_LINES, key=lambda line, mark=mark: abs(line[0] - mark.r) + abs(turn(line[1], mark.theta)))
            off = np.array([mark.r - wanted[0], turn(mark.theta, wanted[1])])
            squared.append(off @ np.linalg.solve(mark.covariance, off))
    assert 0.4 < np.mean(squared) / 2.0 < 2.0


TRUE_LINES = [(0.0, -0.5 * np.pi), (0.0, 0.5 * np.pi), (3.0, 0.0), (2.4, 0.5 * np.pi), (0.0, 0.0), (0.0, np.pi)]


def turn(first, second):
    return (first - second + np.pi) % (2.0 * np.pi) - np.pi


def test_a_drive_goes_on_without_a_filter_where_its_walls_are_known_again():
    laps = [*ROUND, *ROUND]
    problem, poses = noisy_run(5, places=laps)
    begin, found = known_half(problem, poses)
    half, whole = begin.steps, continued(problem, found.state, found.labels)
    assert whole.state.poses.shape[1] == problem.steps
    assert position_error(whole.state, poses) < 0.03
    assert len(whole.state.lines) == 4
    # In another room, few readings are of known walls, or beams contradict these: it may have been carried there.
    elsewhere, _ = noisy_run(5, places=laps, walls=room(-0.5, -0.9, 4.1, 3.9))
    readings = Readings(*(
        np.concatenate((getattr(begin.readings, name), getattr(elsewhere.readings, name)[later]))
        for name in ("places", "beams", "distances") for later in [elsewhere.readings.places >= half]
    ))  # fmt: skip
    carried = replace(problem, wheels=problem.wheels[:, : elsewhere.steps - 1], readings=readings, looks=readings)
    assert continued(carried, found.state, found.labels) is None


def known_half(problem, poses):
    """The first half of a drive, and its solution with the true walls."""
    begin = first_steps(problem, problem.steps // 2)
    return begin, solve_labels(begin, state_from_motions(begin), true_labels(problem, poses)[: len(begin.readings)])


def continued_half(problem, poses):
    """The drive that is continued from its first half, whose walls are known."""
    _, found = known_half(problem, poses)
    return continued(problem, found.state, found.labels)


def filtered_run(wheels, ranges, poses, believed, lost, breaks):
    """A run whose filter has associated the readings before step ``lost`` with the true walls, and none later."""
    noise = NominalNoise(0.02, WHEEL_VARIANCE)
    problem = make_problem(ROBOT, noise, START[None], wheels, ranges)
    labels, readings = true_labels(problem, poses), problem.readings
    known = [(labels == wall) & (readings.places < lost) for wall in range(len(WALLS))]
    return FilteredRun(
        ROBOT, noise, wheels, ranges, np.isfinite(ranges), believed, np.zeros((len(wheels), 1, 3, 3)),
        [AssociationRecord(wall, is_new=True, readings=np.column_stack((readings.places[own], readings.beams[own])))
         for wall, own in enumerate(known)],
        [], breaks=breaks,
    )  # fmt: skip


@pytest.mark.parametrize("carried", [None, 60])
def test_a_run_whose_place_is_not_known_from_some_step_on_is_smoothed_to_its_end(carried):
    wheels, ranges, poses = noisy_drive(5, places=[*ROUND, *ROUND])
    if carried is not None:  # some motions that no wheel reports
        left_out = np.arange(carried, carried + 20)
        wheels, ranges = np.delete(wheels, left_out, 0), np.delete(ranges, left_out, 0)
        poses = np.delete(poses, left_out, 1)
        wheels[carried] = 0.0
    believed, lost = np.moveaxis(poses, 0, 1).copy(), len(wheels) // 2
    believed[lost:] = believed[lost]
    run = filtered_run(wheels, ranges, poses, believed, lost, () if carried is None else ((0, carried),))
    found = smooth_run(run, unplaced=lost, losses=[lost])
    assert found.is_continued
    assert np.hypot(*(found.poses[:, 0] - poses[0])[:, :2].T).max() < 0.1
    # Where the odometry has jumped, the wheels do not say how the robot moved.
    beginning = smooth_run(run, unplaced=lost)
    assert (len(beginning.poses), beginning.is_continued) == (lost, False)


@pytest.mark.parametrize("first", [0, 5])
def test_the_beginning_of_a_run_has_what_was_found_out_until_then(first):
    """Steps of readings and closures count from the start of the drive, of which a run may be the end."""
    steps, later = np.zeros((9, 1, 2)), first + np.array([3, 4])
    records = [AssociationRecord(0, is_new=True, readings=np.array([[first, 0], [last, 1]])) for last in later]
    run = FilteredRun(
        ROBOT, NominalNoise(0.02), steps, steps, steps > 0.0, steps, steps, records,
        [SimpleNamespace(step=step) for step in later], breaks=((0, 3), (0, 4)), first_step=first,
    )  # fmt: skip
    begin = run.until(4)
    assert (len(begin.wheels), begin.associations, begin.breaks) == (4, records[:1], ((0, 3),))
    assert [each.step for each in begin.closures] == [first + 3]
    assert run.until(None) is run


def test_a_path_at_a_wrong_place_is_found_without_the_filter_if_beams_contradict_it():
    wheels, ranges, poses = noisy_drive(5, places=[*ROUND, *ROUND])
    believed, lost = np.moveaxis(poses, 0, 1).copy(), len(wheels) // 2
    right = filtered_run(wheels, ranges, poses, believed, len(wheels), ())
    assert not smooth_run(right, losses=[lost]).is_continued
    wrong = believed.copy()
    wrong[lost:, 0] = compose(np.array([3.5, -0.1, 0.5 * np.pi]), believed[lost:, 0])
    # Before the first of these losses the robot has seen hardly a wall, and before the last one the map is wrong.
    losses = [3, lost - 20, lost, len(wheels) - 10]
    found = smooth_run(filtered_run(wheels, ranges, poses, wrong, lost, ((0, lost),)), losses=losses)
    assert found.continued_from == lost
    assert np.hypot(*(found.poses[:, 0] - poses[0])[:, :2].T).max() < 0.1


def at_steps(problem, steps):
    """A problem with the poses of some steps (t,), which may repeat; no wheels report motions that are left out."""
    is_new = np.diff(steps) == 1
    places = [problem.readings.places == step for step in steps]
    parts = [
        (np.full(own.sum(), number), problem.readings.beams[own], problem.readings.distances[own])
        for number, own in enumerate(places)
    ]
    readings = Readings(*(np.concatenate(each) for each in zip(*parts, strict=True)))
    motions = np.minimum(steps[:-1], problem.steps - 2)
    wheels, stds = problem.wheels[:, motions].copy(), problem.stds[:, motions].copy()
    wheels[:, ~is_new], stds[:, ~is_new] = 0.0, [1e-6, 1e-6, 1e-5]
    return replace(problem, wheels=wheels, stds=stds, readings=readings, looks=readings)


def test_a_drive_with_another_axle_goes_on():
    problem, poses = noisy_run(5, prior=CALIBRATION_PRIOR, places=[*ROUND, *ROUND])
    middle = problem.wheels[..., :2].mean(axis=-1, keepdims=True)
    wheels = problem.wheels.copy()
    wheels[..., :2] = middle + 1.05 * (wheels[..., :2] - middle)
    whole = continued_half(replace(problem, wheels=wheels), poses)
    assert position_error(whole.state, poses) < 0.03
    assert abs(whole.state.calibration[0, 2] - 0.05) < 0.01


def test_a_drive_that_stood_for_long_goes_on():
    problem, poses = noisy_run(5, places=[*ROUND, *ROUND])
    stood = problem.steps // 3
    steps = np.concatenate((np.arange(stood), np.full(3 * problem.steps, stood), np.arange(stood, problem.steps)))
    whole = continued_half(at_steps(problem, steps), poses[:, steps])
    assert position_error(whole.state, poses[:, steps]) < 0.03


@pytest.mark.parametrize("left_out", [12, 30, 80])
def test_a_robot_that_was_carried_a_short_way_does_not_go_on(left_out):
    problem, poses = noisy_run(5, places=[*ROUND, *ROUND])
    carried = problem.steps // 2 + 20
    steps = np.concatenate((np.arange(carried), np.arange(carried + left_out, problem.steps)))
    assert continued_half(at_steps(problem, steps), poses[:, steps]) is None
