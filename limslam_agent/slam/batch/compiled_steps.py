"""The decisions of a step, compiled: the functions of the single estimator with the batch's filter."""

import functools
from types import FunctionType
from typing import Any

from limslam_agent.slam.batch import clone_ekf
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.consistent import association, filter_access, pending_readings
from limslam_agent.slam.core import contact


@functools.cache
def compiled_step(function: Any) -> Any:
    """The compiled counterpart of a plain function, with all that it calls.

    Functions that ask the filter are replaced by those of ``batch.clone_ekf`` of the same names, and kernels that
    Python calls by the functions that they are made of.
    """
    if getattr(function, "__module__", "") == filter_access.__name__:
        return getattr(clone_ekf, function.__name__)
    if hasattr(function, "py_func"):
        return algebra(function.py_func)
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        used = names.get(name)
        if hasattr(used, "py_func") or (isinstance(used, FunctionType) and used.__module__.startswith("limslam_agent")):
            names[name] = compiled_step(used)
    return algebra(FunctionType(function.__code__, names, function.__name__))


process, prune = compiled_step(association.process), compiled_step(association.prune)
is_due, collect = compiled_step(pending_readings.is_due), compiled_step(pending_readings.collect)
has_ended = compiled_step(pending_readings.has_ended)
slip, slip_covariance = compiled_step(contact.slip), compiled_step(contact.slip_covariance)
new_memory = compiled_step(contact.new_memory)
