"""Smoothing of a finished run: all poses and the map, from the observations and the filter's
estimates.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.kernels.tables import FEWEST
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure
from limslam_agent.slam.core.encoder_ticks import ticks_of
from limslam_agent.slam.core.late_ranges import ahead, behind, headings_held_back, held_back
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.graph.graph import DegenerateError
from limslam_agent.slam.line_graph.factors import motion_jacobians, motions_between
from limslam_agent.slam.line_graph.line_smoother import Solution, solve, where_read
from limslam_agent.slam.line_graph.problem import (
    CALIBRATION_PRIOR,
    HEADING_PRIOR,
    RELATIVE_PRIOR,
    Problem,
    make_problem,
    state_from_poses,
)
from limslam_agent.slam.line_graph.reassociation import Association, reassociate
from limslam_agent.slam.line_graph.smoothed_map import contradictions, lasting, smoothed_map
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import compose, inverse, turned, wrap_angle
from limslam_env.interface import NominalNoise, RobotSpec

# Chi-square of the estimated errors, of which each robot has five, from which on they are taken to
# be real. Felt by the rows "drive 4 cm" and "sharp" of the scoreboard, whose robots have no such
# errors.
_CALIBRATION_GATE = 40.0
# m, m, rad: how far the place at which a carried robot was found may be off beyond the covariances
# of its poses. It is so wide that the readings decide, and so narrow that they are still associated
# with the walls around that place.
_FOUND_STDS = np.array([0.3, 0.3, math.radians(10.0)])


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """A run of n robots in t steps: the observations and the filter's estimates."""

    # robot, noise: body and beams of each robot, and the specified noise
    robot: RobotSpec
    noise: NominalNoise
    # wheels, ranges: observations (t, n, 2) and (t, n, n_beams), m; row 0 is the observation at the
    # reset
    wheels: FloatArray
    ranges: FloatArray
    # Mask (t, n, n_beams) of the readings that are of walls, without readings that may be of other
    # robots
    usable: BoolArray
    # poses, covariances: the filter's estimates at each step (t, n, 3) and (t, n, 3, 3); the first
    # poses are the known starts
    poses: FloatArray
    covariances: FloatArray
    # associations, closures: the associations of the observed lines, and the merged landmarks, in
    # order
    associations: list[AssociationRecord]
    closures: list[Closure]
    first_step: int = 0  # step of the drive that row 0 belongs to, if the run is a part of a drive
    # Robots and steps before which a robot was carried away. The poses before and after say where
    # to.
    breaks: tuple[tuple[int, int], ...] = ()
    # Robots and parts of the drive, from a step to before another one, in one step of which a robot
    # has slipped
    slips: tuple[tuple[int, int, int], ...] = ()
    # How the sensor measures, as the filter has found out. None if it is as ``robot`` and ``noise``
    # state.
    sensor: RangeSensor | None = None
    # The ticks (n, 2) of the encoders, m, as the filter has found them; by ``wheels`` if left out
    ticks: FloatArray | None = None
    # Travel (t, n, 2) that waits for late ranges, m. With it, each pose is that of the readings of
    # its step.
    waiting: FloatArray | None = None
    # Headings (t, n) by inertial measurement units, rad; None without such sensors
    yaw: FloatArray | None = None
    # Variances (t, n, 2) of the wheels' travel beyond the noise of encoders, m^2; None if it is
    # known everywhere
    wheel_variances: FloatArray | None = None

    @property
    def has_headings(self) -> bool:
        """Whether a robot has ever reported a heading."""
        return self.yaw is not None and not bool(np.isnan(self.yaw).all())

    @property
    def corrected(self) -> "FilteredRun":
        """The run with readings that are corrected for what is known of its sensor."""
        sensor = self.sensor
        if sensor is None:
            return self
        ranges = sensor.corrected(self.ranges, self.robot)
        return replace(self, ranges=ranges, sensor=sensor._replace(bias=0.0, scale=0.0))

    @property
    def unknown(self) -> FloatArray:
        """Variances (t, n, 2) of the wheels' travel beyond the noise of encoders, m^2, also where
        the wheels may have slipped in any step of a part of the drive. The readings say in which.
        """
        given = self.wheel_variances
        found = np.zeros(self.wheels.shape) if given is None else given.copy()
        wheel = _FOUND_STDS[2] * self.robot.axle / math.sqrt(2.0)
        for number, first, last in self.slips:
            part = slice(max(first, 1), last)
            found[part, number] += wheel**2 / max(last - part.start, 1)
        return found

    @property
    def synchronous(self) -> "FilteredRun":
        """The run with wheels that wait for late ranges."""
        delay = 0.0 if self.sensor is None else self.sensor.delay
        if not delay or self.waiting is not None:
            return self
        wheels = held_back(self.wheels, delay)
        waiting = np.cumsum(self.wheels - wheels, axis=0)
        poses = behind(self.poses, waiting, self.robot.axle)
        ticks = ticks_of(self.wheels)
        yaw = None if self.yaw is None else headings_held_back(self.yaw, delay)
        return replace(self, wheels=wheels, poses=poses, ticks=ticks, waiting=waiting, yaw=yaw)

    def until(self, step: int | None) -> "FilteredRun":
        """The run before a step of its own, with what the filter had found out by then."""
        if step is None:
            return self
        rows = ["wheels", "ranges", "usable", "poses", "covariances"]
        end = self.first_step + step
        optional = ("waiting", "yaw", "wheel_variances")
        rows += [name for name in optional if getattr(self, name) is not None]
        return replace(
            self,
            **{name: getattr(self, name)[:step] for name in rows},
            associations=[each for each in self.associations if each.readings[:, 0].max() < end],
            closures=[each for each in self.closures if each.step < end],
            breaks=tuple(each for each in self.breaks if each[1] < step),
            slips=tuple(
                (number, first, min(last, step))
                for number, first, last in self.slips
                if first < step
            ),
        )


