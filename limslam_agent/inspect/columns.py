"""The compact form of a recording: named arrays of numbers and a table of texts, compressed into
one string.
"""

import base64
import gzip
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import FloatArray

_ALIGNED = 8
"""Arrays begin at multiples of so many bytes, which the typed arrays of JavaScript need."""

_LARGEST = 32000
"""Largest whole number that a quantised length may become, so that it fits into 16 bits."""

_LEAST_QUANTUM = 1e-3
"""Smallest step of quantised lengths, m."""


class Ragged:
    """Rows of different length, kept as one array of values and the place at which each row
    begins.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._rows = list[NDArray[Any]]()

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, row: NDArray[Any]) -> None:
        """Add a row (n, width)."""
        self._rows.append(np.asarray(row).reshape(-1, self._width))

    def values(self) -> NDArray[Any]:
        """All rows below each other (N, width)."""
        return np.concatenate(self._rows) if self._rows else np.zeros((0, self._width))

    def starts(self) -> NDArray[np.uint32]:
        """Where each row begins, and where the last one ends (rows + 1,)."""
        counts = [len(row) for row in self._rows]
        return np.concatenate(([0], np.cumsum(counts, dtype=np.int64))).astype(np.uint32)


def rounded(values: Any, digits: int = 4) -> Any:
    """Numbers or nested lists of numbers for JSON, with a few digits. What is not finite becomes
    None.
    """
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, list | tuple):
        return [rounded(value, digits) for value in values]
    return round(float(values), digits) if math.isfinite(values) else None


def quantum_for(groups: Iterable[FloatArray]) -> float:
    """The step, m, by which lengths become 16-bit numbers: 1 mm, and more in large buildings."""
    largest = max((float(np.abs(each).max()) for each in groups if each.size), default=0.0)
    return max(_LEAST_QUANTUM, largest / _LARGEST)


def quantised(lengths: FloatArray, quantum: float) -> NDArray[np.int16]:
    """Lengths, m, in units of a step, m."""
    return np.asarray(np.rint(lengths / quantum).astype(np.int16))


def packed(arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any], *, level: int = 9) -> str:
    """Arrays and a table that JSON can hold as text in base64. ``level`` is how well it is
    compressed, 1 to 9.

    It is a gzip file of the length of a header (4 bytes, little endian), the header, and the
    arrays. The header is JSON: ``meta``, and for each array its type, shape and place.
    """
    listed = {}
    blocks = []
    place = 0
    for name, array in arrays.items():
        block = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes()
        listed[name] = {
            "type": array.dtype.name,
            "shape": list(array.shape),
            "at": place,
            "bytes": len(block),
        }
        padding = -len(block) % _ALIGNED
        blocks += [block, bytes(padding)]
        place += len(block) + padding
    header = json.dumps(
        {"meta": dict(meta), "arrays": listed}, allow_nan=False, separators=(",", ":")
    ).encode()
    header += b" " * (-(len(header) + 4) % _ALIGNED)
    content = len(header).to_bytes(4, "little") + header + b"".join(blocks)
    return base64.b64encode(gzip.compress(content, level, mtime=0)).decode("ascii")
