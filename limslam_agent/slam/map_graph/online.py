"""The online graph: the pose while driving, in a local frame whose place the graph of chunks gives.

The step follows the odometry, corrected for the errors that are known, from the last event that was
smoothed. It costs some microseconds. After each metre of driving, a job smooths the last
metres. After each 2.5 m, when a chunk is complete, it also draws the chunk, searches for its loops,
and solves the graph of chunks. A robot would do the job beside its steps. Its result therefore
counts from the next key pose on, some decimetres later. The pose of the local frame in the world
jumps only then.

Nothing here knows later events: the pose at an event is a function of the events up to it.
"""

import math
import time as clock
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.graph import GraphConfig, LocalMapConfig
from limslam_agent.slam.map_graph.chunk_graph import ChunkGraph, inflated
from limslam_agent.slam.map_graph.joined_map import loop_to_joined
from limslam_agent.slam.map_graph.key_poses import (
    KEY_DISTANCE,
    KEY_TURN,
    LogData,
    calibrated,
    motion_variances,
)
from limslam_agent.slam.map_graph.local_maps import LocalMap, cut_chunks
from limslam_agent.slam.map_graph.loops import Loop
from limslam_agent.slam.map_graph.reversing import AFTER, LEAST_LENGTH, driven_backwards
from limslam_agent.slam.map_graph.window import (
    LocalFrame,
    OdometryErrors,
    RecentEvents,
    smooth_window,
)
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import between, compose, inverse, moved_covariance

_WINDOW = 6
"""Distance driven that is smoothed, in hops between chunks: 15 m, since the walls of the local
smoothing reach over 10 m, and a chunk over 7 m.
"""

_EACH = 1.0
"""Distance driven after which the last metres are smoothed, m."""

_REVISED = 2
"""Number of earlier motions between chunks that each window estimates anew."""


@dataclass(frozen=True, eq=False)
class Anchor:
    """A smoothed event, from which the steps go on."""

    ridden: FloatArray  # pose (3,) by corrected odometry alone when the event was measured
    # Sums (3,) of the variances of all motions by odometry up to the event (along, across,
    # heading), m^2 and rad^2
    variances: FloatArray
    # pose, covariance: pose (3,) and covariance (3, 3) in the world
    pose: FloatArray
    covariance: FloatArray
    since: FloatArray  # covariance (3, 3) of the motion since the last chunk, or since the start
    errors: FloatArray  # the constant errors (5,) of odometry that are known


