"""Bodies in a pymunk space: the only module that knows pymunk.

pymunk moves the bodies and says what they touch. Its contact solver is switched off: one
step of 0.1 s would let a robot sink 3 cm into a wall before the solver first sees it, and the
wheels set the velocity anew at each step anyway. Instead a robot that overlaps something is
put back along the shortest way, which is frictionless sliding, and turns freely.
"""

import math

import numpy as np
import pymunk

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import arc, wheels_to_arc, wrap_angle

_WALL, _ROBOT, _QUERY = 1, 2, 4
_TOUCH = 1e-5
_MAX_PUSHES = 24
_LONGEST_MOVE = 0.5
_DEEPEST = 5e-4


class Physics:
    """Round robots among walls.

    Parameters
    ----------
    edges
        Walls (k, 4), m.
    radius, axle
        Of every robot, m.
    poses
        Where the robots start (n, 3).
    """

    def __init__(self, edges: FloatArray, radius: float, axle: float, poses: FloatArray) -> None:
        self._radius, self._axle = radius, axle
        self._space = pymunk.Space()
        self._space.iterations = 1
        for x1, y1, x2, y2 in edges.tolist():
            wall = pymunk.Segment(self._space.static_body, (x1, y1), (x2, y2), 0.0)
            # A shape's mask names who may notice it: queries only, so the solver has no pairs.
            wall.filter = pymunk.ShapeFilter(categories=_WALL, mask=_QUERY)
            self._space.add(wall)
        self._bodies = [self._add_robot(pose, number) for number, pose in enumerate(poses)]
        self._filters = [
            pymunk.ShapeFilter(group=number + 1, categories=_QUERY, mask=_WALL | _ROBOT) for number in range(len(poses))
        ]

    @property
    def poses(self) -> FloatArray:
        """Where the robots are (n, 3); headings wrapped."""
        poses = np.array([(*body.position, body.angle) for body in self._bodies])
        poses[:, 2] = wrap_angle(poses[:, 2])
        return poses

    def step(self, travel: FloatArray, period: float) -> BoolArray:
        """Turn the wheels by ``travel`` (n, 2), m, in ``period`` s.

        Without contact the new pose is the end of the exact arc of constant wheel speeds:
        each body gets the velocity of the arc's chord.

        Returns
        -------
        contact
            (n,), whether a robot touched something.
        """
        # A move of more than the radius could end beyond a wall; an arc in pieces is the same arc.
        parts = max(1, math.ceil(float(np.abs(travel).max()) / (_LONGEST_MOVE * self._radius)))
        contact = np.zeros(len(self._bodies), dtype=bool)
        for _ in range(parts):
            contact |= self._move_freely(travel / parts, period / parts)
        return contact

    def _move_freely(self, travel: FloatArray, period: float) -> BoolArray:
        before = [body.position for body in self._bodies]
        for body, wheels in zip(self._bodies, travel, strict=True):
            x, y, turn = arc(*wheels_to_arc(wheels, self._axle)).tolist()
            body.velocity = pymunk.Vec2d(x, y).rotated(body.angle) / period
            body.angular_velocity = turn / period
        self._space.step(period)
        return self._separate(before)

    def _add_robot(self, pose: FloatArray, number: int) -> pymunk.Body:
        body = pymunk.Body(mass=1.0, moment=1.0)
        body.position, body.angle = (float(pose[0]), float(pose[1])), float(pose[2])
        disc = pymunk.Circle(body, self._radius)
        disc.filter = pymunk.ShapeFilter(group=number + 1, categories=_ROBOT, mask=_QUERY)
        self._space.add(body, disc)
        return body

    def _separate(self, before: list[pymunk.Vec2d]) -> BoolArray:
        contact = np.zeros(len(self._bodies), dtype=bool)
        for _ in range(_MAX_PUSHES):
            pushed = [self._push_out(number, contact) for number in range(len(self._bodies))]
            if not any(pushed):
                return contact
        # Wedged: between walls that meet in a sharp corner the pushes go on for ever. Who is put back
        # may meet one who came after him, who then has to go back as well.
        for _ in self._bodies:
            deep = [number for number in range(len(self._bodies)) if self._is_deep(number)]
            for number in deep:
                self._move(self._bodies[number], before[number])
        return contact

    def _is_deep(self, number: int) -> bool:
        nearest = self._nearest(number)
        return nearest is not None and nearest.distance < self._radius - _DEEPEST

    def _push_out(self, number: int, contact: BoolArray) -> bool:
        nearest = self._nearest(number)
        if nearest is None or nearest.shape is None:
            return False
        depth = self._radius - nearest.distance
        contact[number] = True
        if depth <= 0.0:
            return False
        body, other = self._bodies[number], nearest.shape.body
        is_robot = other is not None and other.body_type == pymunk.Body.DYNAMIC
        share = 0.5 if is_robot else 1.0
        self._move(body, body.position + nearest.gradient * (depth * share))
        if is_robot and other is not None:
            self._move(other, other.position - nearest.gradient * (depth * share))
        return depth > _TOUCH

    def _nearest(self, number: int) -> pymunk.PointQueryInfo | None:
        position = self._bodies[number].position
        return self._space.point_query_nearest(position, self._radius + _TOUCH, self._filters[number])

    def _move(self, body: pymunk.Body, place: pymunk.Vec2d) -> None:
        body.position = place
        self._space.reindex_shapes_for_body(body)
