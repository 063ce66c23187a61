"""Policies from a Python file that the user names: ``FILE.py:NAME``, a class or a function that
makes a policy.
"""

import importlib.util
import inspect
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.policy import Policy
from limslam_agent.policies.target_policy import TargetPolicy
from limslam_agent.runs.actor_checks import acts_on_belief
from limslam_env.interface import RobotSpec

_INSTALLED = ("limslam_agent", "limslam_env")
_PACKAGES = "site-packages"  # folder of packages, which lies beside the policy in some projects

OFFERED = ("robot", "config", "seed")
"""Arguments that a class or a function may take, each by its name. None of them has to be taken."""


class PolicyFileError(ValueError):
    """A policy cannot be loaded from its file, or code in the file has raised an error. The message
    names the line.
    """


def is_file_policy(policy: str) -> bool:
    """Whether a policy is named by a file, and not by its name."""
    return ".py:" in policy or policy.endswith(".py")


def short_name(policy: str) -> str:
    """The name of a policy, and for a file the name without the folder: ``mine.py:Turn``."""
    if not is_file_policy(policy):
        return policy
    path, name = file_and_name(policy)
    return f"{path.name}:{name}"


def file_and_name(policy: str) -> tuple[Path, str]:
    """The file, and the name of the class or the function in it."""
    path, _, name = policy.rpartition(":")
    if not path.endswith(".py"):
        raise PolicyFileError(
            f"{policy}: the name of the policy in the file is missing: FILE.py:CLASS"
        )
    if not name.isidentifier():
        raise PolicyFileError(f"{policy}: {name!r} cannot be the name of a class or a function")
    if not Path(path).is_file():
        raise PolicyFileError(f"{path}: no such file")
    return Path(path), name


def file_policies(
    policy: str, robot: RobotSpec, config: PolicyConfig, *, robots: int, seed: int
) -> list[Policy]:
    """A new policy of a file for each robot. Each has its own random generator as ``seed``."""
    path, name = file_and_name(policy)
    made = made_by_file(policy, robot, config, robots=robots, seed=seed)
    with naming_lines_of(policy):
        return [_checked(each, f"{path}: {name}") for each in made]


def made_by_file(
    policy: str, robot: RobotSpec, config: PolicyConfig, *, robots: int, seed: int
) -> list[Any]:
    """What a class or a function of a file makes for each robot, which may be a policy or an actor.
    A planner that only chooses targets (``target(grid, pose)``) is made a policy.

    Raises
    ------
    PolicyFileError
        If the file cannot be loaded, or has nothing by that name that can be called.
    """
    path, name = file_and_name(policy)
    with naming_lines_of(policy):
        try:
            module = _loaded(path)
        # What is no text in UTF-8, or holds a byte 0, has no line that an error could name.
        except (SyntaxError, ValueError) as error:
            raise PolicyFileError(
                f"{_place_in_file(error, policy) or path}: {_words(error)}"
            ) from error
        maker = _maker(module, path, name)
        made = [
            maker({"robot": robot, "config": config, "seed": np.random.default_rng([seed, number])})
            for number in range(robots)
        ]
    return [
        TargetPolicy(each, robot, config)
        if hasattr(each, "target") and not hasattr(each, "act")
        else each
        for each in made
    ]


