"""The motion of round robots and their contact with walls and each other, with pymunk.

A robot that is far from all obstacles moves to the end of the arc of its wheels.
``kernels.observation`` does the same where it measures. Near obstacles pymunk moves the bodies and
reports their contacts. pymunk's contact solver is switched off, because in one step of 0.1 s a
robot could penetrate a wall by 3 cm before the solver notices, and because the wheels set a new
velocity at each step. Instead, a robot that overlaps an obstacle is moved out of it along the
shortest way: it slides without friction and turns freely.
"""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import pymunk

from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import arc_end, wrap_angle
from limslam_env.kernels.contact import DEEPEST, LONGEST_MOVE, MAX_PUSHES, TOUCH
from limslam_env.kernels.observation import AXLE, CLEARANCE, LONGEST

_WALL = 1
_ROBOT = 2
_QUERY = 4

# Distance up to which obstacles are searched for, m.
_OUTLOOK = 0.5

_Pose: TypeAlias = tuple[float, float, float]


class Physics:
    """Round robots of one ``radius``, m, among walls (k, 4), m; :meth:`place` them before the first
    step.

    Attributes
    ----------
    current, motion
        Where the robots are (n, 3), and what their motion depends on (3,), as
        :func:`limslam_env.kernels.observation.drive_and_observe` reads and changes them.
    """

    def __init__(self, edges: FloatArray, radius: float, num_robots: int) -> None:
        self._edges = edges
        self._radius = radius
        self._space = pymunk.Space()
        self._space.iterations = 1
        for x1, y1, x2, y2 in edges.tolist():
            wall = pymunk.Segment(self._space.static_body, (x1, y1), (x2, y2), 0.0)
            # Shapes only take part in queries, so the solver has no pairs of shapes to resolve.
            wall.filter = pymunk.ShapeFilter(categories=_WALL, mask=_QUERY)
            self._space.add(wall)
        self._bodies = [self._add_robot(number) for number in range(num_robots)]
        self._filters = [
            pymunk.ShapeFilter(group=number + 1, categories=_QUERY, mask=_WALL | _ROBOT)
            for number in range(num_robots)
        ]
        # A disc has no orientation, so pymunk does not have to know the headings.
        self.current = np.zeros((num_robots, 3))
        self.motion = np.zeros(3)
        self.motion[AXLE] = 1.0
        self.motion[LONGEST] = LONGEST_MOVE * radius

    def place(self, poses: FloatArray, axle: float) -> None:
        """Put the robots at poses (n, 3); their wheels are ``axle`` (m) apart."""
        self.current[:] = [(x, y, wrap_angle(theta)) for x, y, theta in poses.tolist()]
        self.motion[AXLE] = axle
        self.motion[CLEARANCE] = 0.0

    @property
    def poses(self) -> FloatArray:
        """Where the robots are (n, 3); headings wrapped; a copy."""
        return self.current.copy()

    def step(self, travel: Sequence[Sequence[float]], period: float) -> list[bool]:
        """Carry each robot's wheels on by ``travel``, m, in ``period`` s; returns whether each
        robot touched something.

        Without contact the new pose is the end of the exact arc of constant wheel speeds:
        a body that pymunk moves gets the velocity of the arc's chord.
        """
        farthest = 0.5 * max(abs(left + right) for left, right in travel)
        if farthest <= self.motion[LONGEST]:
            return self._move(travel, period, farthest)
        # A move of more than the radius could end beyond a wall; an arc in pieces is the same arc.
        parts = math.ceil(farthest / self.motion[LONGEST])
        pieces = [[wheel / parts for wheel in robot] for robot in travel]
        contacts = [self._move(pieces, period / parts, farthest / parts) for _ in range(parts)]
        return [any(robot) for robot in zip(*contacts, strict=True)]

    def _move(
        self, travel: Sequence[Sequence[float]], period: float, farthest: float
    ) -> list[bool]:
        # Two robots may approach each other.
        self.motion[CLEARANCE] -= farthest if len(travel) == 1 else 2.0 * farthest
        before: list[_Pose] = [(x, y, heading) for x, y, heading in self.current.tolist()]
        axle = float(self.motion[AXLE])
        goals = [
            arc_end(*pose, left, right, axle)
            for pose, (left, right) in zip(before, travel, strict=True)
        ]
        if self.motion[CLEARANCE] <= 0.0:
            return self._move_bodies(before, goals, period)
        # No robot can touch anything: pymunk is not needed.
        self.current[:] = goals
        return [False] * len(goals)

    def _move_bodies(self, before: list[_Pose], goals: list[_Pose], period: float) -> list[bool]:
        for body, (x, y, _), (goal_x, goal_y, _) in zip(self._bodies, before, goals, strict=True):
            self._put(body, (x, y))
            body.velocity = (goal_x - x) / period, (goal_y - y) / period
        self._space.step(period)
        contact = self._separate() if self._touches_or_looks_ahead() else [False] * len(goals)
        self.current[:] = [
            (*body.position, heading)
            for body, (_, _, heading) in zip(self._bodies, goals, strict=True)
        ]
        return contact

    def _touches_or_looks_ahead(self) -> bool:
        """Whether a robot touches something; if none does, the clearance says for how long none
        can.
        """
        nearest = [self._nearest(number, _OUTLOOK) for number in range(len(self._bodies))]
        gaps = [_OUTLOOK if found is None else found.distance - self._radius for found in nearest]
        self.motion[CLEARANCE] = clearance = min(gaps) - TOUCH
        return clearance <= 0.0

    def _add_robot(self, number: int) -> pymunk.Body:
        body = pymunk.Body(mass=1.0, moment=1.0)
        disc = pymunk.Circle(body, self._radius)
        disc.filter = pymunk.ShapeFilter(group=number + 1, categories=_ROBOT, mask=_QUERY)
        self._space.add(body, disc)
        return body

    def _separate(self) -> list[bool]:
        contact = [False] * len(self._bodies)
        self.motion[CLEARANCE] = 0.0
        for _ in range(MAX_PUSHES):
            pushed = [self._push_out(number, contact) for number in range(len(self._bodies))]
            if not any(pushed):
                return contact
        # Between walls at a sharp angle the pushes do not converge: robots that still overlap
        # something return to their positions before the step. Another robot may have moved there,
        # and then has to return as well.
        for _ in self._bodies:
            deep = [number for number in range(len(self._bodies)) if self._is_deep(number)]
            for number in deep:
                x, y, _ = self.current[number].tolist()
                self._put(self._bodies[number], (x, y))
        return contact

    def _is_deep(self, number: int) -> bool:
        nearest = self._nearest(number, TOUCH)
        return nearest is not None and nearest.distance < self._radius - DEEPEST

    def _push_out(self, number: int, contact: list[bool]) -> bool:
        nearest = self._nearest(number, TOUCH)
        if nearest is None or nearest.shape is None:
            return False
        depth = self._radius - nearest.distance
        contact[number] = True
        if depth <= 0.0:
            return False
        body = self._bodies[number]
        other = nearest.shape.body
        is_robot = other is not None and other.body_type == pymunk.Body.DYNAMIC
        share = 0.5 if is_robot else 1.0
        self._put(body, body.position + nearest.gradient * (depth * share))
        if is_robot and other is not None:
            self._put(other, other.position - nearest.gradient * (depth * share))
        return depth > TOUCH

    def _nearest(self, number: int, outlook: float) -> pymunk.PointQueryInfo | None:
        position = self._bodies[number].position
        return self._space.point_query_nearest(
            position, self._radius + outlook, self._filters[number]
        )

    def _put(self, body: pymunk.Body, place: tuple[float, float]) -> None:
        body.position = place
        self._space.reindex_shapes_for_body(body)

    def __getstate__(self) -> dict[str, Any]:
        return {
            "edges": self._edges,
            "radius": self._radius,
            "poses": self.current,
            "motion": self.motion,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        Physics.__init__(self, state["edges"], state["radius"], len(state["poses"]))
        # The simulation holds the same arrays.
        self.current = state["poses"]
        self.motion = state["motion"]
