"""The drives of a dataset: one job for each plan and policy, and the arrays that are recorded in it.

The names of the arrays are their paths in the files of Minari. The group ``truth`` is not part of Minari's format, and
Minari's reader does not return it.
"""

from dataclasses import asdict, dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from benchmarks.suite.jobs import RANDOM, Job, Outcome, digest
from benchmarks.suite.suite import Suite
from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.runs.oracle import policies_by_belief
from limslam_agent.runs.results import drive_scores
from limslam_agent.status.status import LEVELS
from limslam_agent.wrappers.single import SlamObservation, default_config, observed_belief

FORMAT = 1
"""Version of what a drive records. Datasets of another version are not continued."""

ENVIRONMENT = "LimSlam-Random-v0"
FIRST_PLAN = 300_000
"""First plan of a dataset. No suite, no training and no track of the arena uses plans from 300 000 to 999 999 999."""

POLICIES = {
    "frontier": "The frontier explorer, which maps and plans, at 0.2 m/s.",
    "frontier_fast": "The frontier explorer at the top speed of 0.3 m/s.",
    "learned": "The shipped learned explorer, at 0.3 m/s: a network that chooses a heading twice a second, and the"
    " frontier explorer where little is left to see.",
    "random": "Straight drives in random directions.",
    "wall_follower": "A wall follower.",
}
"""Policies that can drive, since they act on the belief alone, and their descriptions."""

TRUTH = "truth"
"""The group of what no robot can know."""

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class DatasetConfig:
    """The drives of a dataset.

    Attributes
    ----------
    plans, first_plan
        Number of floor plans, and the seed of the first one. The seeds of the others follow.
    policies
        Each policy drives on each plan.
    noise
        Standard deviation of the ranges, m. The estimator is told this value.
    size
        Side of the observed grid in cells of 0.10 m.
    max_time
        Longest simulated time of a drive, s.

    Raises
    ------
    ValueError
        If a value is out of bounds, or a policy cannot drive.
    """

    plans: int = 1000
    first_plan: int = FIRST_PLAN
    policies: tuple[str, ...] = ("frontier", "learned", "random")
    noise: float = 0.02
    size: int = 128
    max_time: float = 300.0

    def __post_init__(self) -> None:
        if not 1 <= self.plans <= 1_000_000:
            raise ValueError(f"a dataset has 1 to 1000000 plans, not {self.plans}")
        if not self.policies or len(set(self.policies)) < len(self.policies):
            raise ValueError(f"each policy is named once, at least one of {', '.join(POLICIES)}")
        if unknown := [name for name in self.policies if name not in POLICIES]:
            raise ValueError(f"no policy {unknown[0]!r} can drive for a dataset; there are {', '.join(POLICIES)}")
        if not 1.0 <= self.max_time <= 36_000.0:
            raise ValueError(f"a drive takes at most 1 to 36000 s, not {self.max_time:g}")

    @property
    def suite(self) -> Suite:
        """One job for each policy and plan, plan by plan, so that a part of the drives has all policies."""
        jobs = tuple(
            Job(f"{RANDOM}{plan}", self.noise, preset=DEFAULT_PRESET, policy=policy, seed=plan, max_time=self.max_time)
            for plan in range(self.first_plan, self.first_plan + self.plans)
            for policy in self.policies
        )
        return Suite("dataset", "Drives of a dataset.", jobs, digest([FORMAT, asdict(self)]))

    def environment(self) -> SlamObservation:
        """The environment whose observations and rewards are recorded."""
        # The shipped robot's steps are 0.1 s long.
        bare = gym.make(
            ENVIRONMENT, sensor_noise=self.noise, max_episode_steps=round(self.max_time * 10), disable_env_checker=True
        )
        return SlamObservation(bare, size=self.size)


