"""How large the estimator is: its lines and its constants, counted from its sources."""

import ast
from hashlib import sha256
from pathlib import Path

import limslam_agent

ESTIMATOR = (
    "slam", "places", "status", "kernels",
    "mapping/mapper.py", "mapping/frames.py", "mapping/frame_mapper.py", "mapping/renewal.py", "mapping/joining.py",
    "dropouts.py",
    "replay/calibration.py", "replay/hand_over.py", "replay/plausibility.py", "replay/smoothing.py", "replay/trust.py",
    "two_logs/by_graph.py", "two_logs/joining.py", "two_logs/joint.py", "two_logs/place.py",
)  # fmt: skip
"""The folders and files of the estimation side, in ``limslam_agent``. What does not exist is left out."""


def estimator_files() -> list[Path]:
    """The files of the estimator of the package that is imported."""
    found = (Path(limslam_agent.__file__).parent / name for name in ESTIMATOR)
    return sorted(file for path in found for file in ([path] if path.suffix else path.rglob("*.py")) if file.is_file())


def size_of(files: list[Path]) -> dict[str, int]:
    """Lines, files, and assignments at module level whose value has a number in it."""
    texts = [file.read_text(encoding="utf-8") for file in files]
    nodes = [node for text in texts for node in ast.parse(text).body]
    constants = sum(_has_number(node.value) for node in nodes if isinstance(node, ast.Assign | ast.AnnAssign))
    return {"lines": sum(len(text.splitlines()) for text in texts), "files": len(files), "constants": constants}


def digest_of(files: list[Path]) -> str:
    """Digest of the content of files: 16 hexadecimal digits."""
    return sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _has_number(value: ast.expr | None) -> bool:
    return value is not None and any(
        isinstance(node, ast.Constant) and type(node.value) in {int, float} for node in ast.walk(value)
    )
