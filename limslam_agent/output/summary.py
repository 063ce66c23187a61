"""A finished run or replay in a few lines of text, for the command line."""

from collections.abc import Mapping
from typing import Any


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
    lines += _errors(metrics)
    if _has(metrics, "limit_ate_m", "ate_over_limit"):
        best, ratio = metrics["limit_ate_m"], metrics["ate_over_limit"]
        lines.append(f"limit       {best:.3f} m rms, the optimum of the same log; the error is {ratio:.1f} times that")
    if _has(metrics, "landmarks", "wall_f1_aligned"):
        walls, f1 = metrics["landmarks"], metrics["wall_f1_aligned"]
        lines.append(f"map         {walls} walls, F1 {f1:.2f} at 10 cm when aligned")
    if _has(cost, "speed_x_real_time"):
        lines.append(f"speed       {cost['speed_x_real_time']:.0f} x real time")
    return lines


def replay_summary(metrics: Mapping[str, Any]) -> list[str]:
    """Lines about a replay, from the ``metrics`` of its ``result.json``. Missing values are left out."""
    lines = _errors(metrics)
    trajectories = {
        "smoothed_": "smoothed", "": "estimate", "odometry_": "odometry, corrected", "raw_odometry_": "odometry, raw",
    }  # fmt: skip
    for prefix, words in trajectories.items():
        if _has(metrics, f"{prefix}relation_error_m", f"{prefix}relation_error_deg"):
            lines.append(f"relations   {words:20}" + _relation_text(metrics, prefix))
    if _has(metrics, "landmarks"):
        lines.append(f"map         {metrics['landmarks']} walls")
    return lines


def _errors(metrics: Mapping[str, Any]) -> list[str]:
    if not _has(metrics, "ate_m", "odometry_ate_m"):
        return []
    return [f"error       {metrics['ate_m']:.3f} m rms; by odometry alone {metrics['odometry_ate_m']:.3f} m"]


def _relation_text(metrics: Mapping[str, Any], prefix: str) -> str:
    every, loops = (f"{prefix}{part}relation_error" for part in ("", "loop_"))
    text = f"{metrics[every + '_m']:7.3f} m {metrics[every + '_deg']:6.2f} deg"
    if not _has(metrics, f"{loops}_m", f"{loops}_deg"):
        return text
    return text + f"   loops {metrics[loops + '_m']:7.3f} m {metrics[loops + '_deg']:6.2f} deg"


def _has(numbers: Mapping[str, Any], *names: str) -> bool:
    """Whether all names have numbers. The file may come from another version, or from an editor."""
    return all(isinstance(numbers.get(name), int | float) for name in names)
