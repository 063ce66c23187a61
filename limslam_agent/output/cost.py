"""Cost of a run: wall-clock time and memory."""

import resource
import sys

import numpy as np

from limslam_env.geometry import FloatArray


def run_cost(duration: float, wall_clock: float, **step_ms: FloatArray) -> dict[str, float]:
    """Values for ``cost`` in a ``result.json``.

    Parameters
    ----------
    duration
        Time that passed in the run or in its log, s.
    wall_clock
        Time that the computation took, s.
    **step_ms
        Time that each named part of a step took (n,), ms.
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
