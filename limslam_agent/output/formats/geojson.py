"""Writes walls and paths as GeoJSON (RFC 7946) for geographic information systems."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.output.formats.content import ExportedRun
from limslam_env.geometry import FloatArray

_EARTH_RADIUS = 6_378_137.0  # m, of the sphere on which a degree is measured


def write_geojson(folder: Path, exported: ExportedRun, origin: tuple[float, float] | None) -> list[Path]:
    """Write ``map.geojson``: each wall and each path as a line.

    Parameters
    ----------
    folder
        Folder to write to.
    exported
        The run.
    origin
        Latitude and longitude, deg, of the point (0, 0) of the map, whose x axis points to the east. Without it the
        coordinates are metres, and the member ``frame`` says so, since GeoJSON itself only knows degrees.
    """
    run = exported.run
    walls = run.segments.reshape(-1, 2, 2)
    features = [_line(wall, {"kind": "wall", "length_m": math.dist(*wall.tolist())}, origin) for wall in walls]
    for kind, each in exported.paths().items():
        for number, poses in enumerate(each):
            features.append(_line(poses[:, :2], {"kind": "path", "path": kind, "robot": number}, origin))
    content: dict[str, Any] = {"type": "FeatureCollection", "name": run.title, "features": features}
    if origin is None:
        content["frame"] = "local, m"
    path = folder / "map.geojson"
    path.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")
    return [path]


def _line(points: FloatArray, properties: dict[str, Any], origin: tuple[float, float] | None) -> dict[str, Any]:
    # A line needs two points.
    points = points if len(points) > 1 else np.repeat(points, 2, axis=0)
    if origin is None:
        rounded = points.round(6)
    else:
        latitude, longitude = origin
        degree = math.radians(1.0) * _EARTH_RADIUS
        east = longitude + points[:, 0] / (degree * math.cos(math.radians(latitude)))
        # 1e-9 degrees are 0.1 mm.
        rounded = np.column_stack((east, latitude + points[:, 1] / degree)).round(9)
    geometry = {"type": "LineString", "coordinates": rounded.tolist()}
    return {"type": "Feature", "geometry": geometry, "properties": properties}
