"""The consistent estimator: SLAM with lines in which each range is used once, as a measurement of a
cloned pose.

Readings are pending, beside clones of the poses that they were taken from, until the Hough
transform finds a line in them and it is clear which wall the line is. Then each reading updates the
filter as one range from one pose.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import AgentConfig
from limslam_agent.kernels.tables import FEWEST, Walls
from limslam_agent.slam.consistent import limits
from limslam_agent.slam.consistent.assumed_sensor import AssumedSensor
from limslam_agent.slam.consistent.map_state import MapState
from limslam_agent.slam.consistent.pending_readings import (
    RANGE,
    SIDES,
    WAITING,
    Belief,
    Scan,
    Setup,
    most_clones,
    note_motion,
    pending_of,
    readings_of,
    sides_of,
)
from limslam_agent.slam.consistent.reports import StepReports
from limslam_agent.slam.consistent.step_settings import step_settings
from limslam_agent.slam.consistent.wall_map import NEW, WallMap
from limslam_agent.slam.core.contact import Contacts
from limslam_agent.slam.core.diagnostics import PendingPoints
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import (
    AS_SPECIFIED,
    Calibration,
    HeadingCalibration,
    Motion,
    OdometryCalibration,
    calibrated,
)
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.turn_meter import Turn
from limslam_env.geometry import FloatArray
from limslam_env.geometry.segment import sample
from limslam_env.interface import Observation, RobotSpec

if TYPE_CHECKING:
    from limslam_agent.slam.consistent.clone_ekf import CloneEKF

KNOWN_SPACING = 0.01
"""Distance, m, between the points by which a wall of an earlier map is counted, as if beams had
ended there.
"""

KNOWN_VARIANCES = (0.01**2, math.radians(0.2) ** 2)
"""Variances, m^2 and rad^2, that are added to those of an earlier map's lines, whose correlations
are not known.
"""

_CALIBRATION_GATE = (
    8.0  # twice the logarithm of the Bayes factor for wheels and axle of other sizes
)


class ConsistentEstimator(Estimator):
    """SLAM in which each reading updates, once, the pose that it was taken from.

    A ``sensor`` is how the ranges are measured, if that is known to differ from the specified one.
    """

    filter: "CloneEKF"

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig,
        start_pose: FloatArray | None = None,
        sensor: RangeSensor | None = None,
    ) -> None:
        # Kernels. Who imports this module need not wait for numba.
        from limslam_agent.slam.consistent.clone_ekf import CloneEKF

        super().__init__(robot, config, start_pose)
        robots = len(self.robots)
        own = self._own
        calibration = own.self_calibration
        errors = own.range_errors
        stds = (
            errors.stds(len(robot.beams) if robots == 1 else 0, robot.control_period)
            if errors.enabled
            else None
        )
        odometry = None if calibration.calibrate == "never" else calibration.covariance
        self.filter = CloneEKF(self._start, odometry, stds)
        if calibration.calibrate == "always":
            self.filter.calibrate()
        self._with_heading: set[int] = set()  # robots whose calibration is one of headings
        self._contacts = [Contacts(robot, config.range_std) for _ in self.robots]
        pending = own.pending
        self._sides = sides_of(robot, pending.beams)
        widest = int(np.bincount(self._sides + 1, minlength=2)[1:].max())
        room = widest * most_clones(pending.batch, pending.max_clones, robots)
        self._pending = pending_of(robots, room)
        self._sensor = AssumedSensor(self._specified, float(robot.max_ranges.max()), errors)
        self._assume(sensor or self._specified)
        self._map: WallMap = WallMap(self.filter, own.extents)

    def step(self, *observations: Observation) -> None:
        """Predict, collect the readings of beams that have hit no teammate, and process each side
        that has enough of them: see the base class.
        """
        motions = self._read(observations)
        for number, motion in enumerate(motions):
            self._predict(number, motion)
        self._drop_beams_on_robots()
        for number, front in enumerate(self.robots):
            self._measure(number, front)

    @property
    def _own(self) -> ConsistentConfig:
        return cast(ConsistentConfig, self.config.estimator)

    @property
    def walls(self) -> Walls:
        """The landmarks without their lines, in arrays."""
        return self._map.arrays

    @property
    def association_limits(self) -> dict[str, float]:
        """The limits that decide about associations and loops, for diagnostics to show beside the
        values.
        """
        return {
            "gate": self.settings.gate,
            "far_gate": limits.FAR_GATE,
            "angle": limits.MAX_ANGLE,
            "offset": limits.MAX_OFFSET,
            "gap": limits.MAX_END_GAP,
            "loop_gate": limits.ONE_WALL_GATE,
            "loop_overlap": limits.MIN_OVERLAP,
            "loop_offset": limits.MAX_OFFSET,
        }

    def know(self, landmarks: Sequence[Landmark], segments: FloatArray) -> None:
        """Begin with the walls (k, 4), m, of an earlier map, and the landmarks that they lie on."""
        for mark in landmarks:
            if mark.segments:
                points, _ = sample(segments[list(mark.segments)], KNOWN_SPACING)
                spread = mark.covariance + np.diag(KNOWN_VARIANCES)
                self.filter.add_known_line(
                    np.array([mark.r, mark.theta]), spread, points.mean(axis=0)
                )
                self._map.add_known(points)

    @property
    def odometry_calibrations(self) -> list[tuple[Calibration, FloatArray] | None]:
        """Each robot's odometry calibration and its covariance (3, 3); None while its odometry is
        not corrected.
        """
        found = [self.filter.calibration(robot) for robot in range(len(self.robots))]
        return [
            each and (self._calibration_of(number, each[0]), each[1])
            for number, each in enumerate(found)
        ]

    def calibrate(self, found: tuple[Calibration, FloatArray] | None = None) -> None:
        """Correct the odometry from now on, by the readings so far, or, before the first step, by a
        calibration and its covariance (3, 3) that an earlier drive of the robot has found.
        """
        self.filter.calibrate()
        if found is not None:
            self.filter.know_calibration(np.array(found[0]), found[1])
            if isinstance(found[0], HeadingCalibration):
                self._with_heading.add(0)

    @property
    def sensor(self) -> RangeSensor:
        """How the sensor measures, as specified or as the data require."""
        return self._sensor.sensor

    @property
    def beam_turns(self) -> FloatArray | None:
        """By what each beam is turned to the left, and its standard deviation (n_beams, 2), rad;
        None if no beam is.
        """
        assumed = self.sensor.turns
        if not assumed or self.filter.range_errors is None:
            return None
        turns, covariance = self.filter.range_errors.turns
        if not len(turns):
            return None
        return np.column_stack((turns + assumed, np.sqrt(covariance.diagonal())))

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3), also by what is unknown of the map's size."""
        found = super().covariances
        std = self.sensor.scale_std
        if std:
            away = std * (self.poses - self._start) * (1.0, 1.0, 0.0)
            found += away[:, :, None] * away[:, None]
        return found

    @property
    def is_renewable(self) -> bool:
        """Whether pose and map can be replaced: those of a single robot."""
        return len(self.robots) == 1

    @property
    def map_state(self) -> MapState:
        """The pose of the robot and the map, without the pending readings. Later steps do not
        change it.
        """
        self._check_renewable()
        ekf = self.filter
        return MapState(ekf.pose, ekf.anchored, ekf.anchors.copy(), ekf.marginal(), self._map.walls)

    def renew(self, state: MapState) -> None:
        """Replace the pose of the only robot and the map, and forget the pending readings, which
        the new map knows.

        Landmarks with the number ``NEW`` get new numbers, and those that are a known wall are
        merged with it: at first those that were recognised, since another wall may be as near to
        where a landmark seems to be. Landmarks through which most beams have passed by now are left
        out.
        """
        from limslam_agent.slam.consistent.merging import close_loops_of

        self._check_renewable()
        walls = self._map.up_to_date(state.walls)
        state = replace(state, walls=walls).select(
            [index for index, wall in enumerate(walls) if wall.is_wall]
        )
        self.filter.restart(state.pose, state.lines, state.anchors, state.covariance)
        new = self._map.replace(state.walls)
        known_as = [wall.known_as for wall in state.walls if wall.number == NEW]
        reports = self._reports(0)
        self._merge_recognised(new, known_as, reports)
        for number in new:
            places = np.flatnonzero(self._map.numbers == number)
            if len(places):
                close_loops_of(self._belief, int(places[0]), self.settings, reports)
        self._pending.fill[:] = 0

    def relocate(
        self,
        pose: FloatArray,
        covariance: FloatArray,
        robot: int = 0,
        ends: FloatArray | None = None,
    ) -> None:
        """Put a robot at another pose (3,), m, m, rad, with the covariance (3, 3) of its error.

        Readings that are still pending are used before. If a match has found the pose, its readings
        end at ``ends`` (n, 2), m. The covariance is then that of the match, and the pose has the
        errors of the walls at these points, if the estimate can be renewed. Otherwise it is
        independent of the map.
        """
        self.finish()
        by_lines = (
            None if ends is None or not self.is_renewable else self.map_state.by_walls(pose, ends)
        )
        self.filter.relocate(pose, covariance, robot, by_lines)

    def _predict(self, number: int, motion: Motion) -> None:
        """Predict the pose of a robot, whose motion is less certain if it touches something, as the
        wheels show.
        """
        if motion.turn is not None:
            self._learn_from_turn(number, motion.turn)
        found = self.filter.calibration(number)
        front = self.robots[number]
        if found is not None:
            calibration = self._calibration_of(number, found[0])
            motion = calibrated(motion, self.robot.axle, calibration)
        elif self.filter.calibration_evidence is not None:
            motion = calibrated(motion, self.robot.axle, AS_SPECIFIED)
        if motion.is_by_wheels:
            motion = self._contacts[number].loosened(motion, front.ranges, front.measured)
        self.filter.predict(motion, number)
        note_motion(self._pending, number, motion.increment)

    def _learn_from_turn(self, number: int, turn: Turn) -> None:
        """Make the constant errors of a robot's heading a part of the state, once, and observe its
        drift.
        """
        if number not in self._with_heading:
            self._with_heading.add(number)
            self.filter.calibrate()
            prior = self._own.self_calibration
            self.filter.know_calibration(np.zeros(3), prior.heading_covariance, number)
        if turn.drift is not None:
            self.filter.observe_drift(turn.drift, turn.drift_variance, number)

    def _calibration_of(self, number: int, errors: FloatArray) -> Calibration:
        """The constant errors (3,) of a robot's odometry."""
        if number in self._with_heading:
            return HeadingCalibration(*errors.tolist())
        return OdometryCalibration(*errors.tolist())

    def _measure(self, number: int, front: FrontEnd) -> None:
        """Collect the new readings of a robot, and use each side that has enough of them."""
        from limslam_agent.slam.consistent.step import measure

        self._make_room()
        jitter = self.filter.jitters[number]
        scan = Scan(front.step, front.ranges, front.measured, front.hits, jitter)
        measure(self._belief, number, scan, self._setup, self._reports(number))
        if (self.filter.calibration_evidence or 0.0) > _CALIBRATION_GATE:
            self.calibrate()
            self._assume(self.sensor._replace(bend=0.0))  # it may have been due to the wheels
        self._correct_sensor()

    def finish(self) -> None:
        """Use all pending readings."""
        from limslam_agent.slam.consistent.step import use_side

        for number in range(len(self.robots)):
            reports = self._reports(number)
            for side in range(len(SIDES)):
                self._make_room()
                use_side(self._belief, number, side, True, self._setup, reports)  # noqa: FBT003

    @property
    def pending_points(self) -> list[PendingPoints]:
        """End points of the pending readings, by robot and side."""
        from limslam_agent.slam.consistent.clone_filter import end_points

        found = []
        ekf = self.filter.arrays
        for row, (waiting, fresh) in enumerate(self._pending.fill.tolist()):
            readings = readings_of(ekf, self._pending.rows[row, :waiting], self._setup)
            number, side = divmod(row, len(SIDES))
            points = end_points(ekf, readings, math.nan)
            found.append(PendingPoints(number, SIDES[side], points, self.settings.batch, fresh))
        return found

    def _assume(self, sensor: RangeSensor) -> None:
        """Take the sensor to measure like this from now on."""
        self._sensor.assume(sensor)
        self.filter.arrays = self.filter.arrays._replace(bend=sensor.bend)
        self.filter.has_turned_beams = bool(sensor.turns)
        self.settings = step_settings(self._own, sensor, self._sensor.usual_std)
        table = sensor.mounted(self.robot).beam_table
        self._setup = Setup(self.settings, table, self._sides)

    @property
    def _belief(self) -> Belief:
        return Belief(self.filter.arrays, self._map.arrays, self._pending)

    def _reports(self, number: int) -> StepReports:
        step = self.robots[number].step
        return StepReports(self, self._sensor, self._map, number, step)

    def _make_room(self) -> None:
        """Make room for another clone, and for all lines that the readings may show."""
        waiting = int(self._pending.fill[:, WAITING].sum()) + len(self.robot.beams)
        lines = len(self._pending.fill) + waiting // min(self.settings.min_votes, FEWEST)
        self._map.make_room(lines)
        self.filter.make_room(lines=lines, clones=1)

    def assume(self, sensor: RangeSensor) -> None:
        """Take the sensor to measure like this from now on, and correct the state for what was
        assumed before.
        """
        self.filter.correct_ranges(sensor.change_from(self.sensor))
        pending = self._pending.rows[..., RANGE]
        pending[:] = sensor.true(self.sensor.reported(pending))
        self._assume(sensor)

    def learn_from(self, other: Estimator) -> None:
        """Take robots, odometry and sensor to be from now on as another SLAM has found them."""
        super().learn_from(other)
        if other.sensor != self.sensor:
            self.assume(other.sensor)
        if any(found is not None for found in other.odometry_calibrations):
            self.calibrate()

    def correct_delay(self) -> None:
        """Take the ranges to be as late as they are, if the readings say so. The caller lets the
        wheels wait for them.

        Without that, the same delay would be found again and again.
        """
        found = self._sensor.delayed(self.filter.range_errors)
        if found is not None:
            self.assume(found)

    def leave_out(self, beam: int) -> None:
        """Use no further readings of a broken beam. What was found about the sensor may have been
        due to it.
        """
        if self.is_renewable:
            self._forget_sensor_but((*self.sensor.broken, beam))

    def forget_sensor(self) -> None:
        """Take the sensor to be as specified again, apart from what is known of broken and late
        beams.
        """
        if self.is_renewable:
            self._forget_sensor_but(self.sensor.broken)

    def _forget_sensor_but(self, broken: tuple[int, ...]) -> None:
        self.assume(self._specified._replace(delay=self.sensor.delay, broken=broken))

    def _check_renewable(self) -> None:
        if not self.is_renewable:
            raise TypeError("only the estimate of a single robot can be renewed")

    def _correct_sensor(self) -> None:
        """Take the sensor's errors as estimated, if the readings say that they are not as
        assumed.
        """
        found = self._sensor.correction(self.filter.range_errors)
        if found is None:
            found = self._scaled()
        elif found.places != self.sensor.places:  # what was taken for a scale may have been this
            found = found._replace(scale=0.0, scale_std=0.0)
        if found is not None:
            self.assume(found)

    def _scaled(self) -> RangeSensor | None:
        """The sensor with another scale, if the wheels of the only robot seem to have another
        size. That is found while the mapper can begin anew: it does not correct the state.
        """
        is_early = self.is_renewable and self.robots[0].step < limits.RESTART_WITHIN
        found = self.filter.calibration() if is_early else None
        if found is None:
            return None
        wheels = np.array([1.0, 0.0, 0.0] if self._with_heading else [0.5, 0.5, 0.0])
        prior = self._own.self_calibration.size_std
        return self._sensor.scaled(
            self.filter.range_errors,
            float(wheels @ found[0]),
            float(wheels @ found[1] @ wheels) ** 0.5,
            prior,
        )

    def _merge_recognised(
        self, new: Sequence[int], known_as: Sequence[int], reports: StepReports
    ) -> None:
        """Merge new landmarks with the known ones that they were recognised as, as far as all of
        them agree.
        """
        from limslam_agent.slam.consistent.merging import merge_landmarks

        places = {number: place for place, number in enumerate(self._map.numbers.tolist())}
        pairs = [
            (places[known], places[number])
            for number, known in zip(new, known_as, strict=True)
            if self.settings.closes_loops and known in places
        ]
        agreeing = [pairs[chosen] for chosen in self._map.agreeing(pairs)]
        # The younger landmark is removed: the last ones first, so that the others keep their
        # places.
        for older, younger in sorted(agreeing, key=lambda pair: -pair[1]):
            merge_landmarks(self._belief, older, younger, reports)
