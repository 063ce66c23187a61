"""Reads ROS 1 bags, ROS 2 bags and MCAP files, and synchronises ranges and odometry by time."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from limslam_agent.logs.odometry_breaks import OdometryStream
from limslam_agent.logs.pose_log import LARGEST_STEP_BACK, check_max_range, pose_log
from limslam_agent.logs.recorded_log import FilePath, RecordedLog, naming
from limslam_agent.logs.ros_bag import Bag, open_bag
from limslam_agent.logs.ros_topics import Plan, Reader, Topics, plan_for
from limslam_env.geometry import FloatArray

# Errors of a message whose content does not match its type.
_MISSHAPEN = (ValueError, TypeError, AttributeError, IndexError, OverflowError)

Stream = tuple[FloatArray, FloatArray]
"""Times (n,), s, and values (n, k) at these times."""


def read_ros(
    path: FilePath,
    beams_deg: Sequence[float] | None,
    max_range: float,
    topics: Topics | None = None,
) -> RecordedLog:
    """Read a bag. Each scan becomes one event with the odometry at the time of the scan.

    The parameters are those of `limslam_agent.logs.log_reader.read_log`. ``path`` is a ``.bag``,
    the folder of a ROS 2 bag, or a single ``.mcap`` or ``.db3`` file.

    The times are those of the message headers. They are those of the bag if a header has no time or
    the clocks of the topics differ. Odometry is interpolated. Sensors with different periods are
    combined at the times of the slowest sensor. Raises a LogError if the bag cannot be read, is cut
    short or damaged; if it is unclear which topics to use; if a topic holds something other than a
    number where one is needed, its times step back, or the times of the topics do not overlap.
    """
    with open_bag(path) as bag, naming(path, _MISSHAPEN):
        check_max_range(max_range)
        plan = plan_for(bag, topics or {}, beams_deg, max_range)
        readers = [*(reader for reader, _ in plan.scans), *plan.moves]
        return _merge(plan, _on_one_clock(readers, _read(bag, readers)))


def _read(bag: Bag, readers: list[Reader]) -> list[FloatArray]:
    """A table for each reader: the times of the bag, s, the stamps of the messages, and what the
    reader reads.
    """
    rows: list[list[Any]] = [[] for _ in readers]
    for message in bag.messages({reader.topic for reader in readers}):
        for reader, row in zip(readers, rows, strict=True):
            if reader.topic != message.topic:
                continue
            try:
                values = reader.read(message.content)
                if values is not None:
                    row.append([message.bag_time, *map(float, values)])
            except _MISSHAPEN as error:
                raise ValueError(f"{reader.topic}: message {len(row) + 1}: {error}") from error
    for reader, row in zip(readers, rows, strict=True):
        if not row:
            raise ValueError(f"the topic {reader.topic} is empty")
    return [np.array(row) for row in rows]


def _on_one_clock(readers: list[Reader], tables: list[FloatArray]) -> list[Stream]:
    """Times and values of each reader, sorted by time."""
    stamps = [table[:, 1] for table in tables]
    is_stamped = all((each > 0.0).all() for each in stamps)
    # Stamps of two machines, or of a clock that began at zero, cannot be compared.
    overlap = max(each.min() for each in stamps) <= min(each.max() for each in stamps)
    clock = int(is_stamped and overlap)
    ordered = []
    for reader, table in zip(readers, tables, strict=True):
        steps = np.diff(table[:, clock])
        if len(steps) and steps.min() < -LARGEST_STEP_BACK:
            row = int(np.argmin(steps)) + 2
            raise ValueError(
                f"{reader.topic}: message {row}: the time steps back by {-steps.min():.1f} s"
            )
        order = np.argsort(table[:, clock], kind="stable")
        ordered.append((table[order, clock], table[order, 2:]))
    return ordered


def _merge(plan: Plan, streams: list[Stream]) -> RecordedLog:
    moves = streams[len(plan.scans) :]
    time, ranges = _together(plan, streams[: len(plan.scans)])
    begin = max(times[0] for times, _ in moves)
    end = min(times[-1] for times, _ in moves)
    is_inside = (time >= begin) & (time <= end)
    if not is_inside.any():
        raise ValueError(
            "the times of ranges and odometry do not overlap: ranges from "
            f"{time[0]:.3f} to {time[-1]:.3f} s, odometry from {begin:.3f} to {end:.3f} s"
        )
    time = time[is_inside]
    ranges = ranges[is_inside]
    heading = moves[-1][1]
    heading[:, -1] = np.unwrap(heading[:, -1])
    times = min((times for times, _ in moves), key=len)
    stream = OdometryStream(times, _poses_at(moves, times))
    odometry = stream.at(time) if len(moves) == 1 else _poses_at(moves, time)
    silent = stream.silent_times(time, ranges)
    kept = ~silent.hold(time)
    if not kept.any():
        raise ValueError("has no odometry at the times of its ranges")
    return pose_log(
        plan.beams,
        time[kept],
        odometry[kept],
        notes=(*stream.notes, *silent.notes(time)),
        ranges=ranges[kept],
        has_scan=np.ones(int(kept.sum()), dtype=np.bool_),
        gaps=tuple(silent.events_after(time[kept])),
    )


def _poses_at(moves: list[Stream], time: FloatArray) -> FloatArray:
    """Odometry (n, 3) at times (n,), s, by linear interpolation. Headings do not jump."""
    columns = [np.interp(time, times, column) for times, values in moves for column in values.T]
    return np.column_stack(columns)


def _together(plan: Plan, scans: list[Stream]) -> Stream:
    """Times of the slowest sensor (n,), and all readings at these times (n, n_beams).

    Of each other sensor the reading nearest in time is taken, at most half a period of the slowest
    sensor away. Events without a reading of every sensor are left out.
    """
    time, _ = min(scans, key=lambda scan: len(scan[0]))
    apart = 0.5 * float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    is_whole = np.ones(len(time), dtype=np.bool_)
    ranges = np.zeros((len(time), len(plan.beams)))
    for (reader, places), (times, values) in zip(plan.scans, scans, strict=True):
        nearest = _nearest(times, time)
        is_met = np.abs(times[nearest] - time) <= apart + 1e-6
        if 2 * np.count_nonzero(is_met) < len(time):
            raise ValueError(f"{reader.topic} has no messages for most of the time: leave it out")
        is_whole &= is_met
        ranges[:, places] = values[nearest]
    if not is_whole.any():
        raise ValueError("the sensors have no common times")
    return time[is_whole], ranges[is_whole]


def _nearest(times: FloatArray, wanted: FloatArray) -> Any:
    """Indices (n,) of the sorted times that are nearest to the wanted times."""
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    return np.where(np.abs(times[after] - wanted) < np.abs(times[before] - wanted), after, before)
