"""What is exported: a finished run with its readings and its grid."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.grid.occupancy import GridView
from limslam_agent.output.finished_run import LOG, FinishedRun, FolderError, read_run
from limslam_agent.places.saved_map import SavedMapError, read_grid
from limslam_agent.safe_files import load_arrays
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

_READINGS = ("ranges", "wheels", "yaw", "robot")


@dataclass(frozen=True, eq=False)
class Readings:
    """What the robots of a run measured."""

    robot: RobotSpec
    ranges: NDArray[
        np.float32
    ]  # (n, robots, beams) float32, m. A beam's maximum where nothing was seen.
    wheels: NDArray[Any]  # (n, robots, 2), left and right wheel travel since the previous step, m
    yaw: NDArray[Any] | None = None  # (n, robots), rad; None without inertial measurement units


@dataclass(frozen=True, eq=False)
class ExportedRun:
    """A finished run with all that other programs may want of it."""

    run: FinishedRun
    readings: Readings | None  # None where the folder has none, as that of a replayed log
    grid: GridView | None

    def paths(self) -> dict[str, list[FloatArray]]:
        """The trajectories that exist, each with the poses (n, 3) of each robot."""
        run = self.run
        kinds = {
            "true": run.true,
            "estimated": run.estimated,
            "smoothed": run.smoothed,
            "odometry": run.odometry,
        }
        return {name: poses for name, poses in kinds.items() if poses}


def read_exported(folder: Path) -> ExportedRun:
    """Read the folder of a finished run. Raises a FolderError if the folder is not that of a run,
    or a file in it cannot be used.
    """
    run = read_run(folder).with_one_time()
    try:
        grid = read_grid(folder) if (folder / "map.yaml").is_file() else None
    except SavedMapError as error:
        raise FolderError(str(error)) from error
    return ExportedRun(run, read_readings(run), grid)


def read_readings(run: FinishedRun) -> Readings | None:
    """The readings in a run's folder, or None where there are none. Raises a FolderError if they
    cannot be read, or do not fit the run.
    """
    path = run.folder / LOG
    if not path.is_file():
        return None
    try:
        arrays = load_arrays(path, _READINGS)
        robot = RobotSpec.from_json(str(arrays["robot"]))
        count = len(run.time)
        robots = len(run.estimated)
        ranges = arrays["ranges"].astype(np.float32).reshape(count, robots, len(robot.beams))
        wheels = arrays["wheels"].reshape(count, robots, 2)
        yaw = arrays["yaw"].reshape(count, robots) if "yaw" in arrays else None
    except KeyError as error:
        raise FolderError(f"{path}: has no array {error.args[0]}") from error
    except (OSError, ValueError) as error:
        raise FolderError(f"{path}: does not fit the run: {error}") from error
    return Readings(robot, ranges, wheels, yaw)
