"""A faster way through numba's compiler: machine code is made only of the functions that Python
calls.

numba optimises each function and makes machine code of it, and does both again for every function
that calls it. Here a function that is compiled for another one stays as it is until it is linked
into a function that Python calls. If Python calls the inner function later, its machine code is
made then. The results are the same, since neither way changes the order of floating-point
operations.

This uses parts of numba that are not public. ``limslam_env.compilation`` uses it for the versions
of numba that it was tried with, and compiles as usual with others. All changes to numba's objects
last for one compilation: they are made under numba's compiler lock, and undone when the function is
done. Loading code from disk meanwhile is numba's own.
"""

import contextlib
import functools
from collections.abc import Callable, Iterator
from typing import Any

from llvmlite.binding import newpassmanagers
from numba.core import (
    codegen,
    compiler,
    compiler_machinery,
    cpu,
    dispatcher,
    errors,
    ir,
    ir_utils,
    lowering,
    postproc,
    targetconfig,
    transforms,
    typed_passes,
    types,
)
from numba.core.compiler_lock import global_compiler_lock
from numba.core.environment import lookup_environment
from numba.core.types import functions
from numba.extending import overload
from numba.np import arrayobj


class _Kernel(codegen.JITCodeLibrary):
    """Code of a function that Python calls."""

    def _optimize_functions(self, ll_module: Any) -> None:
        """Make the code shorter. All that numba does here is done again once the functions inside
        are linked.
        """
        target = self._codegen
        ll_module.data_layout = target._data_layout  # noqa: SLF001
        passes = newpassmanagers.create_new_module_pass_manager()
        passes.add_sroa_pass()
        passes.add_simplify_cfg_pass()
        passes.add_instruction_combine_pass()
        passes.run(ll_module, target._pass_builder(opt=0))  # noqa: SLF001


