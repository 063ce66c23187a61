"""Pictures with the coordinates of a world, and the colours that pictures of the truth and of a
belief share. Nothing of a simulation is known here.
"""

import math
from dataclasses import dataclass, replace
from typing import Self, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import FloatArray

Image: TypeAlias = NDArray[np.uint8]
Colour: TypeAlias = tuple[int, int, int]

PAPER = (250, 250, 249)
UNSEEN = (222, 227, 233)
SEEN = (252, 248, 238)
BEAM = (226, 138, 40)
BELIEF = (205, 48, 66)
FRONTIER = (20, 150, 140)
TEXT = (86, 94, 108)
RULE = (208, 213, 220)
ROBOTS = (
    (38, 103, 178),
    (40, 140, 92),
    (132, 84, 170),
    (176, 88, 60),
    (20, 128, 142),
    (168, 62, 110),
)

SHIFT = 4
"""OpenCV draws at 1/16 pixel."""

_FAR = 100_000  # pixels


def robot_colour(number: int) -> Colour:
    """Colour of a robot. The colours repeat if there are more robots than colours."""
    return ROBOTS[number % len(ROBOTS)]


def mixed(first: Colour, second: Colour, share: float) -> Colour:
    """A mixture of two colours. ``share`` is the share of the second colour."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(first, second, strict=True))
    return red, green, blue


@dataclass(frozen=True, eq=False)
class Canvas:
    """A picture with world coordinates: x to the right, y upwards, m."""

    image: Image  # (height, width, 3), RGB
    low: FloatArray  # a position (2,), m
    origin: FloatArray  # the pixel (2,) that it falls on
    scale: float  # pixels per metre

    def on(self, image: Image) -> Self:
        """The same on another picture."""
        return replace(self, image=image)

    def pixels(self, points: FloatArray) -> NDArray[np.int32]:
        """Positions (n, 2), m, in the fixed-point pixel coordinates of OpenCV."""
        across = np.array([self.scale, -self.scale])
        pixels = (np.asarray(points, dtype=float) - self.low) * across + self.origin
        # What is believed may lie anywhere, but OpenCV uses 32-bit coordinates.
        return np.asarray(np.round(np.clip(pixels, -_FAR, _FAR) * (1 << SHIFT)), dtype=np.int32)

    def lines(self, segments: FloatArray, colour: Colour, width: int) -> None:
        """Draw lines between pairs of points (n, 4), m. The width is in pixels."""
        chains = self.pixels(segments.reshape(-1, 2)).reshape(-1, 2, 2)
        cv2.polylines(self.image, list(chains), False, colour, width, cv2.LINE_AA, SHIFT)  # noqa: FBT003 (they are not closed)

    def path(
        self, points: FloatArray, colour: Colour, width: int = 1, *, closed: bool = False
    ) -> None:
        """Draw lines through points (n, 2), m. The width is in pixels."""
        if len(points):
            pixels = self.pixels(points)
            cv2.polylines(self.image, [pixels], closed, colour, width, cv2.LINE_AA, SHIFT)

    def polygon(self, points: FloatArray, colour: Colour) -> None:
        """Fill the polygon with corners (n, 2), m."""
        cv2.fillPoly(self.image, [self.pixels(points)], colour, cv2.LINE_AA, SHIFT)

    def discs(self, centres: FloatArray, radius: float, colour: Colour, width: int = -1) -> None:
        """Draw discs at positions (n, 2), m, or rings of a width. All sizes are in pixels."""
        size = round(radius * (1 << SHIFT))
        for x, y in self.pixels(np.reshape(centres, (-1, 2))).tolist():
            cv2.circle(self.image, (x, y), size, colour, width, cv2.LINE_AA, SHIFT)

    def arrow(self, pose: FloatArray, length: float) -> FloatArray:
        """Corners (4, 2), m, of a small arrow head around a pose (3,), as long as a number of
        pixels.
        """
        corners = np.array([(0.55, 0.0), (-0.45, 0.4), (-0.25, 0.0), (-0.45, -0.4)])
        cos = math.cos(pose[2])
        sin = math.sin(pose[2])
        turn = np.array([[cos, sin], [-sin, cos]])
        return np.asarray(pose[:2] + corners * (length / self.scale) @ turn)
