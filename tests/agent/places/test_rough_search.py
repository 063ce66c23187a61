"""The rough search of a map adds up what its cells say of the ends and the ways of rays."""

import numpy as np
import pytest
from support.halls import HALL, PART, ROBOT, drive

from limslam_agent.kernels.rays import scan_poses
from limslam_agent.kernels.tables import RAY_LENGTH, RAY_REACH, RAY_TO_X
from limslam_agent.status.rays import rays_of
from limslam_env.geometry import se2


def test_the_rough_search_adds_up_the_cells_of_ends_and_ways():
    cells = np.random.default_rng(7).normal(size=(2, 100, 140)).astype(np.float32)
    fields = np.ascontiguousarray(cells.reshape(2, 50, 2, 70, 2).transpose(0, 2, 4, 1, 3))
    rays, turns = rays_of(drive(PART, HALL), ROBOT)[:40], np.array([0.4, -2.0])
    middle, scores = rays[:, :RAY_TO_X].mean(axis=0), np.empty((2, 50, 70), dtype=np.float32)
    scan_poses(turns, rays, middle, fields, 0.05, np.empty(rays.shape, dtype=np.int64), scores)
    lengths, ended = rays[:, RAY_LENGTH], rays[:, RAY_LENGTH] < rays[:, RAY_REACH]
    inner = np.where(ended, np.maximum(lengths - 0.2, 0.0), lengths)
    assert 0 < ended.sum() < len(rays)
    for number, turn in enumerate(turns):
        for place in ((30, 20), (4, 51), (45, 69)):
            total = 0.0
            for kind, along in ((0, lengths), (1, inner), (1, 0.5 * inner)):
                ends = rays[:, :RAY_TO_X] - middle + along[:, None] * rays[:, RAY_TO_X:RAY_LENGTH]
                points = se2.transform_points(np.array([0.0, 0.0, turn]), ends)
                column, row = (2 * np.array(place)[::-1] + np.floor(points / 0.05 + 0.5)).astype(int).T
                inside = (row >= 0) & (row < cells.shape[1]) & (column >= 0) & (column < cells.shape[2])
                inside &= ended | (kind == 1)
                total += cells[kind, row[inside], column[inside]].sum()
            assert scores[(number, *place)] == pytest.approx(total, abs=1e-3)
