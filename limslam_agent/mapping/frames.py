"""Frames: the frames in which robots map one after the other, and how a lost robot goes from one to
the next.
"""

from collections.abc import Iterable

import numpy as np

from limslam_agent.config.presets import AgentConfig, self_calibrating
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.mapping.frame_mapper import FrameMapper
from limslam_agent.places.absence import Placement, StepLog
from limslam_agent.places.recovery import Recovery
from limslam_agent.places.revisions import Revision, Unplaced
from limslam_agent.slam.core.motion import OdometryCalibration
from limslam_agent.slam.slam import (
    ConsistentEstimator,
    Estimator,
    LineSlam,
    RangeSensor,
    is_renewable,
)
from limslam_agent.status.monitor import Loss
from limslam_agent.status.rays import Sight
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec

WRONG_PLACE = Loss(Status("lost", "the readings contradict the map at the place that was found"), 0)


class Frames:
    """The present frame of one robot or several, with its SLAM and grid, and what is known in every
    frame.

    Attributes
    ----------
    slam_ms
        Wall-clock time that the SLAM took in the latest step, without the grid and the odometry,
        ms.
    frame
        Number of times that the frame of the poses has changed: a lost robot goes on in a local
        frame until it has found its place, and then in the earlier frame again. A renewal that
        moves the path far counts as well.
    map_number
        Number of the present map. A local frame has a map of its own; in the earlier frame, the
        number is as before.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig) -> None:
        if not isinstance(robot, RobotSpec) or not isinstance(config, AgentConfig):
            raise TypeError(
                "a mapper needs a RobotSpec and an AgentConfig, in this order, not "
                f"{type(robot).__name__} and {type(config).__name__}"
            )
        self.robot = robot
        self.config = config

    def _begin(self, slam: Estimator) -> None:
        """Begin with an empty map in the first frame."""
        self._present = FrameMapper(slam, OccupancyGrid(self.config.grid), self.config)
        self.frame = self.map_number = self._own_map = self._maps = 0
        self.slam_ms = 0.0
        self._revisions = list[Revision]()
        self._unplaced: Unplaced | None = None

    @property
    def slam(self) -> Estimator:
        """The SLAM, with landmarks, loop closures and everything else that it knows. Another frame
        has another SLAM.
        """
        return self._present.slam

    @property
    def _followed(self) -> ConsistentEstimator:
        """The SLAM of a robot that finds its place again when it is lost."""
        slam = self.slam
        assert is_renewable(slam)  # noqa: S101 (no other one is followed)
        return slam

    def _found(self) -> tuple[RangeSensor, list[bool], list[list[float]]]:
        """The sensor as it is known now, whether sizes of wheels and axle of each robot are
        corrected, and for how many steps its beams repeat their readings.

        The errors of a heading are a part of the state from the start.
        """
        slam = self.slam
        is_calibrated = [
            each is not None and isinstance(each[0], OdometryCalibration)
            for each in slam.odometry_calibrations
        ]
        return slam.sensor, is_calibrated, [front.holds for front in slam.robots]

    def _slam_at(self, starts: FloatArray) -> Estimator:
        """A SLAM with an empty map and robots at these poses, with what is known of odometry and
        sensor.
        """
        sensor, is_calibrated, _ = self._found()
        config = self_calibrating(self.config) if any(is_calibrated) else self.config
        slam = LineSlam(self.robot, config, starts, sensor)
        for front, known in zip(slam.robots, self.slam.robots, strict=False):
            front.know_repeats(known)
            if sensor.delay:  # it cannot find them in travel that waits
                front.ticks = known.ticks
        return slam

    def _use(self, slam: Estimator, grid: OccupancyGrid) -> None:
        """Go on with another SLAM and grid, in another frame, with what is known of odometry and
        sensor.
        """
        slam.learn_from(self.slam)
        self._present = FrameMapper(slam, grid, self.config, self._present.drawers)
        self.frame, self.map_number = self.frame + 1, self._own_map

    def _number_map(self, *, is_own: bool) -> None:
        """Give a new map its number. The robot never goes back to a map from before its own map."""
        self._maps += 1
        self.map_number, self._own_map = self._maps, self._maps if is_own else self._own_map

    def _process_again(self, observations: Iterable[Observation], begin: int = 0) -> Revision:
        """Process stored observations of the only robot, from a step on, in the present frame."""
        poses = list[FloatArray]()
        covariances = list[FloatArray]()
        for observation in observations:
            # The caller has later steps already, which a renewal would not move.
            self._present.process((observation,), self.frame, may_renew=False)
            self.slam_ms += self._present.slam_ms
            poses.append(self.slam.pose)
            covariances.append(self.slam.covariance)
        return Revision(
            begin, np.array(poses).reshape(-1, 3), np.array(covariances).reshape(-1, 3, 3)
        )

    def _replay(self, log: StepLog, begin: int, end: int) -> Revision:
        """Process the logged steps from ``begin`` to before ``end`` again, and log their new
        poses.
        """
        again = self._process_again(
            (log[number].observation for number in range(begin, end)), begin
        )
        log.move(begin, again.poses)
        return again

    def _follow(self, recovery: Recovery, observation: Observation, motion: FloatArray) -> None:
        """Keep a step, and see to it that a lost robot goes on in a local frame and finds its place
        again.
        """
        own = self._present.monitors[0]
        sensor = self.slam.sensor
        step = Sight.of(self.slam.robots[0], self.slam.pose, motion, observation)
        recovery.note(step, self._followed, self._present.grid, is_suspicious=own.is_suspicious)
        if recovery.is_too_long:
            self._own_map = self.map_number
            recovery.stay()
        if own.loss is not None and recovery.still_fits(own, sensor):
            self._present.reset_monitors()
        elif own.loss is not None:
            self._lose(recovery, own.loss, own.jump)
        elif found := recovery.seek_elsewhere(own, self._followed, self._present.grid):
            self._go_on_at(recovery, found)
        elif recovery.is_due():
            if recovery.is_lost:
                found = recovery.seek(sensor)
                if found is not None:
                    self._go_on_at(recovery, found)
            elif recovery.is_refuted(sensor):
                self._lose(recovery, WRONG_PLACE, 0.0)
            else:
                recovery.confirm(own.by_readings, self._followed, self._present.grid.view)

    def _lose(self, recovery: Recovery, loss: Loss, jump: float) -> None:
        """See to it that a robot that is lost goes on: in a renewed map, near by, or in a local
        frame.
        """
        # The map of a local frame does not say where the robot is in the frame that it was lost
        # from.
        known = None if recovery.is_lost else loss.known
        if recovery.may_be_wrong and known is None:
            self._revisions.pop()  # the place that was found was wrong
        recovery.lose(loss, jump, self._followed, self._present.grid)
        found: Placement | None = None
        if recovery.may_have_drifted:
            found = recovery.seek_near(known, self.slam.sensor)
            if found is None and self._go_on_renewed(recovery):
                return
        if found is None:
            self._go_on_locally(recovery)
        else:
            self._go_on_at(recovery, found)

    def _go_on_locally(self, recovery: Recovery) -> None:
        """Begin a new map in a local frame, with the steps since the robot was lost.

        The new map takes the place of the earlier one if that has too few walls for the robot to be
        found in it.
        """
        absence = recovery.absence
        log = recovery.log
        assert absence is not None  # noqa: S101 (the robot is lost)
        is_anew = recovery.begin_anew()
        slam = self._slam_at(log[absence.first - 1].pose)
        if absence.known is not None and is_renewable(slam):
            calibration = absence.known.slam.odometry_calibrations[0]
            if calibration is not None:
                slam.calibrate(calibration)
        self._use(slam, OccupancyGrid(self.config.grid))
        self._number_map(is_own=is_anew)
        self.slam.robots[0].step = absence.first - 1
        # The first step may be a jump of the odometry, which the local frame begins with and need
        # not doubt again.
        second = min(absence.first + 1, log.end)
        begun = self._replay(log, absence.first, second)
        self._present.begin_anew()
        again = self._replay(log, second, log.end)
        if is_anew:
            self._revise(begun, again)

    def _go_on_renewed(self, recovery: Recovery) -> bool:
        """Renew the estimate of a robot that has just been lost, if that explains its readings;
        whether it was done.
        """
        is_renewed = self._present.renew_lost()
        if is_renewed:
            renewal = self._present.renewal
            poses = renewal.poses
            covariances = renewal.covariances
            self.frame += renewal.has_jumped
            self._revisions.append(
                Revision(recovery.log.end - len(poses), np.array(poses), np.array(covariances))
            )
            recovery.has_been_renewed(poses, self._followed, self._present.grid)
        return is_renewed

    def _go_on_at(self, recovery: Recovery, found: Placement) -> None:
        """Go on in the frame that the robot was lost from, at the place that was found."""
        absence = recovery.absence
        log = recovery.log
        assert absence is not None and absence.known is not None  # noqa: PT018, S101 (the robot was lost from a frame)
        self._use(*absence.known.copied())
        self.slam.robots[0].step = log.begin - 1
        before = self._replay(log, log.begin, found.step)
        found, closed = found.put(self._followed, self._present.grid)
        # The comparisons until now have seen how the robot was carried away, and no stretch with
        # that motion can be smoothed.
        self._present.begin_anew()
        self._revise(before, self._replay(log, found.step, log.end))
        # The search has weighed the readings of these steps together. While they are processed
        # again, a bent map may contradict a few of them, and the robot would be lost and found in
        # turns.
        self._present.reset_monitors()
        recovery.has_joined(found, closed)

    def _give_up(self, recovery: Recovery) -> None:
        """Take back the map that the robot was lost from. The robot's place in it remains
        unknown.
        """
        absence = recovery.absence
        assert absence is not None and absence.known is not None  # noqa: PT018, S101 (the robot was lost from a frame)
        local = self._present.grid.copied().view
        self._unplaced = Unplaced(
            absence.known.step, self.slam.segments, self.slam.landmarks, local
        )
        pose = self.slam.pose
        covariance = self.slam.covariance
        self._use(*absence.known.copied())
        self._followed.relocate(pose, covariance)
        recovery.note_event("not found", step=recovery.log.end - 1)

    def _revise(self, first: Revision, second: Revision) -> None:
        """Note that the poses from a step on, in two parts, are known better now."""
        poses = np.concatenate([first.poses, second.poses])
        covariances = np.concatenate([first.covariances, second.covariances])
        self._revisions.append(Revision(first.begin, poses, covariances))
