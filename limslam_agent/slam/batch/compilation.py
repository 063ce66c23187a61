"""How the kernels of the batch are compiled: the decorators of ``limslam_env.compilation``, for these sources."""

from limslam_env.compilation import algebra, compiled, entry_of

__all__ = ["algebra", "compiled", "entry"]

entry = entry_of(
    "limslam_env.interface",
    "limslam_agent.config",
    "limslam_agent.slam.core",
    "limslam_agent.kernels",
    "limslam_agent.slam.consistent",
    "limslam_agent.slam.batch",
)
"""The decorator for kernels of the batch that Python calls."""
