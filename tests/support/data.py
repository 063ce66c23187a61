"""Where recorded data lie, which are no part of the project, the worlds that ship, and how a log is
refused.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import limslam_env
from limslam_agent import read_log
from limslam_env import RobotSpec

SHIPPED_WORLDS = sorted(
    path.stem for path in Path(limslam_env.__file__).with_name("worlds").glob("*.toml")
)
DEFAULT_FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data"


def data_folder() -> Path:
    """The folder of recorded data, from ``LIMSLAM_DATA`` or beside the checkout; skips the test
    where it is absent.
    """
    folder = Path(os.environ.get("LIMSLAM_DATA", DEFAULT_FOLDER))
    if not (folder / "fr079").is_dir():
        pytest.skip(
            f"recorded data not found in {folder}: set LIMSLAM_DATA to the folder that holds fr079"
        )
    return folder


def refusal(
    path: Path, *arguments: object, read: Callable[..., object] = read_log, **options: object
) -> str:
    """Why a file is refused: one line that begins with its name."""
    with pytest.raises(ValueError) as caught:
        read(path, *arguments, **options)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def own_log(count: int = 4) -> dict[str, Any]:
    """The arrays of a ``log.npz`` of some steps."""
    generator = np.random.default_rng(3)
    return {
        "time": 0.1 * np.arange(count),
        "ranges": generator.uniform(0.1, 1.5, (count, 6)).astype(np.float32),
        "wheels": generator.uniform(-0.03, 0.03, (count, 2)).astype(np.float32),
        "action": generator.uniform(-1.0, 1.0, (count, 2)).astype(np.float32),
        "true_pose": generator.uniform(-1.0, 1.0, (count, 3)),
        "wall_seen": generator.integers(-2, 9, (count, 6)),
        "robot": np.array(RobotSpec().to_json()),
        "start_pose": np.array([1.0, 2.0, 0.5]),
    }
