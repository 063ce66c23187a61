"""The record of a run, and what is known at its end: the smoothed path, and the map that is drawn
from it.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from limslam_agent.grid.occupancy import GridView, drawn_grid
from limslam_agent.mapping.team import Snapshot
from limslam_agent.places.revisions import PlaceHistory, revised
from limslam_agent.policies.policy import NOT_EXPLORED
from limslam_agent.readings import as_readings
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.slam.core.diagnostics import Closure
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Calibration
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import AssociationRecord
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.simulation.coverage import CoverageGrid
from limslam_env.worlds.world import World

if TYPE_CHECKING:
    from limslam_agent.slam.line_graph.run import SmoothedRun


@dataclass(frozen=True, eq=False)
class FinalMap:
    """The map of a finished run, from which its files, its picture and its scores are made.

    Walls (k, 4), m, cut at doors and holes; the lines that they lie on; and the poses (t, n, 3), m
    and rad, that the map was drawn from.
    """

    segments: FloatArray
    landmarks: list[Landmark]
    grid: GridView
    poses: FloatArray


@dataclass(frozen=True, eq=False)
class Episode:
    """The record of a run, with one row for each step. Row 0 is the moment of the reset."""

    config: RunConfig
    world: World
    time: FloatArray  # (t,), s
    # Observations of the n robots: (t, n, n_beams), m, and (t, n, 2), m
    ranges: FloatArray
    wheels: FloatArray
    yaw: FloatArray  # headings (t, n) by inertial measurement units, rad; NaN without such units
    # answer to each observation (t, n, 2). The action of a row leads to the next row.
    actions: FloatArray
    # Poses (t, n, 3): the truth, the estimate, and odometry alone
    true: FloatArray
    estimated: FloatArray
    odometry: FloatArray
    covariances: FloatArray  # (t, n, 3, 3), of the estimated poses
    # Status of each robot's estimate (t, n), an index into ``status.LEVELS``
    levels: IntArray
    wall_seen: IntArray  # what each beam truly hit (t, n, n_beams)
    # Which beams were ignored because they may have hit another robot, an array of (t, n, n_beams)
    dropped: BoolArray
    # True coverage by all robots together (t,), and whether each robot touches
    # Which beams were ignored because they may have hit another robot, in the shape of wall_seen.
    coverage: FloatArray
    contact: BoolArray
    # The association of each observed line, and the loops that were closed
    associations: list[AssociationRecord]
    closures: list[Closure]
    # Each robot's odometry calibration and its covariance (3, 3) at the end; None where none was
    # needed
    calibrations: list[tuple[Calibration, FloatArray] | None]
    places: PlaceHistory  # what happened when the robot was lost
    # Whether the robot's place in an earlier map was found. The poses are in the frame of that map
    # then.
    in_prior_map: bool
    snapshot: Snapshot  # what is believed at the end
    coverage_grid: CoverageGrid  # the cells that count for coverage
    # stop_reason, is_finished: why the run ended, and whether the agent itself said so
    stop_reason: str
    is_finished: bool
    # slam_ms, decide_ms, wall_clock: cost of a step: the SLAM alone (t,), ms, and the grid with the
    # policies (t,), ms. Cost of the whole loop, s.
    slam_ms: FloatArray
    decide_ms: FloatArray
    wall_clock: float
    # Whether somebody has ended the run, or what follows it, which is left out where it takes long
    is_interrupted: bool = False
    is_joined: bool = True  # whether the robots share a frame at the end
    # How the range sensors measure, as the SLAM takes it at the end. None if it estimates nothing
    # of the kind.
    sensor: RangeSensor | None = None
    # By what each beam is turned to the left, and its standard deviation (n_beams, 2), rad, as the
    # SLAM takes it at the end; None if it takes no beam to be turned
    beam_turns: FloatArray | None = None

    def interrupted(self) -> "Episode":
        """The same after somebody has ended the run, or what follows it."""
        return replace(self, is_interrupted=True)

    @property
    def claims_explored(self) -> bool:
        """Whether the agent itself has said that it is done, and not that it has given up."""
        return self.is_finished and not self.stop_reason.endswith(NOT_EXPLORED)

    @property
    def placed_steps(self) -> slice:
        """The steps in which the poses are known in the frame of the map. A lost robot may end in
        another one.
        """
        known = self.places.placed
        return known if self.config.robots == 1 and known.stop != 0 else slice(None)

    @property
    def placed_robots(self) -> int:
        """Number of robots whose place in the map is known at the end: the first ones."""
        return 1 if self.config.unknown_starts and not self.is_joined else self.config.robots

    @property
    def revised(self) -> tuple[FloatArray, FloatArray]:
        """Estimated poses (t, n, 3) and covariances, of the steps in which a robot was lost by what
        was known later.
        """
        return revised(self.estimated, self.covariances, self.places.revisions)

    @cached_property
    def smoothed(self) -> "SmoothedRun | None":
        """All poses and walls by what was known at the end. None if the settings do not ask for it,
        if there is nothing to smooth, or if the run was interrupted.

        Only the associations of the consistent estimator can be smoothed.
        """
        agent = self.config.agent
        settings = self.config.agent.run_smoothing
        if self.is_interrupted:
            return None
        # The smoother does not know the lines of an earlier map.
        if settings is None or self.in_prior_map or self.placed_robots < self.config.robots:
            return None
        # The kernels of the smoother load numba, which takes time that other commands do not need.
        from limslam_agent.slam.line_graph.run import FilteredRun
        from limslam_agent.slam.line_graph.smoother import smooth_run, smooth_with_unknown_start

        places, (poses, covariances) = self.places, self.revised
        run = FilteredRun(
            robot=self.config.robot,
            noise=agent.noise,
            wheels=self.wheels,
            ranges=self.ranges,
            usable=~self.dropped,
            poses=poses,
            covariances=covariances,
            associations=self.associations,
            closures=self.closures,
            breaks=tuple((0, step) for step in places.breaks),
            slips=tuple((0, *part) for part in places.slips),
            sensor=self.sensor,
            yaw=self.yaw if self.config.imu else None,
        )
        if self.config.unknown_starts:
            return smooth_with_unknown_start(run, settings)
        return smooth_run(run, settings, places.placed.stop)

    @property
    def online_map(self) -> FinalMap:
        """The map as the robots knew it when the run stopped."""
        return FinalMap(
            self.snapshot.segments, self.snapshot.landmarks, self.snapshot.grid, self.revised[0]
        )

    @cached_property
    def final_map(self) -> FinalMap:
        """The map by all that is known at the end: drawn from the smoothed poses, if the run was
        smoothed.
        """
        smoothed = self.smoothed
        config = self.config
        if smoothed is None:
            return self.online_map
        ranges = as_readings(smoothed.ranges, config.robot.min_ranges, config.robot.max_ranges)
        is_new = np.array([config.robot.measures(step) for step in range(len(ranges))])[:, None]
        measured = is_new & ~np.isnan(ranges) & ~self.dropped
        if self.sensor is not None:
            measured[..., list(self.sensor.broken)] = False
        used = self.placed_steps
        grid = drawn_grid(
            config.agent.grid, smoothed.robot, smoothed.read_at[used], ranges[used], measured[used]
        )
        return FinalMap(smoothed.segments, smoothed.landmarks, grid, smoothed.poses)
