"""Compiled code from an empty cache and from one that was warmed up gives the same estimate."""

import os
import subprocess
import sys

import pytest


def command(*words, cache, folder):
    """Run ``limslam`` with compiled code in a folder of its own."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "LIMSLAM_QUIET": "1"}
    subprocess.run(
        [sys.executable, "-m", "limslam_agent", *words],
        check=True,
        cwd=folder,
        env=environment,
        capture_output=True,
    )


@pytest.mark.slow
def test_an_empty_cache_and_a_warm_one_give_the_same_estimate(tmp_path):
    kept = tmp_path / "on_demand"
    warm = tmp_path / "warm"
    drive = ("run", "--seed", "1", "--max-time", "120", "--out")
    command(*drive, "first", cache=kept, folder=tmp_path)
    command("warmup", cache=warm, folder=tmp_path)
    command(*drive, "second", cache=warm, folder=tmp_path)
    for name in ("trajectory_est.tum", "trajectory_smoothed.tum", "map.json"):
        first = tmp_path / "first" / name
        second = tmp_path / "second" / name
        assert first.read_bytes() == second.read_bytes()
