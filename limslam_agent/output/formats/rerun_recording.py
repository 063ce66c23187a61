"""Writes a run as a recording for the Rerun viewer. rerun-sdk is an extra, imported when it is needed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.output.finished_run import heading_error, heading_std, position_error, position_std
from limslam_agent.output.formats.content import ExportedRun
from limslam_agent.output.formats.ros_builder import cells_of
from limslam_agent.output.style import LEFT, ROBOTS, WALL, Colour
from limslam_env.geometry import FloatArray
from limslam_env.geometry.shapes import ellipse

_COLOURS: dict[str, Colour] = {
    "true": (120, 126, 136), "estimated": ROBOTS[0], "smoothed": ROBOTS[1], "odometry": LEFT
}  # fmt: skip
_ARROW = 0.2  # m, length of the arrow that shows a robot
_CORNERS = 24  # of the ellipse of 95 % around a position
_EPOCH = 1e8  # s; a log whose times are larger than this has seconds since 1970


def write_rerun(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write ``run.rrd``: map, paths, poses, readings and errors over time, and a layout of the viewer (blueprint).

    Raises
    ------
    ValueError
        If rerun-sdk is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise ValueError("a .rrd is written with rerun-sdk: pip install 'limslam[rerun]'") from error
    path = folder / "run.rrd"
    stream = rerun.RecordingStream("limslam")
    stream.save(path, default_blueprint=_blueprint(exported))
    stream.send_recording_name(exported.run.title)
    recording = _Recording(rerun, stream, exported)
    recording.write_map()
    for number, prefix in _robots(exported):
        recording.write_robot(number, prefix)
    stream.disconnect()
    return [path]


def _robots(exported: ExportedRun) -> Iterator[tuple[int, str]]:
    """The number of each robot, and the first part of the names of what is known of it."""
    robots = len(exported.run.estimated)
    return ((number, f"robot_{number}" if robots > 1 else "robot") for number in range(robots))


def _blueprint(exported: ExportedRun) -> Any:
    """The map seen from above, and beside it a view of the errors and one of the readings of each robot."""
    from rerun import blueprint

    points = np.vstack([exported.run.segments.reshape(-1, 2), *(poses[:, :2] for poses in exported.run.estimated)])
    x, y = (points.min(axis=0) + points.max(axis=0)) / 2.0
    height = 1.2 * float(np.ptp(points, axis=0).max()) + 1.0
    above = blueprint.EyeControls3D(position=(x, y, height), look_target=(x, y, 0.0), eye_up=(0.0, 1.0, 0.0))
    plan = blueprint.Spatial3DView(origin="map", name="Map, m", eye_controls=above)
    plots = [("ranges", "Ranges, m")] if exported.readings is not None else []
    if exported.run.true:
        plots = [("position_error", "Error of the position, m"), ("heading_error", "Error of the heading, deg"), *plots]
    beside = [
        blueprint.TimeSeriesView(origin=f"plots/{prefix}/{part}", name=name)
        for _, prefix in _robots(exported)
        for part, name in plots
    ]
    layout = blueprint.Horizontal(plan, blueprint.Vertical(*beside)) if beside else plan
    return blueprint.Blueprint(layout, blueprint.TimePanel(timeline="time", state="collapsed"), collapse_panels=True)


class _Recording:
    """Writes the parts of a run to a stream of Rerun.

    What is known at the end, the map and the paths, is static: the viewer shows it at all times. Poses, readings and
    errors belong to the timeline ``time``. The plane of the map is z = 0, with y to the top.
    """

    def __init__(self, rerun: Any, stream: Any, exported: ExportedRun) -> None:
        self._rr, self._stream, self._exported = rerun, stream, exported
        time = exported.run.time
        self._time = [rerun.TimeColumn("time", **{"timestamp" if time[0] > _EPOCH else "duration": time})]

    def write_map(self) -> None:
        """Write the walls and the occupancy grid."""
        self._lines("map/walls", _raised(self._exported.run.segments.reshape(-1, 2, 2)), WALL)
        grid = self._exported.grid
        if grid is None:
            return
        rows, columns = grid.values.shape
        size = self._rr.components.ImageFormat(width=columns, height=rows, color_model="L", channel_datatype="U8")
        place, colours = (*grid.low.tolist(), -0.01), self._rr.components.Colormap.RvizMap
        # The first row of an image is its highest one.
        cells = np.ascontiguousarray(cells_of(grid)[::-1]).tobytes()
        picture = self._rr.GridMap(data=cells, format=size, cell_size=grid.cell, translation=place, colormap=colours)
        self._stream.log("map/grid", picture, static=True)

    def write_robot(self, number: int, prefix: str) -> None:
        """Write the paths, the poses over time, the readings and the errors of a robot."""
        for kind, poses in self._exported.paths().items():
            self._lines(f"map/{prefix}/path/{kind}", [_raised(poses[number][:, :2])], _COLOURS[kind])
            self._pose(f"map/{prefix}/{kind}", poses[number], _COLOURS[kind])
        run = self._exported.run
        for kind, estimated, covariances in (
            ("estimated", run.estimated, run.covariances), ("smoothed", run.smoothed, run.smoothed_covariances)
        ):  # fmt: skip
            if covariances:
                self._ellipses(f"map/{prefix}/uncertainty/{kind}", estimated[number], covariances[number], kind)
                self._bounds(f"plots/{prefix}", covariances[number], kind)
            if estimated and run.true:
                self._errors(f"plots/{prefix}", estimated[number], run.true[number], kind)
        self._readings(number, prefix)

    def _pose(self, entity: str, poses: FloatArray, colour: Colour) -> None:
        half, nothing = 0.5 * poses[:, 2], np.zeros(len(poses))
        turns = np.column_stack((nothing, nothing, np.sin(half), np.cos(half)))
        columns = self._rr.Transform3D.columns(translation=_raised(poses[:, :2]), quaternion=turns)
        self._stream.send_columns(entity, self._time, columns)
        arrow = self._rr.Arrows3D(vectors=[[_ARROW, 0.0, 0.0]], colors=[colour])
        self._stream.log(entity, arrow, static=True)

    def _ellipses(self, entity: str, poses: FloatArray, covariances: FloatArray, kind: str) -> None:
        shapes = np.array([ellipse(each[:2, :2].astype(float), _CORNERS) for each in covariances])
        rings = poses[:, None, :2] + np.concatenate((shapes, shapes[:, :1]), axis=1)
        self._stream.send_columns(entity, self._time, self._rr.LineStrips3D.columns(strips=_raised(rings)))
        self._stream.log(entity, self._rr.LineStrips3D.from_fields(colors=[_COLOURS[kind]]), static=True)

    def _bounds(self, entity: str, covariances: FloatArray, kind: str) -> None:
        self._plot(f"{entity}/position_error/{kind}_2_sigma", 2.0 * position_std(covariances), kind)
        self._plot(f"{entity}/heading_error/{kind}_2_sigma", 2.0 * np.degrees(heading_std(covariances)), kind)

    def _errors(self, entity: str, poses: FloatArray, true: FloatArray, kind: str) -> None:
        self._plot(f"{entity}/position_error/{kind}", position_error(poses, true), kind)
        self._plot(f"{entity}/heading_error/{kind}", np.degrees(np.abs(heading_error(poses, true))), kind)

    def _readings(self, number: int, prefix: str) -> None:
        """The beams that saw something, in the frame of the estimated pose, and all ranges as plots."""
        readings = self._exported.readings
        if readings is None:
            return
        ranges, beams = readings.ranges[:, number], readings.robot.beams
        starts = np.array([(beam.x, beam.y) for beam in beams])
        angles = np.array([beam.angle for beam in beams])
        ends = starts + ranges[:, :, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        rays = _raised(np.stack((np.broadcast_to(starts, ends.shape), ends), axis=2))
        seen = ranges < np.array([beam.max_range for beam in beams], dtype=np.float32)
        entity = f"map/{prefix}/estimated/beams"
        strips = self._rr.LineStrips3D.columns(strips=rays[seen]).partition(seen.sum(axis=1))
        self._stream.send_columns(entity, self._time, strips)
        self._stream.log(entity, self._rr.LineStrips3D.from_fields(colors=[LEFT]), static=True)
        for index in range(len(beams)):
            self._plot(f"plots/{prefix}/ranges/beam_{index}", ranges[:, index])

    def _plot(self, entity: str, values: Any, kind: str | None = None) -> None:
        self._stream.send_columns(entity, self._time, self._rr.Scalars.columns(scalars=values))
        name = entity.rpartition("/")[2].replace("_", " ")
        # The bound of an error has the colour of the error, and a thinner line.
        width = 1.0 if name.endswith("sigma") else 2.0
        colours = {} if kind is None else {"colors": [_COLOURS[kind]]}
        self._stream.log(entity, self._rr.SeriesLines(names=[name], widths=[width], **colours), static=True)

    def _lines(self, entity: str, strips: Any, colour: Colour) -> None:
        self._stream.log(entity, self._rr.LineStrips3D(strips, colors=[colour]), static=True)


def _raised(points: FloatArray) -> FloatArray:
    """Points (..., 2) of the plane as points (..., 3) of space."""
    return np.concatenate((points, np.zeros((*points.shape[:-1], 1))), axis=-1)