class _Library(_Kernel):
    """Code of a function that is handed on to the functions that call it, without machine code."""

    wrapped: tuple[Any, ...] | None = None
    """What numba's wrapper for calls from Python is made of: context, description, environment,
    helper, lock.
    """
    _has_machine_code = False

    def _optimize_final_module(self) -> None:
        """Leave the optimisation to the caller's library."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> Any:
        """The address of a function; the machine code is made at the first question."""
        self._ensure_finalized()
        if not self._has_machine_code:
            self._has_machine_code = True
            super()._optimize_final_module()
            super()._finalize_final_module()
        return super().get_pointer_to_function(name)


class _Later:
    """Takes the place of the machine code of a function, and makes it when Python calls the
    function.
    """

    def __init__(self, library: _Library) -> None:
        self.library = library

    def __call__(self, *arguments: Any) -> Any:
        return self._code(*arguments)

    @functools.cached_property
    def _code(self) -> Any:
        if self.library.wrapped is None:
            raise RuntimeError(
                f"{self.library.name!r} was compiled for calls from other compiled functions only"
            )
        context, description, environment, helper, release_gil = self.library.wrapped
        with global_compiler_lock:
            library = _Kernel(context.codegen(), self.library.name)
            library.add_linking_library(self.library)
            context.create_cpython_wrapper(
                library, description, environment, helper, release_gil=release_gil
            )
            code = _executable(context, library, description, environment)
            # Functions that are compiled from now on find this one by its machine code.
            context.insert_user_function(code, description, [self.library])
        return code


_usual_executable = cpu.CPUContext.get_executable
_add_overload = dispatcher.Dispatcher.add_overload
_create_wrapper = lowering.Lower.create_cpython_wrapper


def _executable(context: Any, library: Any, description: Any, environment: Any) -> Any:
    """What Python calls. The environments of all functions inside of it are set, as numba does for
    code from disk.
    """
    if isinstance(library, _Library):
        return _Later(library)
    code = _usual_executable(context, library, description, environment)
    for variable in library._final_module.global_variables:  # noqa: SLF001
        known = (
            lookup_environment(variable.name) if variable.name.startswith("_ZN08NumbaEnv") else None
        )
        if known is not None:
            library.codegen.set_env(variable.name, known)
    return code


def _insert(owner: Any, made: Any) -> None:
    """Keep what was compiled with its function. Python does not find machine code that does not
    exist yet.
    """
    if isinstance(made.entry_point, _Later):
        owner.overloads[tuple(made.signature.args)] = made
    else:
        _add_overload(owner, made)


def _wrap(lower: Any, release_gil: Any) -> None:
    """Write the wrapper for calls from Python, or remember what it needs."""
    if isinstance(lower.library, _Library) and not lower.genlower:
        lower.library.wrapped = (
            lower.context,
            lower.fndesc,
            lower.env,
            lower.call_helper,
            release_gil,
        )
        return
    _create_wrapper(lower, release_gil)


def _wrap_for_c(lower: Any) -> None:
    """Write no wrapper for calls from C: nothing calls kernels from there."""


_usual_statement = lowering.Lower.lower_inst


def _is_borrowed(lower: Any, name: str) -> bool:
    """Whether a variable is an argument, or part of a tuple that is one. The caller holds these
    until the function returns.
    """
    known = lower.definitions[name]
    value = known[0] if len(known) == 1 else None
    if isinstance(value, ir.Expr) and value.op in ("getattr", "static_getitem"):
        value = value.value if isinstance(lower.typeof(value.value.name), types.BaseTuple) else None
    if isinstance(value, ir.Var):
        return _is_borrowed(lower, value.name)
    return isinstance(value, ir.Arg)


def _write(lower: Any, statement: Any) -> None:
    """Write the code of a statement, which counts no references to what the caller holds. numba
    counts them for each variable, and threads that share an array wait for each other to do so.
    """
    if not hasattr(lower, "definitions"):
        lower.definitions = ir_utils.build_definitions(lower.blocks)
    name = None
    if isinstance(statement, ir.Assign):
        name = statement.target.name
    elif isinstance(statement, ir.Del):
        name = statement.value
    if name is None or not _is_borrowed(lower, name):
        _usual_statement(lower, statement)
        return
    with _replaced(lower.context.nrt, incref=_nothing, decref=_nothing):
        _usual_statement(lower, statement)


def _nothing(*arguments: Any) -> None:
    """Take the place of the counting of references."""


def _raise_of_shapes(source: Any, target: Any) -> Any:
    """Take the place of numba's error about unequal shapes, which is 25 functions, since its
    message has both.
    """
    raise NotImplementedError


@overload(_raise_of_shapes)
def _shape_error(source: Any, target: Any) -> Any:
    """The compiled form of this error."""
    del source, target

    def fail(source: Any, target: Any) -> Any:  # noqa: ARG001
        raise ValueError("cannot assign slice from input of different size")

    return fail


_usual_equal = compiler.Flags.__eq__


_OPTIONS_HASH: int = hash(compiler.Flags())


def _hash(options: Any) -> int:
    """The hash of compiler options: numba makes it of their names only, and computes it anew each
    time.
    """
    del options
    return _OPTIONS_HASH


def _equal(first: Any, second: Any) -> Any:
    """Whether compiler options are equal; only those that differ from their defaults are
    compared.
    """
    if type(first) is not type(second):
        return _usual_equal(first, second)
    ours = first._values  # noqa: SLF001
    theirs = second._values  # noqa: SLF001
    if ours == theirs:
        return True
    defaults = first.options
    return all(
        ours.get(name, defaults[name].default) == theirs.get(name, defaults[name].default)
        for name in {**ours, **theirs}
    )


_usual_call_type = functions.BaseFunction.get_call_type
_call_types: dict[tuple[Any, ...], Any] = {}


def _call_type(function: Any, context: Any, arguments: Any, named: Any) -> Any:
    """Types of a call of a function of numba's own, which numba works out anew for each call."""
    key = function, arguments, tuple(named.items()), targetconfig.ConfigStack.top_or_none()
    known = _call_types.get(key)
    if known is None:
        known = _usual_call_type(function, context, arguments, named)
        if known is not None and known.return_type.is_precise():
            _call_types[key] = known
    return known


