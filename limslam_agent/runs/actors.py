"""Anything that can act, behind one protocol: from all robots' observations to all robots' actions."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from limslam_env.geometry import FloatArray

Observations = Mapping[str, Any]
Actions = Mapping[str, Any]


class Driver(Protocol):
    """Who drives the robots of an episode.

    Attributes
    ----------
    knows_its_end
        Whether it says itself when it is done.
    believer
        Who has a ``snapshot()`` of what is believed; None if nobody does.
    """

    knows_its_end: bool
    believer: Any

    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        """Begin again at known poses (3,), m, m, rad, of the robots by their names."""
        ...

    def act(self, observations: Observations) -> Actions:
        """Wheel speeds (2,) of each robot by its name."""
        ...

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        ...

    @property
    def stop_reason(self) -> str | None:
        """Why there is nothing left to do, where that is known."""
        ...


def driver_of(actor: Any, *, is_team: bool) -> Driver:
    """Who can drive as ``actor`` does: the robots of a team, or the only one.

    Raises
    ------
    ValueError
        If it cannot act.
    """
    if isinstance(actor, Mapping):
        if not is_team:
            raise ValueError("a dict of actors is for parallel environments; here one actor drives one robot")
        return _Each({name: driver_of(part, is_team=False) for name, part in actor.items()})
    if isinstance(actor, type):
        raise ValueError(f"{actor.__name__} is a class and cannot act: give an object of it")  # noqa: TRY004 (a value)
    if callable(getattr(actor, "act", None)):
        return _One(actor, actor.act, is_team=is_team)
    if callable(getattr(actor, "predict", None)):
        return _Model(actor)
    if callable(actor):
        return _One(actor, actor, is_team=is_team)
    raise ValueError(f"{type(actor).__name__} cannot act: it has no act, no predict, and is no function")


class _One:
    """One actor for all: of a team it is told everything at once, and a single robot's is told what that one sees."""

    def __init__(self, actor: Any, answer: Callable[[Any], Any], *, is_team: bool) -> None:
        self._actor, self._answer, self._is_team = actor, answer, is_team
        self.knows_its_end = hasattr(actor, "done")
        self.believer = actor if callable(getattr(actor, "snapshot", None)) else None

    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        reset = getattr(self._actor, "reset", None)
        if callable(reset):
            poses = np.array(list(start_poses.values()))
            reset(poses if self._is_team else poses[0], seed)

    def act(self, observations: Observations) -> Actions:
        if not self._is_team:
            return {name: self._answer(observation) for name, observation in observations.items()}
        actions = self._answer(observations)
        if not isinstance(actions, Mapping):
            raise ValueError(f"several robots need a dict of actions by their names, not {actions!r}")  # noqa: TRY004
        return actions

    @property
    def done(self) -> bool:
        return bool(getattr(self._actor, "done", False))

    @property
    def stop_reason(self) -> str | None:
        return getattr(self._actor, "stop_reason", None)


class _Model:
    """A model as Stable-Baselines3 has them; what a recurrent one remembers is kept for each robot."""

    knows_its_end, believer, done, stop_reason = False, None, False, None

    def __init__(self, model: Any) -> None:
        self._model = model
        self._states: dict[str, Any] = {}

    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        del start_poses, seed
        self._states = {}

    def act(self, observations: Observations) -> Actions:
        return {name: self._predicted(name, observation) for name, observation in observations.items()}

    def _predicted(self, name: str, observation: Any) -> Any:
        # Models without a memory need not know the argument.
        state = self._states.get(name)
        memory = {} if state is None else {"state": state, "episode_start": np.zeros(1, dtype=bool)}
        action, self._states[name] = self._model.predict(observation, deterministic=True, **memory)
        return action


class _Each:
    """An actor for each robot."""

    believer = None

    def __init__(self, drivers: Mapping[str, Driver]) -> None:
        self._drivers = drivers
        self.knows_its_end = all(driver.knows_its_end for driver in drivers.values())

    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        if set(self._drivers) != set(start_poses):
            raise ValueError(f"there must be one actor for each of {', '.join(start_poses)}, not {list(self._drivers)}")
        for name, driver in self._drivers.items():
            driver.reset({name: start_poses[name]}, seed)

    def act(self, observations: Observations) -> Actions:
        return {name: self._drivers[name].act({name: seen})[name] for name, seen in observations.items()}

    @property
    def done(self) -> bool:
        return all(driver.done for driver in self._drivers.values())

    @property
    def stop_reason(self) -> str | None:
        reasons = {str(driver.stop_reason) for driver in self._drivers.values() if driver.stop_reason is not None}
        return "; ".join(sorted(reasons)) or None
