"""How well different visits of the same place coincide in the smoothed path of a log whose true path is not known.

``python -m benchmarks revisits LOG FOLDER...`` prints a line for each folder of a replay of the log. The log is cut
into local maps along the smoothed path. Each pair of local maps that two visits have drawn of one place is matched, and
the shift of the match is the distance by which the path places the two visits apart. A match in a corridor hardly
determines the shift along it, so a few shifts are large even where the path is exact. The resolution is 0.1 m, 1 deg.
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.logs.log_reader import read_log
from limslam_agent.output.tum import read_tum
from limslam_agent.replay.smoothing import log_data
from limslam_agent.slam.graph.key_poses import ERRORS, LogData, Trajectory, choose_keys
from limslam_agent.slam.graph.local_maps import LocalMap, chunk_middles, cut_chunks
from limslam_agent.slam.graph.matching import Window, match, search_grid
from limslam_env.geometry import FloatArray, IntArray, se2

WITHIN = 0.3
"""Visits this near to each other coincide, m."""

_REACH = 1.0, np.radians(15.0)  # of a match, m and rad
_NEAR, _APART = 1.5, 15.0  # m between the middles of two visits, and m driven between them
_SCORE, _TURN_STEP = 0.6, np.radians(1.0)


@dataclass(frozen=True, eq=False)
class Revisits:
    """Visits of one place at different times.

    Attributes
    ----------
    pairs
        Number of pairs of local maps whose middles are near each other, with 15 m or more driven between them.
    shifts, turns
        Differences between the path and the match of each pair that matches (k,), m and rad.
    """

    pairs: int
    shifts: FloatArray
    turns: FloatArray

    @property
    def coinciding(self) -> float:
        """Share of the pairs that match with a shift below 0.3 m."""
        return float(np.mean(self.shifts <= WITHIN))

    @property
    def words(self) -> str:
        """One line for the screen."""
        if not len(self.shifts):
            return f"none of {self.pairs} pairs of visits matches"
        shift, turn = np.percentile(self.shifts, [50, 90]), np.degrees(np.percentile(self.turns, [50, 90]))
        pairs = f"{len(self.shifts)} of {self.pairs} pairs of visits match"
        match = f"{pairs}, {self.coinciding:.0%} of them within {WITHIN:g} m"
        median = f"median {shift[0]:.2f} m and {turn[0]:.1f} deg"
        return (
            f"{match}; {median}, 90 % within {shift[1]:.2f} m and {turn[1]:.1f} deg, largest {self.shifts.max():.2f} m"
        )


def revisits_of(log_path: Path, folder: Path) -> Revisits:
    """Match the visits of each place along the smoothed path of a replay of a log.

    Raises
    ------
    ValueError
        If the log or the path cannot be read, or the path is not that of the log.
    """
    poses, log = read_tum(folder / "trajectory_smoothed.tum")[1], read_log(log_path)
    if len(poses) != len(log):
        raise ValueError(f"{folder}: the path has {len(poses)} poses and the log {log_path} has {len(log)} events")
    return revisits(log_data(log, poses, 0.0), poses)


def revisits(log: LogData, poses: FloatArray) -> Revisits:
    """Match the visits of each place along the path ``poses`` (n, 3) of a log's events."""
    config = GraphConfig()
    # In place of odometry: events between two key poses then follow the path, too.
    data = replace(log, odometry=poses)
    keys = choose_keys(data, config.keys)
    middles = chunk_middles(keys, config.maps, config.maps.hop)
    path = Trajectory(poses[keys.first_event], np.zeros(ERRORS))
    maps = cut_chunks(keys, path, config.maps, middles, data.max_range)
    return _matched(maps, path.poses[middles])


def _matched(maps: list[LocalMap], poses: FloatArray) -> Revisits:
    shifts, turns, pairs = [], [], 0
    for first, chunk in enumerate(maps):
        others = _visits(maps, poses, first)
        pairs += len(others)
        grid = search_grid(chunk, _REACH[0])
        for second in others:
            guess = se2.between(poses[first], poses[second])
            window = Window(*_REACH, _TURN_STEP)
            found = match(grid, maps[second].points, guess, window, _SCORE)
            if found.score > _SCORE:
                shifts.append(np.hypot(*(found.pose - guess)[:2]))
                turns.append(abs(float(se2.wrap_angle(found.pose[2] - guess[2]))))
    return Revisits(pairs, np.array(shifts), np.array(turns))


def _visits(maps: list[LocalMap], poses: FloatArray, first: int) -> IntArray:
    """Later local maps that other visits have drawn near the middle of the first one."""
    travel = np.array([each.travel for each in maps])
    near = np.hypot(*(poses[:, :2] - poses[first, :2]).T) <= _NEAR
    return np.flatnonzero(near & (travel - travel[first] >= _APART))


if __name__ == "__main__":
    sys.exit("the command is now: python -m benchmarks revisits")
