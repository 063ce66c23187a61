"""Pictures in the PGM format, which map_server's maps are made of."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_env.worlds.formats.text_files import read_bytes
from limslam_env.worlds.world import WorldError

MAX_PIXELS = 36_000_000

_HEADER_BYTES = 65_536
_PLAIN_SAMPLE_BYTES = 8  # of a P2 file, the spaces around included
_HEADER = re.compile(rb"P([25])" + 3 * rb"(?:\s|#[^\n\r]*[\n\r])+(\d{1,9})" + rb"\s")


def read_pgm(path: Path) -> tuple[NDArray[np.integer[Any]], int]:
    """Read a PGM file, binary (P5) or plain (P2), of 8 or 16 bits.

    Returns
    -------
    samples
        (rows, columns), the uppermost row first.
    largest
        The level that stands for white.

    Raises
    ------
    WorldError
        If it is no PGM file, has too many pixels, too few samples, or one above its own white.
    """
    header = _HEADER.match(read_bytes(path, _HEADER_BYTES))
    if not header:
        raise WorldError("no PGM file: its header is neither that of P5 nor of P2")
    columns, rows, largest = (int(number) for number in header.groups()[1:])
    if not 1 <= rows * columns <= MAX_PIXELS:
        raise WorldError(f"{columns} x {rows} pixels; 1 to {MAX_PIXELS} can be read")
    if not 1 <= largest <= 65_535:
        raise WorldError(f"white is {largest}; it must lie between 1 and 65535")
    if header[1] == b"2":
        samples = _plain(path, header.end(), rows * columns)
    else:
        samples = _binary(path, header.end(), rows * columns, ">u1" if largest < 256 else ">u2")
    if len(samples) < rows * columns:
        raise WorldError(f"ends after {len(samples)} of {rows * columns} pixels")
    if samples.max() > largest:
        raise WorldError(f"holds the level {samples.max()}, above its white of {largest}")
    return samples.reshape(rows, columns), largest


def _binary(path: Path, start: int, count: int, kind: str) -> NDArray[np.integer[Any]]:
    size = np.dtype(kind).itemsize
    content = read_bytes(path, start + count * size)[start:]
    return np.frombuffer(content, dtype=kind, count=len(content) // size)


def _plain(path: Path, start: int, count: int) -> NDArray[np.integer[Any]]:
    most = start + count * _PLAIN_SAMPLE_BYTES + _HEADER_BYTES
    content = read_bytes(path, most + 1)
    if len(content) > most:
        raise WorldError(f"too long for {count} pixels")
    content = re.sub(rb"#[^\n\r]*", b" ", content[start:])
    odd = re.search(rb"[^\d\s]|\d{6}", content)
    if odd:
        raise WorldError(f"{odd[0].decode('latin-1')!r} is no sample")
    return np.fromstring(content, dtype=np.int32, sep=" ")[:count]
