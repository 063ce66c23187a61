"""Smoothing of a finished run: all poses and the map, from the observations and the filter's estimates."""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.slam.core.contact import LooseMotion
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.line_graph.chain_kernels import motion_jacobians, motions_between
from limslam_agent.slam.line_graph.elimination import DegenerateError
from limslam_agent.slam.line_graph.line_smoother import pose_covariances, solve
from limslam_agent.slam.line_graph.map_score import score, tally
from limslam_agent.slam.line_graph.mending import continued, is_contradicted, is_repaired, mend
from limslam_agent.slam.line_graph.problem import (
    CALIBRATION_PRIOR,
    FEWEST_READINGS,
    RELATIVE_PRIOR,
    Problem,
    Readings,
    make_problem,
    state_from_poses,
)
from limslam_agent.slam.line_graph.reassociation import Association, reassociate, with_kinds
from limslam_agent.slam.line_graph.sensor_errors import TURN_STD, beam_turns, fitted_sensor
from limslam_agent.slam.line_graph.smoothed_map import smoothed_map
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import NominalNoise, RobotSpec

# Chi-square of the estimated errors, of which each robot has four, from which on they are estimated although no beam
# contradicts the map.
_CALIBRATION_GATE = 40.0
_CALIBRATION_PRICE = 20.0  # by how much estimated errors must raise the score
_SENSOR_ROUNDS = 4  # errors of the sensor are estimated at most this many times, each time with a new solution
_CONTINUED = "continued"
_UNSURE_HEADING = math.radians(4.0)  # rad: standard deviation of the filter from which on associations may be wrong
# m, m, rad: how far the place at which a carried robot was found may be off beyond the covariances of its poses. It is
# so wide that the readings decide, and so narrow that they are still associated with the walls around that place.
_FOUND_STDS = np.array([0.3, 0.3, math.radians(10.0)])


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """A run of n robots in t steps: the observations and the filter's estimates.

    Attributes
    ----------
    robot, noise
        Body and beams of each robot, and the specified noise.
    wheels, ranges
        Observations (t, n, 2) and (t, n, n_beams), m; row 0 is the observation at the reset.
    usable
        Mask (t, n, n_beams) of the readings that are of walls, without readings that may be of other robots.
    poses, covariances
        The filter's estimates at each step (t, n, 3) and (t, n, 3, 3); the first poses are the known starts.
    associations, closures
        The associations of the observed lines, and the merged landmarks, in order.
    first_step
        Step of the drive that row 0 belongs to, if the run is a part of a drive.
    breaks
        Robots and steps before which a robot was carried away. The poses before and after say where to.
    sensor
        How the sensor measures, as the filter has found out. None if it is as ``robot`` and ``noise`` state.
    """

    robot: RobotSpec
    noise: NominalNoise
    wheels: FloatArray
    ranges: FloatArray
    usable: BoolArray
    poses: FloatArray
    covariances: FloatArray
    associations: list[AssociationRecord]
    closures: list[Closure]
    first_step: int = 0
    breaks: tuple[tuple[int, int], ...] = ()
    sensor: RangeSensor | None = None

    def until(self, step: int | None) -> "FilteredRun":
        """The run before a step of its own, with what the filter had found out by then."""
        if step is None:
            return self
        rows, end = ("wheels", "ranges", "usable", "poses", "covariances"), self.first_step + step
        return replace(
            self,
            **{name: getattr(self, name)[:step] for name in rows},
            associations=[each for each in self.associations if each.readings[:, 0].max() < end],
            closures=[each for each in self.closures if each.step < end],
            breaks=tuple(each for each in self.breaks if each[1] < step),
        )


