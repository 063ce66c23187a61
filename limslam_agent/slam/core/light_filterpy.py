"""filterpy's extended Kalman filter, imported without ``scipy.stats``.

filterpy imports two distributions of ``scipy.stats``, which takes longer than all other imports of an agent, and a
filter never calls them. Here they are imported when they are first called.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_STATS = "scipy.stats"


class _Distribution:
    """A distribution of ``scipy.stats`` that is imported at its first call after filterpy was imported."""

    is_ready = False

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return getattr(import_module(_STATS), self._name)(*arguments, **named)

    def __getattr__(self, method: str) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            # filterpy tries a method out when it is imported, because of SciPy before 0.16.
            if not _Distribution.is_ready:
                return None
            return getattr(getattr(import_module(_STATS), self._name), method)(*arguments, **named)

        return call


def _filter_class() -> Any:
    if _STATS in sys.modules:
        return import_module("filterpy.kalman").ExtendedKalmanFilter
    stand_in = ModuleType(_STATS)
    for name in ("norm", "multivariate_normal"):
        setattr(stand_in, name, _Distribution(name))
    sys.modules[_STATS] = stand_in
    try:
        return import_module("filterpy.kalman").ExtendedKalmanFilter
    except ImportError:
        # Another version of filterpy wants more of it.
        del sys.modules[_STATS]
        return import_module("filterpy.kalman").ExtendedKalmanFilter
    finally:
        if sys.modules.get(_STATS) is stand_in:
            del sys.modules[_STATS]
        _Distribution.is_ready = True


ExtendedKalmanFilter = _filter_class()
