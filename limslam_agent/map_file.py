"""Reads ``map.json``, which anybody may have made."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.safe_files import read_limited
from limslam_env.geometry import FloatArray
from limslam_env.geometry.numbers import check_poses
from limslam_env.geometry.segment import lengths

MOST_WALLS = 20_000
"""Most walls and most landmarks of a map that are read: more take minutes to draw and to score, and
no building has so many.
"""

MOST_METRES = 20_000.0
"""Largest sum of the lengths of the walls of a map that is read, m."""


def read_map_file(path: Path) -> tuple[dict[str, Any], FloatArray]:
    """The content of a ``map.json``, and its walls (k, 4), m, of bounded coordinates and lengths.

    Raises
    ------
    ValueError
        If the file cannot be read, is no such map, has more than ``MOST_WALLS`` walls or landmarks,
        or walls of more than ``MOST_METRES`` together. The message names the file.
    """
    try:
        content = json.loads(read_limited(path))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: does not hold the content that a run writes")  # noqa: TRY004 (a value)
    listed = content.get("segments")
    for part, name in ((listed, "walls"), (content.get("landmarks"), "landmarks")):
        if isinstance(part, list) and len(part) > MOST_WALLS:
            raise ValueError(f"{path}: it has {len(part)} {name}; at most {MOST_WALLS} are read")
    try:
        walls = np.array(listed, dtype=float).reshape(-1, 4) if isinstance(listed, list) else None
    except (TypeError, ValueError, OverflowError):
        walls = None
    if walls is None or len(walls) > MOST_WALLS:
        raise ValueError(f"{path}: its segments are not rows of four numbers")
    check_poses(f"{path}: the coordinates of its walls", walls)
    together = float(lengths(walls).sum())
    if together > MOST_METRES:
        raise ValueError(
            f"{path}: its walls are {together:g} m long together; at most {MOST_METRES:g} m are "
            "read: are they in m?"
        )
    return content, walls
