"""Datasets for offline reinforcement learning, in the format of Minari: drives of explorers on random plans.

Drives are recorded one by one, as the jobs of a suite. The names of their arrays are their paths in the files of
Minari, which are made at the end: one dataset for each policy, compressed. A folder without a card is not complete, and
the same command goes on with it. The group ``truth`` is not part of Minari's format, and Minari's reader does not
return it.
"""

import json
import os
import shutil
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import limslam_env
from benchmarks.suite.jobs import RANDOM, Job, Outcome, digest
from benchmarks.suite.runner import Summary, run_suite
from benchmarks.suite.store import Row, read_rows, series_path
from benchmarks.suite.suite import Suite
from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.measurements.processes import Processes
from limslam_agent.output.atomic_write import replace_content
from limslam_agent.runs.policies import policies_by_belief
from limslam_agent.runs.results import drive_scores
from limslam_agent.safe_files import load_arrays
from limslam_agent.status.status import LEVELS
from limslam_agent.wrappers.single import SlamObservation, default_config, observed_belief

if TYPE_CHECKING:
    import h5py

FORMAT = 1
"""Version of what a drive records. Datasets of another version are not continued."""

ENVIRONMENT = "LimSlam-Random-v0"
FIRST_PLAN = 300_000
"""First plan of a dataset. No suite, no training and no plan of the arena uses plans from 300 000 to 999 999 999."""

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

NAMESPACE, VERSION = "limslam", 0
DATA_FILE = "data/main_data.hdf5"
DRIVES, CARD, SETTINGS = "drives", "README.md", "dataset.json"

_ROWS_PER_CHUNK = 256
"""Steps that are compressed together. A learner that reads whole episodes is served by large chunks."""

_CARD = Path(__file__).with_name("dataset_card.md")

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


def make_dataset(
    config: DatasetConfig, folder: Path, processes: Processes, *, retry_failed: bool = False
) -> Summary | None:
    """Make what is missing of a dataset; None if it is complete.

    Parameters
    ----------
    config
        Settings of the dataset.
    folder
        Root of the datasets. It may hold a dataset with the same settings, whole or in part.
    processes
        Run the drives.
    retry_failed
        Record the drives again that have failed.

    Raises
    ------
    ValueError
        If the folder holds something else.
    """
    settings, path = (json.dumps(asdict(config), indent=2) + "\n").encode(), folder / SETTINGS
    if not path.is_file() and folder.exists() and any(each.name[0] != "." for each in folder.iterdir()):
        raise ValueError(f"{folder}: is not empty and holds no dataset")
    if path.is_file() and path.read_bytes() != settings:
        raise ValueError(f"{folder}: holds a dataset with other settings (see {SETTINGS}): choose another folder")
    if (folder / CARD).is_file():
        return None
    replace_content(path, settings)
    summary = run_suite(
        config.suite, folder / DRIVES, processes, work=partial(record_drive, config), retry_failed=retry_failed
    )
    if not summary.failures:
        by_key = {row.key: row for row in read_rows(folder / DRIVES)}
        rows: dict[str, list[Row]] = {policy: [] for policy in config.policies}
        for job in config.suite.jobs:  # in the order of the plans; in the folder they are in the order of their ends
            rows[job.policy].append(by_key[job.key])
        for policy, driven in rows.items():
            # What an earlier process has left unfinished.
            shutil.rmtree(folder / dataset_id(policy), ignore_errors=True)
            _write_dataset(folder, policy, driven, config)
        replace_content(folder / CARD, card(config, rows).encode())
        shutil.rmtree(folder / DRIVES)
    return summary


def dataset_id(policy: str) -> str:
    """The name of a policy's dataset in Minari."""
    return f"{NAMESPACE}/{policy}-v{VERSION}"


def require_minari() -> None:
    """Import what the files need.

    Raises
    ------
    ValueError
        If the extra ``datasets`` is not installed.
    """
    try:
        import h5py  # noqa: F401
        import minari  # noqa: F401
    except ModuleNotFoundError as error:
        raise ValueError(f"datasets need {error.name}: pip install -e '.[datasets]'") from error