class OnlineGraph:
    """Estimates the pose of a robot that reports poses of odometry.

    Parameters
    ----------
    log
        A log of the robot. Only its beams, their longest range and their noise are used, and none
        of its events.
    start
        Pose (3,) of the first event.
    config
        The settings.

    Attributes
    ----------
    pose, covariance
        The pose (3,) at the last event, and its covariance (3, 3).
    errors
        What is known of the constant errors of odometry.
    places
        The graph of chunks; None before the first chunk is complete.
    job_ms
        Time that the job of the last step took, ms; zero if there was none.
    """

    places: ChunkGraph | None

    def __init__(self, log: LogData, start: FloatArray, config: GraphConfig | None = None) -> None:
        self._log = log
        self._config = config or GraphConfig()
        self._recent = RecentEvents()
        self.places = None
        self._start = np.asarray(start, dtype=float)
        self.errors = OdometryErrors.unknown(self._config.motion)
        self._ridden = np.zeros(3)
        self._variances = np.zeros(3)
        self._anchor = Anchor(
            self._ridden,
            self._variances,
            self._start,
            np.zeros((3, 3)),
            np.zeros((3, 3)),
            self.errors.mean,
        )
        # Motion (3,) by odometry from the last chunk, or from the start, to the first event that is
        # kept, and its covariance (3, 3); None while the middle of that chunk is kept
        self._blind: tuple[FloatArray, FloatArray] | None = None
        self._waiting: Anchor | None = None
        self._frame: LocalFrame | None = None  # the last window
        self._chunk_std = 0.0
        self._first_covariance = np.zeros((3, 3))
        self._middles = [0]  # events in the middle of the last chunks
        # event from which on stretches are judged; those that prove that odometry has no sign
        self._judged_to = 0
        self._proofs = 0
        self._reversed = list[
            tuple[int, int]
        ]()  # stretches that are to be turned round if that is proven
        # distances driven at which the last metres are smoothed, and the next chunk is complete
        self._smooth_at = _EACH
        self._job_at = _remainder(self._config.maps)
        self._key_travel = 0.0
        self._key_turned = 0.0
        self.pose = self._start
        self.covariance = np.zeros((3, 3))
        self.job_ms = 0.0

    def step(
        self,
        time: float,
        odometry: FloatArray,
        ranges: FloatArray,
        hit: BoolArray,
        break_stds: FloatArray | None = None,
    ) -> None:
        """Process an event.

        Parameters
        ----------
        time
            Time, s.
        odometry
            Pose (3,) of odometry in a frame of its own, m, m, rad.
        ranges, hit
            Ranges (b,), m, and whether each beam has seen a wall (b,).
        break_stds
            Standard deviations (3,) of the motion before the event, m and rad, if odometry does not
            tell it.
        """
        recent = self._recent
        travel = self._recent.travel
        turned = self._recent.turned
        recent.append(time, odometry, ranges, hit, break_stds)
        self.job_ms = 0.0
        motion = calibrated(recent.last_motion[None], self._anchor.errors)[0]
        self._ridden = compose(self._ridden, motion)
        if break_stds is None:
            moved = np.array([recent.travel - travel]), np.array([recent.turned - turned])
            self._variances = self._variances + motion_variances(*moved)[0]
        else:
            self._variances = self._variances + break_stds**2
            # The next chunk lies behind the break as a whole.
            self._job_at = self._smooth_at = recent.travel + 2.0 * self._config.maps.half
        if self._is_key_pose():
            self._key_travel = recent.travel
            self._key_turned = recent.turned
            if self._waiting is not None:
                self._anchor = self._waiting
                self._waiting = None
            if recent.travel >= min(self._smooth_at, self._job_at):
                begin = clock.perf_counter()
                self._do_job()
                self.job_ms = 1e3 * (clock.perf_counter() - begin)
        anchor = self._anchor
        motion, own = self._since_anchor()
        self.pose = compose(anchor.pose, motion)
        self.covariance = moved_covariance(anchor.pose, anchor.covariance, motion, own)

    @property
    def position_std(self) -> float:
        """Standard deviation of the position in the map, m: that of the last chunk, and of the
        motion since.
        """
        if self.places is None:
            return float(np.sqrt(np.trace(self.covariance[:2, :2])))
        moved = self._variances - self._anchor.variances
        return float(np.sqrt(self._chunk_std**2 + moved[:2].sum()))

    def _ridden_at(self, errors: FloatArray) -> FloatArray:
        """Pose (3,) by corrected odometry at the time at which the ranges were measured."""
        since = calibrated(self._recent.motion_during(errors[3])[None], errors)[0]
        return compose(self._ridden, inverse(since))

    def _is_key_pose(self) -> bool:
        driven = self._recent.travel - self._key_travel
        turned = self._recent.turned - self._key_turned
        return driven >= KEY_DISTANCE or turned >= KEY_TURN

    @property
    def _last_chunk(self) -> FloatArray:
        """Pose (3,) of the last chunk, or of the start."""
        return self._start if self.places is None else self.places.poses[-1]

    def _since_anchor(self) -> tuple[FloatArray, FloatArray]:
        """Motion (3,) since the anchor by corrected odometry, and its covariance (3, 3)."""
        motion = between(self._anchor.ridden, self._ridden_at(self._anchor.errors))
        return motion, np.diag(self._variances - self._anchor.variances)

    def _since_chunk(self) -> tuple[FloatArray, FloatArray]:
        """Motion (3,) since the last chunk, or since the start, and its covariance (3, 3)."""
        before = between(self._last_chunk, self._anchor.pose)
        motion, own = self._since_anchor()
        return compose(before, motion), moved_covariance(before, self._anchor.since, motion, own)

    def _do_job(self) -> None:
        """Smooth the last metres and find their place. The result waits until the next key pose."""
        maps = self._config.maps
        recent = self._recent
        is_complete = recent.travel >= self._job_at
        self._smooth_at = recent.travel + _EACH
        while self._job_at <= recent.travel:
            self._job_at += maps.hop
        frame = smooth_window(
            self._directed(), recent.first, self.errors, self._config, self._frame
        )
        self._frame = frame
        if not is_complete:
            if frame is not None:
                self._waiting = self._followed(frame)
            return
        if frame is None:
            self._begin_anew()
            return
        driven = recent.travel - recent.travel_at(recent.first)
        self.errors = frame.learned(self.errors, min(1.0, maps.hop / driven))
        self._waiting = self._placed(frame)
        if self.places is not None:
            self._middles = self._middles[-1 - _REVISED :]
            recent.forget_before(
                min(recent.at(recent.travel - (_WINDOW - 1) * maps.hop), self._middles[0])
            )

    def _begin_anew(self) -> None:
        """Forget all events but the last one: no beam has seen anything in the window.

        Odometry alone tells the motion since the last chunk.
        """
        self._blind = self._since_chunk()
        self._middles = [self._recent.last]
        self._recent.forget_before(self._recent.last)
        # The next chunk lies behind this event as a whole.
        self._job_at = self._smooth_at = self._recent.travel + 2.0 * self._config.maps.half

    def _followed(self, frame: LocalFrame) -> Anchor:
        """The last event of a window that completes no chunk. It counts as no better known than by
        odometry since the last anchor.
        """
        return replace(
            self._anchor, ridden=self._ridden_at(self._anchor.errors), pose=self._end_of(frame)
        )

    def _end_of(self, frame: LocalFrame) -> FloatArray:
        """Pose (3,) of the last event of a window in the world: by earlier visits, or else by the
        last chunk.
        """
        last = frame.poses[-1]
        back = self._recent.travel - 0.5 * self._config.maps.half
        key = int(frame.keys.event_key[self._recent.at(back) - frame.first])
        found = self._in_joined_map(frame, key, self._local_map(frame, key))
        if found is not None:
            return compose(found[1], between(frame.trajectory.poses[key], last))
        middle = frame.poses[self._middles[-1] - frame.first]
        return compose(self._last_chunk, between(middle, last))

    def _local_map(self, frame: LocalFrame, key: int) -> LocalMap:
        """The local map around a key pose of the window."""
        (drawn,) = cut_chunks(frame.keys, frame.trajectory, np.array([key]))
        event = self._recent.first + int(frame.keys.first_event[key])
        return replace(drawn, travel=self._recent.travel_at(event))

    def _in_joined_map(
        self, frame: LocalFrame, key: int, drawn: LocalMap
    ) -> tuple[Loop, FloatArray] | None:
        """The loop from earlier visits to the local map that was drawn around a key pose, and its
        pose (3,).
        """
        if self.places is None:
            return None
        last = int(frame.keys.event_key[self._middles[-1] - frame.first])
        own = np.diag(frame.keys.step_variances[last:key].sum(axis=0))
        motion = between(frame.trajectory.poses[last], frame.trajectory.poses[key])
        return loop_to_joined(self.places, drawn, motion, own)

    def _directed(self) -> LogData:
        """The last events. What was driven backwards is turned round if odometry has no sign."""
        recent = self._recent
        reversing = self._config.reversing
        data = recent.data(self._log)
        if recent.backwards >= LEAST_LENGTH:
            return data
        after = max(self._judged_to - recent.first, 0)
        for begin, end, is_proof in driven_backwards(data, self._config, after):
            self._proofs += is_proof
            self._judged_to = recent.first + end
            self._reversed.append((recent.first + begin, recent.first + end))
        self._judged_to = max(self._judged_to, recent.at(recent.travel - AFTER))
        self._reversed = [each for each in self._reversed if each[0] >= recent.first]
        if self._proofs >= reversing.fewest:
            for begin, end in self._reversed:
                recent.turn_round(begin, end)
                self._frame = None
            self._reversed.clear()
        return recent.data(self._log)

    def _placed(self, frame: LocalFrame) -> Anchor:
        """The last event of the window, after its chunk has been added."""
        recent = self._recent
        maps = self._config.maps
        last = len(frame.keys) - 1
        if recent.travel >= 2.0 * maps.half:
            key = int(frame.keys.event_key[recent.at(recent.travel - maps.half) - recent.first])
            self._add_chunk(frame, key)
        if self.places is None:
            key = 0
            pose = self._start
            covariance = np.zeros((3, 3))
        else:
            pose = self.places.poses[-1]
            covariance = self.places.last_covariance + _turned(
                self._first_covariance, pose - self.places.poses[0]
            )
        motion = between(frame.trajectory.poses[key], frame.poses[-1])
        own = inflated(frame.covariances(np.array([key, last])))[0]
        return Anchor(
            self._ridden_at(self.errors.mean),
            self._variances,
            self._end_of(frame),
            moved_covariance(pose, covariance, motion, own),
            own,
            self.errors.mean,
        )

    def _add_chunk(self, frame: LocalFrame, key: int) -> None:
        """Add the chunk around a key pose of the window to the graph."""
        recent = self._recent
        config = self._config
        event = recent.first + int(frame.keys.first_event[key])
        chunk = self._local_map(frame, key)
        pose = frame.trajectory.poses[key]
        before = np.array(self._middles) - recent.first
        own = inflated(frame.covariances(np.array([frame.keys.event_key[before[-1]], key])))[0]
        path = np.vstack((frame.poses[before], pose))
        motions = between(path[:-1], path[1:])
        if self._blind is not None:
            motion, covariance = self._blind
            own = moved_covariance(motion, covariance, motions[0], own)
            motions = compose(motion, motions)
            self._blind = None
            self._middles = []
        if self.places is None:
            self._first_covariance = moved_covariance(
                self._start, np.zeros((3, 3)), motions[-1], own
            )
            self.places = ChunkGraph(chunk, compose(self._start, motions[-1]), config.maps)
            self._middles = []
        else:
            self.places.add(chunk, motions, own)
        self._middles.append(event)
        # Another visit may have seen less of this place from each of its chunks than from all.
        if not any(each.second == len(self.places.maps) - 1 for each in self.places.counting):
            found = self._in_joined_map(frame, key, chunk)
            if found is not None:
                self.places.close([found[0]])
        self._chunk_std = self.places.position_std


def _turned(covariance: FloatArray, apart: FloatArray) -> FloatArray:
    """What the covariance (3, 3) of the first pose adds to that of a pose that is ``apart`` (3,)
    from it.
    """
    turned = np.array([[1.0, 0.0, -apart[1]], [0.0, 1.0, apart[0]], [0.0, 0.0, 1.0]])
    return np.asarray(turned @ covariance @ turned.T)


def _remainder(config: LocalMapConfig) -> float:
    """Distance driven at the first job, m. Later jobs follow at each hop, so that one completes the
    first chunk.
    """
    return math.fmod(2.0 * config.half, config.hop) or config.hop
