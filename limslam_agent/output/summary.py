"""The figures of a finished run or replay for its ``result.json``, and in a few lines of text for
the command line.
"""

import math
import re
import sys
from collections.abc import Mapping, Sequence
from string import Formatter
from typing import Any

import numpy as np

from limslam_agent.output.finished_run import part_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.messages import counted

FEW_POINTS = 10.0
"""With fewer readings of walls in a metre of driving, many paths were wrong in each kind of
building.
"""
_SENSOR = {
    "delay_s": ("ranges are {:.2f} s later than the wheels", 1.0),
    "bias_m": ("ranges are {:.1f} cm too long", 100.0),
    "scale": ("ranges are {:.1f} % too long", 100.0),
    "scale_std": ("the map may be {:.1f} % too large or too small", 200.0),
    "noise_m": ("noise of {:.1f} cm", 100.0),
    "noise_growth_per_m": ("further noise of {:.1f} cm at 1 m", 100.0),
    "cone_rad": ("beams open by {:.0f} deg", math.degrees(2.0)),
    "wall_curvature_per_m": ("walls curve by {:.0f} deg a metre", math.degrees(1.0)),
}
_ONE = re.compile(r"(?<![\d.])1 (wall|step|collision)s\b")
_WALLS = "{landmarks} walls, F1 {wall_f1_aligned:.2f} at 10 cm when aligned"
_ODOMETRY = {
    "left": ("left wheel {:+.2f} +- {:.2f} %", 100.0),
    "right": ("right wheel {:+.2f} +- {:.2f} %", 100.0),
    "axle": ("axle {:+.2f} +- {:.2f} %", 100.0),
    "size": ("wheels {:+.2f} +- {:.2f} %", 100.0),
    "scale": ("turns {:+.2f} +- {:.2f} % of the heading", 100.0),
    "drift": ("drift of the heading {:+.3f} +- {:.3f} deg/s", math.degrees(1.0)),
}


def calibration_record(
    calibration: Mapping[str, float], covariance: FloatArray
) -> dict[str, float]:
    """For a ``result.json``: the constant errors of the odometry by their names, and their standard
    deviations.
    """
    stds = np.sqrt(np.diag(covariance)).tolist()
    return {
        **calibration,
        **{f"{part}_std": std for part, std in zip(calibration, stds, strict=True)},
    }


def record_of(
    time: FloatArray,
    paths: Sequence[FloatArray],
    odometry: Sequence[FloatArray],
    places: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """The ``record`` of a ``result.json``: how long it is, where odometry ended, and what happened
    to a robot that was lost.

    The driven distance is measured along ``paths``, poses (n, 3) of each robot: the true ones where
    they are known.
    """
    driven = [float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()) for poses in paths]
    ends = [
        [float(x), float(y), float(np.degrees(heading))]
        for x, y, heading in (poses[-1] for poses in odometry)
    ]
    return {
        "steps": len(time),
        "duration_s": float(np.ptp(time)),
        "driven_m": float(np.mean(driven)),
        "odometry_end": ends,
        "places": [
            {**each, "time_s": float(time[min(each["step"], len(time) - 1)] - time[0])}
            for each in sorted(places, key=lambda place: place["step"])
        ],
    }


def sensor_record(
    sensor: RangeSensor | None, turns: FloatArray | None, range_std: float, robot: RobotSpec
) -> dict[str, Any]:
    """For a ``result.json``: what was found about a sensor, against one with a standard deviation
    of the ranges, m, and by what each beam is turned to the left, with its standard deviation
    (n_beams, 2), rad.
    """
    specified = RangeSensor(range_std, cone=robot.cone)
    rows = () if turns is None else np.degrees(turns).tolist()
    return {
        "sensor": sensor and sensor.found(specified, robot.control_period),
        "beam_turns": [{"deg": turn, "std_deg": std} for turn, std in rows],
    }


