"""What a run costs: wall clock and memory."""

import resource
import sys

import numpy as np

from limslam_env.geometry import FloatArray


def run_cost(duration: float, wall_clock: float, **step_ms: FloatArray) -> dict[str, float]:
    """Figures for ``cost`` in a ``result.json``.

    Parameters
    ----------
    duration
        What passed in the run or its log, s.
    wall_clock
        What passed outside, s.
    **step_ms
        For each named part of a step what it cost (n,), ms.
    """
    parts = {
        f"{name}_ms_{label}": float(np.percentile(values, share))
        for name, values in step_ms.items()
        for label, share in (("median", 50.0), ("p99", 99.0))
    }
    # Linux counts kilobytes, macOS bytes.
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return {
        **parts,
        "speed_x_real_time": duration / wall_clock,
        "wall_clock_s": wall_clock,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit,
    }
