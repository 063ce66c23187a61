"""Reading files of limited size and lists of numbers in them, and replacing files in one step."""

import secrets
from pathlib import Path
from typing import Any

import numpy as np

from limslam_env.worlds.world import MAX_SIDE, WorldError

MAX_FILE_BYTES = 20_000_000


def read_bytes(path: Path, count: int) -> bytes:
    """The first ``count`` bytes of a file, or all when there are fewer; a WorldError where it cannot be read."""
    try:
        # A pipe or a device might never end.
        if path.is_file():
            with path.open("rb") as file:
                return file.read(count)
    except (OSError, ValueError) as error:
        raise WorldError(f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    raise WorldError("no such file")


def read_text(path: Path, largest: int) -> str:
    """The text of a file; a WorldError where it has more than ``largest`` bytes or is no UTF-8."""
    content = read_bytes(path, largest + 1)
    if len(content) > largest:
        raise WorldError(f"larger than {largest / 1e6:g} MB")
    try:
        # Lines may end in any of three ways, and a byte order mark may stand before the text.
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise WorldError(f"cannot be read: {error}") from error


def number_array(value: Any, key: str, dimensions: int) -> Any:
    """Nested lists of a file's numbers as an array; a WorldError, which names the ``key``, for anything else."""

    def is_number_list(item: Any, depth: int) -> bool:
        if depth > 0:
            return isinstance(item, list) and all(is_number_list(part, depth - 1) for part in item)
        # Whole numbers of a file may be too large for a float; floats that are not finite are named later.
        return isinstance(item, float) or (type(item) is int and abs(item) <= MAX_SIDE * 1e6)

    if not is_number_list(value, dimensions):
        raise WorldError(f"{key} must be a list of {'numbers' if dimensions == 1 else 'lists of numbers'}")
    counts = [len(row) for row in value] if dimensions > 1 else []
    odd = next((row for row, count in enumerate(counts) if count != counts[0]), None)
    if odd is not None:
        raise WorldError(f"{key}[{odd}] has {counts[odd]} numbers, and {key}[0] has {counts[0]}")
    return np.array(value, dtype=float)


def replace_file(path: Path, content: bytes) -> None:
    """Write a file under another name in the same folder, then rename it, so that no incomplete file is ever seen."""
    beside = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        try:
            beside.write_bytes(content)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except (OSError, ValueError) as error:
        raise WorldError(f"{path}: cannot be written: {error}") from error
