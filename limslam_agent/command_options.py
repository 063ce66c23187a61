"""Commands whose options are the fields of a dataclass."""

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args, get_type_hints

import typer

from limslam_agent.config.help import Help

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


def takes(kind: type[Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Make a function a command that has the options of a dataclass, and then those of its own
    named arguments.

    The function gets the options of the dataclass as keyword arguments, None for those that were
    not given.
    """

    def decorated(function: Callable[..., Any]) -> Callable[..., Any]:
        own = [
            each.replace(
                kind=each.KEYWORD_ONLY, annotation=_with_option(each.name, each.annotation)
            )
            for each in inspect.signature(function).parameters.values()
            if each.kind is not each.VAR_KEYWORD
        ]

        @functools.wraps(function)
        def command(**arguments: Any) -> Any:
            return function(**arguments)

        parameters = [*_declared(kind), *own]
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined] # what typer looks at
        command.__annotations__ = {each.name: each.annotation for each in parameters}
        return command

    return decorated


def with_told(options: T, told: Mapping[str, Any]) -> T:
    """Options with those that were given in place of their own. An error names the option."""
    for name, value in told.items():
        if value is None:
            continue
        changed: dict[str, Any] = {name: value}
        try:
            options = replace(options, **changed)
        except ValueError as error:
            words = str(error).removeprefix(name)
            raise ValueError(f"--{name.replace('_', '-')}{words}") from error
    return options


def _declared(kind: type[Any]) -> list[inspect.Parameter]:
    """The arguments of a function that typer makes the options of a dataclass of."""
    hints = get_type_hints(kind, include_extras=True)
    options = {
        field.name: _with_option(field.name, hints[field.name], field.default)
        for field in fields(kind)
    }
    return [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=hint)
        for name, hint in options.items()
        if any(isinstance(each, typer.models.OptionInfo) for each in get_args(hint))
    ]


def _with_option(name: str, hint: Any, default: Any = None) -> Any:
    """The annotation of an argument, with an option of typer in place of its `Help`."""
    plain, *extras = get_args(hint) if hasattr(hint, "__metadata__") else (hint,)
    said = next((each for each in extras if isinstance(each, Help)), None)
    if said is None:
        return hint
    shown = said.default
    if shown is True and default in (None, False):
        shown = False
    if shown is True:
        shown = f"{default:g}" if isinstance(default, float) else str(default)
    # Nothing is said to switch a bool off.
    names = [said.name or f"--{name.replace('_', '-')}"] if said.name or plain is bool else []
    option = typer.Option(*names, help=said.words, rich_help_panel=said.panel, show_default=shown)
    return Annotated[plain | None, option]
