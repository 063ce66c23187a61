"""What tests of recorded logs share: where the recordings lie, which are no part of the project, and a refusal."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from limslam_agent import read_log
from limslam_agent.logs.recorded_log import LogError

DEFAULT_FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data"


def data_folder() -> Path:
    """The folder of recorded data, from ``LIMSLAM_DATA`` or beside the checkout; skips the test where it is absent."""
    folder = Path(os.environ.get("LIMSLAM_DATA", DEFAULT_FOLDER))
    if not (folder / "fr079").is_dir():
        pytest.skip(f"recorded data not found in {folder}: set LIMSLAM_DATA to the folder that holds fr079")
    return folder


def refusal(path: Path, *arguments: object, read: Callable[..., object] = read_log, **options: object) -> str:
    """Why a file is refused: one line that begins with its name."""
    with pytest.raises(LogError) as caught:
        read(path, *arguments, **options)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message
