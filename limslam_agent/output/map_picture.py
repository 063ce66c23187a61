"""What a picture of a map shows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import FloatArray

Paths: TypeAlias = Mapping[str, Sequence[FloatArray]]
"""Poses (n, 3) of each robot, by the kinds in the names of their files."""


@dataclass(frozen=True, eq=False)
class MapPicture:
    """Content of a picture of a map. All arrays are in the world frame, m."""

    title: str  # Title above the picture
    segments: FloatArray  # Walls of the map (N, 4)
    # Estimated positions (n, 2) of each robot that go with the map, of one robot at least
    estimated: Sequence[FloatArray]
    # Positions (n, 2) of each robot by odometry alone from the same start. Empty if they are
    # unknown.
    odometry: Sequence[FloatArray] = ()
    # True walls (k, 4), and true positions (n, 2) of each robot. None, and empty, if they are
    # unknown.
    true_edges: FloatArray | None = None
    true: Sequence[FloatArray] = ()
    # Occupancy grid, which is drawn behind everything. None draws no grid.
    grid: GridView | None = None
    # Positions (n, 2) of each robot as they were estimated while it drove, if the map is from the
    # smoothed paths. Empty if ``estimated`` are those positions.
    online: Sequence[FloatArray] = ()
    # A sentence below the title, such as why the map may be wrong. Empty if there is none.
    remark: str = ""
    # Colour of walls and paths, where several maps are compared. Empty gives each its own.
    colour: str = ""
    # Covariances (3, 3) of the last estimated pose of each robot. Empty draws no ellipses.
    covariances: Sequence[FloatArray] = ()

    @classmethod
    def of(cls, title: str, segments: FloatArray, paths: Paths, **others: Any) -> "MapPicture":
        """The picture of a map with the paths of robots."""

        def positions(kind: str) -> list[FloatArray]:
            return [poses[:, :2] for poses in paths.get(kind, ())]

        online = positions("est")
        smoothed = positions("smoothed")
        return cls(
            title,
            segments,
            smoothed or online,
            positions("odometry"),
            true=positions("true"),
            online=online if smoothed else (),
            **others,
        )
