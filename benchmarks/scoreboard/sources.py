"""How large the estimator is: its lines, its constants, and its largest file and function, counted from its sources."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import limslam_agent

ESTIMATOR = (
    "slam", "places", "status", "kernels",
    "mapper.py", "frame_mapper.py", "renewal.py", "joining.py", "dropouts.py",
    "replay/calibration.py", "replay/filter_estimate.py", "replay/hand_over.py", "replay/joined_lines.py",
    "replay/local_views.py", "replay/loop_scores.py", "replay/plausibility.py", "replay/reversing.py",
    "replay/smoothing.py", "replay/trust.py", "replay/two_logs.py",
)  # fmt: skip
"""The folders and files of the estimation side, in ``limslam_agent``. What does not exist is left out."""


@dataclass(frozen=True)
class Size:
    """The size of the estimator.

    Attributes
    ----------
    lines, files
        Lines of its files, and their number.
    constants
        Number of assignments at module level whose value has a number in it.
    largest_file, largest_function
        Name and lines of its largest file and function.
    """

    lines: int
    files: int
    constants: int
    largest_file: tuple[str, int]
    largest_function: tuple[str, int]

    @property
    def words(self) -> str:
        """One line for the screen."""
        file, function = (f"{name} ({lines})" for name, lines in (self.largest_file, self.largest_function))
        return (
            f"{self.lines} lines in {self.files} files, {self.constants} constants; largest file {file}, "
            f"largest function {function}"
        )


def estimator_files(package: Path | None = None) -> list[Path]:
    """The files of the estimator of the package that is imported, or of another copy of it."""
    top = package or Path(limslam_agent.__file__).parent
    found = (top / name for name in ESTIMATOR)
    return sorted(file for path in found for file in ([path] if path.suffix else path.rglob("*.py")) if file.is_file())


def size_of(files: list[Path]) -> Size:
    """Count lines, constants and functions of some files."""
    lines, constants, functions = dict[str, int](), 0, {"none": 0}
    for file in files:
        text = file.read_text(encoding="utf-8")
        name, tree = f"{file.parent.name}/{file.name}", ast.parse(text)
        lines[name] = len(text.splitlines())
        constants += sum(_has_number(node.value) for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign))
        functions |= {f"{name}:{each.name}": _length(each) for each in _functions(tree)}
    first, longest = (max(each.items(), key=lambda item: item[1]) for each in (lines, functions))
    return Size(sum(lines.values()), len(files), constants, first, longest)


def digest_of(files: list[Path]) -> str:
    """Digest of the content of files: 16 hexadecimal digits."""
    return sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def _length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    return (function.end_lineno or function.lineno) - function.lineno + 1


def _has_number(value: ast.expr | None) -> bool:
    return value is not None and any(
        isinstance(node, ast.Constant) and type(node.value) in {int, float} for node in ast.walk(value)
    )
