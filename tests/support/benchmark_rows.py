"""Rows of results and their series, made up from a seed, for the tests of tables, plots and reports."""

import json
from dataclasses import asdict, replace

import numpy as np

from benchmarks.suite.store import Row

EDGES = np.array([[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0], [2, 0, 2, 1], [2, 2, 2, 3]], dtype=float)


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
    return replace(made, metrics={}, cost={}, series=None, error=reason)


def grid(seeds=3, worlds=("env1", "env2"), noises=(0.0, 0.02), robots=(1, 2)):
    """Rows of every world, noise and number of robots."""
    return [
        row(world, noise, seed, robots=number)
        for world in worlds for noise in noises for number in robots for seed in range(seeds)
    ]  # fmt: skip


def series_of(made):
    """A path of some loops, odometry that turns away from it, and a belief that stays near."""
    rng = np.random.default_rng(made.seed)
    count = 60 * max(made.laps, 1)
    time = np.arange(count, dtype=float)
    turn = 2 * np.pi * time * max(made.laps, 1) / (count - 1)
    paths = [
        np.column_stack((2 + np.cos(turn + shift), 1.5 + np.sin(turn + shift), (turn + shift) % (2 * np.pi) - np.pi))
        for shift in np.arange(made.robots)
    ]
    true = np.stack(paths, axis=1)
    growth = rng.uniform(0.5, 1.0) * (time / count)[:, None, None] * np.array([0.4, 0.4, 0.2])
    return {
        "time": time, "coverage": np.minimum(1.0, time / 40.0), "true": true, "odometry": true + growth,
        "estimated": true + 0.02 * rng.normal(size=true.shape), "sigma": np.full(true.shape, 0.02),
        "segments": EDGES[:4] + 0.02, "edges": EDGES,
    }  # fmt: skip


def write_folder(folder, rows, *, jobs=None):
    """A folder of results with series for all rows that did not fail."""
    (folder / "series").mkdir(parents=True)
    lines = []
    for made in rows:
        kept = made
        if made.error is None and made.series is None:
            name = f"series/{made.key}.npz"
            np.savez(folder / name, **series_of(made))
            kept = replace(made, series=name)
        lines.append(json.dumps(asdict(kept)) + "\n")
    (folder / "results.jsonl").write_text("".join(lines), encoding="utf-8")
    stamp = {"suite": "made-up", "digest": "d1ge57", "jobs": jobs or len(rows), "versions": {}, "commit": "0123456789"}
    (folder / "suite.json").write_text(json.dumps(stamp), encoding="utf-8")
    return folder
