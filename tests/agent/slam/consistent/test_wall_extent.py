"""Where a wall is along its line: hits, gaps, doors that open again, and counts taken over from another landmark."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from limslam_agent.config.consistent import ExtentConfig
from limslam_agent.kernels.extents import add_wall, clear_along_beams, count_hits, merge_walls, pass_at
from limslam_agent.kernels.tables import BIN, FARTHEST, empty_walls
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.wall_map import WallExtent, WallMap
from limslam_env.geometry import FloatArray, segment
from limslam_env.geometry import line as line_geometry

GAP = 0.30
TOLERANCE = 1.0  # beams that pass for each that ends there
spots = st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=30).map(np.array)


class Extent:
    """The extent of the first landmark of a map of its own."""

    def __init__(self) -> None:
        self.walls = empty_walls(2, 1000)
        add_wall(self.walls, 0)

    def hit(self, along: FloatArray) -> None:
        count_hits(self.walls, 0, along)

    def pass_at(self, along: float) -> bool:
        """Count a beam that passes; whether it counted."""
        before = self.walls.counted.sum()
        pass_at(self.walls, 0, along)
        return bool(self.walls.counted.sum() > before)

    def absorb(self, other: "Extent", factor: float, shift: float) -> None:
        for own, others in zip(self.walls[:4], other.walls[:4], strict=True):
            own[1] = others[0]
        merge_walls(self.walls, 0, 1, factor, shift, 2)

    def intervals(self, gap: float, tolerance: float) -> FloatArray:
        low, length = self.walls.table[0, :2]
        extent = WallExtent(int(low), self.walls.counted[0, :, :length], self.walls.reached[0, :, :length])
        return extent.intervals(gap, tolerance)

    @property
    def ends(self) -> tuple[float, float]:
        low, high = self.walls.ends[0].tolist()
        return low, high


def hit_at(*along: FloatArray) -> Extent:
    extent = Extent()
    for places in along:
        extent.hit(places)
    return extent


def wall(low: float, high: float) -> FloatArray:
    """A place in every bin, 1 cm from its lower end."""
    return np.arange(low + 0.01, high, BIN)


def passed(extent: Extent, low: float, high: float, times: int) -> None:
    for along in np.repeat(np.arange(low + 0.02, high, BIN), times):
        extent.pass_at(float(along))


@given(spots, st.floats(0.06, 2.0))
def test_pieces_are_the_hits_cut_at_gaps(along: FloatArray, gap: float) -> None:
    pieces = hit_at(along).intervals(gap, TOLERANCE)
    # All hits are within some piece, pieces begin and end with hits, in order, and what is between is a gap.
    assert all(((pieces[:, 0] <= place) & (place <= pieces[:, 1])).any() for place in along)
    assert np.isin(pieces, along).all()
    assert (pieces[:, 1] >= pieces[:, 0]).all()
    assert (pieces[1:, 0] - pieces[:-1, 1] > gap).all()
    for low, high in pieces:
        inside = np.sort(along[(along >= low) & (along <= high)])
        assert (np.diff(inside) <= gap).all()


@pytest.mark.parametrize("hits", [3])
def test_a_door_that_was_closed_by_mistake_opens_again_when_enough_beams_pass(hits: int) -> None:
    extent = hit_at(*[wall(0.0, 2.0)] * hits)
    passed(extent, 0.8, 1.4, hits)
    np.testing.assert_allclose(extent.intervals(GAP, TOLERANCE), [[0.01, 1.96]])
    passed(extent, 0.8, 1.4, 1)
    np.testing.assert_allclose(extent.intervals(GAP, TOLERANCE), [[0.01, 0.76], [1.41, 1.96]])
    assert extent.ends == pytest.approx((0.01, 1.96))
    # A wider tolerance takes the passes for errors, and it closes again when it is hit again.
    assert len(extent.intervals(GAP, (hits + 1) / hits)) == 1
    extent.hit(wall(0.8, 1.4))
    np.testing.assert_allclose(extent.intervals(GAP, TOLERANCE), [[0.01, 1.96]])


# Two landmarks that turn out to be one wall.


# The map that is drawn of it.


def wall_map(theta: float = 0.7, config: ExtentConfig | None = None) -> tuple[WallMap, FloatArray]:
    """A map of one wall 2 m long, read 40 times, and its line (r, theta)."""
    belief = CloneEKF(np.zeros(3))
    line = np.array([1.0, theta])
    belief.add_line(theta, line[0] * np.array([math.cos(theta), math.sin(theta)]))
    walls = WallMap(belief, config or ExtentConfig())
    walls.add_known(line_geometry.at(line, wall(-1.0, 1.0)))
    return walls, line


def beams_from(walls: WallMap, origins: FloatArray, heading: float, free: float, std: float = 0.005) -> None:
    """Beams that begin at points (n, 2) and went a distance into the same direction."""
    beam = np.zeros((1, 8))
    beam[0, FARTHEST] = 10.0
    for origin in origins:
        clear_along_beams(
            walls.arrays, walls._belief.anchored, walls._belief.anchors, np.append(origin, heading), (0.0, 0.0),
            np.array([free]), np.ones(1, dtype=bool), beam, (std, 0.0), np.empty((1, 6)),
        )  # fmt: skip


def look(walls: WallMap, line: FloatArray, along: FloatArray, free: float, std: float = 0.005) -> None:
    """Beams straight at places along the wall from 0.5 m before it."""
    beams_from(walls, line_geometry.at(line, along) - 0.5 * line_geometry.normal(line), line[1], free, std)


@pytest.mark.parametrize("theta", [0.7, -2.0])
def test_a_piece_of_the_map_vanishes_where_beams_pass(theta: float) -> None:
    walls, line = wall_map(theta)
    assert segment.lengths(walls.segments) == pytest.approx([1.95])
    for _ in range(2):
        look(walls, line, np.arange(-0.28, 0.3, 0.05), 1.2)
    segments = walls.segments
    assert segment.lengths(segments) == pytest.approx([0.65, 0.65], abs=0.051)
    middles = 0.5 * (segments[:, :2] + segments[:, 2:])
    np.testing.assert_allclose(np.abs(middles @ line_geometry.direction(line)), 0.65, atol=0.05)
    np.testing.assert_allclose(walls.ends(0) @ line_geometry.direction(line), [-0.99, 0.96], atol=1e-12)
    for _ in range(2):
        look(walls, line, np.arange(-0.98, 1.0, 0.05), 1.2)
    assert walls.segments.shape == (0, 4)
    assert len(walls.all_landmarks) == 1


def test_beams_that_end_at_the_wall_or_within_what_is_unsure_or_look_away_do_not_open_it() -> None:
    walls, line = wall_map()
    along = np.arange(-0.98, 1.0, 0.05)
    for _ in range(3):
        look(walls, line, along, 0.5)
        look(walls, line, along, 0.54)
        look(walls, line, along, 1.2, std=0.3)
        beams_from(walls, line_geometry.at(line, along) - 0.5 * line_geometry.normal(line), line[1] + math.pi, 1.2)
        beams_from(walls, line_geometry.at(line, along), line[1] + 0.5 * math.pi, 1.2)
    assert segment.lengths(walls.segments) == pytest.approx([1.95])
