"""One interface for anything that can act: from the observations of all robots to the actions of all robots."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from limslam_env.geometry import FloatArray

Observations = Mapping[str, Any]
Actions = Mapping[str, Any]


class Driver(Protocol):
    """Drives the robots of an episode.

    Attributes
    ----------
    can_stop
        Whether the driver itself says when it is done.
    snapshot_source
        Object with a ``snapshot()`` of what is believed, or None if there is no such object.
    """

    can_stop: bool
    snapshot_source: Any

    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        """Start again. ``start_poses`` are known poses (3,) of the robots by their names: x (m), y (m), heading
        (rad).
        """
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
        """Why there is nothing left to do, in words. None if that is unknown."""
        ...


def driver_of(actor: Any, *, is_team: bool) -> Driver:
    """The driver that acts as ``actor`` does, for all robots of a team or for a single robot.

    Raises
    ------
    ValueError
        If ``actor`` cannot act.
    """
    if isinstance(actor, Mapping):
        if not is_team:
            raise ValueError("a dict of actors is for parallel environments; here one actor drives one robot")
        return _ActorPerRobot({name: driver_of(part, is_team=False) for name, part in actor.items()})
    if isinstance(actor, type):
        raise ValueError(f"{actor.__name__} is a class and cannot act: pass an instance")  # noqa: TRY004 (a value)
    if callable(getattr(actor, "act", None)):
        return _SingleActor(actor, actor.act, is_team=is_team)
    if callable(getattr(actor, "predict", None)):
        return _ModelActor(actor)
    if callable(actor):
        return _SingleActor(actor, actor, is_team=is_team)
    raise ValueError(f"{type(actor).__name__} cannot act: it has no act, no predict, and is not callable")


class _SingleActor:
    """One actor for all robots. In a team it answers all observations at once. Otherwise it answers those of one
    robot.
    """

    def __init__(self, actor: Any, answer: Callable[[Any], Any], *, is_team: bool) -> None:
        self._actor, self._answer, self._is_team = actor, answer, is_team
        self.can_stop = hasattr(actor, "done")
        self.snapshot_source = actor if callable(getattr(actor, "snapshot", None)) else None

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


class _ModelActor:
    """A model in the style of Stable-Baselines3. The state of a recurrent model is kept for each robot."""

    can_stop, snapshot_source, done, stop_reason = False, None, False, None

    def __init__(self, model: Any) -> None:
        self._model = model
        self._states: dict[str, Any] = {}

    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        del start_poses, seed
        self._states = {}

    def act(self, observations: Observations) -> Actions:
        return {name: self._predicted(name, observation) for name, observation in observations.items()}

    def _predicted(self, name: str, observation: Any) -> Any:
        # Models without a recurrent state need not accept these arguments.
        state = self._states.get(name)
        memory = {} if state is None else {"state": state, "episode_start": np.zeros(1, dtype=bool)}
        action, self._states[name] = self._model.predict(observation, deterministic=True, **memory)
        return action


class _ActorPerRobot:
    """A separate actor for each robot."""

    snapshot_source = None

    def __init__(self, drivers: Mapping[str, Driver]) -> None:
        self._drivers = drivers
        self.can_stop = all(driver.can_stop for driver in drivers.values())

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
