"""Watches a mapper step by step and keeps what the page shows."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.inspect.columns import Ragged, quantised, quantum_for, rounded
from limslam_agent.inspect.event_log import Event, EventLog
from limslam_agent.inspect.grid import GridChanges, frontiers_of
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.policies.policy import Policy, checked_plan
from limslam_agent.slam.core.diagnostics import PendingPoints
from limslam_agent.slam.slam import Estimator
from limslam_agent.status.status import LEVELS
from limslam_env.geometry import FloatArray, no_rows
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import Side

MOST_FRAMES = 6000
"""Longer runs are kept at every second step, every third, and so on."""

MOST_BEAMS = 72
"""Of more beams, only so many are kept, evenly spread."""

SIDES: tuple[Side, ...] = ("left", "right", "none")
"""Scan buffers in their order; ``none`` is that of the beams ahead and behind."""

_FRONTIERS_EVERY = 20
"""Frontiers are computed at least once in so many steps, and whenever a robot has a new goal."""

_MM = 1e3

# A value of each frame, by the type of its column
_COLUMNS = {
    "pose": np.float32,
    "cov": np.float32,
    "odometry": np.float32,
    "level": np.uint8,
    "reason": np.uint16,
    "ranges": np.uint16,
    "landmarks": np.uint16,
    "buffers": np.uint16,
    "map_index": np.uint16,
    "plan_index": np.uint16,
    "frontier_index": np.int32,
    "goal": np.float32,
}

_LEAST_DETERMINANT = 1e-30
"""A covariance of a pose with a smaller determinant, m^4 rad^2, is that of a known start."""


class Recorder:
    """Keeps the frames and the events of one run.

    Call :meth:`note` after each step of the mapper. Nothing that the recorder does changes the
    mapper.

    ``steps`` is the number of steps that will come, or at least their largest number. Of steps that
    the mapper has made before, nothing is known. ``frame_rows`` has the step of each frame.
    """

    def __init__(self, mapper: Mapper, steps: int) -> None:
        self._mapper = mapper
        self._steps = steps
        self.log = EventLog(mapper)
        self._time = list[float]()
        self._true = list[FloatArray]()
        self._slam_steps = list[int]()
        self._stride = -(-steps // MOST_FRAMES)
        beams = len(mapper.robot.beams)
        self._beams = np.unique(
            np.linspace(0, beams - 1, min(beams, MOST_BEAMS)).round().astype(int)
        )
        self._row = 0
        self.frame_rows = list[int]()
        self._columns = defaultdict[str, list[Any]](list)
        self._reasons: dict[str, int] = {"": 0}
        self._pending = Ragged(2)
        self._plans = Ragged(2)
        self._cells = Ragged(2)
        self._walls = Ragged(5)
        self._marks = Ragged(11)
        self._grid = Ragged(4)
        self._frontiers: list[list[dict[str, Any]]] = []
        self._changes = GridChanges()
        self._last_map = b""
        self._last_plans = b""
        self._last_goals = np.full((len(mapper.poses), 2), np.nan)
        self._frontiers_at = -_FRONTIERS_EVERY

    def note(
        self,
        time: float,
        ranges: FloatArray,
        policies: Sequence[Policy] | None = None,
        true: FloatArray | None = None,
    ) -> None:
        """Keep a step that the mapper has made, after the policy of each robot has decided, if
        there are policies.

        The readings (n, n_beams), m, are NaN where a beam has measured nothing new. True poses (n,
        3), m and rad, are kept where they are known.
        """
        self._time.append(float(time))
        self._slam_steps.append(self._mapper.slam.robots[0].step)
        goals = _goals_of(policies, len(self._last_goals))
        self.log.note(goals)
        if self._row % self._stride == 0 or self._row == self._steps - 1:
            self._keep(ranges, policies, goals)
            self._true += [] if true is None else [true]
        self._row += 1

    def finish(self) -> None:
        """Note what the mapper has done with the pending readings at the end of the run."""
        if (
            self.log.is_in_another_frame
            and self.frame_rows
            and self.frame_rows[-1] == self._row - 1
        ):
            # The last row of a run is in the frame in which the run has ended.
            for name, column in self._estimates().items():
                self._columns[name][-1] = column
        self.log.finish()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All columns by their names in ``page/data.js``."""
        walls = self._walls.values()
        marks = self._marks.values()
        pending, plans, cells = (
            each.values() for each in (self._pending, self._plans, self._cells)
        )
        self.quantum = quantum_for([walls[:, :4], marks[:, 7:11], pending, plans, cells])
        rows = np.array(self.frame_rows)
        columns = {
            name: np.array(self._columns[name], dtype=kind) for name, kind in _COLUMNS.items()
        }
        found: dict[str, NDArray[Any]] = {
            "time": np.array(self._time)[rows],
            **columns,
            "pending": quantised(pending, self.quantum),
            "pending_starts": self._pending.starts(),
            "plans": quantised(plans, self.quantum),
            "plan_starts": self._plans.starts(),
            "frontier_cells": quantised(cells, self.quantum),
            "frontier_starts": self._cells.starts(),
            "walls": np.column_stack((quantised(walls[:, :4], self.quantum), walls[:, 4])).astype(
                np.int16
            ),
            "wall_starts": self._walls.starts(),
            "marks": marks[:, :7].astype(np.float32),
            "mark_ends": quantised(marks[:, 7:11], self.quantum),
            "mark_starts": self._marks.starts(),
            "grid": self._grid.values().astype(np.int16),
            "grid_starts": self._grid.starts(),
            **self._owners(rows),
        }
        if self._true:
            true = np.array(self._true)
            found["true"] = true.astype(np.float32)
            found["nees"] = self._nees(true)
        return found

    def meta(self) -> dict[str, Any]:
        """All that is no array. Call :meth:`arrays` before."""
        mapper = self._mapper
        robot = self._mapper.robot
        return {
            "robots": len(mapper.poses),
            "radius": robot.radius,
            "cell": mapper.config.grid.cell,
            "quantum": self.quantum,
            "map": mapper.map_number,
            "steps": len(self._time),
            "stride": self._stride,
            "beams": [
                {
                    "x": rounded(beam.x),
                    "y": rounded(beam.y),
                    "angle": rounded(beam.angle),
                    "max": beam.max_range,
                    "side": beam.side,
                }
                for beam in (robot.beams[index] for index in self._beams.tolist())
            ],
            "limits": self._mapper.slam.association_limits,
            "reasons": list(self._reasons),
            "frontiers": self._frontiers,
            "merges": isinstance(mapper.config.estimator, ConsistentConfig),
            "events": [self._dated(event) for event in self.log.events],
        }

    def _dated(self, event: Event) -> Event:
        """An event with its time instead of its step."""
        row = min(event["row"], len(self._time) - 1)
        return {
            "t": rounded(self._time[row], 3),
            **{name: value for name, value in event.items() if name != "row"},
        }

    def poses(self) -> FloatArray:
        """Estimated poses (f, n, 3) of the frames, m and rad."""
        return np.array(self._columns["pose"])

    def _keep(
        self, ranges: FloatArray, policies: Sequence[Policy] | None, goals: FloatArray
    ) -> None:
        mapper = self._mapper
        columns = self._columns
        self.frame_rows.append(self._row)
        for name, column in self._estimates().items():
            columns[name].append(column)
        columns["ranges"].append(self._millimetres(ranges))
        columns["landmarks"].append(len(mapper.slam.segments))
        self._keep_buffers(mapper.slam)
        self._keep_map(mapper.slam)
        grid = mapper.grid
        self._grid.add(self._changes.since_last(grid))
        self._keep_plans([] if policies is None else [checked_plan(policy) for policy in policies])
        columns["goal"].append(goals)
        if policies is not None:
            self._keep_frontiers(goals)
        columns["frontier_index"].append(len(self._frontiers) - 1)

    def _estimates(self) -> dict[str, Any]:
        """What the mapper estimates now of each robot."""
        mapper = self._mapper
        statuses = self._mapper.statuses
        return {
            "pose": mapper.poses,
            "cov": mapper.covariances[:, *np.triu_indices(3)],
            "odometry": mapper.odometry,
            "level": [LEVELS.index(status.level) for status in statuses],
            "reason": [
                self._reasons.setdefault(status.reason, len(self._reasons)) for status in statuses
            ],
        }

    def _millimetres(self, ranges: FloatArray) -> NDArray[np.uint16]:
        """Readings (n, b) in mm; 0 where there is none, and the largest number where nothing was
        seen.
        """
        robot = self._mapper.robot
        some = ranges[:, self._beams]
        most = robot.max_ranges[self._beams]
        whole = np.clip(np.rint(np.nan_to_num(some) * _MM), 1, 65534)
        return np.where(np.isnan(some), 0, np.where(some >= most, 65535, whole)).astype(np.uint16)

    def _keep_buffers(self, slam: Estimator) -> None:
        """Keep the pending points, and of each buffer: its robot, its side, its points, new ones,
        and its size.
        """
        found = {(each.robot, each.side): each for each in slam.pending_points}
        nothing = PendingPoints(0, "none", no_rows(2), 0, 0)
        robots = range(len(self._mapper.poses))
        buffers = [found.get((robot, side), nothing) for robot in robots for side in SIDES]
        sizes = [(len(each.points), each.new, each.enough) for each in buffers]
        self._columns["buffers"].append(
            [(count, count if new is None else new, enough) for count, new, enough in sizes]
        )
        self._pending.add(np.concatenate([each.points.reshape(-1, 2) for each in buffers]))

    def _keep_map(self, slam: Estimator) -> None:
        """Keep walls and landmarks where they have changed since the last frame."""
        walls = slam.segments
        owners = np.full(len(walls), -1.0)
        for mark in slam.landmarks:
            owners[list(mark.segments)] = mark.number + 1
        marks = np.array(
            [
                (
                    mark.number + 1,
                    mark.r,
                    mark.theta,
                    *mark.covariance[np.triu_indices(2)],
                    mark.observations,
                    *mark.ends.ravel(),
                )
                for mark in slam.all_landmarks
            ]
        ).reshape(-1, 11)
        content = marks.tobytes() + walls.tobytes()
        if content != self._last_map or not len(self._marks):
            self._last_map = content
            self._walls.add(np.column_stack((walls.reshape(-1, 4), owners)))
            self._marks.add(marks)
        self._columns["map_index"].append(len(self._marks) - 1)

    def _keep_plans(self, plans: list[FloatArray]) -> None:
        """Keep the plan of each robot where one has changed. The plans of a frame follow each
        other.
        """
        content = b"|".join(plan.tobytes() for plan in plans)
        if content != self._last_plans or not len(self._plans):
            self._last_plans = content
            for number in range(len(self._mapper.poses)):
                self._plans.add(plans[number] if number < len(plans) else np.zeros((0, 2)))
        self._columns["plan_index"].append(len(self._plans) // len(self._mapper.poses) - 1)

    def _keep_frontiers(self, goals: FloatArray) -> None:
        has_moved = not np.array_equal(goals, self._last_goals, equal_nan=True)
        if not has_moved and self._row - self._frontiers_at < _FRONTIERS_EVERY:
            return
        self._last_goals = goals
        self._frontiers_at = self._row
        mapper = self._mapper
        found = []
        shown = slice(1) if mapper.is_apart else slice(None)
        for cells, costs in frontiers_of(
            mapper.grid, list(mapper.poses[shown]), mapper.robot, mapper.config.policy
        ):
            self._cells.add(cells)
            found.append({"cells": len(self._cells) - 1, "costs": costs})
        self._frontiers.append(found)

    def _owners(self, rows: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """The wall (f, n, b) that each reading of a frame was given to, 0 for none, and the step at
        which it was.
        """
        shape = len(self._time), len(self._mapper.poses), len(self._mapper.robot.beams)
        wall = np.zeros(shape, dtype=np.uint16)
        steps_given = np.zeros(shape, dtype=np.uint32)
        # A live robot may have made several steps since the last one that was noted.
        noted = np.full(max(self._slam_steps, default=-1) + 2, -1)
        noted[self._slam_steps] = np.arange(len(self._slam_steps))
        for row, record in self.log.associations:
            steps, beams = record.readings.T
            steps = noted[np.minimum(steps, len(noted) - 1)]
            is_noted = steps >= 0
            steps = steps[is_noted]
            beams = beams[is_noted]
            wall[steps, record.robot, beams] = record.landmark + 1
            steps_given[steps, record.robot, beams] = row
        return {"owner": wall[rows][..., self._beams], "given": steps_given[rows][..., self._beams]}

    def _nees(self, true: FloatArray) -> NDArray[np.float32]:
        """NEES / 3 of each frame and robot (f, n), given the true poses. NaN where the covariance
        is zero.
        """
        error = self.poses() - true
        error[..., 2] = wrap_angle(error[..., 2])
        covariances = np.zeros((*error.shape, 3))
        rows, columns = np.triu_indices(3)
        covariances[..., rows, columns] = covariances[..., columns, rows] = self._columns["cov"]
        found = np.full(error.shape[:2], np.nan)
        is_known = np.linalg.det(covariances) > _LEAST_DETERMINANT
        solved = np.linalg.solve(covariances[is_known], error[is_known][..., None])[..., 0]
        found[is_known] = np.einsum("ni,ni->n", error[is_known], solved) / 3.0
        return found.astype(np.float32)


def _goals_of(policies: Sequence[Policy] | None, robots: int) -> FloatArray:
    """The goal (n, 2), m, of each robot; NaN for a robot without a goal."""
    goals = [getattr(policy, "goal", None) for policy in policies or ()]
    return np.array(
        [(np.nan, np.nan) if goal is None else goal for goal in goals or [None] * robots],
        dtype=float,
    )