def run_cost(duration: float, wall_clock: float, **step_ms: FloatArray) -> dict[str, float]:
    """Values for ``cost`` in a ``result.json``, from the time that passed in the run or in its log,
    s, the time that computing took, s, and the times that each named part of a step took (n,), ms.
    """
    parts = {
        f"{name}_ms_{label}": float(np.percentile(values, share))
        for name, values in step_ms.items()
        for label, share in (("median", 50.0), ("p99", 99.0))
    }
    return {
        **parts,
        "speed_x_real_time": duration / wall_clock,
        "wall_clock_s": wall_clock,
        **peak_memory(),
    }


def peak_memory() -> dict[str, float]:
    """The most memory that this process has had, MB. Windows does not tell it in this way."""
    if sys.platform == "win32":
        return {}
    import resource

    # Linux counts kilobytes, macOS bytes.
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return {"peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit}


def record_summary(result: Mapping[str, Any]) -> list[str]:
    """Lines about what was done and how, from a ``result.json``. Missing values are left out."""
    config = part_of(result, "config")
    record = part_of(result, "record")
    agent = part_of(config, "agent")
    preset = config.get("preset") or agent.get("preset")
    beams = part_of(config, "robot").get("beams")
    noise = part_of(agent, "noise").get("range_std")
    method = [
        " ".join(str(each) for each in (preset, config.get("ablation")) if each),
        counted(len(beams), "beam") if isinstance(beams, list | tuple) else "",
        f"range noise of {100.0 * noise:g} cm assumed" if isinstance(noise, int | float) else "",
    ]
    lines = [f"method      {', '.join(filter(None, method))}"] if any(method) else []
    each = " by each robot" if _has(config, "robots") and config["robots"] > 1 else ""
    lines += _line(
        "record", "{steps} steps, {duration_s:.1f} s, {driven_m:.1f} m driven" + each, record
    )
    places = record.get("places")
    known = [each for each in places if _has(each, "time_s")] if isinstance(places, list) else []
    lines += _listed("place", [_event(str(each.get("event")), each) for each in known])
    calibrations = record.get("calibration")
    for errors in calibrations if isinstance(calibrations, list) else ():
        words = [
            text.format(scale * errors[part], scale * errors[f"{part}_std"])
            for part, (text, scale) in _ODOMETRY.items()
            if _has(errors, part, f"{part}_std")
        ]
        if errors:
            lines += _listed("calibrated", words or ["by unknown sizes"])
    if part_of(result, "metrics").get("status") != "lost":
        names = [
            f"the beam at {math.degrees(beam['angle']):.4g} deg" if _has(beam, "angle") else ""
            for beam in (beams if isinstance(beams, list | tuple) else ())
        ]
        lines += _sensor(part_of(record, "sensor"), names)
        lines += _turned(record.get("beam_turns"), names)
    return lines


def _event(event: str, details: Mapping[str, Any]) -> str:
    """An event of a robot that was lost or searched for its place, in words."""
    if event == "not joined":
        where = "the map of the second robot is in map_unplaced.json, in its own frame"
        return f"not joined: {details.get('reason')}; {where}"
    start: Any = details.get("start")
    is_pose = isinstance(start, list) and _has(dict(enumerate(start)), 0, 1, 2)
    if event == "joined" and "reason" in details and is_pose:
        x, y, heading = start[:3]
        where = f"x {x:.2f} m, y {y:.2f} m, heading {np.degrees(heading):.1f} deg"
        return f"joined: {details['reason']}; the second log begins at {where}"
    if not event.startswith("not found"):
        return f"{event} at {details['time_s']:.1f} s"
    own_frame = f": {details.get('reason')}; the results are in the run's own frame"
    return event + (own_frame if "saved map" in event else " again")


def _sensor(found: Mapping[str, Any], beams: Sequence[str]) -> list[str]:
    """What was found about a sensor that is not as specified, as ``RangeSensor.found`` has it."""
    words = [
        text.format(scale * found[name])
        for name, (text, scale) in _SENSOR.items()
        if _has(found, name)
    ]
    broken = found.get("broken_beams")
    for number, beam in enumerate(beams):
        if isinstance(broken, list) and number in broken and beam:
            words.append(f"{beam} always reads the same and is left out")
    return _listed("sensor", words)


def _turned(turns: Any, beams: Sequence[str]) -> list[str]:
    """Which of a robot's beams are turned against its settings by more than chance, as
    :func:`sensor_record` has it.
    """
    sure = [
        f"{beam} by {abs(turn['deg']):.1f} +- {turn['std_deg']:.1f} deg"
        f" to the {'left' if turn['deg'] > 0.0 else 'right'}"
        for beam, turn in zip(beams, turns if isinstance(turns, list) else (), strict=False)
        if beam and _has(turn, "deg", "std_deg") and abs(turn["deg"]) > 3.0 * turn["std_deg"]
    ]
    return [f"{line}, against the robot's settings" for line in _listed("turned", sure)]


def run_summary(metrics: Mapping[str, Any], cost: Mapping[str, Any]) -> list[str]:
    """Lines about a run, from the ``metrics`` and the ``cost`` of its ``result.json``. Missing
    values are left out.
    """
    lines = [f"stopped     {metrics.get('stop_reason', 'for an unknown reason')}"]
    lines += _line("", "after {exploration_time_s:.1f} s and {path_m:.1f} m", metrics)
    seen = "{coverage_true:.1%} of what can be seen, {collisions:g} collisions"
    lines += _line("covered", seen, metrics)
    lines += _status(metrics) + _errors(metrics)
    if limit := _line(
        "limit",
        "{limit_ate_m:.3f} m rms, the least-squares solution with known associations",
        metrics,
    ):
        smoothed = _with(", smoothed is {smoothed_over_limit:.1f} times that", metrics)
        lines += limit + _line(
            "", "the error is {ate_over_limit:.1f} times that" + smoothed, metrics
        )
    before = _with("; {wall_f1_aligned_online:.2f} before smoothing", metrics)
    lines += _line("map", _WALLS + before, metrics)
    return lines + _line("speed", "{speed_x_real_time:.0f} x real time", cost)


def replay_summary(metrics: Mapping[str, Any]) -> list[str]:
    """Lines about a replay, from the ``metrics`` of its ``result.json``. Missing values are left
    out.
    """
    lines = _status(metrics) + _smoothed_status(metrics) + _errors(metrics)
    lines += _line(
        "",
        "the online graph took over from the filter after {online_graph_from_s:.0f} s",
        metrics,
    )
    trajectories = {
        "smoothed_": "smoothed, at the end",
        "smoothed_between_": "between the logs",
        "": "filter, while driving"
        if metrics.get("online_graph_from_s") is None
        else "while driving",
        "odometry_": "odometry, corrected",
        "raw_odometry_": "odometry, raw",
    }
    texts = {
        prefix: _relation_text(metrics, prefix)
        for prefix in trajectories
        if _has(metrics, f"{prefix}relation_error_m", f"{prefix}relation_error_deg")
    }
    # Without a correction both are the same path.
    if texts.get("odometry_") == texts.get("raw_odometry_"):
        texts.pop("odometry_", None)
    lines += [f"relations   {trajectories[prefix]:21}{text}" for prefix, text in texts.items()]
    return lines + (_line("map", _WALLS, metrics) or _line("map", "{landmarks} walls", metrics))


def _status(metrics: Mapping[str, Any]) -> list[str]:
    """The status at the end, and how long the estimate had each status if there were several."""
    level = metrics.get("status")
    if not isinstance(level, str):
        return []
    reason = metrics.get("status_reason")
    note = metrics.get("status_note")
    why = f": {reason}" if reason else ""
    times = {
        name: metrics[f"{name}_s"]
        for name in ("ok", "unsure", "lost")
        if _has(metrics, f"{name}_s") and metrics[f"{name}_s"] > 0.0
    }
    words = ", ".join(f"{name} for {seconds:.0f} s" for name, seconds in times.items())
    spent = "" if list(times) == ["ok"] else words
    if isinstance(note, str):
        # A smoothed path can be right where the filter was lost.
        return [f"status      {level}{why}{f'; {note}' if note else ''}"]
    if not any("smoothed" in name for name in metrics):
        return [f"status      {level}{why}{f'; {spent}' if spent else ''}"]
    if not spent:
        return [f"status      {level} while driving{why}"]
    return [f"status      while driving {spent}{f'; at its end {level}{why}' if why else ''}"]


def _smoothed_status(metrics: Mapping[str, Any]) -> list[str]:
    """Whether the smoothed path can be trusted, and how far the robot drove backwards although
    odometry reports driving ahead.
    """
    level = metrics.get("smoothed_status")
    lines = []
    if isinstance(level, str):
        reason = metrics.get("smoothed_status_reason")
        lines += _listed("", [f"{level} at the end{f': {reason}' if reason else ''}"])
        if metrics.get("smoothed_kind") == "odometry":
            path = "the path is that of odometry, which the readings do not make better"
            lines += _listed("", [path])
        few = f"with fewer than {FEW_POINTS:.0f}, paths were often wrong"
        points = "{smoothed_points_per_m:.1f} readings of walls in a metre of driving: " + few
        if _has(metrics, "smoothed_points_per_m") and metrics["smoothed_points_per_m"] < FEW_POINTS:
            lines += _line("", points, metrics)
    if _has(metrics, "smoothed_reversed_places") and metrics["smoothed_reversed_places"]:
        where = counted(metrics["smoothed_reversed_places"], "place")
        ahead = f" m at {where}, which odometry reports as driven ahead"
        lines += _line("", "driven backwards over {smoothed_reversed_m:.1f}" + ahead, metrics)
    return lines


def _errors(metrics: Mapping[str, Any]) -> list[str]:
    lines = _line("error", "{ate_m:.3f} m rms; by odometry alone {odometry_ate_m:.3f} m", metrics)
    if not lines:
        return _line("error", "{ate_aligned_m:.3f} m rms when aligned", metrics)
    smoothed = _with(", smoothed {anees_smoothed:.2g}", metrics)
    lines += _line(
        "consistency",
        f"NEES / 3 is {{anees:.2g}}{smoothed}; 1 is right, more is overconfident",
        metrics,
    )
    return lines + _line(
        "smoothed", "{ate_smoothed_m:.3f} m rms, by all that was known at the end", metrics
    )


def _relation_text(metrics: Mapping[str, Any], prefix: str) -> str:
    every, loops = (f"{prefix}{part}relation_error" for part in ("", "loop_"))
    text = f"{metrics[every + '_m']:7.3f} m {metrics[every + '_deg']:6.2f} deg"
    if not _has(metrics, f"{loops}_m", f"{loops}_deg"):
        return text
    return text + f"   loops {metrics[loops + '_m']:7.3f} m {metrics[loops + '_deg']:6.2f} deg"


def _line(title: str, text: str, numbers: Mapping[str, Any]) -> list[str]:
    """A line with numbers by their names, if all of them are there."""
    words = _with(text, numbers)
    return _listed(title, [words] if words else [])


def _listed(title: str, words: Sequence[str]) -> list[str]:
    """A line with a list, if there is anything in it."""
    return [f"{title:12}{', '.join(words)}"] if words else []


def _with(text: str, numbers: Mapping[str, Any]) -> str:
    """A text with numbers by their names, in which 1 has a singular; empty if one is missing."""
    names = [name for _, name, _, _ in Formatter().parse(text) if name]
    return _ONE.sub(r"1 \1", text.format_map(numbers)) if _has(numbers, *names) else ""


def _has(numbers: Any, *names: object) -> bool:
    """Whether all names have numbers. The file may come from another version, or from an editor."""
    return isinstance(numbers, Mapping) and all(
        isinstance(numbers.get(name), int | float) for name in names
    )
