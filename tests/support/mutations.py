"""Mutations of the source, drawn at random, and which of them the tests notice.

``python tests/support/mutations.py limslam_env/geometry --number 10 --seed 1`` changes ten places
of these files, one after the other, in a copy of the checkout, and runs the tests that belong to
them until the first one fails.
"""

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
COMPARISONS = {
    ast.Lt: ast.Gt,
    ast.Gt: ast.Lt,
    ast.LtE: ast.GtE,
    ast.GtE: ast.LtE,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
SIGNS = {ast.Add: ast.Sub, ast.Sub: ast.Add}
LONGEST_S = 900
NOT_CODE = {"annotation", "returns", "decorator_list", "type_params"}


@dataclass(frozen=True)
class Mutation:
    """A place in a file, relative to the root, and what stands there instead."""

    file: Path
    node: ast.expr
    changed: ast.expr

    def __str__(self) -> str:
        return (
            f"{self.file}:{self.node.lineno}: {ast.unparse(self.node)}  ->  "
            f"{ast.unparse(self.changed)}"
        )

    def applied(self) -> str:
        """The text of the file with the mutation."""
        lines = (ROOT / self.file).read_bytes().splitlines(keepends=True)
        first = self.node.lineno - 1
        last = self.node.end_lineno - 1
        before = lines[first][: self.node.col_offset]
        after = lines[last][self.node.end_col_offset :]
        lines[first : last + 1] = [before, f"({ast.unparse(self.changed)})".encode(), after]
        return b"".join(lines).decode()


def mutations(file: Path) -> list[Mutation]:
    """All mutations of a file that is given relative to the root."""
    tree = ast.parse((ROOT / file).read_bytes())
    return [
        Mutation(file, node, changed) for node in _expressions(tree) for changed in _changed(node)
    ]


def _expressions(node: ast.AST) -> Iterator[ast.expr]:
    """All expressions that are executed, without texts and messages of errors."""
    if isinstance(node, ast.expr):
        yield node
    if isinstance(node, ast.Raise | ast.JoinedStr):
        return
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in NOT_CODE:
                yield from _expressions(child)


def _changed(node: ast.expr) -> Iterator[ast.expr]:
    """What can stand in place of an expression: another sign, order, condition, comparison or
    constant.
    """
    match node:
        case ast.BinOp(left, operator, right) if type(operator) in SIGNS:
            yield ast.BinOp(left, SIGNS[type(operator)](), right)
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield operand
        case ast.Call(function, arguments, keywords):
            for exchanged in _exchanged(arguments):
                yield ast.Call(function, exchanged, keywords)
        case ast.BoolOp(operator, values):
            for i in range(len(values)):
                left = [*values[:i], *values[i + 1 :]]
                yield ast.BoolOp(operator, left) if len(left) > 1 else left[0]
        case ast.Compare(left, [operator], right):
            yield ast.Compare(left, [COMPARISONS[type(operator)]()], right)
        case ast.IfExp(_, body, orelse):
            yield from (body, orelse)
        case ast.Constant(bool() | int() | float() as value):
            yield ast.Constant(_other(value))


def _exchanged(arguments: list[ast.expr]) -> Iterator[list[ast.expr]]:
    """Two neighbouring arguments of a call change places, each pair in turn."""
    if not any(isinstance(argument, ast.Starred) for argument in arguments):
        for i in range(len(arguments) - 1):
            yield [*arguments[:i], arguments[i + 1], arguments[i], *arguments[i + 2 :]]


def _other(value: float) -> float:
    """Another number of the same type."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else 2.0 * value or 1.0


def tests_of(file: Path) -> str:
    """The tests of a file: the file or the nearest folder of the same name, relative to the
    root.
    """
    package, *folders = file.with_suffix("").parts
    mirrored = Path("tests", package.removeprefix("limslam_"), *folders)
    if (ROOT / (own := mirrored.with_name(f"test_{mirrored.name}.py"))).exists():
        return str(own)
    return str(next(folder for folder in mirrored.parents if (ROOT / folder).exists()))


def _passes(checkout: Path, tests: list[str]) -> bool:
    """Whether tests pass in a copy of the checkout. Tests that do not end have noticed something,
    too.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-n0", "-p", "no:cacheprovider", *tests]
    settings = {
        "cwd": checkout,
        "env": {**os.environ, "PYTHONPATH": str(checkout)},
        "timeout": LONGEST_S,
    }
    try:
        return subprocess.run(command, **settings, capture_output=True, check=False).returncode == 0
    except subprocess.TimeoutExpired:
        return False


def main() -> int:
    """Print each mutation with what the tests did, and return how many survived."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "paths", nargs="+", type=Path, help="files or folders of the source, relative to the root"
    )
    parser.add_argument("--number", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--tests", nargs="+", help="tests to run; left out, those in the folder of the same name"
    )
    options = parser.parse_args()
    files = sorted(
        file for path in options.paths for file in ([path] if path.suffix else path.rglob("*.py"))
    )
    found = [mutation for file in files for mutation in mutations(file)]
    drawn = [
        found[i]
        for i in np.random.default_rng(options.seed).permutation(len(found))[: options.number]
    ]
    survived = []
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder, "checkout")
        shutil.copytree(ROOT, checkout, ignore=shutil.ignore_patterns(".*", "__pycache__"))
        if not _passes(checkout, options.tests or [*{tests_of(one.file) for one in drawn}]):
            parser.error("these tests fail without a mutation")
        for one in drawn:
            (checkout / one.file).write_text(one.applied(), encoding="utf-8")
            survived.append(_passes(checkout, options.tests or [tests_of(one.file)]))
            shutil.copy2(ROOT / one.file, checkout / one.file)
            sys.stderr.write(f"{'survived' if survived[-1] else 'died'} {one}\n")
    sys.stderr.write(f"{survived.count(False)} of {len(drawn)} died\n")
    return sum(survived)


if __name__ == "__main__":
    sys.exit(main())
