"""What kind of object an actor is, and whether it was made for the robot and the observations of an
environment.
"""

import inspect
from dataclasses import fields
from typing import Any

import gymnasium as gym
from gymnasium import spaces

from limslam_env.interface import RobotSpec
from limslam_env.messages import one_line


def check_actor(actor: Any, robot: RobotSpec, env: Any) -> None:
    """Refuse an actor that was made for another robot, or a model that was trained on observations
    of another form.

    ``env`` is the environment as the actor sees it, with all wrappers.
    """
    own = getattr(actor, "robot", None)
    if isinstance(own, RobotSpec) and own != robot:
        different = [
            part.name
            for part in fields(robot)
            if getattr(own, part.name) != getattr(robot, part.name)
        ]
        raise ValueError(
            f"{type(actor).__name__} was made for another robot than that of the environment "
            "(they differ in "
            f"{', '.join(different)}): give both the same robot, by the argument robot="
        )
    names = getattr(env, "possible_agents", None)
    _check_observations(
        actor, env.observation_space if names is None else env.observation_space(names[0])
    )


def _check_observations(actor: Any, seen: Any) -> None:
    trained = getattr(actor, "observation_space", None)
    if not (isinstance(trained, gym.Space) and isinstance(seen, gym.Space)) or _form(
        trained
    ) == _form(seen):
        return
    raise ValueError(
        one_line(
            f"{type(actor).__name__} was trained on other observations ({_described(trained)}) "
            "than the environment "
            f"gives ({_described(seen)}): pass the wrappers of the training by wrap=, for example "
            "wrap=SlamObservation"
        )
    )


def _form(space: Any) -> Any:
    """Keys and sizes of a space. The order of the axes is left out, because libraries move the axes
    of pictures.
    """
    if isinstance(space, spaces.Dict):
        return {key: _form(part) for key, part in space.items()}
    return sorted(space.shape or ())


def _described(space: Any) -> str:
    if isinstance(space, spaces.Dict):
        return ", ".join(f"{key} {part.shape}" for key, part in space.items())
    return f"shape {space.shape}"


def acts_on_belief(actor: Any, is_policy: bool | None = None) -> bool:
    """Whether an object is a policy, which acts on a belief, and not an actor, which acts on an
    observation.

    ``is_policy`` decides if it is known. Otherwise the name of the argument of ``act`` does:
    ``belief`` or ``observation``. With another name, an object is a policy if it has
    ``stop_reason`` and ``plan``.

    Raises
    ------
    ValueError
        If a policy is incomplete, or if nothing tells which of both the object is.
    """
    name = type(actor).__name__
    argument = first_argument(getattr(actor, "act", None))
    missing = [part for part in ("act", "stop_reason", "plan") if not hasattr(actor, part)]
    if is_policy if is_policy is not None else argument == "belief":
        if missing:
            reason = "policy= says so" if is_policy else "act takes a belief"
            raise ValueError(
                f"{name} is a policy, because {reason}, but it has no {' and no '.join(missing)}: "
                "write stop_reason = None and plan = np.zeros((0, 2)) in the class"
            )
        return True
    if is_policy is False or argument is None or argument.startswith("observation") or missing:
        return False
    if any(hasattr(actor, part) for part in ("reset", "done", "predict", "snapshot")):
        raise ValueError(
            f"{name} may be a policy or an actor: call the argument of act belief if it is a "
            "policy, "
            "and observation if it is an actor"
        )
    return True


def first_argument(act: Any) -> str | None:
    """The name of the first argument of a function. None if there is no such function, it cannot be
    called with one argument, or its arguments are unknown.
    """
    try:
        return next(iter(inspect.signature(act).bind(None).signature.parameters), None)
    except (TypeError, ValueError):
        return None
