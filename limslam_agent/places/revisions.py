"""What becomes known about earlier steps of a robot that was lost: their poses, or that their place
is unknown.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.status.monitor import MAYBE_CARRIED
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray

NOT_CONFIRMED = "the robot's place was found, and it is not confirmed yet"
BEGUN_ANEW = (
    "the robot was lost before its map had walls, and has begun a new map where it believed to be"
)
GIVEN_UP = (
    "the robot was lost for so long that its latest map has taken the place of the earlier one"
)
_UNCONFIRMED = {
    event: Status("unsure", reason)
    for event, reason in (
        ("found", NOT_CONFIRMED),
        ("renewed", NOT_CONFIRMED),
        ("begun anew", BEGUN_ANEW),
        ("given up", GIVEN_UP),
    )
}


@dataclass(frozen=True, eq=False)
class Revision:
    """Poses of a robot as they became known when it had found its place.

    Attributes
    ----------
    begin
        Number of the first step.
    poses, covariances
        Poses (m, 3), m and rad, and covariances (m, 3, 3).
    """

    begin: int
    poses: FloatArray
    covariances: FloatArray


@dataclass(frozen=True, eq=False)
class Unplaced:
    """The map of a robot that was still lost at the end, in its local frame.

    Attributes
    ----------
    begin
        Number of the step since which the robot's place is unknown.
    segments, landmarks
        Walls (k, 4), m, and the lines that they lie on.
    grid
        Occupancy grid.
    """

    begin: int
    segments: FloatArray
    landmarks: list[Landmark]
    grid: GridView


@dataclass(frozen=True, eq=False)
class Event:
    """Something that has happened to a robot.

    Attributes
    ----------
    record
        The event for ``result.json``.
    revision
        The poses of earlier steps as they are known since then.
    carried_at
        The step before which the robot was carried away.
    slipped
        The part of the drive, from a step to before another one, in one step of which the robot has
        slipped.
    refutes
        Whether the place that was found before is wrong.
    """

    record: dict[str, Any]
    revision: Revision | None = None
    carried_at: int | None = None
    slipped: tuple[int, int] | None = None
    refutes: bool = False


@dataclass(frozen=True, eq=False)
class PlaceHistory:
    """What happened to a robot that was lost during a run.

    Attributes
    ----------
    events
        When the robot was lost and found.
    unplaced
        The local map of a robot that is still lost at the end; None otherwise.
    is_suspicious
        Whether the robot may have been carried away before the end. The smoother, which believes
        the wheels, cannot see that.
    """

    events: Sequence[Event] = ()
    unplaced: Unplaced | None = None
    is_suspicious: bool = False

    @property
    def records(self) -> list[dict[str, Any]]:
        """The events, and the matches that decided them, for ``result.json``."""
        return [event.record for event in self.events]

    @property
    def revisions(self) -> list[Revision]:
        """Poses of earlier steps as they became known when the robot had found its place."""
        return [event.revision for event in self._unrefuted if event.revision is not None]

    @property
    def breaks(self) -> list[int]:
        """The steps before which the robot was carried away, as far as it has found its place
        again.
        """
        return [event.carried_at for event in self._unrefuted if event.carried_at is not None]

    @property
    def slips(self) -> list[tuple[int, int]]:
        """Parts of the drive in which the robot has slipped."""
        return [event.slipped for event in self._unrefuted if event.slipped is not None]

    @property
    def _unrefuted(self) -> list[Event]:
        """The events with revisions that no later event refutes."""
        found = list[Event]()
        for event in self.events:
            if event.refutes:
                found.pop()
            elif event.revision is not None:
                found.append(event)
        return found

    @property
    def placed(self) -> slice:
        """The steps in which the robot's place is known at the end."""
        return slice(None if self.unplaced is None else self.unplaced.begin)

    @property
    def doubt(self) -> Status:
        """The status at the end of a robot whose place or map was not confirmed, or that may have
        been carried away.

        Otherwise, it is ok.
        """
        found = _UNCONFIRMED.get(self.records[-1]["event"], Status()) if self.events else Status()
        return MAYBE_CARRIED if found.level == "ok" and self.is_suspicious else found


def revised(
    poses: FloatArray, covariances: FloatArray, revisions: Sequence[Revision]
) -> tuple[FloatArray, FloatArray]:
    """The poses (t, n, 3) of a run of one robot as they are known at the end, with covariances (t,
    n, 3, 3).

    While the robot was lost, its poses were in a local frame.
    """
    poses = poses.copy()
    covariances = covariances.copy()
    for revision in revisions:
        rows = slice(revision.begin, revision.begin + len(revision.poses))
        poses[rows, 0] = revision.poses
        covariances[rows, 0] = revision.covariances
    return poses, covariances