@dataclass(frozen=True, eq=False)
class SmoothedRun:
    """The smoothed estimate of a run."""

    # poses, covariances: poses (t, n, 3), m and rad, and covariances (t, n, 3, 3)
    poses: FloatArray
    covariances: FloatArray
    # the poses (t, n, 3) at which the ranges were read: others than ``poses`` if these are late
    read_at: FloatArray
    # landmarks, segments: the walls of the map: their lines as landmarks with covariances, and
    # their segments (k, 4), m
    landmarks: list[Landmark]
    segments: FloatArray
    # The readings of each robot that lie on each landmark, by its place in ``landmarks``
    associations: list[AssociationRecord]
    # Calibration (n, 5): relative excess of left wheel, right wheel and axle over their specified
    # values, or with a heading sensor the numbers of ``HeadingCalibration``; and the bias, m,
    # and the scale of all ranges. None where the robots are taken to be as specified, and neither
    # is known.
    calibration: FloatArray | None
    ranges: FloatArray  # the readings (t, n, n_beams), m, corrected for all that is known of them
    contradictions: float  # share of all looks that passed through a wall of the solution
    robot: RobotSpec  # the robot with its beams as they are mounted


def smooth_run(
    run: FilteredRun, config: SmootherConfig | None = None, unplaced: int | None = None
) -> SmoothedRun | None:
    """Estimate all poses and lines of a run from all its measurements.

    The filter's associations are the initial associations, and every association can change. The
    result is None if the robots did not move or no wall was seen often enough: there is nothing to
    smooth then.

    ``unplaced`` is the step from which on the filter did not know the place of the only robot. From
    there on, the poses are those of the filter.
    """
    run = run.synchronous
    found = settle(run.until(unplaced), config or SmootherConfig())
    return None if found is None else _smoothed(found, run)


