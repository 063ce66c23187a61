"""Writes maps, also that of a live robot, and the covariances of trajectories."""

import json
import math
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray


def write_covariances(path: Path, estimated: FloatArray, smoothed: FloatArray | None) -> None:
    """Write covariances (t, n, 3, 3) of the estimated poses of n robots, and of the smoothed poses
    if there are any.

    Single precision is enough for pictures and keeps the file small.
    """
    arrays: dict[str, Any] = {"estimated": estimated.astype(np.float32)}
    if smoothed is not None:
        arrays["smoothed"] = smoothed.astype(np.float32)
    np.savez_compressed(path, **arrays)


def write_json(path: Path, content: Any) -> None:
    """Write readable JSON. NaN and infinity are errors. Values that do not apply are ``null``."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values that JSON can hold: plain numbers and texts, and None for numbers that are not
    finite.
    """
    items = {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in values.items()
    }
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in items.items()
    }


class WallsAndGrid(Protocol):
    """The final map of a run or a replay, from which every file of the map, its picture and its
    scores are made.
    """

    @property
    def segments(self) -> FloatArray:
        """Walls (N, 4) as x1, y1, x2, y2 in the world frame, m, cut at doors and holes."""

    @property
    def landmarks(self) -> list[Landmark]:
        """The lines that the walls lie on, with covariances."""

    @property
    def grid(self) -> GridView:
        """Occupancy grid."""


def write_map(folder: Path, final: WallsAndGrid) -> None:
    """Write ``map.json``, ``map.pgm`` and ``map.yaml``."""
    write_json(folder / "map.json", map_content(final))
    write_grid(folder, final.grid)


def map_content(final: WallsAndGrid, frame: str = "world") -> dict[str, Any]:
    """The content of ``map.json`` in a frame, m and rad.

    The segments are written with all their digits, so that a score of the file equals the score of
    the run.
    """
    return {
        "frame": frame,
        "segments": final.segments.tolist(),
        "landmarks": [
            {
                "r": mark.r,
                "theta": mark.theta,
                "cov": mark.covariance.tolist(),
                "ends": mark.ends.tolist(),
                "observations": mark.observations,
                "segments": list(mark.segments),
            }
            for mark in final.landmarks
        ],
    }


def write_grid(folder: Path, grid: GridView) -> None:
    """Write ``map.pgm`` and ``map.yaml`` in the format of ROS's map_server."""
    # A log without a scan leaves an empty grid. A picture needs at least one pixel.
    values = grid.values if grid.values.size else np.zeros((1, 1))
    pixels = np.where(values > 0, 254, np.where(values < 0, 0, 205)).astype(np.uint8)[::-1]
    header = f"P5\n{pixels.shape[1]} {pixels.shape[0]}\n255\n".encode()
    (folder / "map.pgm").write_bytes(header + pixels.tobytes())
    x, y = grid.low
    (folder / "map.yaml").write_text(
        f"image: map.pgm\nresolution: {grid.cell:g}\norigin: [{x:.6f}, {y:.6f}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        encoding="utf-8",
    )


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
    """Write ``map.json``, ``map.pgm``, ``map.yaml`` and ``map.png``. Existing files of these names
    are replaced.

    Parameters
    ----------
    folder
        Where the files go. The folder is made if there is none.
    snapshot
        What ``Mapper.snapshot``, ``LimSlamAgent.snapshot`` or ``LimSlamTeam.snapshot`` returned.
    path
        Estimated positions or poses (n, 2) or (n, 3), m, that the picture shows. For several robots
        a list of arrays. By default the picture shows only where the robots are.
    title
        Title above the picture.

    Raises
    ------
    ValueError
        If the number of paths is not that of the robots.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from limslam_agent import Mapper, save_map
    >>> from limslam_env import RobotSpec
    >>> mapper = Mapper(RobotSpec())
    >>> for _ in range(100):
    ...     mapper.step({"ranges": np.full(6, 0.8), "wheels": np.array([0.02, 0.02])})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_map(folder, mapper.snapshot())
    ...     sorted(path.name for path in Path(folder).iterdir())
    ['map.json', 'map.pgm', 'map.png', 'map.yaml']
    """
    from limslam_agent.output.drawing import draw_map
    from limslam_agent.output.map_picture import MapPicture

    target = Path(folder)
    each = [pose[None] for pose in snapshot.poses] if path is None else path
    paths = [each] if isinstance(each, np.ndarray) and each.ndim == 2 else list(each)
    if len(paths) != len(snapshot.poses):
        raise ValueError(f"{len(paths)} paths do not go with {len(snapshot.poses)} robots")
    target.mkdir(parents=True, exist_ok=True)
    write_map(target, snapshot)
    picture = MapPicture.of(title, snapshot.segments, {"est": paths}, grid=snapshot.grid)
    draw_map(target / "map.png", picture)
