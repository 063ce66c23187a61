"""Compiled code that is kept on disk: it is used again, and made anew when anything that it
contains has changed.
"""

import ast
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from limslam_env.compilation import ENV_SOURCES, compiled, source_stamp
from limslam_env.geometry import FloatArray
from limslam_env.kernels import batch_step

CALLED = """from limslam_env.compilation import compiled
from kernel_package.constants import FACTOR

@compiled
def times(number):
    return FACTOR * number
"""
CALLS = """from limslam_env.compilation import entry_of
from kernel_package.called import times

@entry_of("kernel_package")
def doubled(number):
    return times(number) + 1
"""
MAIN = """from kernel_package.calls import doubled
result = doubled(20)
print(result, sum(doubled.stats.cache_hits.values()), int("limslam_env.linking" in sys.modules))
"""


def write_package(parent: Path) -> Path:
    folder = parent / "kernel_package"
    folder.mkdir()
    texts = {"__init__": "", "constants": "FACTOR = 2\n", "called": CALLED, "calls": CALLS}
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def package(tmp_path):
    return write_package(tmp_path)


@pytest.fixture(scope="module")
def once(tmp_path_factory):
    """The package after one interpreter has compiled its kernel."""
    folder = write_package(tmp_path_factory.mktemp("once"))
    assert called_anew(folder) == [41, 0, 1]
    return folder


@pytest.fixture
def kept(once, tmp_path):
    """A copy of the package with its compiled code."""
    return shutil.copytree(once, tmp_path / once.name)


def called_anew(package) -> list[int]:
    """What a kernel returns in a new interpreter, whether it came from the disk, and if the
    compiler was loaded.
    """
    code = f"import sys\nsys.path.insert(0, {str(package.parent)!r})\n{MAIN}"
    command = [sys.executable, "-B", "-c", code]
    output = subprocess.run(
        command, check=True, capture_output=True, text=True, cwd=package.parent
    ).stdout
    return [int(number) for number in output.split()]


def test_a_change_of_what_a_kernel_calls_or_of_a_constant_makes_its_cache_stale(package):
    assert called_anew(package) == [41, 0, 1]
    assert called_anew(package) == [41, 1, 0]
    (package / "constants.py").write_text("FACTOR = 3\n", encoding="utf-8")
    assert called_anew(package) == [61, 0, 1]
    (package / "called.py").write_text(CALLED.replace("*", "-"), encoding="utf-8")
    assert called_anew(package) == [-16, 0, 1]
    assert called_anew(package) == [-16, 1, 0]


def test_sources_that_do_not_exist_are_named():
    with pytest.raises(ModuleNotFoundError, match=r"limslam_env\.nothing"):
        source_stamp("limslam_env.nothing")


def test_by_numbas_public_interface_nothing_is_kept(package, monkeypatch):
    monkeypatch.setenv("LIMSLAM_PUBLIC_NUMBA", "1")
    assert called_anew(package) == [41, 0, 0]
    assert not list(package.rglob("*.nbi"))


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def with_zeros(content: bytes) -> bytes:
    """A file of the right size with a part that never reached the disk."""
    half = len(content) // 2
    return content[:half] + bytes(len(content) - half)


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize(
    "damaged",
    [
        cut,
        with_zeros,
        lambda content: content[:-1],
        lambda _: b"",
        lambda _: b"this is no compiled code",
        lambda content: bytes(len(content)),
    ],
    ids=["cut", "half zeros", "a byte short", "empty", "another text", "zeros"],
)
def test_a_damaged_file_is_as_good_as_an_absent_one(kept, ending, damaged):
    (path,) = kept.rglob(f"*doubled*.{ending}")
    path.write_bytes(damaged(path.read_bytes()))
    assert called_anew(kept) == [41, 0, 1]
    assert called_anew(kept) == [41, 1, 0]


def test_compiled_code_is_used_in_another_place(kept):
    assert called_anew(kept) == [41, 1, 0]


@pytest.mark.parametrize("place", [0.1, 0.5, 0.9])
def test_machine_code_with_a_wrong_byte_is_never_run(kept, place):
    (path,) = kept.rglob("*doubled*.nbc")
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= 0xFF
    path.write_bytes(content)
    assert called_anew(kept) == [41, 0, 1]


def test_a_kernel_runs_though_its_files_cannot_be_replaced(kept):
    for path in kept.rglob("*doubled*.nb?"):
        path.unlink()
        path.mkdir()
    assert called_anew(kept) == [41, 0, 1]


INNER = """import numpy as np
from limslam_env.compilation import compiled, entry_of, merged

@compiled
def largest(numbers):
    if len(numbers) == 0:
        raise ValueError("no numbers")
    best = numbers[0]
    for number in numbers:
        best = max(best, number)
    return best

@compiled
def after_first(numbers):
    rest = numbers[1:]
    return largest(rest)

@merged
def doubled(number):
    return 2.0 * number

@entry_of("inner_kernels")
def doubled_largest(numbers):
    return doubled(largest(numbers))

@entry_of("inner_kernels", allocates=False)
def largest_after(numbers):
    return after_first(numbers)

@entry_of("inner_kernels")
def largest_of_copy(numbers):
    return after_first(numbers.copy())

@entry_of("inner_kernels")
def copied(numbers, places):
    numbers[: len(places)] = places
    return doubled_largest(numbers) + largest(places)
"""


