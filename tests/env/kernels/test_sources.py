"""What compiled kernels are made of: every module whose functions or constants they use is in their stamp."""

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

from limslam_env.compilation import ENV_SOURCES
from limslam_env.kernels import batch_step


def modules_of(source: str) -> list[str]:
    """The modules of a package, or the module itself."""
    spec = find_spec(source)
    if not spec.submodule_search_locations:
        return [source]
    return [source, *(f"{source}.{path.stem}" for path in Path(spec.origin).parent.glob("*.py"))]


def project_imports(module: str) -> set[str]:
    spec = find_spec(module)
    found = set()
    for node in ast.walk(ast.parse(Path(spec.origin).read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("limslam_"):
            found.add(node.module)
    return found


@pytest.mark.parametrize("source", ENV_SOURCES)
def test_the_sources_import_nothing_beyond_themselves(source):
    known = {module for each in ENV_SOURCES for module in modules_of(each)}
    modules = [module for module in modules_of(source) if not module.endswith("__init__")]
    assert modules
    # What is said while something is compiled changes no code.
    assert set().union(*map(project_imports, modules)) - known - {"limslam_env.messages"} == set()


def test_the_step_of_a_batch_is_in_the_sources():
    assert batch_step.__name__ in {module for each in ENV_SOURCES for module in modules_of(each)}