def beside(first: FilteredRun, second: FilteredRun, frame: FloatArray) -> FilteredRun:
    """Two runs of one robot each as a run of two robots, of which the one whose run is shorter
    stands still at its end.

    ``frame`` (3,) is the pose of the second run's frame in that of the first one.
    """
    first = first.corrected
    second = second.corrected
    moved = replace(
        second,
        poses=compose(frame, second.poses),
        covariances=turned(second.covariances, float(frame[2])),
    )
    steps = max(len(first.poses), len(second.poses))
    at_the_end: dict[str, Any] = {
        "wheels": 0.0,
        "ranges": math.nan,
        "usable": False,
        "poses": None,
        "covariances": None,
        "wheel_variances": 0.0,
    }
    if first.yaw is not None and second.yaw is not None:
        at_the_end["yaw"] = math.nan
    columns: dict[str, Any] = {}
    for name, value in at_the_end.items():
        own = [
            run.unknown if name == "wheel_variances" else getattr(run, name)
            for run in (first, moved)
        ]
        rest = [
            np.full((steps - len(each), *each.shape[1:]), each[-1] if value is None else value)
            for each in own
        ]
        columns[name] = np.concatenate(
            [np.concatenate(each) for each in zip(own, rest, strict=True)], axis=1
        )
    apart = 1 + max((record.landmark for record in first.associations), default=-1)
    seconds = [
        replace(each, landmark=each.landmark + apart, robot=1) for each in second.associations
    ]
    united = [
        replace(each, older=each.older + apart, younger=each.younger + apart)
        for each in second.closures
    ]
    longer = max(
        (first, second), key=lambda each: len(each.poses)
    )  # its readings say more about the sensor
    return FilteredRun(
        robot=first.robot,
        noise=first.noise,
        associations=[*first.associations, *seconds],
        closures=[*first.closures, *united],
        breaks=(*first.breaks, *((1, step) for _, step in second.breaks)),
        sensor=longer.sensor,
        **columns,
    )


def smooth_with_unknown_start(
    run: FilteredRun, config: SmootherConfig | None = None
) -> SmoothedRun | None:
    """Smooth a run of two robots as :func:`smooth_run`. The second one's start is known only
    roughly.

    It may have been carried before its first step. Its start then follows from its pose after this
    step.
    """
    usable = run.usable.copy()
    usable[0, 1] = False
    found = smooth_run(replace(run, usable=usable, breaks=(*run.breaks, (1, 1))), config)
    if found is not None:
        motion = compose(inverse(run.poses[1, 1]), run.poses[0, 1])
        found.poses[0, 1], found.covariances[0, 1] = (
            compose(found.poses[1, 1], motion),
            found.covariances[1, 1],
        )
    return found


def settle(run: FilteredRun, config: SmootherConfig) -> Association | None:
    """The solution of a run; None if there is nothing to smooth."""
    if len(run.poses) < 2:
        return None
    prior = CALIBRATION_PRIOR if config.calibrate == "always" else None
    if run.has_headings and config.calibrate != "never":
        prior = HEADING_PRIOR
    problem = make_problem(
        run.robot,
        run.noise,
        run.poses[0],
        run.wheels,
        run.ranges,
        run.usable,
        prior,
        run.first_step,
        run.sensor,
        run.ticks,
        run.yaw if run.has_headings else None,
        run.unknown,
    )
    problem = with_breaks(problem, run)
    labels = filter_labels(problem, run.associations, run.closures, run.first_step)
    if np.count_nonzero(labels >= 0) < FEWEST:
        return None
    try:
        best = lasting(reassociate(problem, state_from_poses(problem, run.poses), labels))
        if config.calibrate == "if_needed" and not run.has_headings:
            best = _calibrated_if_needed(best, run, labels)
    except DegenerateError:
        return None
    return best


def _calibrated_if_needed(found: Association, run: FilteredRun, labels: IntArray) -> Association:
    """The solution with constant errors of wheels, axle and ranges if these are significant, before
    and after it.
    """
    sized = _calibrated(found.problem)
    if sized.sensor.scale_std:  # the size of the whole map is unknown, too
        return reassociate(sized, found.state, labels)
    if not _has_errors(sized, solve(sized, found.state, found.labels)):
        return found
    again = lasting(reassociate(sized, state_from_poses(sized, run.poses), labels))
    return again if _has_errors(sized, again.solution) else found


def _has_errors(problem: Problem, solution: Solution) -> bool:
    """Whether the estimated constant errors are significant, by Wald's test."""
    values = solution.state.calibration.ravel()
    return float(
        values @ np.linalg.solve(solution.of_calibration, values)
    ) > _CALIBRATION_GATE * len(problem.starts)


def _calibrated(problem: Problem) -> Problem:
    """The problem with constant errors of wheels, axle and ranges.

    What a wide beam reads, and what a sensor reads whose noise grows with the range, is known to
    some millimetres only. That looks like a common error of all sizes with a bias, so the robots of
    such sensors have relative errors alone, unless a bias or a scale is known: a wrong one has to
    be corrected.
    """
    sensor = problem.sensor
    is_rough = (sensor.cone > 0.0 or sensor.growth > 0.0) and not (sensor.bias or sensor.scale_std)
    return replace(problem, prior=RELATIVE_PRIOR if is_rough else CALIBRATION_PRIOR)


