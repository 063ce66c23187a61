"""A finished run or replay in a few lines of text, for the command line."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from limslam_agent.output.finished_run import part_of
from limslam_env.geometry import FloatArray
from limslam_env.messages import counted

FEW_POINTS = 10.0
"""With fewer readings of walls in a metre of driving, many paths were wrong in each kind of building."""
_SENSOR = {
    "delay_s": ("ranges are {:.2f} s later than the wheels", 1.0),
    "bias_m": ("ranges are {:.1f} cm too long", 100.0),
    "noise_m": ("noise of {:.1f} cm", 100.0),
    "noise_growth_per_m": ("further noise of {:.1f} cm at 1 m", 100.0),
    "cone_rad": ("beams open by {:.0f} deg", math.degrees(2.0)),
}
_SIZES = {"left": "left wheel", "right": "right wheel", "axle": "axle"}


def calibration_record(calibration: Sequence[float], covariance: FloatArray) -> dict[str, float]:
    """For a ``result.json``: relative errors of left wheel, right wheel and axle, and their standard deviations."""
    pairs = zip(_SIZES, calibration, np.sqrt(np.diag(covariance)), strict=True)
    return {name: number for part, error, std in pairs for name, number in ((part, error), (f"{part}_std", float(std)))}


def turn_records(turns: FloatArray | None) -> list[dict[str, float]]:
    """For a ``result.json``: by what each beam is turned to the left, with its standard deviation (n_beams, 2), rad."""
    rows = () if turns is None else np.degrees(turns).tolist()
    return [{"deg": turn, "std_deg": std} for turn, std in rows]


def record_of(time: FloatArray, paths: Sequence[FloatArray], odometry: Sequence[FloatArray]) -> dict[str, Any]:
    """The ``record`` of a ``result.json``: how long it is, and where odometry ended.

    Parameters
    ----------
    time
        Times of the steps (n,), s.
    paths
        Poses (n, 3) of each robot along which the driven distance is measured: the true ones where they are known.
    odometry
        Poses (n, 3) of each robot by odometry alone.
    """
    driven = [float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()) for poses in paths]
    ends = [[float(x), float(y), float(np.degrees(heading))] for x, y, heading in (poses[-1] for poses in odometry)]
    return {
        "steps": len(time),
        "duration_s": float(np.ptp(time)),
        "driven_m": float(np.mean(driven)),
        "odometry_end": ends,
    }


def place_records(time: FloatArray, places: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What happened to a robot that was lost, with the time since the first of all steps (n,), s."""
    return [{**each, "time_s": float(time[min(each["step"], len(time) - 1)] - time[0])} for each in places]


def record_summary(result: Mapping[str, Any]) -> list[str]:
    """Lines about what was done and how, from a ``result.json``. Missing values are left out."""
    config, record = part_of(result, "config"), part_of(result, "record")
    agent = part_of(config, "agent")
    preset, beams = config.get("preset") or agent.get("preset"), part_of(config, "robot").get("beams")
    noise = part_of(agent, "noise").get("range_std")
    method = [
        " ".join(str(each) for each in (preset, config.get("ablation")) if each),
        f"{len(beams)} beams" if isinstance(beams, list | tuple) else "",
        f"range noise of {100.0 * noise:g} cm assumed" if isinstance(noise, int | float) else "",
    ]
    lines = [f"method      {', '.join(filter(None, method))}"] if any(method) else []
    if _has(record, "steps", "duration_s", "driven_m"):
        lasted = f"{record['steps']} steps, {record['duration_s']:.1f} s, {record['driven_m']:.1f} m driven"
        is_team = _has(config, "robots") and config["robots"] > 1
        lines.append(f"record      {lasted}{' by each robot' if is_team else ''}")
    lines += _places(record.get("places"))
    each = record.get("calibration")
    lines += [_calibration_line(found) for found in each if found] if isinstance(each, list) else []
    if part_of(result, "metrics").get("status") != "lost":
        lines += _sensor_line(record.get("sensor"), beams) + _turned_beams(record.get("beam_turns"), beams)
    return lines


def _places(events: Any) -> list[str]:
    """When the robot was lost, and when it found its place again."""
    known = [each for each in events if isinstance(each, dict)] if isinstance(events, list) else []
    words = [_event(str(each.get("event")), each) for each in known if _has(each, "time_s")]
    return [f"place       {', '.join(words)}"] if words else []


def _event(event: str, details: Mapping[str, Any]) -> str:
    """An event of a robot that was lost or searched for its place, in words."""
    if event == "not joined":
        where = "the map of the second robot is in map_unplaced.json, in its own frame"
        return f"not joined: {details.get('reason')}; {where}"
    start = _numbers(details.get("start"))
    if event == "joined" and "reason" in details and start is not None:
        where = f"x {start[0]:.2f} m, y {start[1]:.2f} m, heading {np.degrees(start[2]):.1f} deg"
        return f"joined: {details['reason']}; the second log begins at {where}"
    if not event.startswith("not found"):
        return f"{event} at {details['time_s']:.1f} s"
    own_frame = f": {details.get('reason')}; the results are in the run's own frame"
    return event + (own_frame if "saved map" in event else " again")


