"""Rows of results, made up from a seed, for the tests of tables."""

from dataclasses import replace

import numpy as np

from benchmarks.suite.store import Row


def row(
    world="env1", noise=0.0, seed=0, *, robots=1, policy="frontier", laps=0, ablation=None, preset="paper", **other
):
    """A row whose metrics are drawn from its seed; ``other`` are metrics, or fields of the row."""
    rng = np.random.default_rng([seed, robots, int(1000 * noise), len(world)])
    metrics = {
        "wall_f1": 0.9 - rng.uniform(0.0, 0.1) - noise, "wall_f1_aligned": 0.95 - rng.uniform(0.0, 0.05),
        "wall_f1_5cm": 0.7, "wall_recall": 0.9, "spurious_walls": int(100 * noise) + int(rng.integers(0, 2)),
        "doors_open": None, "ate_m": 0.1 + noise + rng.uniform(0.0, 0.05), "odometry_ate_m": 0.8, "anees": 2.0,
        "exploration_time_s": None if laps else 200.0 / robots + rng.uniform(0.0, 9.0), "coverage_true": 0.99,
        "association_right_share": 0.9, "heading_rmse_deg": 1.0, "odometry_heading_rmse_deg": 5.0,
        "stop_reason": "explored: no frontier is left", "time_to_50_s": 40.0, "time_to_90_s": 80.0,
        "time_to_95_s": 90.0, "path_m": 30.0, "collisions": 0,
    }  # fmt: skip
    fields = {name: other.pop(name) for name in list(other) if name in Row.__dataclass_fields__}
    made = Row(
        world=world, noise=noise, robots=robots, preset=preset, policy="laps" if laps else policy, ablation=ablation,
        laps=laps, seed=seed, metrics=metrics | other, cost={"job_s": 1.5, "slam_ms_median": 0.1},
        versions={"python": "3.11", "numpy": "2.0"}, commit="0123456789abcdef",
    )  # fmt: skip
    key = f"{world}-{noise}-{robots}-{preset}-{policy}-{ablation}-{laps}-{seed}".replace(":", "_")
    return replace(made, key=key, **fields)


def failed(made, reason="RuntimeError: <boom> & 100% | over_there"):
    """The same job, failed."""
    return replace(made, metrics={}, cost={}, error=reason)


def grid(seeds=3, worlds=("env1", "env2"), noises=(0.0, 0.02), robots=(1, 2)):
    """Rows of every world, noise and number of robots."""
    return [
        row(world, noise, seed, robots=number)
        for world in worlds for noise in noises for number in robots for seed in range(seeds)
    ]  # fmt: skip