def run_inner(folder, statements) -> list[str]:
    """What statements print that use the kernels above, in a new interpreter."""
    (folder / "inner_kernels.py").write_text(INNER, encoding="utf-8")
    code = f"""
import sys
import numpy as np
sys.path.insert(0, {str(folder)!r})
{statements}"""
    command = [sys.executable, "-B", "-c", code]
    return subprocess.run(
        command, check=True, capture_output=True, text=True, cwd=folder
    ).stdout.splitlines()


LACKING = """
from numba.core import compiler, environment
del environment.lookup_environment
"""
BROKEN = """
from limslam_env import linking
def fail(*arguments):
    raise AttributeError("another numba")
linking._executable = fail
"""


@pytest.mark.parametrize(
    "before",
    ["", "import numba; numba.__version__ = '0.1.0'", LACKING, BROKEN],
    ids=["this numba", "an unknown numba", "a numba that lacks parts", "linking fails"],
)
def test_functions_inside_a_kernel_can_be_called_by_themselves(tmp_path, before):
    statements = f"""{before}
from inner_kernels import doubled_largest, largest
numbers = np.array([1.0, 5.0, 3.0])
print(doubled_largest(numbers), largest(numbers), largest(numbers), doubled_largest(numbers + 1))
print(largest(np.array([7, 8])), doubled_largest(np.array([4, 2])))
"""
    assert run_inner(tmp_path, statements) == ["10.0 5.0 5.0 12.0", "8 8.0"]


def test_kept_code_can_be_loaded_while_another_kernel_is_compiled(tmp_path):
    """Both kernels hold functions that may raise errors, whose environments are set when their code
    is loaded.
    """
    first = (
        "from inner_kernels import doubled_largest\nprint(doubled_largest(np.array([1.0, 5.0])))"
    )
    assert run_inner(tmp_path, first) == ["10.0"]
    statements = """
from inner_kernels import copied, doubled_largest, largest
def error(kernel, *arguments):
    try:
        kernel(*arguments)
    except ValueError as error:
        return error
print(copied(np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0])), doubled_largest(np.array([7.0])))
print(sum(doubled_largest.stats.cache_hits.values()), sum(copied.stats.cache_hits.values()))
for kernel in (doubled_largest, largest):
    print(error(kernel, np.zeros(0)))
print("cannot assign slice" in str(error(copied, np.zeros(1), np.zeros(2))))
"""
    expected = ["15.0 14.0", "1 0", "no numbers", "no numbers", "True"]
    assert run_inner(tmp_path, statements) == expected
    # All of it comes from the disk now.
    assert run_inner(tmp_path, statements) == [expected[0], "1 1", *expected[2:]]


def test_a_kernel_without_arrays_holds_a_function_that_was_compiled_for_one_with_arrays(tmp_path):
    statements = """
from inner_kernels import largest_after, largest_of_copy
numbers = np.array([7.0, 5.0, 3.0])
"""
    both = statements + "print(largest_of_copy(numbers), largest_after(numbers))"
    assert run_inner(tmp_path, both) == ["5.0 5.0"]
    # This interpreter does not load the kernel that makes arrays.
    assert run_inner(tmp_path, statements + "print(largest_after(numbers))") == ["5.0"]


def test_nothing_of_numba_stays_changed_after_a_compilation(tmp_path):
    statements = """
from numba.core import cpu, dispatcher, ir, lowering, postproc
from numba.core.registry import cpu_target
from numba.core.types import functions
from numba.np import arrayobj
import gc
codegen = cpu_target.target_context.codegen()
holders = (cpu.CPUContext, dispatcher.Dispatcher, lowering.Lower, codegen, arrayobj)
holders += (functions.BaseFunction, ir.Inst, postproc.PostProcessor)
before = [dict(vars(holder)) for holder in holders]
from inner_kernels import copied
copied(np.array([1.0, 2.0]), np.array([4.0]))
for holder, values in zip(holders, before):
    now = dict(vars(holder))
    names = {name for name in now.keys() | values.keys() if not name.startswith("__")}
    print([name for name in names if now.get(name) is not values.get(name)])
print(gc.isenabled())
"""
    assert run_inner(tmp_path, statements) == ["[]"] * 8 + ["True"]


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


class Pair(NamedTuple):
    """Two arrays."""

    first: FloatArray
    second: FloatArray


@compiled
def largest_part(pair: Pair, count: int) -> FloatArray:
    """A part of a pair, or a new array after ``count`` of them."""
    largest = pair.first
    for _ in range(count):
        other = pair.second
        if other.sum() > largest.sum():
            largest = other
        elif largest.sum() < 0.0:
            largest = largest + other
    return largest


@compiled
def through_another(pair: Pair, count: int) -> FloatArray:
    """The same by a function that is handed a new pair."""
    return largest_part(Pair(pair.second, pair.first), count)


@pytest.mark.parametrize("function", [largest_part, through_another])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_functions_count_the_references_that_they_keep_and_no_others(function, sign):
    pair = Pair(np.full(3, sign), np.full(3, 2.0 * sign))
    before = [sys.getrefcount(each) for each in pair]
    results = [function(pair, 4) for _ in range(3)]
    assert all((each == function.py_func(pair, 4)).all() for each in results)
    del results
    assert [sys.getrefcount(each) for each in pair] == before
