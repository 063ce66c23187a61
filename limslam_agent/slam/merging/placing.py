"""Where a second log may lie in the first one: its local maps are matched with the whole map of the first log.

A local map of a few metres of driving fits in many places of a building. All local maps of a right placement, however,
move the second log by the same motion. Walls have few directions, so few turns are possible. For each of them all
shifts are compared at once by the fast Fourier transform (J. Lewis, "Fast normalized cross-correlation", 1995).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter1d, maximum_filter

from limslam_agent.config.graph import LocalMapConfig
from limslam_agent.slam.graph.local_maps import HIT, LocalMap, chunk_middles, cut_chunks, united
from limslam_agent.slam.graph.matching import Window, match, search_grid
from limslam_agent.slam.graph.point_links import point_cloud
from limslam_agent.slam.merging.chains import Chain
from limslam_env.geometry import FloatArray, se2

# Local maps that are matched with the whole map of the first log. They are longer than the chunks of the graph, because
# nothing is known about their place.
_PIECES = LocalMapConfig(half=6.0, hop=4.0)
_COARSE, _TURN_STEP = 0.2, math.radians(3.0)  # side of a cell, m, and step of the turns of the first search, rad
_LIKELY = 0.6  # turns are searched at which the walls of both logs agree at least so well, as a share of the best turn
_PEAKS = 25  # places of a local map that are kept
_COARSE_SCORE, _SCORE = 0.5, 0.55  # of a place in the first search, and after its refinement
_BINS = 120  # of wall directions, over a full turn
_WINDOW = Window(0.5, np.radians(6.0), np.radians(1.5))  # of the refinement
_TOPS_APART = 5  # cells of the first search between two places of a local map


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose (3,) of a local map of the second log in the first log's frame, with the score of the match."""

    piece: int
    pose: FloatArray
    score: float


@dataclass(frozen=True, eq=False)
class Pieces:
    """A log as overlapping local maps with poses (c, 3), and the directions of its walls (``_BINS``,)."""

    maps: list[LocalMap]
    poses: FloatArray
    directions: FloatArray

    @classmethod
    def of(cls, chain: Chain, reach: float) -> "Pieces":
        """Cut a log along its smoothed trajectory. The grids have room for beams of a length ``reach``, m."""
        keys, trajectory, data = chain.keys, chain.smoothed, chain.data
        middles = chunk_middles(keys, _PIECES, _PIECES.hop)
        maps = cut_chunks(keys, trajectory, _PIECES, middles, reach)
        cloud = point_cloud(keys, trajectory, data.range_std)
        angles = np.arctan2(*cloud.normals[cloud.good].T[::-1]) % (2.0 * np.pi)
        counts = np.bincount((angles * _BINS / (2.0 * np.pi)).astype(np.int64) % _BINS, minlength=_BINS)
        return cls(maps, trajectory.poses[middles], gaussian_filter1d(counts.astype(float), 1.0, mode="wrap"))

    def whole(self, cell: float) -> tuple[LocalMap, FloatArray]:
        """All local maps as one map with cells of a given side, m, and the pose (3,) of its frame."""
        offsets = self.poses[:, :2] - 0.5 * (self.poses[:, :2].min(axis=0) + self.poses[:, :2].max(axis=0))
        order = np.argsort(np.hypot(*offsets.T), kind="stable")
        poses, maps = self.poses[order], [self.maps[number] for number in order]
        reach = np.hypot(*se2.between(poses[0], poses)[:, :2].T).max() - maps[0].low
        settings = replace(_PIECES, cell=cell, hit_radius=max(cell, _PIECES.hit_radius))
        return united(maps, poses, 2 * int(np.ceil(reach / cell)), settings), poses[0]