class _Recorder:
    """The rows of a drive, one for each observation, and one for each action."""

    def __init__(self, team: LimSlamTeam, start: NDArray[Any], size: int) -> None:
        self._team, self._start, self._size = team, start, size
        self._rows: dict[str, list[Any]] = {}

    def observe(self, observation: dict[str, Any], info: dict[str, Any]) -> None:
        """Keep what is believed after an observation, the readings, and the truth."""
        mapper = self._team.mapper
        belief = observed_belief(mapper.belief, self._start, observation["ranges"], self._size)
        self._add({f"observations/{name}": part for name, part in belief.items()})
        self._add({"infos/wheels": observation["wheels"], "infos/status": LEVELS.index(mapper.statuses[0].level)})
        self._add({f"{TRUTH}/{name}": info[name] for name in ("pose", "coverage", "collision")})

    def act(self, action: NDArray[Any], reward: float, *, terminated: bool, truncated: bool) -> None:
        """Keep an action and what came of it."""
        self._add({"actions": action, "rewards": reward, "terminations": terminated, "truncations": truncated})

    def _add(self, row: dict[str, Any]) -> None:
        for name, value in row.items():
            self._rows.setdefault(name, []).append(value)

    def arrays(self) -> Arrays:
        """The rows as arrays."""
        arrays = {name: np.array(rows) for name, rows in self._rows.items()}
        for name in ("rewards", "truth/coverage"):
            arrays[name] = arrays[name].astype(np.float32)
        arrays["infos/status"] = arrays["infos/status"].astype(np.uint8)
        return arrays


def record_drive(config: DatasetConfig, job: Job) -> Outcome:
    """Drive by the policy of a job, on its plan, until the policy stops or the episode ends.

    Raises
    ------
    ValueError
        If the policy stops before its first action.
    """
    env = config.environment().env
    simulation: Any = env.unwrapped
    arrays, stop_reason = _driven(env, simulation, config, job)
    if "actions" not in arrays:
        raise ValueError(f"the policy {job.policy} has stopped before its first action: {stop_reason}")
    arrays[f"{TRUTH}/walls"] = simulation.world.edges.astype(np.float32)
    clock = np.arange(len(arrays["actions"]) + 1) * simulation.robot.control_period
    true, contact = arrays[f"{TRUTH}/pose"][:, None], arrays[f"{TRUTH}/collision"][:, None]
    metrics = {
        "return": float(arrays["rewards"].sum(dtype=float)), "steps": len(arrays["actions"]),
        **drive_scores(clock, arrays[f"{TRUTH}/coverage"], true, contact, has_explored=False),
        "lost_s": simulation.robot.control_period * int((arrays["infos/status"] == LEVELS.index("lost")).sum()),
        "stop_reason": stop_reason,
    }  # fmt: skip
    return Outcome(metrics, {}, arrays, digest([FORMAT, asdict(config)]))


def _driven(env: gym.Env[Any, Any], simulation: Any, config: DatasetConfig, job: Job) -> tuple[Arrays, str]:
    """The arrays of a drive, and why it ended. The policies are those of ``limslam run``."""
    robot, settings = simulation.robot, default_config([simulation.nominal_noise])
    observation, info = env.reset(seed=job.seed, options={"world": job.world})
    team = LimSlamTeam(robot, settings, 1, policies_by_belief(job.policy, robot, settings, robots=1, seed=job.seed))
    team.reset(info["pose"][None], job.seed)
    recorder = _Recorder(team, np.array(info["pose"]), config.size)
    while True:
        team.observe([observation])
        recorder.observe(observation, info)
        # A policy that stops gives a last action, which is not executed.
        action = team.decide()[0].astype(np.float32)
        if team.done:
            arrays = recorder.arrays()
            # The environment would go on, so the episode counts as cut short.
            if "truncations" in arrays:
                arrays["truncations"][-1] = True
            return arrays, team.stop_reason or "the policy says that it is done"
        observation, reward, is_over, is_late, info = env.step(action)
        recorder.act(action, float(reward), terminated=is_over, truncated=is_late)
        if is_over or is_late:
            team.observe([observation])
            recorder.observe(observation, info)
            return recorder.arrays(), "the coverage goal is reached" if is_over else "the longest time is over"
