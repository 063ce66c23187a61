"""Opens any log that the project can replay."""

from collections.abc import Sequence
from os import fspath
from pathlib import PurePath

from limslam_agent.carmen import read_carmen
from limslam_agent.recorded_log import ZIP_MAGIC, FilePath, LogError, RecordedLog, first_bytes, read_npz

DEFAULT_BEAMS_DEG = (-90.0, -45.0, -15.0, 15.0, 45.0, 90.0)
DEFAULT_MAX_RANGE = 3.0


def read_log(path: FilePath, beams_deg: Sequence[float] | None = None, max_range: float | None = None) -> RecordedLog:
    """Read the project's own ``log.npz`` or a CARMEN log, told apart by their first bytes.

    Parameters
    ----------
    path
        The log.
    beams_deg
        Beam angles in degrees to choose out of a CARMEN log's, six when None. Our own log has its beams.
    max_range
        Longest reading in m of a CARMEN log's beams, 3 m when None. Our own log has its limits.

    Raises
    ------
    LogError
        If the file cannot be used, or fixes what was to be chosen.
    """
    if first_bytes(path, len(ZIP_MAGIC)) == ZIP_MAGIC or PurePath(path).suffix == ".npz":
        if beams_deg is not None or max_range is not None:
            chosen = "beams" if beams_deg is not None else "largest range"
            raise LogError(f"{fspath(path)}: the log fixes its {chosen}, which cannot be chosen")
        return read_npz(path)
    beams = DEFAULT_BEAMS_DEG if beams_deg is None else beams_deg
    return read_carmen(path, beams, DEFAULT_MAX_RANGE if max_range is None else max_range)