_usual_lifetimes = postproc.PostProcessor.run


def _lifetimes(processor: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:  # noqa: FBT002
    """Where variables are alive: numba works it out after each step, and only generators and the
    last step ask.
    """
    code = processor.func_ir
    if emit_dels or code.is_generator:
        _usual_lifetimes(processor, emit_dels, extend_lifetimes)
        return
    code.blocks = transforms.canonicalize_cfg(code.blocks)
    code.variable_lifetime = postproc.VariableLifetime(code.blocks)
    code.generator_info = None


def _without_colour(scheme: Any, message: str, *colours: Any) -> str:
    """Leave an error message as it is: numba writes thousands of them while it tries which
    functions fit.
    """
    del scheme, colours
    return message


@contextlib.contextmanager
def _replaced(holder: Any, **values: Any) -> Iterator[None]:
    missing = object()
    before = {name: vars(holder).get(name, missing) for name in values}
    for name, value in values.items():
        setattr(holder, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is missing:
                delattr(holder, name)
            else:
                setattr(holder, name, value)


@contextlib.contextmanager
def _linking(target: Any) -> Iterator[None]:
    """Let numba link what it compiles on the way, functions of its own included."""

    def create(name: str, **options: Any) -> Any:
        return _Library(target, name, **options)

    def load(serialized: Any) -> Any:
        with _replaced(
            target, create_library=functools.partial(type(target).create_library, target)
        ):
            return type(target).unserialize_library(target, serialized)

    with (
        _replaced(target, create_library=create, unserialize_library=load),
        _replaced(cpu.CPUContext, get_executable=_executable),
        _replaced(dispatcher.Dispatcher, add_overload=_insert),
        _replaced(lowering.Lower, create_cpython_wrapper=_wrap, create_cfunc_wrapper=_wrap_for_c),
        _replaced(lowering.Lower, lower_inst=_write),
        _replaced(functions.BaseFunction, get_call_type=_call_type),
        _replaced(postproc.PostProcessor, run=_lifetimes),
        _replaced(arrayobj, raise_with_shape_context=_raise_of_shapes),
        _replaced(compiler.Flags, __hash__=_hash, __eq__=_equal),
        _replaced(type(errors.termcolor()), _markup=_without_colour),
    ):
        yield


@compiler_machinery.register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(typed_passes.NativeLowering):
    """The step that writes the code of a function that Python calls: into a library with machine
    code.
    """

    _name = "limslam_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _Kernel(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


class InnerPipeline(compiler.CompilerBase):
    """Compiles a function for other compiled functions; if Python calls it first, it is compiled as
    a kernel.
    """

    is_kernel = False
    depth = 0

    def define_pipelines(self) -> list[Any]:
        """The steps of numba's own pipeline."""
        steps = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        if self.is_kernel or InnerPipeline.depth == 1:
            steps.passes = [
                (_Lowering if step is typed_passes.NativeLowering else step, name)
                for step, name in steps.passes
            ]
            steps.finalize()
        return [steps]

    def _compile_core(self) -> Any:
        # A function is compiled while its caller is. One thread compiles at a time.
        InnerPipeline.depth += 1
        try:
            if InnerPipeline.depth > 1:
                return super()._compile_core()
            with _linking(self.state.targetctx.codegen()):
                return super()._compile_core()
        finally:
            InnerPipeline.depth -= 1


class KernelPipeline(InnerPipeline):
    """Compiles a function that Python calls."""

    is_kernel = True


def compile_or_retry(
    part: Any, compile_core: Callable[..., Any], arguments: Any, *, is_kernel: bool
) -> Any:
    """Compile a function, which Python calls or not, here, or as numba does by itself if that
    fails.

    ``compile_core`` is the method of ``part``, the function's compiler, that compiles with these
    arguments.
    """
    part.pipeline_class = KernelPipeline if is_kernel else InnerPipeline
    try:
        return compile_core(*arguments)
    except errors.TypingError:
        raise
    except Exception:
        if InnerPipeline.depth:
            raise
        part.pipeline_class = compiler.Compiler
        return compile_core(*arguments)
