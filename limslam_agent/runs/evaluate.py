"""Scores anything that can act by the metrics of ``limslam run``."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pettingzoo
from pettingzoo.env_registry.exceptions import PettingZooRegistryError

import limslam_env  # noqa: F401 (registers the environments)
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.policies.policy import NOT_EXPLORED
from limslam_agent.runs.actor_checks import acts_on_belief, check_actor
from limslam_agent.runs.actors import ALONE, Driver, driver_of
from limslam_agent.runs.episode import OUT_OF_TIME
from limslam_agent.runs.results import drive_scores, map_scores, over_robots, trajectory_scores
from limslam_agent.runs.run_spec import LONGEST_TIME
from limslam_env.envs.adapter import SimulationEnv
from limslam_env.envs.arguments import given
from limslam_env.geometry import FloatArray
from limslam_env.geometry.numbers import check_count, check_number
from limslam_env.interface import RobotSpec
from limslam_env.messages import described

Result = dict[str, Any]
"""Metrics of one episode by their names in ``docs/metrics.md``, and its ``seed``."""

_TIMES = ("time_to_", "exploration_time")
_TEAMS = "limslam/"


def evaluate(
    scored: Any = None,
    /,
    env_id: str = "LimSlam-Env1-v0",
    seeds: int | Iterable[int] = range(10),
    *,
    policy: Any = None,
    actor: Any = None,
    max_time: float = 1800.0,
    preset: str | None = None,
    wrap: Callable[[Any], Any] | None = None,
    **arguments: Any,
) -> list[Result]:
    """Let an actor or a policy explore once for each seed, and score it with the metrics of
    ``limslam run``.

    Parameters
    ----------
    scored, policy, actor
        One of them: ``policy`` is a policy, ``actor`` is an actor, and ``scored`` is either of
        them, by its form. A **policy** has ``act(belief)``, ``stop_reason`` and ``plan``
        (`Policy`). A new copy of it is the policy of a `LimSlamAgent` in each episode, which is
        told the ``robot`` and the ``nominal_noise`` of the environment. An **actor** is anything
        with ``act(observation)``, a model of Stable-Baselines3 or another object with
        ``predict(observation, deterministic=True) -> (action, state)``, or a callable. If the actor
        has a ``reset(start_pose, seed)``, it is called before each episode. In a parallel
        environment an actor answers a dict of all robots' observations with a dict of their
        actions. A model with ``predict`` answers for each robot in turn. A **name** that ``limslam
        run --policy`` knows (``"frontier"``, ``"learned"`` and so on) stands for the agent of that
        command, and for its team in a parallel environment.
    env_id
        A Gymnasium id (``LimSlam-Env1-v0``), or a PettingZoo id (``limslam/Env1-v0``) for several
        robots.
    seeds
        One episode is driven for each seed. A number n means the seeds 0 to n - 1.
    max_time
        Longest simulated time of an episode, s.
    preset
        The settings of the agent that gets a policy: ``graph`` (the default), ``paper``,
        ``consistent`` or ``odometry``. An actor has its own settings.
    wrap
        Wraps the bare environment into the one that the actor sees. With `SlamObservation`, the
        estimate of the wrapper is scored.
    **arguments
        Arguments of the environment, such as ``sensor_noise=0.02`` or ``num_robots=3``.
        ``coverage_goal`` is by default None for an actor that says itself when it is ``done``, else
        0.99.

    Returns
    -------
    results
        For each seed the metrics of the drive: ``coverage_true``, ``time_to_50_s`` and so on,
        ``exploration_time_s``, ``collisions``, ``path_m`` and ``stop_reason``. For an actor whose
        ``snapshot()`` is that of `LimSlamAgent` or `LimSlamTeam`, or that sees the belief of
        `SlamObservation`, also the metrics of the trajectory and the map.

    Raises
    ------
    ValueError
        If the environment does not exist, or the actor cannot act in it (because it was made for
        another robot or trained on other observations, for example), or an answer of the actor is
        not an action.

    Examples
    --------
    >>> from limslam_agent import evaluate
    >>> results = evaluate("wall_follower", "LimSlam-Env1-v0", seeds=1, max_time=5.0)
    >>> 0.0 < results[0]["coverage_true"] < 1.0
    True
    """
    chosen, is_policy = _chosen(scored, policy, actor)
    _check(chosen, is_policy, env_id, max_time, preset)
    seeds = _seeds(seeds)
    is_team = env_id.startswith(_TEAMS)
    robot = given("robot", arguments.get("robot"), RobotSpec)
    make = partial(
        driver_of, chosen, is_team=is_team, robot=robot, preset_name=preset, is_policy=is_policy
    )
    goal = {"coverage_goal": None} if make().can_stop else {}
    bare = _make(env_id, max(1, round(max_time / robot.control_period)), {**goal, **arguments})
    env = wrap(bare) if wrap else bare
    try:
        driver = make(noise=bare.unwrapped.nominal_noise)
        check_actor(chosen, bare.unwrapped.robot, env)
        return [
            _scored(driver, _Robots(env, is_team=is_team), bare.unwrapped, int(seed))
            for seed in seeds
        ]
    finally:
        env.close()


def medians(results: Sequence[Result]) -> dict[str, float | None]:
    """The median of each metric over several episodes.

    A time that was never reached counts as later than all others. If half of the times were not
    reached, the median is None. For other metrics, episodes without the metric are ignored.

    Examples
    --------
    >>> from limslam_agent import medians
    >>> medians([{"coverage_true": 0.5}, {"coverage_true": 0.9}, {"coverage_true": 0.8}])
    {'coverage_true': 0.8}
    """
    columns: dict[str, list[float]] = {}
    for result in results:
        for name, value in result.items():
            column = columns.setdefault(name, [])
            if isinstance(value, int | float) and name != "seed":
                column.append(float(value))
            elif value is None and name.startswith(_TIMES):
                column.append(np.inf)
    middles = {name: float(np.median(column)) for name, column in columns.items() if column}
    return {name: middle if np.isfinite(middle) else None for name, middle in middles.items()}


def _seeds(seeds: Any) -> list[int]:
    """The seeds, of which a number n means 0 to n - 1."""
    if isinstance(seeds, int) and not isinstance(seeds, bool):
        check_count("the number of seeds", seeds, _MOST_EPISODES)
        return list(range(seeds))
    is_list = isinstance(seeds, Iterable) and not isinstance(seeds, str | bytes)
    found = list(seeds) if is_list else []
    if not found or not all(isinstance(seed, int | np.integer) and seed >= 0 for seed in found):
        raise ValueError(
            "seeds must be a number of episodes, or whole numbers from 0, at least one of them, "
            f"not {described(seeds)}"
        )
    return [int(seed) for seed in found]


_MOST_EPISODES = 1_000_000

_Infos = dict[str, dict[str, Any]]
"""The true infos of the robots by their names."""


class _Robots:
    """A single-robot or a parallel environment, with all robots by their names."""

    def __init__(self, env: Any, *, is_team: bool) -> None:
        self._env = env
        self._is_team = is_team

    @property
    def mapper(self) -> Mapper | None:
        """The mapper of the wrapper whose beliefs the actor sees, if there is one."""
        found = (
            self._env.get_wrapper_attr("mapper")
            if isinstance(self._env, gym.Wrapper) and self._env.has_wrapper_attr("mapper")
            else None
        )
        return found if isinstance(found, Mapper) else None

    def reset(self, seed: int) -> tuple[dict[str, Any], _Infos]:
        """Observations and true infos of the robots."""
        observation, info = self._env.reset(seed=seed)
        return (observation, info) if self._is_team else ({ALONE: observation}, {ALONE: info})

    def step(self, actions: Mapping[str, Any]) -> tuple[dict[str, Any], _Infos, bool, bool]:
        """Observations and infos, whether the episode has terminated, and whether it was
        truncated.
        """
        if self._is_team:
            observations, _, over, late, infos = self._env.step(dict(actions))
            return observations, infos, all(over.values()), all(late.values())
        observation, _, is_over, is_late, info = self._env.step(actions[ALONE])
        return {ALONE: observation}, {ALONE: info}, bool(is_over), bool(is_late)


def _chosen(scored: Any, policy: Any, actor: Any) -> tuple[Any, bool | None]:
    """What is to be scored, and whether it is a policy; None where its form says so."""
    each = [
        (one, is_policy)
        for one, is_policy in ((scored, None), (policy, True), (actor, False))
        if one is not None
    ]
    if len(each) != 1 or isinstance(actor, str):
        raise ValueError(
            "evaluate scores one thing: evaluate(policy=...), also by its name, or "
            "evaluate(actor=...), or either of them as the first argument"
        )
    return each[0]


def _check(
    actor: Any, is_policy: bool | None, env_id: Any, max_time: float, preset: str | None
) -> None:
    """Refuse arguments that cannot be used, before anything is made."""
    check_number("max_time", max_time, 1e-3, LONGEST_TIME, "s")
    if not isinstance(env_id, str):
        raise ValueError(  # noqa: TRY004 (all refused arguments are ValueErrors)
            f"env_id is a name such as 'LimSlam-Env1-v0', not {described(env_id)}: "
            "evaluate makes the environment itself, from further arguments (sensor_noise=0.02 and "
            "so on) and wrap="
        )
    has_agent = isinstance(actor, str) or (
        not isinstance(actor, type) and acts_on_belief(actor, is_policy)
    )
    if preset is not None and not has_agent:
        raise ValueError(f"preset={preset!r} is for a policy: an actor brings its own settings")


def _make(env_id: str, max_steps: int, arguments: dict[str, Any]) -> Any:
    try:
        if env_id.startswith(_TEAMS):
            env: Any = pettingzoo.make("parallel", env_id, max_cycles=max_steps, **arguments)
        else:
            env = gym.make(
                env_id, max_episode_steps=max_steps, disable_env_checker=True, **arguments
            )
    except PettingZooRegistryError as error:
        raise ValueError(f"there is no environment {env_id!r}") from error
    except gym.error.Error as error:
        raise ValueError(str(error)) from error
    except TypeError as error:
        unknown = re.search(r"unexpected keyword argument '(\w+)'", str(error))
        if unknown is None or unknown[1] not in arguments:
            raise
        raise ValueError(
            f"{unknown[1]} is an argument neither of evaluate nor of {env_id}"
        ) from error
    if not isinstance(env.unwrapped, SimulationEnv):
        env.close()
        raise ValueError(f"{env_id!r} is not a LimSLAM environment")  # noqa: TRY004 (a wrong value)
    return env


def _scored(driver: Driver, robots: _Robots, stage: SimulationEnv, seed: int) -> Result:
    """Drive one episode and score it."""
    truth, beliefs, stop_reason = _drive(driver, robots, seed)
    source = driver.snapshot_source or robots.mapper
    time, coverage = (
        np.array([next(iter(infos.values()))[name] for infos in truth])
        for name in ("time", "coverage")
    )
    true, contact = (
        np.array([[info[name] for info in infos.values()] for infos in truth])
        for name in ("pose", "collision")
    )
    has_explored = stop_reason is not None and not stop_reason.endswith(NOT_EXPLORED)
    scores: Result = drive_scores(time, coverage, true, contact, has_explored=has_explored)
    if source is not None:
        estimated, odometry, covariances = (
            np.array(column) for column in zip(*beliefs, strict=True)
        )
        snapshot = source.snapshot()
        scores |= over_robots(trajectory_scores, true, estimated, odometry, covariances)
        scores |= map_scores(
            stage.world, stage.robot, stage.coverage_grid, snapshot, true, estimated
        )
    return {"seed": seed, **scores, "stop_reason": stop_reason or OUT_OF_TIME}


def _drive(
    driver: Driver, robots: _Robots, seed: int
) -> tuple[list[_Infos], list[tuple[FloatArray, FloatArray, FloatArray]], str | None]:
    """What is true in each step, what is believed, and the stop reason, which is None if the time
    ran out.

    What is believed are estimated poses (n, 3), odometry (n, 3) and covariances (n, 3, 3) of n
    robots.
    """
    observations, infos = robots.reset(seed)
    _begin(driver, infos, seed)
    source = driver.snapshot_source or robots.mapper
    truth = list[_Infos]()
    beliefs = list[tuple[FloatArray, FloatArray, FloatArray]]()
    is_over = False
    is_late = False
    while True:
        # The last observation only updates the estimate; its action is not executed.
        actions = driver.act(observations)
        truth.append(infos)
        if source is not None:
            snapshot = source.snapshot()
            beliefs.append((snapshot.poses, snapshot.odometry, snapshot.covariances))
        if is_over or is_late or driver.done:
            break
        observations, infos, is_over, is_late = robots.step(actions)
    finish = getattr(source, "finish", None)
    if callable(finish):
        finish()
    if driver.done:
        return truth, beliefs, driver.stop_reason
    return truth, beliefs, "the coverage goal is reached" if is_over else None


def _begin(driver: Driver, infos: _Infos, seed: int) -> None:
    driver.reset({name: np.array(info["pose"], dtype=float) for name, info in infos.items()}, seed)
    if driver.done:
        raise ValueError(
            f"the actor was done before seed {seed} began: a policy serves for one run only"
        )
