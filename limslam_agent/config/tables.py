"""Settings as TOML tables: read with the checks of their dataclasses, and written."""

import types
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, Field, asdict, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from limslam_agent.safe_files import read_limited

T = TypeVar("T")
Table = Mapping[str, Any]

MAX_FILE_BYTES = 1_000_000

_PLAIN = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    Path: "a text",
}


class SettingsError(ValueError):
    """A file of settings that cannot be used; the message names the file and the key."""

    def __init__(self, message: str) -> None:
        # The command line imports this module, but not the simulator.
        from limslam_env.messages import one_line

        super().__init__(one_line(message))


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file. Raises a SettingsError if there is no such file, or it is not
    TOML.
    """
    # The command line imports this module, but not the simulator.
    from limslam_env.toml_text import read_toml_text

    try:
        return read_toml_text(
            read_limited(path, MAX_FILE_BYTES).decode("utf-8-sig").replace("\r\n", "\n")
        )
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from error


def write_toml(path: Path, table: Table, comment: str) -> None:
    """Write a table, with a line of comment above it. Settings that are None are left out, since
    TOML has no null.
    """
    import tomli_w

    path.write_text(f"# {comment}\n{tomli_w.dumps(_without_none(table))}", encoding="utf-8")


def table_of(settings: Any) -> dict[str, Any]:
    """A dataclass as a table, with the dataclasses in it as tables."""
    return asdict(settings)


def updated(settings: T, table: Any, where: str, fixed: Collection[str] = ()) -> T:
    """Settings with the values of a table in place of their own.

    Parameters
    ----------
    settings
        A frozen dataclass. A table for a dataclass inside of it changes only the values that the
        table has.
    table
        The values by their names.
    where
        File and key of the table, for messages: ``run.toml: agent.grid``.
    fixed
        Names of settings that the table must not have.

    Raises
    ------
    SettingsError
        If a key is unknown, or a value has a wrong type or is impossible.
    """
    every = {name: getattr(settings, name) for name in _hints(type(settings))}
    current = {name: value for name, value in every.items() if name not in fixed}
    return _made(
        type(settings), every | _converted_table(type(settings), table, where, current), where
    )


def built(kind: type[T], table: Any, where: str) -> T:
    """A dataclass from a table that has at least the values without defaults. Raises a
    SettingsError if a key is unknown or missing, or a value has a wrong type or is impossible;
    ``where`` is the file and the key.
    """
    values = _converted_table(kind, table, where, dict.fromkeys(_hints(kind)))
    for field in _fields(kind):
        has_default = field.default is not MISSING or field.default_factory is not MISSING
        if field.name not in values and not has_default:
            raise SettingsError(f"{_key(where, field.name)}: is missing")
    return _made(kind, values, where)


def _made(kind: type[T], values: dict[str, Any], where: str) -> T:
    try:
        return kind(**values)
    except ValueError as error:
        raise SettingsError(f"{where}: {error}") from error


def _converted_table(kind: type[Any], table: Any, where: str, current: Table) -> dict[str, Any]:
    if not isinstance(table, Mapping):
        raise SettingsError(f"{where}: must be a table, not {table!r}")
    hints = _hints(kind)
    for name in table:
        if name not in current:
            raise SettingsError(
                f"{_key(where, name)}: there is no such setting; there are {', '.join(current)}"
            )
    return {
        name: _converted(hints[name], value, _key(where, name), current[name])
        for name, value in table.items()
    }


def _converted(hint: Any, value: Any, where: str, current: Any = None) -> Any:
    """A TOML value as the type that a hint names; ``current`` is the setting's value so far."""
    kinds = get_args(hint)
    if value is None and type(None) in kinds:
        return None
    if is_dataclass(current):
        return updated(current, value, where)
    if is_dataclass(hint) and isinstance(hint, type):
        return built(hint, value, where)
    if get_origin(hint) in {Union, types.UnionType}:
        return _converted_union([kind for kind in kinds if kind is not type(None)], value, where)
    if get_origin(hint) is tuple:
        return _converted_list(kinds, value, where)
    if get_origin(hint) is Literal and value not in kinds:
        raise _refusal(where, f"one of {', '.join(map(str, kinds))}", value)
    return value if get_origin(hint) is Literal else _converted_plain(hint, value, where)


def _converted_plain(hint: Any, value: Any, where: str) -> Any:
    if hint is float and type(value) is int:
        try:
            return float(value)
        except OverflowError:
            raise _refusal(where, "smaller", value) from None
    if type(value) is not (str if hint is Path else hint):
        raise _refusal(where, _PLAIN.get(hint, "a text"), value)
    return Path(value) if hint is Path else value


def _converted_union(kinds: Sequence[Any], value: Any, where: str) -> Any:
    for kind in kinds[:-1]:
        try:
            return _converted(kind, value, where)
        except SettingsError:
            continue
    return _converted(kinds[-1], value, where)


def _converted_list(kinds: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise _refusal(where, "a list", value)
    kinds = kinds[:1] * len(value) if kinds[1:] == (Ellipsis,) else kinds
    if len(kinds) != len(value):
        raise SettingsError(f"{where}: must have {len(kinds)} values, not {len(value)}")
    return tuple(
        _converted(kind, each, f"{where}[{number}]")
        for number, (kind, each) in enumerate(zip(kinds, value, strict=True))
    )


def _refusal(where: str, words: str, value: Any) -> SettingsError:
    from limslam_env.messages import described

    return SettingsError(f"{where}: must be {words}, not {described(value)}")


def _key(where: str, name: str) -> str:
    """The key of a value in a table; the table of a whole file has a file's name, but no key."""
    return f"{where}.{name}" if ": " in where else f"{where}: {name}"


def _hints(kind: type[Any]) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in _fields(kind)}


def _fields(kind: type[Any]) -> tuple[Field[Any], ...]:
    return tuple(field for field in fields(kind) if field.init)


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _without_none(each) for name, each in value.items() if each is not None}
    return value
