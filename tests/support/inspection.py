"""Short runs and their pages for the tests of the inspector."""

import base64
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.command_line import Finished, limslam

SHORT = ("--world", "square", "--noise", 0.02, "--until", "seen", "--max-time", 25)


def short_run(folder: Path, *options: object) -> Path:
    """The folder of a short run."""
    done = limslam("run", *SHORT, *options, "--out", folder)
    assert done.returncode == 0, done.stderr
    return folder


def inspected(source: Path, out: Path, *options: object) -> Finished:
    """``limslam inspect`` of a folder or a log."""
    return limslam("inspect", source, "--out", out, *options)


def data_in(page: Path) -> str:
    """The recording in a page, as it was packed."""
    return page.read_text(encoding="utf-8").split('id="data">', 1)[1].split("</script>", 1)[0]


def unpacked(text: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """The arrays and the table of a text that ``limslam_agent.inspect.columns.packed`` has made."""
    content = gzip.decompress(base64.b64decode(text))
    length = int.from_bytes(content[:4], "little")
    header = json.loads(content[4 : 4 + length])
    body = content[4 + length :]
    arrays = {
        name: np.frombuffer(
            body[told["at"] : told["at"] + told["bytes"]], dtype=told["type"]
        ).reshape(told["shape"])
        for name, told in header["arrays"].items()
    }
    return arrays, header["meta"]
