"""Explore a world many times and print what came of it: ``python -m benchmarks.explore``."""

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

from limslam_agent.episode import RunConfig, run_episode
from limslam_agent.results import cost, score

COLUMNS = {
    "coverage_true": "covered",
    "exploration_time_s": "time s",
    "collisions": "collisions",
    "ate_m": "ATE m",
    "odometry_ate_m": "odometry m",
    "anees": "NEES / 3",
    "wall_f1_aligned": "F1 aligned",
    "wall_f1": "F1",
    "wall_f1_5cm": "F1 5 cm",
    "spurious_walls": "spurious",
    "doors_open": "doors open",
    "closures_right": "closed right",
    "closures_wrong": "closed wrong",
    "speed_x_real_time": "x real time",
}


def run_one(config: RunConfig) -> dict[str, Any]:
    """Metrics and cost of one run, flat."""
    episode = run_episode(config)
    return {**score(episode), **cost(episode)}


def median_with_interval(values: list[float]) -> str:
    """The median, and its 95 % bootstrap interval when there are enough values for one."""
    if len(values) < 3 or np.ptp(values) == 0.0:
        return f"{np.median(values):.3g}"
    interval = stats.bootstrap(
        (np.array(values),), np.median, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return f"{np.median(values):.3g} [{interval.low:.3g}, {interval.high:.3g}]"


def main() -> None:
    """Print a Markdown table: a row a seed, and the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--world", default="env1")
    parser.add_argument("--noise", type=float, default=0.02)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--laps", type=int, default=0)
    parser.add_argument("--robots", type=int, default=1)
    parser.add_argument("--ablation")
    parser.add_argument("--seeds", type=int, default=10, help="how many")
    parser.add_argument("--first-seed", type=int, default=0)
    options = parser.parse_args()
    # The first run compiles and imports; its cost is nobody's but the start-up's.
    run_episode(RunConfig(options.world, options.noise, options.preset, max_time=5.0))
    print("| seed | " + " | ".join(COLUMNS.values()) + " |")
    print("|---" * (len(COLUMNS) + 1) + "|")
    rows = []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        config = RunConfig(options.world, options.noise, options.preset, seed, laps=options.laps)
        row = run_one(replace(config, robots=options.robots, ablation=options.ablation))
        rows.append(row)
        cells = ("-" if row[name] is None else f"{row[name]:.3g}" for name in COLUMNS)
        print(f"| {seed} | " + " | ".join(cells) + " |", flush=True)
    medians = []
    for name in COLUMNS:
        values = [row[name] for row in rows if row[name] is not None]
        medians.append(median_with_interval(values) if values else "-")
    print(f"| median, n = {len(rows)} | " + " | ".join(medians) + " |")
    ahead = sum(row["ate_m"] < row["odometry_ate_m"] for row in rows)
    print(f"\nATE below odometry's in {ahead} of {len(rows)}. Stopped: {sorted({row['stop_reason'] for row in rows})}")


if __name__ == "__main__":
    main()
