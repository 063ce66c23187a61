"""What people ask of a robot while it drives: by keys, on its page, and by topics of ROS 2."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from limslam_env.geometry.numbers import LARGEST_COORDINATE, check_number

HOME: Literal["home"] = "home"
"""The destination where the robot began."""


@dataclass(frozen=True, eq=False)
class Goal:
    """A place to drive to."""

    x: float  # m
    y: float
    map_number: int  # of the map that has the place

    def __str__(self) -> str:
        return f"the goal ({self.x:z.1f}, {self.y:z.1f})"


Destination: TypeAlias = Goal | Literal["home"]


@dataclass(eq=False)
class Orders:
    """The orders that hold now. Any thread may give them; the session carries them out.

    Attributes
    ----------
    is_paused
        Whether the robot only maps. The wheels are stopped once, and then get no command, so that a
        person can drive.
    destination
        Where to drive instead of exploring, if anywhere.
    end
        Why the session shall end, in words. None while it goes on.
    when_explored
        What follows when nothing is left to explore: the end of the session, the way home, or a
        pause.
    answers
        What became of each order so far, a line each.
    """

    is_paused: bool = False
    destination: Destination | None = None
    end: str | None = None
    when_explored: Literal["end", "home", "pause"] = "end"
    answers: list[str] = field(default_factory=list)

    @property
    def shall_stand(self) -> bool:
        """Whether no wheel shall move."""
        return self.is_paused or self.end is not None

    def pause(self, why: str = "paused: the robot maps, and its wheels stand still") -> None:
        """Stop the wheels and go on mapping."""
        if not self.is_paused:
            self.is_paused = True
            self.answers.append(why)

    def go_on(self) -> None:
        """Go on with what the robot did before the pause."""
        if self.is_paused:
            self.is_paused = False
            self.answers.append("going on")

    def go_home(self) -> None:
        """Drive back to the start, and end there."""
        if self.destination != HOME:
            self.destination = HOME
            self.answers.append("driving home")
        self.is_paused = False

    def press(self, keys: str) -> None:
        """Carry out the orders of keys; other keys mean nothing."""
        for key in keys.lower():
            if key == "p":
                (self.go_on if self.is_paused else self.pause)()
            elif key == "h":
                self.go_home()

    def drop_destination(self, answer: str) -> None:
        """Drive nowhere after all, for a reason in words."""
        self.destination = None
        self.answers.append(answer)

    def obey(self, message: Mapping[str, Any]) -> None:
        """Carry out an order of a page: ``{"order": "pause"}``, ``"go on"``, ``"home"``, or
        ``"goal"`` with ``x`` and ``y``, m, and the number ``map``. Raises a ValueError if it is
        none of them.
        """
        plain = {"pause": self.pause, "go on": self.go_on, "home": self.go_home}
        order = message.get("order")
        if order == "goal":
            x, y, number = (_number(message, name) for name in ("x", "y", "map"))
            self.destination = Goal(x, y, int(number))
        elif isinstance(order, str) and order in plain:
            plain[order]()
        else:
            raise ValueError(f"there is no such order; there are {', '.join(plain)} and goal")


def _number(message: Mapping[str, Any], name: str) -> float:
    value: Any = message.get(name)
    check_number(f"the {name} of a goal", value, -LARGEST_COORDINATE, LARGEST_COORDINATE)
    return float(value)
