"""The decisions of a step, compiled: the functions of the single estimator, with what the filter
asks of its arrays.
"""

import functools
from types import FunctionType
from typing import Any

from limslam_agent.kernels.covariance import move_pose
from limslam_agent.kernels.extents import clear_along_beams
from limslam_agent.slam.consistent import association, clone_filter, pending_readings, separate_bias
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


@compiled
def note_nothing(*_: Any) -> None:
    """A batch estimates no constant errors beside its filters."""


_INSTEAD = {separate_bias.note_update: note_nothing, separate_bias.note_readings: note_nothing}
"""What takes the place of plain functions that cannot be compiled."""


@functools.cache
def compiled_step(function: Any) -> Any:
    """The compiled counterpart of a plain function, with all that it calls, or of a kernel that
    Python calls.
    """
    if function in _INSTEAD:
        return _INSTEAD[function]
    if hasattr(function, "py_func"):
        return compiled(function.py_func)
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        used = names.get(name)
        if hasattr(used, "py_func") or (
            isinstance(used, FunctionType) and used.__module__.startswith("limslam_")
        ):
            names[name] = compiled_step(used)
    return compiled(FunctionType(function.__code__, names, function.__name__))


process = compiled_step(association.process)
prune = compiled_step(association.prune)
is_due = compiled_step(pending_readings.is_due)
collect = compiled_step(pending_readings.collect)
has_ended = compiled_step(pending_readings.has_ended)
slip = compiled_step(contact.slip)
slip_covariance = compiled_step(contact.slip_covariance)
clone = compiled_step(clone_filter.clone)
size_of = compiled_step(clone_filter.size_of)
move = compiled_step(move_pose)
clear = compiled_step(clear_along_beams)
wheel_motion = compiled_step(motion.wheel_motion)
tick_by = compiled_step(encoder_ticks.tick_by)
jitter_of = compiled_step(encoder_ticks.jitter_of)
first_jitter = compiled_step(encoder_ticks.first_jitter)
turned = compiled_step(se2.turned)