@dataclass(frozen=True, eq=False)
class SmoothedRun:
    """The smoothed estimate of a run.

    Attributes
    ----------
    poses, covariances
        Poses (t, n, 3), m and rad, and covariances (t, n, 3, 3).
    landmarks, segments
        The walls of the map: their lines as landmarks with covariances, and their segments (k, 4), m.
    calibration
        Calibration (n, 4): relative excess of left wheel, right wheel and axle over their specified values, and the
        bias of all ranges, m. None where the robots are taken to be as specified, and no bias is known.
    moves
        The moves that corrected the associations; empty if no move was necessary or none raised the score.
    range_std, beam_width
        Standard deviation of a range of usual length, m, and half the opening angle of the beams, rad: as specified, or
        as the readings require.
    contradictions
        Share of all looks that passed through a wall of the solution.
    robot, turns
        The robot with its beams as they are mounted, and by what each beam is turned to the left against the specified
        robot, with its standard deviation (n_beams, 2), rad; None where the beams are taken to be as specified.
    continued_from
        Step from which on the smoother has found the poses by itself, without the filter; None without one.
    """

    poses: FloatArray
    covariances: FloatArray
    landmarks: list[Landmark]
    segments: FloatArray
    calibration: FloatArray | None
    moves: tuple[str, ...]
    contradictions: float
    range_std: float
    beam_width: float
    robot: RobotSpec
    turns: FloatArray | None = None
    continued_from: int | None = None

    @property
    def is_continued(self) -> bool:
        """Whether the smoother has found later poses by itself."""
        return self.continued_from is not None


def completed(found: SmoothedRun, poses: FloatArray, covariances: FloatArray) -> SmoothedRun:
    """A smoothed run with the later steps of a longer run, whose poses (t, n, 3) stay as they are."""
    count = len(found.poses)
    return replace(
        found,
        poses=np.concatenate((found.poses, poses[count:])),
        covariances=np.concatenate((found.covariances, covariances[count:])),
    )


@dataclass(frozen=True, eq=False)
class Settled:
    """A solution, its problem, the moves that corrected its associations, and where it has gone on by itself."""

    problem: Problem
    association: Association
    moves: tuple[str, ...]
    continued_from: int | None = None

    @property
    def worth(self) -> float:
        """The score, minus the gain that is required to accept a calibration."""
        price = 0.0 if self.problem.prior is None else _CALIBRATION_PRICE
        return score(self.problem, self.association).total - price


def smooth_run(
    run: FilteredRun,
    config: SmootherConfig | None = None,
    unplaced: int | None = None,
    losses: Sequence[int] = (),
) -> SmoothedRun | None:
    """Estimate all poses and lines of a run from all its measurements.

    The filter's associations are the initial associations, and every association can change. Wrong associations are
    searched for where beams contradict the result, or where the filter's heading was uncertain. The result is None if
    the robots did not move or no wall was seen often enough: there is nothing to smooth then.

    ``unplaced`` is the step from which on the filter did not know the place of the only robot. The result ends there,
    unless its own walls say where the robot went. ``losses`` are the steps before which that robot was lost, as far as
    its odometry says how it moved since then.
    """
    config = config or SmootherConfig()
    best, found = settle(run.until(unplaced), config), None
    if best is None:
        return None
    if is_contradicted(best.problem, best.association):
        found = _without_filter(run, config, losses)
    elif unplaced in losses:
        found = _continued(best, run)
    return _smoothed(found or best)


def _without_filter(run: FilteredRun, config: SmootherConfig, losses: Sequence[int]) -> Settled | None:
    """The solution of a run whose filter has placed a lost robot wrongly.

    It goes on alone from the latest loss before which no beams contradict the map; None if nothing says where the robot
    was later. A map that is contradicted mostly stays so, and each solution may take minutes, so this loss is found by
    bisection.
    """
    known, first, last = None, 0, len(losses)
    while first < last:
        middle = (first + last) // 2
        begin = settle(run.until(losses[middle]), config)
        if begin is not None and is_contradicted(begin.problem, begin.association):
            last = middle
        else:
            known, first = begin or known, middle + 1
    return None if known is None else _continued(known, run)


def _continued(best: Settled, run: FilteredRun) -> Settled | None:
    """The solution of a whole run, from that of its beginning; None if nothing says where the robot was later."""
    drive = make_problem(run.robot, run.noise, run.poses[0], run.wheels, run.ranges, run.usable, None, run.first_step)
    if drive.steps <= best.problem.steps:
        return None
    drive = with_breaks(drive, replace(run, breaks=run.until(best.problem.steps).breaks))
    # The beginning has shown how the sensor measures, and whether the wheels are as specified.
    whole = replace(
        best.problem, wheels=drive.wheels, stds=drive.stds, jumps=drive.jumps, loose=drive.loose,
        readings=drive.readings, looks=drive.looks,
    )  # fmt: skip
    found = continued(whole, best.association.state, best.association.labels)
    return None if found is None else Settled(whole, found, (*best.moves, _CONTINUED), best.problem.steps)


