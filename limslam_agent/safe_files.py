"""Opens files that anybody may have made: only regular files, and no more bytes than a limit."""

import errno
import stat
import warnings
import zipfile
from collections.abc import Collection
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_TEXT_BYTES = 64_000_000
"""Most bytes of a text file that is read as a whole."""

MAX_ARRAY_BYTES = 256_000_000
"""Most bytes of the arrays that are read from one file."""


class TooLargeError(ValueError):
    """The arrays of a file have too many bytes."""


def open_regular(path: Path) -> IO[bytes]:
    """Open a file to read its bytes. Pipes and devices, which may never end, are refused before
    they are opened.

    A file of no bytes is not opened either: files of the kernel such as ``/proc/kmsg`` look like
    that, and may wait.

    Raises
    ------
    OSError
        If the file cannot be opened or is not a regular file.
    """
    try:
        status = path.stat()
    except ValueError as error:  # a name that no file can have
        raise OSError(errno.EINVAL, str(error), str(path)) from error
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "Is a directory", str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return path.open("rb") if status.st_size else BytesIO()


def read_limited(path: Path, largest: int = MAX_TEXT_BYTES) -> bytes:
    """All bytes of a regular file.

    Raises
    ------
    OSError
        If the file cannot be read, is not a regular file, or has more than ``largest`` bytes.
    """
    with open_regular(path) as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"it is larger than {largest / 1e6:g} MB", str(path))
    return content


def load_arrays(
    path: Path, names: Collection[str] | None = None, largest: float = MAX_ARRAY_BYTES
) -> "dict[str, NDArray[Any]]":
    """The arrays of an ``.npz`` file by their names, of these names only, where they are given.
    Nothing is unpickled.

    Raises
    ------
    OSError
        If the file cannot be opened or is not a regular file.
    TooLargeError
        If the arrays have more than ``largest`` bytes. The message does not name the file.
    ValueError
        If the file is damaged. The message does not name the file.
    """
    with open_regular(path) as raw:
        try:
            # A header that Python 2 wrote is read, but numpy warns about it.
            with warnings.catch_warnings(action="ignore"):
                return _arrays_in(raw, names, largest)
        # numpy, zipfile and zlib raise errors of very different types on damaged files.
        except Exception as error:
            if isinstance(error, TooLargeError):
                raise
            from limslam_env.messages import LONGEST_VALUE, one_line

            raise ValueError(
                f"cut short or damaged: {one_line(str(error), LONGEST_VALUE)}"
            ) from error


def _arrays_in(
    raw: IO[bytes], names: Collection[str] | None, largest: float
) -> "dict[str, NDArray[Any]]":
    with zipfile.ZipFile(raw) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        wanted = {name: info for name, info in members.items() if names is None or name in names}
        total = sum(info.file_size for info in wanted.values())
        if total > largest:
            raise TooLargeError(
                f"its arrays have {total / 1e6:.0f} MB; at most {largest / 1e6:g} MB are read"
            )
        return {name: _array(archive, info) for name, info in wanted.items()}


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> "NDArray[Any]":
    # Imported here so that the command line can check settings before it loads numpy.
    import numpy as np

    with archive.open(info) as member:
        # The size that the array's own header promises is reserved at once, before any data are
        # read.
        version = np.lib.format.read_magic(member)
        read_header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read_header(member)
        count = 1
        for side in shape:
            count *= int(side)
        if dtype.hasobject or count * dtype.itemsize > info.file_size:
            raise ValueError(f"the header of {info.filename} does not fit its data")
    with archive.open(info) as member:
        return np.asarray(np.lib.format.read_array(member, allow_pickle=False))