def with_breaks(problem: Problem, run: FilteredRun) -> Problem:
    """A problem in which carried robots came to where the filter found them: their wheels say
    nothing of that motion.

    The filter has found them by hundreds of readings, of which the associations of the run hold a
    few only.
    """
    wheels = problem.wheels.copy()
    roots = problem.roots.copy()
    jumps = np.zeros_like(problem.wheels)
    turns = None if problem.turns is None else problem.turns.copy()
    for number, step in run.breaks:
        poses = run.poses[step - 1 : step + 1, number].copy()
        covariances = run.covariances[step - 1 : step + 1, number]
        poses[1, 2] = poses[0, 2] + wrap_angle(float(poses[1, 2] - poses[0, 2]))
        wheels[number, step - 1] = 0.0
        if turns is not None:
            turns[number, step - 1] = 0.0
        jumps[number, step - 1] = motions_between(poses, problem.robot.axle)[0]
        jacobian = motion_jacobians(poses, problem.robot.axle)[0]
        both = block_diag(covariances[0], covariances[1] + np.diag(_FOUND_STDS**2))
        roots[number, step - 1] = np.linalg.inv(np.linalg.cholesky(jacobian @ both @ jacobian.T))
    return replace(
        problem, wheels=wheels, roots=roots, turns=turns, jumps=jumps if run.breaks else None
    )


def filter_labels(
    problem: Problem,
    associations: Iterable[AssociationRecord],
    closures: list[Closure],
    first_step: int = 0,
) -> IntArray:
    """For each reading (k,), the landmark of the filter's final association, or -1. Row 0 is a step
    of the drive.
    """
    count = len(problem.starts)
    steps = problem.steps
    table = np.full((count * steps, len(problem.robot.beams)), -1)
    united = {closure.younger: closure.older for closure in closures}
    for record in associations:
        number = record.landmark
        while number in united:
            number = united[number]
        rows = record.readings[:, 0] - first_step
        beams = record.readings[:, 1]
        table[record.robot * steps + rows[rows >= 0], beams[rows >= 0]] = number
    return np.asarray(table[problem.readings.places, problem.readings.beams])


def _smoothed(found: Association, run: FilteredRun) -> SmoothedRun:
    problem = found.problem
    covariances = np.moveaxis(found.solution.of_poses + problem.jitters(found.state), 0, 1)
    state = where_read(problem, found.state, found.labels)
    found = replace(found, solution=replace(found.solution, state=state))
    poses = np.moveaxis(state.poses, 0, 1).copy()
    poses[..., 2] = wrap_angle(poses[..., 2])
    landmarks, segments = smoothed_map(found)
    read_at = np.concatenate((poses, run.poses[len(poses) :]))
    sensor = problem.sensor
    calibration = np.add(found.state.calibration, (0.0, 0.0, 0.0, sensor.bias, sensor.scale))
    sensors = [sensor._replace(bias=bias, scale=scale) for *_, bias, scale in calibration.tolist()]
    ranges = [own.corrected(run.ranges[:, number], run.robot) for number, own in enumerate(sensors)]
    return SmoothedRun(
        ranges=np.stack(ranges, axis=1),
        poses=read_at if run.waiting is None else ahead(read_at, run.waiting, run.robot.axle),
        read_at=read_at,
        covariances=np.concatenate((covariances, run.covariances[len(poses) :])),
        landmarks=landmarks,
        segments=segments,
        associations=_associations(found, landmarks, run.first_step),
        calibration=calibration
        if problem.prior is not None or sensor.bias or sensor.scale
        else None,
        contradictions=contradictions(found),
        robot=problem.robot,
    )


def _associations(
    found: Association, landmarks: list[Landmark], first_step: int
) -> list[AssociationRecord]:
    problem = found.problem
    readings = found.problem.readings
    records = []
    for number, mark in enumerate(landmarks):
        for robot in range(len(problem.starts)):
            own = (found.labels == mark.number) & (readings.places // problem.steps == robot)
            rows = np.column_stack(
                (readings.places[own] % problem.steps + first_step, readings.beams[own])
            )
            if len(rows):
                records.append(AssociationRecord(number, is_new=False, readings=rows, robot=robot))
    return records
