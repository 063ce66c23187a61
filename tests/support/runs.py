"""Runs by the command line, and the folders of runs as any program would read and write them."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from support.command_line import told

from limslam_env.geometry import FloatArray


@dataclass(frozen=True)
class Folder:
    """The folder of a run."""

    path: Path

    def content(self, name: str) -> Any:
        """The content of a file of JSON."""
        return json.loads((self.path / name).read_text(encoding="utf-8"))

    @property
    def result(self) -> dict[str, Any]:
        return self.content("result.json")

    @property
    def metrics(self) -> dict[str, Any]:
        return self.result["metrics"]

    @property
    def segments(self) -> FloatArray:
        return np.array(self.content("map.json")["segments"], dtype=float).reshape(-1, 4)

    @cached_property
    def time(self) -> FloatArray:
        return np.loadtxt(next(self.path.glob("trajectory_est*.tum")))[:, 0]

    def poses(self, name: str) -> FloatArray:
        """The poses (n, 3) of a trajectory, such as ``est`` or ``true_0``."""
        return read_poses(self.path / f"trajectory_{name}.tum")

    def covariances(self, name: str = "estimated") -> FloatArray:
        """Covariances (n, 3, 3) of the poses of the first robot."""
        with np.load(self.path / "covariance_est.npz") as arrays:
            return arrays[name][:, 0].astype(float)


def run(folder: Path, *options: object) -> Folder:
    """Run ``limslam run`` with options into a folder."""
    told("run", *options, "--out", folder)
    return Folder(folder)


def read_poses(path: Path) -> FloatArray:
    """The poses (n, 3) of a file of TUM's format."""
    table = np.loadtxt(path, ndmin=2)
    return np.column_stack((table[:, 1:3], Rotation.from_quat(table[:, 4:]).as_euler("ZYX")[:, 0]))


def write_poses(path: Path, time: FloatArray, poses: FloatArray) -> None:
    """A file of TUM's format, with nine digits."""
    turns = Rotation.from_euler("z", poses[:, 2:]).as_quat()
    np.savetxt(path, np.column_stack((time, poses[:, :2], np.zeros(len(time)), turns)), fmt="%.9f")


def write_run(
    folder: Path,
    *,
    robots: int = 1,
    truth: bool = True,
    offset: float = 0.1,
    config: dict[str, Any] | None = None,
    metrics: dict[str, Any] | None = None,
) -> Path:
    """A small finished run that was made by hand: 30 poses a robot, each ``offset`` (m, rad)
    off.
    """
    folder.mkdir(parents=True, exist_ok=True)
    time = 0.1 * np.arange(30)
    turns = np.linspace(0.0, 3.0, 30)
    poses = np.column_stack((1.0 + np.cos(turns), 1.0 + np.sin(turns), turns + 1.5))
    for number in range(robots):
        suffix = f"_{number}" if robots > 1 else ""
        write_poses(folder / f"trajectory_est{suffix}.tum", time, poses + offset)
        if truth:
            write_poses(folder / f"trajectory_true{suffix}.tum", time, poses)
    walls = [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 3.0]]
    (folder / "map.json").write_text(
        json.dumps({"frame": "world", "segments": walls, "landmarks": []})
    )
    config = {"world": "hall", "noise": 0.02, "preset": "paper"} if config is None else config
    metrics = (
        {"stop_reason": "explored: no frontier is left", "ate_m": offset}
        if metrics is None
        else metrics
    )
    result = {
        "metrics": metrics,
        "cost": {"speed_x_real_time": 80.0},
        "config": config,
        "seed": 3,
        "versions": {},
    }
    (folder / "result.json").write_text(json.dumps(result))
    (folder / "map.png").write_bytes(b"")
    return folder


def result_of(folder: Path) -> dict[str, Any]:
    """The content of the ``result.json`` of a folder."""
    return Folder(folder).result