def _calibration_line(found: Any) -> str:
    """A robot's odometry calibration, as :func:`calibration_record` has it."""
    if not isinstance(found, dict) or not _has(found, *(f"{part}{end}" for part in _SIZES for end in ("", "_std"))):
        return "calibrated  by unknown sizes"
    sizes = [
        f"{name} {100.0 * found[part]:+.2f} +- {100.0 * found[f'{part}_std']:.2f} %" for part, name in _SIZES.items()
    ]
    return f"calibrated  {', '.join(sizes)}"


def _sensor_line(found: Any, beams: Any) -> list[str]:
    """What was found about a sensor that is not as specified, as ``RangeSensor.found`` has it."""
    if not isinstance(found, dict):
        return []
    words = [text.format(scale * found[name]) for name, (text, scale) in _SENSOR.items() if _has(found, name)]
    broken: Any = found.get("broken_beams")
    known = beams if isinstance(beams, list | tuple) else ()
    for number, beam in enumerate(known) if isinstance(broken, list) else ():
        if number in broken and isinstance(beam, dict) and _has(beam, "angle"):
            words += [f"the beam at {math.degrees(beam['angle']):.4g} deg always reads the same and is left out"]
    return [f"sensor      {', '.join(words)}"] if words else []


def _turned_beams(turns: Any, beams: Any) -> list[str]:
    """Which of a robot's beams are turned against its settings by more than chance, as :func:`turn_records` has it."""
    known = zip(beams, turns, strict=False) if isinstance(turns, list) and isinstance(beams, list | tuple) else ()
    sure = [
        f"the beam at {math.degrees(beam['angle']):.4g} deg by {abs(turn['deg']):.1f} +- {turn['std_deg']:.1f} deg"
        f" to the {'left' if turn['deg'] > 0.0 else 'right'}"
        for beam, turn in known
        if isinstance(beam, dict) and _has(beam, "angle") and isinstance(turn, dict)
        if _has(turn, "deg", "std_deg") and abs(turn["deg"]) > 3.0 * turn["std_deg"]
    ]
    return [f"turned      {', '.join(sure)}, against the robot's settings"] if sure else []


def _numbers(pose: Any) -> list[float] | None:
    """A pose as three numbers; None if it is something else."""
    is_pose = isinstance(pose, list) and len(pose) == 3 and all(isinstance(value, int | float) for value in pose)
    return pose if is_pose else None


def run_summary(metrics: Mapping[str, Any], cost: Mapping[str, Any]) -> list[str]:
    """Lines about a run, from the ``metrics`` and the ``cost`` of its ``result.json``. Missing values are left out."""
    lines = [f"stopped     {metrics.get('stop_reason', 'for an unknown reason')}"]
    if _has(metrics, "exploration_time_s", "path_m"):
        lines.append(f"            after {metrics['exploration_time_s']:.1f} s and {metrics['path_m']:.1f} m")
    if _has(metrics, "coverage_true", "collisions"):
        share, collisions = metrics["coverage_true"], metrics["collisions"]
        lines.append(
            f"covered     {share:.1%} of what can be seen, {collisions:g} collision{'' if collisions == 1 else 's'}"
        )
    lines += _status(metrics) + _errors(metrics)
    if _has(metrics, "limit_ate_m", "ate_over_limit"):
        lines += _limit(metrics)
    if _has(metrics, "landmarks", "wall_f1_aligned"):
        walls, f1 = metrics["landmarks"], metrics["wall_f1_aligned"]
        online = metrics.get("wall_f1_aligned_online")
        before = f"; {online:.2f} before smoothing" if isinstance(online, int | float) else ""
        lines.append(f"map         {walls} walls, F1 {f1:.2f} at 10 cm when aligned{before}")
    if _has(cost, "speed_x_real_time"):
        lines.append(f"speed       {cost['speed_x_real_time']:.0f} x real time")
    return lines


def _limit(metrics: Mapping[str, Any]) -> list[str]:
    best, ratio = metrics["limit_ate_m"], metrics["ate_over_limit"]
    smoothed = metrics.get("smoothed_over_limit")
    after = f", smoothed is {smoothed:.1f} times that" if isinstance(smoothed, int | float) else ""
    return [
        f"limit       {best:.3f} m rms, the least-squares solution with known associations",
        f"            the error is {ratio:.1f} times that{after}",
    ]


