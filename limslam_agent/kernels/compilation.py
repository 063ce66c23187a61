"""How the kernels of a step are compiled: the decorators of ``limslam_env.compilation``, for these
sources.
"""

from limslam_env.compilation import compiled, entry_of

__all__ = ["compiled", "entry", "lean_entry"]

entry = entry_of("limslam_agent.kernels")
"""The decorator for kernels of a step that Python calls."""

lean_entry = entry_of("limslam_agent.kernels", allocates=False)
"""The same for kernels that make no arrays."""
