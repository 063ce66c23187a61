"""How large the estimator is: its lines, its constants, and its largest file and function, counted from its sources."""

import ast
from hashlib import sha256
from pathlib import Path

import limslam_agent

ESTIMATOR = (
    "slam", "places", "status", "kernels",
    "mapping/mapper.py", "mapping/frames.py", "mapping/frame_mapper.py", "mapping/renewal.py", "mapping/joining.py",
    "dropouts.py",
    "replay/calibration.py", "replay/filter_estimate.py", "replay/hand_over.py", "replay/plausibility.py",
    "replay/smoothing.py", "replay/trust.py", "two_logs/by_graph.py", "two_logs/by_lines.py", "two_logs/joining.py",
    "two_logs/joint.py", "two_logs/place.py",
)  # fmt: skip
"""The folders and files of the estimation side, in ``limslam_agent``. What does not exist is left out."""


def estimator_files() -> list[Path]:
    """The files of the estimator of the package that is imported."""
    found = (Path(limslam_agent.__file__).parent / name for name in ESTIMATOR)
    return sorted(file for path in found for file in ([path] if path.suffix else path.rglob("*.py")) if file.is_file())


def size_of(files: list[Path]) -> dict[str, int | str]:
    """Lines, files, assignments at module level whose value has a number in it, and the largest file and function.

    The lines of a function are those of its body: signatures and docstrings are not counted.
    """
    lines, functions, constants = dict[str, int](), {"none": 0}, 0
    for file in files:
        text, name = file.read_text(encoding="utf-8"), f"{file.parent.name}/{file.name}"
        tree = ast.parse(text)
        lines[name] = len(text.splitlines())
        constants += sum(_has_number(node.value) for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign))
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                functions[f"{name}:{node.name}"] = _length(node)
    return {
        "lines": sum(lines.values()), "files": len(files), "constants": constants, "largest_file": _largest(lines),
        "largest_function": _largest(functions),
    }  # fmt: skip


def digest_of(files: list[Path]) -> str:
    """Digest of the content of files: 16 hexadecimal digits."""
    return sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _largest(lengths: dict[str, int]) -> str:
    name = max(lengths, key=lambda each: lengths[each])
    return f"{name} ({lengths[name]})"


def _length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def _has_number(value: ast.expr | None) -> bool:
    return value is not None and any(
        isinstance(node, ast.Constant) and type(node.value) in {int, float} for node in ast.walk(value)
    )
