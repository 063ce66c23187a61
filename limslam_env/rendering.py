"""Pictures of a running simulation, drawn with OpenCV. Loaded only when one is asked for."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.world import World

HEIGHT = 640
"""Height of a picture in pixels; the width follows the world."""

_MAX_WIDTH = 1600
_MARGIN = 28
_SHIFT = 4  # OpenCV draws at 1/16 pixel

_WALL, _OBSTACLE, _PAPER = (52, 58, 70), (214, 218, 224), (252, 252, 250)
_PATHS = ((42, 111, 187), (201, 104, 32), (52, 140, 90), (140, 80, 160))
_HIT, _MISS, _TEXT = (214, 69, 65), (176, 196, 214), (90, 96, 108)


@dataclass(frozen=True, eq=False)
class RenderState:
    """Everything that a picture shows.

    Attributes
    ----------
    world, robot
        What is drawn.
    poses
        (n, 3), m and rad.
    hits
        (n, n_beams), -1 where a beam hit nothing.
    ranges
        (n, n_beams), the readings, m.
    paths
        For each robot its past positions (k, 2), m.
    time, coverage
        s, and 0 to 1.
    """

    world: World
    robot: RobotSpec
    poses: FloatArray
    hits: IntArray
    ranges: NDArray[np.float32]
    paths: list[FloatArray]
    time: float
    coverage: float


class _Canvas:
    """A picture with the world's coordinates: x right, y up, metres."""

    def __init__(self, world: World) -> None:
        corners = world.edges.reshape(-1, 2)
        self._low, high = corners.min(axis=0), corners.max(axis=0)
        width, height = high - self._low
        self._scale = min((HEIGHT - 2 * _MARGIN) / height, (_MAX_WIDTH - 2 * _MARGIN) / width)
        rows, columns = int(height * self._scale) + 2 * _MARGIN, int(width * self._scale) + 2 * _MARGIN
        # Video codecs want even sides.
        self.image = np.full((rows + rows % 2, columns + columns % 2, 3), _PAPER, dtype=np.uint8)
        self._bottom = rows - _MARGIN

    def pixels(self, points: FloatArray) -> NDArray[np.int32]:
        scaled = (np.asarray(points) - self._low) * self._scale
        flipped = np.column_stack((scaled[:, 0] + _MARGIN, self._bottom - scaled[:, 1]))
        return np.asarray(np.round(flipped * (1 << _SHIFT)), dtype=np.int32)

    def lines(self, segments: FloatArray, colour: tuple[int, int, int], width: int) -> None:
        chains = self.pixels(segments.reshape(-1, 2)).reshape(-1, 2, 2)
        cv2.polylines(self.image, list(chains), False, colour, width, cv2.LINE_AA, _SHIFT)

    def path(self, points: FloatArray, colour: tuple[int, int, int], width: int) -> None:
        cv2.polylines(self.image, [self.pixels(points)], False, colour, width, cv2.LINE_AA, _SHIFT)

    def polygon(self, points: FloatArray, colour: tuple[int, int, int]) -> None:
        cv2.fillPoly(self.image, [self.pixels(points)], colour, cv2.LINE_AA, _SHIFT)

    def disc(self, centre: FloatArray, radius: float, colour: tuple[int, int, int], width: int = -1) -> None:
        (x, y), size = self.pixels(centre[None])[0].tolist(), int(radius * self._scale * (1 << _SHIFT))
        cv2.circle(self.image, (x, y), size, colour, width, cv2.LINE_AA, _SHIFT)

    def text(self, words: str) -> None:
        cv2.putText(self.image, words, (_MARGIN, 19), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _TEXT, 1, cv2.LINE_AA)


def render(state: RenderState) -> NDArray[np.uint8]:
    """The state as a picture (height, width, 3), RGB."""
    canvas = _Canvas(state.world)
    for polygon in state.world.obstacles:
        canvas.polygon(polygon, _OBSTACLE)
    for number, path in enumerate(state.paths):
        if len(path) > 1:
            canvas.path(path, _PATHS[number % len(_PATHS)], 1)
    for number, pose in enumerate(state.poses):
        _draw_beams(canvas, state, number)
        _draw_robot(canvas, pose, state.robot.radius, _PATHS[number % len(_PATHS)])
    canvas.lines(state.world.edges, _WALL, 2)
    canvas.text(f"{state.time:7.1f} s   covered {100.0 * state.coverage:5.1f} %")
    return canvas.image


def _draw_beams(canvas: _Canvas, state: RenderState, number: int) -> None:
    x, y, theta = state.poses[number]
    cos, sin = np.cos(theta), np.sin(theta)
    mounts = state.robot.beam_origins
    origins = np.column_stack(
        (x + cos * mounts[:, 0] - sin * mounts[:, 1], y + sin * mounts[:, 0] + cos * mounts[:, 1])
    )
    angles = theta + state.robot.beam_angles
    ends = origins + state.ranges[number][:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    hit = state.hits[number] != -1
    for chosen, colour in ((~hit, _MISS), (hit, _HIT)):
        if chosen.any():
            canvas.lines(np.hstack((origins[chosen], ends[chosen])), colour, 1)
    for end in ends[hit]:
        canvas.disc(end, 0.022, _HIT)


def _draw_robot(canvas: _Canvas, pose: FloatArray, radius: float, colour: tuple[int, int, int]) -> None:
    canvas.disc(pose[:2], radius, colour)
    nose = pose[:2] + radius * np.array([np.cos(pose[2]), np.sin(pose[2])])
    canvas.lines(np.hstack((pose[:2], nose))[None], _PAPER, 2)
