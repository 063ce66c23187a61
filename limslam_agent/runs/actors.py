"""One interface for anything that can act: from the observations of all robots to the actions of all robots."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.runs.actor_checks import first_argument, is_policy
from limslam_agent.runs.policies import policies_by_belief
from limslam_env.geometry import FloatArray
from limslam_env.interface import NominalNoise, RobotSpec

Observations = Mapping[str, Any]
Actions = Mapping[str, Any]


class Driver(ABC):
    """Drives the robots of an episode. This one never says that it is done, and believes nothing.

    Attributes
    ----------
    can_stop
        Whether the driver itself says when it is done.
    snapshot_source
        Object with a ``snapshot()`` of what is believed, or None if there is no such object.
    """

    can_stop = False
    snapshot_source: Any = None

    @abstractmethod
    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        """Start again. ``start_poses`` are known poses (3,) of the robots by their names: x (m), y (m), heading
        (rad).
        """

    @abstractmethod
    def act(self, observations: Observations) -> Actions:
        """Wheel speeds (2,) of each robot by its name."""

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return False

    @property
    def stop_reason(self) -> str | None:
        """Why there is nothing left to do, in words. None if that is unknown."""
        return None


def driver_of(
    actor: Any,
    *,
    is_team: bool,
    robot: RobotSpec | None = None,
    noise: NominalNoise | None = None,
    preset_name: str | None = None,
) -> Driver:
    """The driver that acts as ``actor`` does, for all robots of a team or for a single robot.

    A policy becomes the policy of a `LimSlamAgent` for ``robot`` and ``noise``, of the preset that is named or else of
    the default preset. A text is the name of a policy as in ``limslam run --policy``, which drives such an
    agent or team.

    Raises
    ------
    ValueError
        If ``actor`` cannot act, or if it may be a policy and may be an actor.
    """
    if isinstance(actor, str):
        body, config = robot or RobotSpec(), preset(preset_name or DEFAULT_PRESET, noise)
        return _AgentDriver(
            body, config, lambda robots, seed: policies_by_belief(actor, body, config, robots=robots, seed=seed)
        )
    if isinstance(actor, type):
        raise ValueError(f"{actor.__name__} is a class and cannot act: pass an instance")  # noqa: TRY004 (a value)
    if is_policy(actor):
        if is_team:
            raise ValueError(
                f"{type(actor).__name__} is a policy for one robot: "
                "pass LimSlamTeam(robot, config, num_robots, policies=[...]) with one policy for each robot"
            )
        config = preset(preset_name or DEFAULT_PRESET, noise)
        return _AgentDriver(robot or RobotSpec(), config, lambda _robots, _seed: [_copied(actor)])
    if callable(getattr(actor, "act", None)):
        return _SingleActor(actor, actor.act, is_team=is_team)
    if callable(getattr(actor, "predict", None)):
        return _ModelActor(actor)
    if not callable(actor):
        raise ValueError(  # noqa: TRY004 (all refused arguments are ValueErrors)
            f"{type(actor).__name__} cannot act: it has no act, no predict, and is not callable"
        )
    if first_argument(actor) == "belief":
        raise ValueError(
            f"{getattr(actor, '__name__', 'this')} takes a belief, but a function gets an observation: "
            "a policy is an object with act(belief), stop_reason and plan"
        )
    return _SingleActor(actor, actor, is_team=is_team)


class _AgentDriver(Driver):
    """Drives robots by an agent, which gets new policies in each episode.

    Parameters
    ----------
    robot, config
        Body of each robot, and settings of the agent.
    policies
        Makes a policy for each robot, from the number of robots and a seed. None for the agent's own policies.
    """

    can_stop = True

    def __init__(self, robot: RobotSpec, config: AgentConfig, policies: Callable[[int, int], list[Any] | None]) -> None:
        self._robot, self._config, self._policies = robot, config, policies
        self.snapshot_source: LimSlamTeam = self._team(1, 0)

    def _team(self, robots: int, seed: int) -> LimSlamTeam:
        return LimSlamTeam(self._robot, self._config, robots, self._policies(robots, seed))

    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        self.snapshot_source = self._team(len(start_poses), seed)
        self.snapshot_source.reset(np.array(list(start_poses.values())), seed)

    def act(self, observations: Observations) -> Actions:
        self.snapshot_source.observe(list(observations.values()))
        return dict(zip(observations, self.snapshot_source.decide(), strict=True))

    @property
    def done(self) -> bool:
        return self.snapshot_source.done

    @property
    def stop_reason(self) -> str | None:
        return self.snapshot_source.stop_reason


def _copied(policy: Any) -> Any:
    try:
        return copy.deepcopy(policy)
    except Exception as error:  # a class may raise anything when it is copied
        raise ValueError(
            f"{type(policy).__name__} cannot be copied for each episode ({error}): "
            "pass LimSlamAgent(robot, config, policy=...) and one seed"
        ) from error


class _SingleActor(Driver):
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


class _ModelActor(Driver):
    """A model in the style of Stable-Baselines3. The state of a recurrent model is kept for each robot."""

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