@contextmanager
def naming_lines_of(policy: str) -> Iterator[None]:
    """Turn an error that code of a policy's file raises into one line with its place, also one that
    would end the program. Other errors are unchanged.

    Raises
    ------
    PolicyFileError
        For any error that has passed through a line of the file, and if the working folder is
        another one than before.
    """
    if not is_file_policy(policy):
        yield
        return
    folder = Path.cwd()
    try:
        yield
    except (KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # a policy may raise anything
        place = _place_in_file(error, policy)
        if place is None or is_termination(error):
            raise
        raise PolicyFileError(f"{place}: {_words(error)}") from error
    finally:
        has_moved = Path.cwd() != folder
        os.chdir(folder)
    if has_moved:
        raise PolicyFileError(
            f"{file_and_name(policy)[0]}: has changed the working folder, which must stay as it is"
        )


def is_termination(error: BaseException) -> bool:
    """Whether an error comes from a signal that has asked the program to end. The exit code is then
    128 and the number of the signal.
    """
    return isinstance(error, SystemExit) and isinstance(error.code, int) and error.code > 128


def _words(error: BaseException) -> str:
    """The kind of an error and what it says. An error of a policy may fail to say anything."""
    try:
        said = str(error)
    except Exception:  # noqa: BLE001 (as above)
        said = ""
    return f"{type(error).__name__}: {said}".rstrip(": ")


def _place_in_file(error: BaseException, policy: str) -> str | None:
    """The last line of a policy's file that an error has passed through. None if there is no such
    line.
    """
    path = str(policy.rpartition(":")[0])
    absolute = str(Path(path).absolute())
    if isinstance(error, SyntaxError) and error.filename == absolute and error.lineno:
        return f"{path}, line {error.lineno}"
    frames = [
        frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == absolute
    ]
    if not frames:
        return None
    where = "" if frames[-1].name == "<module>" else f", in {frames[-1].name}"
    return f"{path}, line {frames[-1].lineno}{where}"


def files_of(policy: str) -> dict[Path, Path]:
    """The policy's file, and the files in its folder that were imported in this process, by their
    paths in that folder.
    """
    path, _ = file_and_name(policy)
    folder = path.absolute().parent
    files = {Path(path.name): path}
    for name, module in list(sys.modules.items()):
        place = Path(getattr(module, "__file__", None) or "")
        is_own = name.partition(".")[0] not in _INSTALLED and _PACKAGES not in place.parts
        if is_own and not name.startswith("__") and place.is_relative_to(folder):
            files[place.relative_to(folder)] = place
    return files


def _loaded(path: Path) -> ModuleType:
    """The module of a file. Like a script, it can import files that lie beside it."""
    place = path.absolute()
    if str(place.parent) not in sys.path:
        sys.path.insert(0, str(place.parent))
    name = f"_limslam_policy_{place.stem}"
    spec = importlib.util.spec_from_file_location(name, place)
    assert spec is not None  # noqa: S101 (the suffix is .py)
    assert spec.loader is not None  # noqa: S101
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def _maker(module: ModuleType, path: Path, name: str) -> Callable[[dict[str, Any]], Any]:
    """Calls a class or a function of a file with those of the offered arguments that it takes."""
    maker = getattr(module, name, None)
    if maker is None:
        raise PolicyFileError(f"{path}: has no class and no function {name}")
    if not (inspect.isclass(maker) or inspect.isfunction(maker)):
        raise PolicyFileError(
            f"{path}: {name} is neither a class nor a function that makes a policy"
        )
    parameters = inspect.signature(maker).parameters.values()
    named = {
        part.name
        for part in parameters
        if part.kind in {part.POSITIONAL_OR_KEYWORD, part.KEYWORD_ONLY}
    }
    needed = [
        part.name
        for part in parameters
        if part.default is part.empty and part.name in named - set(OFFERED)
    ]
    if needed:
        raise PolicyFileError(
            f"{path}: {name} needs the argument {needed[0]}: a policy is made without arguments, "
            f"or with some of {', '.join(OFFERED)}"
        )
    return lambda offered: maker(**{key: value for key, value in offered.items() if key in named})


def _checked(policy: Any, label: str) -> Policy:
    try:
        is_one = acts_on_belief(policy)
    except ValueError as error:
        raise PolicyFileError(f"{label}: {error}") from error
    if not is_one:
        raise PolicyFileError(
            f"{label} makes no policy: a policy has act(belief), stop_reason and plan"
        )
    made: Policy = policy
    return made
