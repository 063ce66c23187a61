"""Tells an estimator's listeners what a step decides: lines found, landmarks compared, updated and
merged.
"""

import numpy as np

from limslam_agent.kernels.tables import NUMBER, THETA
from limslam_agent.slam.consistent.assumed_sensor import AssumedSensor
from limslam_agent.slam.consistent.limits import MAX_ANGLE, MAX_END_GAP, MAX_OFFSET
from limslam_agent.slam.consistent.pending_readings import BEAM, RANGE, SIDES, TAKEN_AT, Piece
from limslam_agent.slam.consistent.wall_map import WallMap
from limslam_agent.slam.core.diagnostics import (
    AssociationRecord,
    CandidateTest,
    Closure,
    Comparison,
    Extraction,
)
from limslam_agent.slam.core.estimator import Estimator
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import angle_between, direction, normal


class StepReports:
    """A listener for the decisions of one step of a robot."""

    def __init__(
        self, estimator: Estimator, sensor: AssumedSensor, walls: WallMap, robot: int, step: int
    ) -> None:
        self._estimator = estimator
        self._sensor = sensor
        self._walls = walls.arrays
        self._robot = robot
        self._step = step
        self.cloned = estimator.filter.cloned
        self.corrected = estimator.filter.corrected

    def extracted(self, side: int, points: FloatArray, lines: FloatArray, ends: FloatArray) -> None:
        """The lines (k, 2) with their ends (k, 2, 2) that were found in the pending readings of a
        side.
        """
        estimator = self._estimator
        estimator.last_extraction = Extraction(
            self._robot,
            SIDES[side],
            self._step,
            estimator.poses[self._robot],
            points,
            lines,
            ends,
            is_in_world=True,
        )

    def considered(self, waiting: FloatArray, residuals: FloatArray) -> None:
        """A piece's rows of ``pending`` and the residuals of its readings, before anything is
        decided about it.
        """
        self._sources = waiting[:, [TAKEN_AT, BEAM]].astype(int)
        is_clear = np.isfinite(residuals)
        self._residuals = residuals[is_clear]
        self._ranges = waiting[is_clear, RANGE]

    def compared(self, piece: Piece, squared: FloatArray, landmarks: IntArray, gate: float) -> None:
        """Chi-squares (k,) and indices (k,) of the landmarks that the piece was compared with, and
        the gate.
        """
        listener = self._estimator.on_comparison
        if listener is None:
            return
        distances = dict(zip(landmarks.tolist(), squared.tolist(), strict=True))
        tests = tuple(
            self._test(index, piece, distances.get(index, np.nan), gate)
            for index in range(self._estimator.filter.num_lines)
        )
        tangent = direction(np.array([0.0, piece.segment[THETA]]))
        middle = piece.segment[THETA + 1 : THETA + 3]
        along = (piece.points - middle) @ tangent
        ends = middle + np.array([along.min(), along.max()])[:, None] * tangent
        listener(Comparison(self._robot, self._step, ends, self._sources, tests))

    def updated(self, number: int, is_new: bool) -> None:
        """The piece has corrected a landmark."""
        self._sensor.count(self._residuals, self._ranges)
        self._estimator.report(
            AssociationRecord(int(number), bool(is_new), self._sources, self._robot)
        )

    def merged(self, older: int, younger: int, squared: float, offset: float) -> None:
        """Two landmarks, by number, were merged: their squared Mahalanobis distance, and their
        offset, m.
        """
        self._estimator.closures.append(
            Closure(int(older), int(younger), self._step, squared, 0.0, offset, 0.0)
        )

    def _test(self, index: int, piece: Piece, squared: float, gate: float) -> CandidateTest:
        """The test that threw a landmark out, if any."""
        belief = self._estimator.filter
        walls = self._walls
        line = belief.line(index)
        middle = piece.segment[THETA + 1 : THETA + 3]
        angle = abs(float(angle_between(float(line[1]) - piece.segment[THETA])))
        offset = abs(float((middle - belief.anchors[index]) @ normal(line) - line[0]))
        along, (low, high) = (
            (piece.points - belief.anchors[index]) @ direction(line),
            walls.ends[index].tolist(),
        )
        gap = max(float(along.min()) - high, low - float(along.max()))
        tests = {
            "direction": angle > MAX_ANGLE,
            "offset": offset > MAX_OFFSET,
            "ends": gap > MAX_END_GAP,
        }
        excluded = next((name for name, is_out in tests.items() if is_out), "beams")
        if not np.isnan(squared):
            excluded = "gate" if squared > gate else ""
        return CandidateTest(int(walls.table[index, NUMBER]), excluded, angle, offset, gap, squared)