def settle(run: FilteredRun, config: SmootherConfig) -> Settled | None:
    """The solution of a run; None if there is nothing to smooth."""
    prior = CALIBRATION_PRIOR if config.calibrate == "always" else None
    problem = make_problem(
        run.robot, run.noise, run.poses[0], run.wheels, run.ranges, run.usable, prior, run.first_step, run.sensor
    )
    if problem.steps < 2:
        return None
    problem = with_breaks(problem, run)
    labels = filter_labels(problem, run.associations, run.closures, run.first_step)
    if np.count_nonzero(labels >= 0) < FEWEST_READINGS:
        return None
    try:
        problem, labels = with_kinds(problem, state_from_poses(problem, run.poses), labels)
        problem, found = _as_read(problem, run, labels)
        best = _settled(problem, found, run)
        if config.calibrate == "if_needed" and _may_need_calibration(best):
            sized = _calibrated(problem)
            again = _settled(sized, _reassociated(sized, run, labels), run)
            best = max(best, again, key=lambda each: each.worth)
    except DegenerateError:
        return None
    return best


def _as_read(problem: Problem, run: FilteredRun, labels: IntArray) -> tuple[Problem, Association]:
    """The problem with the noise and the beam width that its residuals require, and its re-associated solution."""
    stated = problem.range_std
    found = _reassociated(problem, run, labels)
    for _ in range(_SENSOR_ROUNDS):
        changed = fitted_sensor(problem, found, stated)
        if changed is problem:
            break
        problem, found = changed, _reassociated(changed, run, labels)
    return problem, found


def _reassociated(problem: Problem, run: FilteredRun, labels: IntArray) -> Association:
    return reassociate(problem, state_from_poses(problem, run.poses), labels)


def _settled(problem: Problem, found: Association, run: FilteredRun) -> Settled:
    """The re-associated solution of a problem, with corrected associations where a correction is needed."""
    if not needs_mending(problem, found, run.covariances):
        return Settled(problem, found, ())
    kept = mend(problem, found)
    if not is_repaired(problem, found, kept[-1].association):
        return Settled(problem, found, ())
    return Settled(problem, kept[-1].association, tuple(candidate.move for candidate in kept[1:]))


def _may_need_calibration(found: Settled) -> bool:
    """Whether beams contradict a solution, or another calibration fits the wheels and ranges much better.

    The second criterion is Wald's test of the calibration that is estimated with the same associations.
    """
    if is_contradicted(found.problem, found.association):
        return True
    sized = _calibrated(found.problem)
    solution = solve(sized, found.association.state, found.association.labels)
    first, count = solution.factored.first_shared, solution.state.calibration.size
    values = (solution.state.calibration - sized.assumed_calibration).ravel()
    covariance = solution.factored.covariance[first : first + count, first : first + count]
    return float(values @ np.linalg.solve(covariance, values)) > _CALIBRATION_GATE * len(sized.starts)


def _calibrated(problem: Problem) -> Problem:
    """The problem with constant errors of wheels, axle and ranges.

    What a wide beam reads, and what a sensor reads whose noise grows with the range, is known to some millimetres only.
    That looks like a common error of all sizes with a bias, so the robots of such sensors have relative errors alone,
    unless a bias is known: a wrong one has to be corrected.
    """
    is_rough = (problem.beam_width > 0.0 or problem.growth > 0.0) and not problem.bias
    return replace(problem, prior=RELATIVE_PRIOR if is_rough else CALIBRATION_PRIOR)