def _write_dataset(folder: Path, policy: str, rows: Sequence[Row], config: DatasetConfig) -> None:
    """Write the dataset of a policy from its drives, in the order of the episodes."""
    import h5py

    dataset = _empty_dataset(folder, policy, config)
    with h5py.File(folder / dataset_id(policy) / DATA_FILE, "w", track_order=True) as file:
        for number, row in enumerate(rows):
            arrays = load_arrays(series_path(folder / DRIVES, str(row.series)))
            _write_episode(file.create_group(f"episode_{number}"), number, row, arrays)
    storage = dataset.storage
    storage.update_metadata({"total_steps": int(_values(rows, "steps").sum()), "total_episodes": len(rows)})
    storage.update_metadata({"dataset_size": storage.get_size()})


def _empty_dataset(folder: Path, policy: str, config: DatasetConfig) -> Any:
    import minari

    env = config.environment()
    with patch.dict(os.environ, {"MINARI_DATASETS_PATH": str(folder)}), warnings.catch_warnings():
        # A project without a mail address has none to give.
        warnings.filterwarnings("ignore", message=".*(code_permalink|author_email).*", category=UserWarning)
        return minari.create_dataset_from_buffers(
            dataset_id(policy), [], env=env, eval_env=env, algorithm_name=policy, author="The LimSLAM authors",
            description=POLICIES[policy], data_format="hdf5", jpeg_encoding=False,
            requirements=[f"limslam=={limslam_env.__version__}"],
        )  # fmt: skip


def _write_episode(group: "h5py.Group", number: int, row: Row, arrays: Arrays) -> None:
    # Minari reads the seed and the options as the arguments of `reset`.
    group.attrs.update({"id": number, "total_steps": len(arrays["actions"]), "seed": row.seed})
    group.attrs["options/world"] = row.world
    group.attrs.update({"policy": row.policy, "stop_reason": str(row.metrics["stop_reason"])})
    for name, array in arrays.items():
        chunks = min(len(array), _ROWS_PER_CHUNK), *array.shape[1:]
        group.create_dataset(
            name, data=array, chunks=chunks, compression="gzip", compression_opts=6, shuffle=array.itemsize > 1
        )


def read_truth(folder: Path, policy: str, episode: int) -> Arrays:
    """What was true in an episode, for evaluation.

    Parameters
    ----------
    folder
        Root of the datasets.
    policy, episode
        Name of the policy, and number of the episode.

    Returns
    -------
    truth
        ``pose`` (t + 1, 3), m and rad; ``coverage`` (t + 1,); ``collision`` (t + 1,); ``walls`` (n, 4), m.
    """
    import h5py

    with h5py.File(folder / dataset_id(policy) / DATA_FILE, "r") as file:
        return {name: np.asarray(part) for name, part in file[f"episode_{episode}/truth"].items()}


def card(config: DatasetConfig, rows: Mapping[str, Sequence[Row]]) -> str:
    """The text of the card, with the drives of each policy."""
    first = next(iter(rows.values()))[0]
    return _CARD.read_text(encoding="utf-8").format(
        commit=first.commit,
        versions=", ".join(f"{name} {version}" for name, version in first.versions.items()),
        plans=config.plans,
        first=config.first_plan,
        last=config.first_plan + config.plans - 1,
        noise=100.0 * config.noise,
        max_time=config.max_time,
        size=config.size,
        metres=0.1 * config.size,
        environment=ENVIRONMENT,
        policies="\n".join(f"- `{dataset_id(policy)}`: {POLICIES[policy]}" for policy in rows),
        table="\n".join(_line(policy, driven) for policy, driven in rows.items()),
    )


def _line(policy: str, driven: Sequence[Row]) -> str:
    """A line of the card's table."""
    steps = _values(driven, "steps")
    medians = [
        f"{np.median(_values(driven, name)):.{decimals}f}"
        for name, decimals in (("return", 1), ("steps", 0), ("coverage_true", 2))
    ]
    sums = [f"{_values(driven, name).sum():.0f}" for name in ("collisions", "lost_s")]
    cells = (f"`{dataset_id(policy)}`", str(len(driven)), f"{steps.sum() / 36000.0:.2f}", *medians, *sums)
    return f"| {' | '.join(cells)} |"


def _values(rows: Sequence[Row], name: str) -> NDArray[Any]:
    return np.array([row.metrics[name] for row in rows], dtype=float)