def replay_summary(metrics: Mapping[str, Any]) -> list[str]:
    """Lines about a replay, from the ``metrics`` of its ``result.json``. Missing values are left out."""
    lines = _status(metrics) + _smoothed_status(metrics) + _reversing(metrics) + _errors(metrics)
    since = metrics.get("online_graph_from_s")
    if isinstance(since, int | float):
        lines.append(f"            the filter was lost after {since:.0f} s; the online graph went on")
    trajectories = {
        "smoothed_": "smoothed, at the end", "smoothed_between_": "between the logs",
        "": "filter, while driving" if since is None else "while driving",
        "odometry_": "odometry, corrected", "raw_odometry_": "odometry, raw",
    }  # fmt: skip
    texts = {
        prefix: _relation_text(metrics, prefix)
        for prefix in trajectories
        if _has(metrics, f"{prefix}relation_error_m", f"{prefix}relation_error_deg")
    }
    # Without a correction both are the same path.
    if texts.get("odometry_") == texts.get("raw_odometry_"):
        texts.pop("odometry_", None)
    lines += [f"relations   {trajectories[prefix]:21}{text}" for prefix, text in texts.items()]
    if _has(metrics, "landmarks"):
        lines.append(f"map         {metrics['landmarks']} walls")
    return lines


def _status(metrics: Mapping[str, Any]) -> list[str]:
    """The status at the end, and how long the estimate had each status if there were several."""
    level, reason, note = metrics.get("status"), metrics.get("status_reason"), metrics.get("status_note")
    if not isinstance(level, str):
        return []
    why = f": {reason}" if reason else ""
    names = [name for name in ("ok", "unsure", "lost") if _has(metrics, f"{name}_s") and metrics[f"{name}_s"] > 0.0]
    times = ", ".join(f"{name} for {metrics[f'{name}_s']:.0f} s" for name in names) if names not in ([], ["ok"]) else ""
    if isinstance(note, str):
        # A smoothed path can be right where the filter was lost.
        return [f"status      {level}{why}{f'; {note}' if note else ''}"]
    if not any("smoothed" in name for name in metrics):
        return [f"status      {level}{why}{f'; {times}' if times else ''}"]
    if not times:
        return [f"status      {level} while driving{why}"]
    return [f"status      while driving {times}{f'; at its end {level}{why}' if why else ''}"]


def _smoothed_status(metrics: Mapping[str, Any]) -> list[str]:
    """Whether the smoothed path can be trusted."""
    level, reason = metrics.get("smoothed_status"), metrics.get("smoothed_status_reason")
    if not isinstance(level, str):
        return []
    lines = [f"            {level} at the end{f': {reason}' if reason else ''}"]
    if _has(metrics, "smoothed_points_per_m") and metrics["smoothed_points_per_m"] < FEW_POINTS:
        points = f"{metrics['smoothed_points_per_m']:.1f} readings of walls in a metre of driving"
        lines.append(f"            {points}: with fewer than {FEW_POINTS:.0f}, paths were often wrong")
    return lines


def _reversing(metrics: Mapping[str, Any]) -> list[str]:
    """How far the robot drove backwards although odometry reports driving ahead."""
    if not _has(metrics, "smoothed_reversed_m", "smoothed_reversed_places") or not metrics["smoothed_reversed_places"]:
        return []
    count = metrics["smoothed_reversed_places"]
    where = f"{metrics['smoothed_reversed_m']:.1f} m at {counted(count, 'place')}"
    return [f"            driven backwards over {where}, which odometry reports as driven ahead"]


def _errors(metrics: Mapping[str, Any]) -> list[str]:
    if not _has(metrics, "ate_m", "odometry_ate_m"):
        aligned = _has(metrics, "ate_aligned_m")
        return [f"error       {metrics['ate_aligned_m']:.3f} m rms when aligned"] if aligned else []
    lines = [f"error       {metrics['ate_m']:.3f} m rms; by odometry alone {metrics['odometry_ate_m']:.3f} m"]
    if _has(metrics, "anees"):
        smoothed = f", smoothed {metrics['anees_smoothed']:.2g}" if _has(metrics, "anees_smoothed") else ""
        lines.append(f"consistency NEES / 3 is {metrics['anees']:.2g}{smoothed}; 1 is right, more is overconfident")
    if _has(metrics, "ate_smoothed_m"):
        lines.append(f"smoothed    {metrics['ate_smoothed_m']:.3f} m rms, by all that was known at the end")
    return lines


def _relation_text(metrics: Mapping[str, Any], prefix: str) -> str:
    every, loops = (f"{prefix}{part}relation_error" for part in ("", "loop_"))
    text = f"{metrics[every + '_m']:7.3f} m {metrics[every + '_deg']:6.2f} deg"
    if not _has(metrics, f"{loops}_m", f"{loops}_deg"):
        return text
    return text + f"   loops {metrics[loops + '_m']:7.3f} m {metrics[loops + '_deg']:6.2f} deg"


def _has(numbers: Mapping[str, Any], *names: str) -> bool:
    """Whether all names have numbers. The file may come from another version, or from an editor."""
    return all(isinstance(numbers.get(name), int | float) for name in names)