def with_breaks(problem: Problem, run: FilteredRun) -> Problem:
    """A problem in which carried robots came to where the filter found them: their wheels say nothing of that motion.

    The filter has found them by hundreds of readings, of which the associations of the run hold a few only.
    """
    own = {(number, step - 1) for number, step in run.breaks}
    wheels, jumps = problem.wheels.copy(), np.zeros_like(problem.wheels)
    # The covariance of a slip would hold the robot near where it was.
    loose = [each for each in problem.loose if (each.robot, each.motion) not in own]
    for number, motion in sorted(own):
        poses, covariances = run.poses[motion : motion + 2, number].copy(), run.covariances[motion : motion + 2, number]
        poses[1, 2] = poses[0, 2] + wrap_angle(float(poses[1, 2] - poses[0, 2]))
        by_before, by_after = np.empty((2, 1, 3, 3))
        wheels[number, motion] = 0.0
        motions_between(poses, problem.robot.axle, jumps[number, motion : motion + 1])
        motion_jacobians(poses, problem.robot.axle, by_before, by_after)
        found = covariances[1] + np.diag(_FOUND_STDS**2)
        covariance = by_before[0] @ covariances[0] @ by_before[0].T + by_after[0] @ found @ by_after[0].T
        loose.append(LooseMotion.of(number, motion, covariance))
    return replace(problem, wheels=wheels, jumps=jumps if own else None, loose=tuple(loose))


def filter_labels(
    problem: Problem, associations: Iterable[AssociationRecord], closures: list[Closure], first_step: int = 0
) -> IntArray:
    """For each reading (k,), the landmark of the filter's final association, or -1. Row 0 is a step of the drive."""
    count, steps = len(problem.starts), problem.steps
    table = np.full((count * steps, len(problem.robot.beams)), -1)
    united = {closure.younger: closure.older for closure in closures}
    for record in associations:
        number = record.landmark
        while number in united:
            number = united[number]
        rows, beams = record.readings[:, 0] - first_step, record.readings[:, 1]
        table[record.robot * steps + rows[rows >= 0], beams[rows >= 0]] = number
    return np.asarray(table[problem.readings.places, problem.readings.beams])


def needs_mending(problem: Problem, found: Association, covariances: FloatArray) -> bool:
    """Whether beams contradict a solution, or the filter's heading was uncertain at any step."""
    heading_std = math.sqrt(max(float(covariances[..., 2, 2].max()), 0.0))
    return heading_std > _UNSURE_HEADING or is_contradicted(problem, found)


def _contradictions(problem: Problem, found: Association) -> float:
    """Share of the looks that pass through walls, without those that saw nothing and may be dropouts of the sensor.

    A beam that saw nothing counts if it also saw nothing in the steps before and after.
    """
    looks, steps = problem.looks, len(problem.starts) * problem.steps
    is_empty = np.zeros((steps + 2, len(problem.robot.beams)), dtype=bool)
    is_empty[looks.places[~problem.is_hit] + 1, looks.beams[~problem.is_hit]] = True
    lasts = is_empty[:-2] & is_empty[1:-1] & is_empty[2:]
    counts = problem.is_hit | lasts[looks.places, looks.beams]
    kept = Readings(looks.places[counts], looks.beams[counts], looks.distances[counts])
    return tally(replace(problem, looks=kept), found).contradictions / max(len(kept), 1)


def _smoothed(best: Settled) -> SmoothedRun:
    problem, found = best.problem, best.association
    poses = np.moveaxis(found.state.poses, 0, 1).copy()
    poses[..., 2] = wrap_angle(poses[..., 2])
    landmarks, segments = smoothed_map(problem, found)
    return SmoothedRun(
        poses=poses,
        covariances=np.moveaxis(pose_covariances(found.solution), 0, 1).copy(),
        landmarks=landmarks,
        segments=segments,
        calibration=found.state.calibration if problem.prior is not None or problem.bias else None,
        moves=best.moves,
        contradictions=_contradictions(problem, found),
        range_std=problem.range_std,
        beam_width=problem.beam_width,
        robot=problem.robot,
        turns=_turns(best),
        continued_from=best.continued_from,
    )


def _turns(best: Settled) -> FloatArray | None:
    """The turns of the beams and their standard deviations (n_beams, 2), rad; None if no beam is turned.

    The turns of several robots are not estimated. Those that are known of their sensors have the prior's uncertainty.
    """
    problem = best.problem
    if problem.turns is None:
        return None
    stds = np.full(len(problem.turns), TURN_STD)
    if len(problem.starts) == 1:
        with suppress(DegenerateError):
            stds = np.sqrt(beam_turns(problem, best.association)[1].diagonal())
    return np.column_stack((problem.turns, stds))
