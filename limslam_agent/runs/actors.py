"""One interface for anything that can act, and an actor as the policy of a robot that a mapper
listens to.
"""

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.presets import preset
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.policies.policy import NO_PLAN
from limslam_agent.runs.actor_checks import acts_on_belief, first_argument
from limslam_agent.runs.policies import policies_by_belief
from limslam_env.geometry import FloatArray
from limslam_env.interface import NominalNoise, Observation, RobotSpec
from limslam_env.messages import described

DONE = "the actor says that it is done"
"""The reason of an actor that is done and does not say why."""

ALONE = "robot_0"
"""The name of a single robot."""


class Driver:
    """Drives the robots of an episode: from the observations of all robots to the actions of all
    robots.

    ``make`` gives the actor of an episode, for a number of robots and a seed. If it
    ``answers_all``, it takes the observations of all robots by their names, and otherwise those of
    one robot.
    """

    def __init__(self, make: Callable[[int, int], Any], *, answers_all: bool) -> None:
        self._make = make
        self._answers_all = answers_all
        self._actor = make(1, 0)

    @property
    def can_stop(self) -> bool:
        """Whether the actor itself says when it is done."""
        return hasattr(self._actor, "done")

    @property
    def snapshot_source(self) -> Any:
        """Object with a ``snapshot()`` of what is believed, or None if there is no such object."""
        return self._actor if callable(getattr(self._actor, "snapshot", None)) else None

    def reset(self, start_poses: Mapping[str, FloatArray], seed: int) -> None:
        """Start again. ``start_poses`` are known poses (3,) of the robots by their names: x (m), y
        (m), heading (rad).
        """
        self._actor = self._make(len(start_poses), seed)
        reset = getattr(self._actor, "reset", None)
        if callable(reset):
            poses = np.array(list(start_poses.values()))
            reset(poses if self._answers_all else poses[0], seed)

    def act(self, observations: Mapping[str, Any]) -> Mapping[str, Any]:
        """Wheel speeds (2,) of each robot by its name."""
        act = getattr(self._actor, "act", None)
        answer = act if callable(act) else self._actor
        if not self._answers_all:
            return {name: answer(observation) for name, observation in observations.items()}
        actions = answer(observations)
        if not isinstance(actions, Mapping):
            raise ValueError(  # noqa: TRY004
                f"several robots need a dict of actions by their names, not {described(actions)}"
            )
        return actions

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return bool(getattr(self._actor, "done", False))

    @property
    def stop_reason(self) -> str:
        """Why there is nothing left to do, in words."""
        return getattr(self._actor, "stop_reason", None) or DONE


def driver_of(
    actor: Any,
    *,
    is_team: bool,
    robot: RobotSpec | None = None,
    noise: NominalNoise | None = None,
    preset_name: str | None = None,
    is_policy: bool | None = None,
) -> Driver:
    """The driver that acts as ``actor`` does, for all robots of a team or for a single robot.

    A policy becomes the policy of a `LimSlamAgent` for ``robot`` and ``noise``, of the preset that
    is named or else of the default preset. ``is_policy`` says whether ``actor`` is one; with None,
    its form does. A text is the name of a policy as in ``limslam run --policy``, which drives such
    an agent or team.

    Raises
    ------
    ValueError
        If ``actor`` cannot act, or if it may be a policy and may be an actor.
    """
    if isinstance(actor, type):
        raise ValueError(f"{actor.__name__} is a class and cannot act: pass an instance")  # noqa: TRY004 (a value)
    body = robot or RobotSpec()
    config = preset(preset_name or DEFAULT_PRESET, noise)
    if isinstance(actor, str):

        def named(robots: int, seed: int) -> LimSlamTeam:
            policies = policies_by_belief(actor, body, config, robots=robots, seed=seed)
            return LimSlamTeam(body, config, robots, policies)

        return Driver(named, answers_all=True)
    if acts_on_belief(actor, is_policy):
        if is_team:
            raise ValueError(
                f"{type(actor).__name__} is a policy for one robot: "
                "pass LimSlamTeam(robot, config, num_robots, policies=[...]) with one policy for "
                "each robot"
            )
        return Driver(
            lambda _robots, _seed: LimSlamTeam(body, config, 1, [_copied(actor)]), answers_all=True
        )
    if not callable(getattr(actor, "act", None)):
        if callable(getattr(actor, "predict", None)):
            return Driver(lambda _robots, _seed: _Model(actor), answers_all=True)
        _check_callable(actor, is_policy)
    return Driver(lambda _robots, _seed: actor, answers_all=is_team)


def _check_callable(actor: Any, is_policy: bool | None) -> None:
    if not callable(actor):
        raise ValueError(  # noqa: TRY004 (all refused arguments are ValueErrors)
            f"{type(actor).__name__} cannot act: it has no act, no predict, and is not callable"
        )
    if is_policy is None and first_argument(actor) == "belief":
        raise ValueError(
            f"{getattr(actor, '__name__', 'this')} takes a belief, but a function gets an "
            "observation: "
            "a policy is an object with act(belief), stop_reason and plan"
        )


def _copied(policy: Any) -> Any:
    try:
        return copy.deepcopy(policy)
    except Exception as error:  # a class may raise anything when it is copied
        raise ValueError(
            f"{type(policy).__name__} cannot be copied for each episode ({error}): "
            "pass LimSlamAgent(robot, config, policy=...) and one seed"
        ) from error


class _Model:
    """A model in the style of Stable-Baselines3. The state of a recurrent model is kept for each
    robot.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._states: dict[str, Any] = {}

    def act(self, observations: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: self._predicted(name, observation) for name, observation in observations.items()
        }

    def _predicted(self, name: str, observation: Any) -> Any:
        # Models without a recurrent state need not accept these arguments.
        state = self._states.get(name)
        memory = {} if state is None else {"state": state, "episode_start": np.zeros(1, dtype=bool)}
        action, self._states[name] = self._model.predict(observation, deterministic=True, **memory)
        return action


class ActorPolicy:
    """Drives a robot by an actor, which knows nothing of the belief: a mapper draws the map from
    the same readings.

    Parameters
    ----------
    actor
        An actor for one robot, as `limslam_agent.evaluate` takes it.
    """

    def __init__(self, actor: Any) -> None:
        self._actor = actor
        self._driver = driver_of(actor, is_team=False)
        self._observation: Observation = {}
        self.stop_reason: str | None = None
        self.plan: FloatArray = NO_PLAN

    def reset(self, start_pose: FloatArray, seed: int) -> None:
        """Begin an episode at a known pose (3,), m and rad."""
        self._driver.reset({ALONE: np.array(start_pose)}, seed)
        self.stop_reason = None

    def observe(self, observation: Observation) -> None:
        """Take the readings of this step."""
        self._observation = observation

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) of the actor, 0 once it is done. The belief is ignored."""
        del belief
        if self.stop_reason is not None:
            return np.zeros(2)
        action: FloatArray = self._driver.act({ALONE: self._observation})[ALONE]
        if self._driver.done:
            self.stop_reason = self._driver.stop_reason
        return action

    def close(self) -> None:
        """End what the actor has started, such as a process. An actor without a ``close`` has
        started nothing.
        """
        close = getattr(self._actor, "close", None)
        if callable(close):
            close()
