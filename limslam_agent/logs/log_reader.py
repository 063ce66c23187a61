"""Opens a recorded log of any supported format."""

from collections.abc import Sequence
from pathlib import PurePath

from limslam_agent.logs.carmen import read_carmen
from limslam_agent.logs.csv_log import is_csv, read_csv
from limslam_agent.logs.headings import with_heading_beside_wheels
from limslam_agent.logs.pose_log import DEFAULT_MAX_RANGE
from limslam_agent.logs.recorded_log import (
    ZIP_MAGIC,
    FilePath,
    RecordedLog,
    first_bytes,
    naming,
    read_npz,
)
from limslam_agent.logs.ros_bag import is_bag
from limslam_agent.logs.ros_log import read_ros
from limslam_agent.logs.ros_topics import Topics
from limslam_agent.logs.table_options import TableOptions

_TEXT_ENDINGS = (".csv", ".csv.gz")
_SPREADSHEETS = (".xlsx", ".xls", ".ods")
_SPREADSHEET_MAGICS = (ZIP_MAGIC, b"\xd0\xcf\x11\xe0")


def read_log(
    path: FilePath,
    beams_deg: Sequence[float] | None = None,
    max_range: float | None = None,
    topics: Topics | None = None,
    table: TableOptions | None = None,
    missing: str = "auto",
) -> RecordedLog:
    r"""Read a log. The format is recognised by content: ``log.npz``, a ROS bag, a text table, or a
    CARMEN log.

    Parameters
    ----------
    path
        The log. A ROS 2 bag is a folder.
    beams_deg
        Directions of the beams to keep, deg. None keeps all beams if there are at most 16, and
        otherwise the beams that are nearest to six usual directions. The beams of a ``log.npz``
        are fixed.
    max_range
        Longest reading that is used, m. 3 m by default, or the beams' own maximum where ``table``
        names a robot. The ranges of a ``log.npz`` are fixed.
    topics
        Topics of a bag, if they cannot be found by their types.
    table
        The robot that recorded a table, and the units of its columns. Other logs take no such
        options.
    missing
        What missing ranges (NaN, negative, 0 or 65535 in the unit of the log) mean: ``nothing``
        was seen, ``not-measured``, or ``auto``, what the log itself says.

    Returns
    -------
    RecordedLog
        One event for each row, line or scan.

    Raises
    ------
    LogError
        If the file cannot be used, or a choice does not apply to its format.
    ValueError
        If ``missing`` is unknown.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from limslam_agent import read_log
    >>> rows = [f"{0.1 * i},{0.02 * i},0.0,0.0,0.8,1.1,0.9" for i in range(60)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = Path(folder) / "drive.csv"
    ...     _ = table.write_text("t,x,y,theta,r_90,r_0,r_-90\n" + "\n".join(rows))
    ...     log = read_log(table)
    >>> len(log), log.robot.max_ranges.tolist()
    (60, [3.0, 3.0, 3.0])
    """
    with naming(path):
        log = _as_reported(path, beams_deg, max_range, topics, table)
    return log if missing == "auto" else log.taken(missing)


def _as_reported(
    path: FilePath,
    beams_deg: Sequence[float] | None,
    max_range: float | None,
    topics: Topics | None,
    table: TableOptions | None,
) -> RecordedLog:
    place = PurePath(path)
    reach = DEFAULT_MAX_RANGE if max_range is None else max_range
    if is_bag(path):
        _refuse_options(table)
        return read_ros(path, beams_deg, reach, topics)
    # Programs also give these endings to plain text.
    is_spreadsheet = place.suffix.lower() in _SPREADSHEETS
    if is_spreadsheet and first_bytes(path, 4) in _SPREADSHEET_MAGICS:
        raise ValueError("is a spreadsheet, which must be saved as CSV in UTF-8")
    if topics:
        raise ValueError("is not a ROS bag, so topics cannot be chosen")
    if first_bytes(path, len(ZIP_MAGIC)) == ZIP_MAGIC or place.suffix == ".npz":
        if beams_deg is not None or max_range is not None:
            chosen = "beams" if beams_deg is not None else "largest range"
            raise ValueError(f"the log fixes its {chosen}, which cannot be chosen")
        log = with_heading_beside_wheels(read_npz(path))
        _refuse_options(table)
        return log
    has_names = table is not None and bool(table.columns)
    if place.name.endswith(_TEXT_ENDINGS) or has_names or is_csv(path):
        return read_csv(path, beams_deg, max_range, table)
    _refuse_options(table, "has no table, which has a header and rows of numbers")
    return read_carmen(path, beams_deg, reach)


def _refuse_options(table: TableOptions | None, fact: str = "is not a table in plain text") -> None:
    if table not in (None, TableOptions()):
        raise ValueError(f"{fact}, so --robot, units and --columns do not go with it")
