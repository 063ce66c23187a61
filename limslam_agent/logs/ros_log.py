"""ROS 1 bags, ROS 2 bags and MCAP files: ranges and odometry, brought together by time."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import fspath
from typing import Any

import numpy as np

from limslam_agent.logs.pose_log import LARGEST_STEP_BACK, check_max_range, pose_log
from limslam_agent.logs.recorded_log import FilePath, LogError, RecordedLog
from limslam_agent.logs.ros_bag import Bag, Told, open_bag
from limslam_agent.logs.ros_messages import stamp_of
from limslam_agent.logs.ros_topics import Plan, Reader, Topics, plan_for
from limslam_env.geometry import FloatArray

# What a message can do that is not what its type says.
_MISSHAPEN = (ValueError, TypeError, AttributeError, IndexError, OverflowError)


@dataclass(frozen=True, eq=False)
class Stream:
    """What one reader took out of a bag: ``values`` (n, k) at times (n,), s, by the messages' stamps and by the bag."""

    topic: str
    stamps: FloatArray
    bag_times: FloatArray
    values: FloatArray


def read_ros(
    path: FilePath, beams_deg: Sequence[float] | None, max_range: float, topics: Topics | None = None
) -> RecordedLog:
    """Read a bag: one event for each scan, with the odometry at that time.

    Parameters
    ----------
    path
        A ``.bag``, a ROS 2 bag's folder, or a single ``.mcap`` or ``.db3`` file.
    beams_deg
        Directions to choose out of its beams, deg; None takes all of up to 16 beams, and six of more.
    max_range
        Longest reading that is used, m; a longer one is "nothing seen".
    topics
        Topics to use; those left out are found by their types.

    Returns
    -------
    RecordedLog
        At the times in the messages' headers, or the bag's where a header has none or the topics' clocks differ.
        Odometry is interpolated. Sensors that measure apart are brought together at the times of the slowest.

    Raises
    ------
    LogError
        If the bag cannot be read, is cut short or damaged; if its topics do not tell what to use; if they hold
        something that is no number where one is needed, step back in time, or do not meet in time.
    """
    with open_bag(path) as bag:
        try:
            check_max_range(max_range)
            plan = plan_for(bag, topics or Topics(), beams_deg, max_range)
            streams = _read(bag, [*plan.scans, *plan.moves])
            return _merge(plan, _on_one_clock(streams))
        except LogError:
            raise
        except _MISSHAPEN as error:
            raise LogError(f"{fspath(path)}: {error}") from error


def _read(bag: Bag, readers: list[Reader]) -> list[Stream]:
    rows: list[list[Any]] = [[] for _ in readers]
    times: list[list[tuple[float, float]]] = [[] for _ in readers]
    for told in bag.messages({reader.topic for reader in readers}):
        for reader, row, time in zip(readers, rows, times, strict=True):
            if reader.topic == told.topic:
                row.append(_values(reader, told, len(row)))
                time.append((stamp_of(told.content), told.bag_time))
    for reader, row in zip(readers, rows, strict=True):
        if not row:
            raise ValueError(f"the topic {reader.topic} is empty")
    tables = [np.array(time, dtype=np.float64) for time in times]
    return [
        Stream(reader.topic, table[:, 0], table[:, 1], np.array(row, dtype=np.float64))
        for reader, row, table in zip(readers, rows, tables, strict=True)
    ]


def _values(reader: Reader, told: Told, number: int) -> Any:
    try:
        return reader.read(told.content)
    except _MISSHAPEN as error:
        raise ValueError(f"{reader.topic}: message {number + 1}: {error}") from error


def _on_one_clock(streams: list[Stream]) -> list[tuple[FloatArray, FloatArray]]:
    """Times (n,) and values (n, k) of each stream, in the order of the times."""
    stamped = all((stream.stamps > 0.0).all() for stream in streams)
    first = max(stream.stamps.min() for stream in streams)
    last = min(stream.stamps.max() for stream in streams)
    # Stamps of two machines, or of one that began at zero, say nothing about each other.
    by_stamp = stamped and first <= last
    ordered = []
    for stream in streams:
        times = stream.stamps if by_stamp else stream.bag_times
        steps = np.diff(times)
        if len(steps) and steps.min() < -LARGEST_STEP_BACK:
            row = int(np.argmin(steps)) + 2
            raise ValueError(f"{stream.topic}: message {row}: the time steps back by {-steps.min():.1f} s")
        order = np.argsort(times, kind="stable")
        ordered.append((times[order], stream.values[order]))
    return ordered


def _merge(plan: Plan, streams: list[tuple[FloatArray, FloatArray]]) -> RecordedLog:
    scans, moves = streams[: len(plan.scans)], streams[len(plan.scans) :]
    time, ranges = _together(plan, scans)
    begin, end = max(times[0] for times, _ in moves), min(times[-1] for times, _ in moves)
    inside = (time >= begin) & (time <= end)
    if not inside.any():
        when = f"ranges from {time[0]:.3f} to {time[-1]:.3f} s, odometry from {begin:.3f} to {end:.3f} s"
        raise ValueError(f"ranges and odometry do not meet in time: {when}")
    time, ranges = time[inside], ranges[inside]
    heading = moves[-1][1]
    heading[:, -1] = np.unwrap(heading[:, -1])
    columns = [np.interp(time, times, column) for times, values in moves for column in values.T]
    return pose_log(plan.beams, time, np.column_stack(columns), ranges, np.ones(len(time), dtype=np.bool_))


def _together(plan: Plan, scans: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Times (n,) of the slowest sensor, and all readings (n, n_beams) that belong to them.

    Of every other sensor the reading nearest in time is taken, if it is no further off than half of the
    slowest one's period. Events at which one is missing are left out.
    """
    time, _ = min(scans, key=lambda scan: len(scan[0]))
    apart = 0.5 * float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    whole = np.ones(len(time), dtype=np.bool_)
    parts = []
    for reader, (times, values) in zip(plan.scans, scans, strict=True):
        nearest = _nearest(times, time)
        met = np.abs(times[nearest] - time) <= apart + 1e-6
        if 2 * np.count_nonzero(met) < len(time):
            raise ValueError(f"{reader.topic} is silent most of the time that others measure: leave it out")
        whole &= met
        parts.append(values[nearest])
    if not whole.any():
        raise ValueError("the sensors never measure together")
    return time[whole], np.column_stack(parts)[whole][:, plan.columns]


def _nearest(times: FloatArray, wanted: FloatArray) -> Any:
    """Indices (n,) of the sorted times nearest to the wanted ones."""
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    return np.where(np.abs(times[after] - wanted) < np.abs(times[before] - wanted), after, before)