def candidates(known: Pieces, local: Pieces) -> list[Candidate]:
    """The places where each local map of the second log fits into the map of the first log."""
    turns = likely_turns(known.directions, local.directions)
    whole, frame = known.whole(_COARSE)
    tops = _all_tops(whole, local, turns - frame[2])
    fine, frame = known.whole(_PIECES.cell)
    grid = search_grid(fine, _WINDOW.shift)
    found = []
    for piece, guess in tops:
        refined = match(grid, local.maps[piece].points, guess, _WINDOW, _SCORE)
        if refined.score >= _SCORE:
            found.append(Candidate(piece, se2.compose(frame, refined.pose), refined.score))
    return found


def likely_turns(known: FloatArray, local: FloatArray) -> FloatArray:
    """The turns (t,), rad, of the second log at which its walls have the directions of the first log's walls."""
    agreement = np.fft.irfft(np.fft.rfft(known) * np.fft.rfft(local).conj(), _BINS)
    bins = np.flatnonzero(agreement >= _LIKELY * agreement.max())
    # A log may be bent by some degrees, so turns beside the likely ones are searched as well.
    step = 2.0 * np.pi / _BINS
    every = max(1, round(_TURN_STEP / step))
    near = np.unique((bins[:, None] + np.arange(-1, 2)) % _BINS)
    return np.asarray(near[::every] * step)


def _all_tops(whole: LocalMap, local: Pieces, turns: FloatArray) -> list[tuple[int, FloatArray]]:
    """Local maps and their best poses (3,) in the frame of a whole map, over all shifts and the given turns."""
    cell, reach = whole.cell, -local.maps[0].low
    pad = int(np.ceil(reach / cell)) + 1
    size = fft.next_fast_len(len(whole.grid) + 2 * pad, real=True)
    grid = np.zeros((size, size), np.float32)
    grid[pad : pad + len(whole.grid), pad : pad + len(whole.grid)] = whole.grid / np.float32(HIT)
    values, low = fft.rfft2(grid), whole.low - pad * cell
    found = []
    for piece, each in enumerate(local.maps):
        tops: list[tuple[float, FloatArray]] = []
        for turn in turns + local.poses[piece, 2]:
            points = se2.transform_points(np.array([0.0, 0.0, turn]), each.points)
            tops += _tops(values, points, low, cell, size, turn)
        tops.sort(key=lambda top: -top[0])
        found += [(piece, pose) for pose in _distinct([pose for _, pose in tops], cell)[:_PEAKS]]
    return found


def _tops(
    values: NDArray[np.complex64],
    points: FloatArray,
    low: float,
    cell: float,
    size: int,
    turn: float,
) -> list[tuple[float, FloatArray]]:
    """The best shifts of turned points (k, 2) with their scores."""
    cells = np.unique(np.floor(points / cell).astype(np.int64), axis=0) % size
    raster = np.zeros((size, size), np.float32)
    raster[cells[:, 0], cells[:, 1]] = 1.0 / max(len(cells), 1)
    scores = fft.irfft2(values * fft.rfft2(raster).conj(), s=(size, size))
    if scores.max() < _COARSE_SCORE:
        return []
    peaks = (scores >= _COARSE_SCORE) & (scores == maximum_filter(scores, size=_TOPS_APART, mode="wrap"))
    high = np.argwhere(peaks)
    order = np.argsort(-scores[peaks], kind="stable")
    return [
        (float(scores[row, column]), np.array([low + row * cell, low + column * cell, turn]))
        for row, column in high[order][:_PEAKS]
    ]


def _distinct(poses: list[FloatArray], cell: float) -> list[FloatArray]:
    """The poses, best first, without those that are close to a better one."""
    kept: list[FloatArray] = []
    for pose in poses:
        if all(np.hypot(*(pose[:2] - each[:2])) > _TOPS_APART * cell or _turned(pose, each) > 0.2 for each in kept):
            kept.append(pose)
    return kept


def _turned(pose: FloatArray, other: FloatArray) -> float:
    return abs(float(se2.wrap_angle(pose[2] - other[2])))
