"""Writes the folder of a run, of a replay, or of two logs that were replayed together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from limslam_agent.output.export import WallsAndGrid, map_content, write_json, write_map
from limslam_agent.output.finished_run import PICTURE, UNPLACED
from limslam_agent.output.map_picture import MapPicture
from limslam_agent.output.provenance import versions
from limslam_agent.output.run_folder import RESULT_FILE
from limslam_agent.output.tum import trajectory_file, write_tum
from limslam_env.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Results:
    """What is written into a folder."""

    # Times (n,), s, and poses (n, 3) of each robot or log, by the kinds in the names of their files
    times: Sequence[FloatArray]
    paths: Mapping[str, Sequence[FloatArray]]
    final: WallsAndGrid  # the map
    picture: MapPicture
    content: Mapping[str, Any]  # of ``result.json``, without the versions
    unplaced: WallsAndGrid | None = None  # a map in a frame of its own
    tables: Mapping[str, Any] = field(default_factory=dict)  # further files of JSON, by their names


def write_results(folder: Path, results: Results) -> dict[str, Any]:
    """Write trajectories, map, picture and result into an existing folder. Returns the content of
    ``result.json``.
    """
    from limslam_agent.output.drawing import draw_map

    for kind, paths in results.paths.items():
        for number, (time, poses) in enumerate(zip(results.times, paths, strict=True)):
            write_tum(folder / trajectory_file(kind, number, len(paths)), time, poses)
    write_map(folder, results.final)
    if results.unplaced is not None:
        write_json(folder / UNPLACED, map_content(results.unplaced, "local"))
    for name, table in results.tables.items():
        write_json(folder / name, table)
    draw_map(folder / PICTURE, results.picture)
    content = {**results.content, "versions": versions()}
    write_json(folder / RESULT_FILE, content)
    return content
