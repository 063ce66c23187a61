"""How the kernels of the line graph are compiled: the decorators of ``limslam_env.compilation``, for these sources."""

from limslam_env.compilation import compiled, entry_of

__all__ = ["compiled", "entry"]

entry = entry_of(
    "limslam_agent.kernels.measurement",
    "limslam_agent.kernels.tables",
    "limslam_agent.slam.line_graph",
)
"""The decorator for kernels of the line graph that Python calls."""
