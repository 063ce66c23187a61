"""Where the recorded data lies that some tests read; it is no part of the project."""

import os
from pathlib import Path

import pytest

DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data"


def data_folder() -> Path:
    """The folder of recorded data, from ``LIMSLAM_DATA`` or beside the checkout; skips the test where it is absent."""
    folder = Path(os.environ.get("LIMSLAM_DATA", DEFAULT_FOLDER))
    if not (folder / "fr079").is_dir():
        pytest.skip(f"recorded data not found in {folder}: set LIMSLAM_DATA to the folder that holds fr079")
    return folder
