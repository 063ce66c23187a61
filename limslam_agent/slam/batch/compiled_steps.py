"""The decisions of a step, compiled: the functions of the single estimator, with what the filter
asks of its arrays.
"""

import functools
from types import FunctionType
from typing import Any

from limslam_agent.kernels.covariance import move_pose
from limslam_agent.kernels.readings import sort_readings
from limslam_agent.slam.consistent import pending_readings, step
from limslam_agent.slam.core import contact, encoder_ticks, motion
from limslam_env.compilation import compiled, entry_of
from limslam_env.geometry import se2

entry = entry_of(
    "limslam_env.interface",
    "limslam_agent.config",
    "limslam_agent.slam.core",
    "limslam_agent.kernels",
    "limslam_agent.slam.consistent",
    "limslam_agent.slam.batch",
)
"""The decorator for kernels of the batch that Python calls."""


@functools.cache
def compiled_step(function: Any) -> Any:
    """The compiled counterpart of a plain function, with all that it calls, or of a kernel that
    Python calls.
    """
    if hasattr(function, "py_func"):
        return compiled(function.py_func)
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        used = names.get(name)
        if hasattr(used, "py_func") or (
            isinstance(used, FunctionType) and used.__module__.startswith("limslam_")
        ):
            names[name] = compiled_step(used)
    return compiled(
        FunctionType(function.__code__, names, function.__name__, function.__defaults__)
    )


measure = compiled_step(step.measure)
note_motion = compiled_step(pending_readings.note_motion)
slip = compiled_step(contact.slip)
slip_covariance = compiled_step(contact.slip_covariance)
move = compiled_step(move_pose)
sort = compiled_step(sort_readings)
wheel_motion = compiled_step(motion.wheel_motion)
tick_by = compiled_step(encoder_ticks.tick_by)
jitter_of = compiled_step(encoder_ticks.jitter_of)
first_jitter = compiled_step(encoder_ticks.first_jitter)
turned = compiled_step(se2.turned)
