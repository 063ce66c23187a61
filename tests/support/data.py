"""Where recorded data lie, which are no part of the project, the worlds that ship, and how a log is
refused.
"""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

import limslam_env
from limslam_agent import read_log

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
