"""The length of functions: a function that fits on a screen can be read at once."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMPILED = ("limslam_env/kernels/", "limslam_agent/slam/batch/")
LONGEST = 60


def functions_of(top: str) -> dict[str, int]:
    """Functions outside compiled kernels, by file and name, and the lines of their bodies."""
    found = {}
    for path in sorted((ROOT / top).rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if name.startswith(COMPILED):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                found[f"{name}:{node.name}:{node.lineno}"] = lines_of(node)
    return found


def lines_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function's body. Signatures declare, like the options of a command, and are not counted."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return body[-1].end_lineno - body[0].lineno + 1 if body else 0


@pytest.mark.parametrize("top", ["limslam_env", "limslam_agent", "benchmarks"])
def test_no_function_is_longer_than_a_screen(top):
    if not (ROOT / top).is_dir():
        pytest.skip("there is only the installed package")
    functions = functions_of(top)
    assert len(functions) > 100
    assert {name: length for name, length in functions.items() if length > LONGEST} == {}


def test_signature_and_docstring_do_not_count():
    tree = ast.parse(
        'def function(\n    value,\n):\n    """One.\n\n    Two.\n    """\n    value += 1\n    return value\n'
    )
    assert lines_of(tree.body[0]) == 2
