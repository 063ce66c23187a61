"""Writes the map of a live robot to a folder."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Protocol

import numpy as np

from limslam_agent.output.export import WallsAndGrid, write_map
from limslam_env.geometry import FloatArray


class LiveMap(WallsAndGrid, Protocol):
    """What a snapshot of a mapper, an agent or a team holds."""

    @property
    def poses(self) -> FloatArray:
        """Estimated pose of each robot (n, 3), m, m, rad."""


def save_map(
    folder: str | PathLike[str],
    snapshot: LiveMap,
    path: FloatArray | Sequence[FloatArray] | None = None,
    title: str = "map",
) -> None:
    """Write ``map.json``, ``map.pgm``, ``map.yaml`` and ``map.png``. Existing files of these names are replaced.

    Parameters
    ----------
    folder
        Where the files go. The folder is made if there is none.
    snapshot
        What ``Mapper.snapshot``, ``LimSlamAgent.snapshot`` or ``LimSlamTeam.snapshot`` returned.
    path
        Estimated positions or poses (n, 2) or (n, 3), m, that the picture shows. For several robots a list of arrays.
        By default the picture shows only where the robots are.
    title
        Title above the picture.

    Raises
    ------
    ValueError
        If the number of paths is not that of the robots.
    OSError
        If a file cannot be written.
    """
    from limslam_agent.output.drawing import MapPicture, draw_map

    target = Path(folder)
    each = [pose[None] for pose in snapshot.poses] if path is None else path
    paths = [each] if isinstance(each, np.ndarray) and each.ndim == 2 else list(each)
    if len(paths) != len(snapshot.poses):
        raise ValueError(f"{len(paths)} paths do not go with {len(snapshot.poses)} robots")
    target.mkdir(parents=True, exist_ok=True)
    write_map(target, snapshot)
    positions = [each[:, :2] for each in paths]
    draw_map(target / "map.png", MapPicture(title, snapshot.segments, positions, grid=snapshot.grid))
