"""The files of a dataset: drives are recorded one by one, and Minari's files, the card and the checksums follow.

There is one dataset of Minari for each policy, compressed. A folder without checksums is not complete, and the same
command goes on with it.
"""

import hashlib
import json
import os
import shutil
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import limslam_env
from benchmarks.dataset.drives import ENVIRONMENT, POLICIES, Arrays, DatasetConfig, record_drive
from benchmarks.suite.runner import Summary, run_suite
from benchmarks.suite.store import STAMP, Row, read_rows, series_path
from limslam_agent.measurements.processes import Processes
from limslam_agent.measurements.store import RESULTS
from limslam_agent.output.atomic_write import replace_content
from limslam_agent.safe_files import load_arrays, read_limited
from limslam_env.geometry import FloatArray

if TYPE_CHECKING:
    import h5py

NAMESPACE, VERSION = "limslam", 0
DATA_FILE = "data/main_data.hdf5"

_ROWS_PER_CHUNK = 256
"""Steps that are compressed together. A learner that reads whole episodes is served by large chunks."""

SUMS = "SHA256SUMS"
"""Checksums in the format of ``sha256sum --check``. The file is written last, so a folder with it is complete."""

DRIVES, CARD, SETTINGS = "drives", "README.md", "dataset.json"

_CARD = Path(__file__).with_name("card.md")


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
    if (folder / SUMS).is_file():
        return None
    replace_content(path, settings)
    summary = run_suite(
        config.suite, folder / DRIVES, processes, work=partial(record_drive, config), retry_failed=retry_failed
    )
    if not summary.failures:
        _write_files(config, folder)
        shutil.rmtree(folder / DRIVES)
    return summary


def _write_files(config: DatasetConfig, folder: Path) -> None:
    """Write Minari's files, the card, and at last the checksums."""
    by_key = {row.key: row for row in read_rows(folder / DRIVES)}
    rows: dict[str, list[Row]] = {policy: [] for policy in config.policies}
    for job in config.suite.jobs:  # in the order of the plans; in the folder they are in the order of their ends
        rows[job.policy].append(by_key[job.key])
    for policy, driven in rows.items():
        # What an earlier process has left unfinished.
        shutil.rmtree(folder / dataset_id(policy), ignore_errors=True)
        write_dataset(folder, folder / DRIVES, policy, driven, config)
    for name in (RESULTS, STAMP):
        shutil.copyfile(folder / DRIVES / name, folder / name)
    sizes = {policy: sum(map(_size, (folder / dataset_id(policy)).rglob("*"))) for policy in rows}
    replace_content(folder / CARD, card(config, rows, sizes).encode())
    above = [folder / name for name in (CARD, SETTINGS, RESULTS, STAMP)]
    files = [*above, *(path for path in (folder / NAMESPACE).rglob("*") if path.is_file())]
    replace_content(folder / SUMS, sums_of(folder, files).encode())


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


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


def write_dataset(folder: Path, drives: Path, policy: str, rows: Sequence[Row], config: DatasetConfig) -> None:
    """Write the dataset of a policy.

    Parameters
    ----------
    folder
        Root of the datasets. The dataset must not exist there yet.
    drives
        Folder of the recorded drives.
    policy, rows
        The policy and its drives, in the order of the episodes.
    config
        Settings of the dataset.
    """
    import h5py

    dataset = _empty_dataset(folder, policy, config)
    steps = 0
    with h5py.File(folder / dataset_id(policy) / DATA_FILE, "w", track_order=True) as file:
        for number, row in enumerate(rows):
            arrays = load_arrays(series_path(drives, str(row.series)))
            _write_episode(file.create_group(f"episode_{number}"), number, row, arrays)
            steps += len(arrays["actions"])
    storage = dataset.storage
    storage.update_metadata({"total_steps": steps, "total_episodes": len(rows)})
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
        group.create_dataset(
            name, data=array, chunks=_chunks(array), compression="gzip", compression_opts=6, shuffle=array.itemsize > 1
        )


def _chunks(array: NDArray[Any]) -> tuple[int, ...]:
    return (min(len(array), _ROWS_PER_CHUNK), *array.shape[1:])


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


def card(config: DatasetConfig, rows: Mapping[str, Sequence[Row]], sizes: Mapping[str, int]) -> str:
    """The text of the card.

    Parameters
    ----------
    config
        Settings of the dataset.
    rows
        Drives of each policy.
    sizes
        Size of the files of each policy, bytes.
    """
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
        sees="24 directions up to 4.3 m",
        environment=ENVIRONMENT,
        policies="\n".join(f"- `{dataset_id(policy)}`: {POLICIES[policy]}" for policy in rows),
        table=_table(config, rows, sizes),
        reasons=_reasons(rows),
    )


def _table(config: DatasetConfig, rows: Mapping[str, Sequence[Row]], sizes: Mapping[str, int]) -> str:
    columns = (
        "dataset, episodes, hours, return, steps, coverage at the end, 90 % after (s), contacts, lost (s), MB, kB/plan"
    )
    lines = [f"| {columns.replace(', ', ' | ')} |", "|---|---:|---:|---|---|---|---:|---:|---:|---:|---:|"]
    for policy, driven in rows.items():
        steps = _values(driven, "steps")
        reached = [np.inf if row.metrics["time_to_90_s"] is None else row.metrics["time_to_90_s"] for row in driven]
        middle = float(np.median(np.array(reached, dtype=float)))
        cells = [
            f"`{dataset_id(policy)}`", str(len(driven)), f"{steps.sum() / 36000.0:.2f}",
            _spread(_values(driven, "return"), "{:.1f}"), _spread(steps, "{:.0f}"),
            _spread(_values(driven, "coverage_true"), "{:.2f}"), f"{middle:.0f}" if np.isfinite(middle) else "never",
            f"{_values(driven, 'collisions').sum():.0f}",
            f"{_values(driven, 'lost_s').sum():.0f}", f"{sizes[policy] / 1e6:.1f}",
            f"{sizes[policy] / 1e3 / config.plans:.0f}",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _values(rows: Sequence[Row], name: str) -> FloatArray:
    return np.array([row.metrics[name] for row in rows], dtype=float)


def _spread(values: FloatArray, form: str) -> str:
    middle, low, high = (form.format(float(value)) for value in (np.median(values), values.min(), values.max()))
    return f"{middle} ({low} to {high})"


def _reasons(rows: Mapping[str, Sequence[Row]]) -> str:
    lines = ["Why drives ended:", ""]
    for policy, driven in rows.items():
        counts = Counter(str(row.metrics["stop_reason"]) for row in driven).most_common()
        lines.append(f"- `{policy}`: {'; '.join(f'{reason} ({count})' for reason, count in counts)}")
    return "\n".join(lines)


def sums_of(folder: Path, files: Sequence[Path]) -> str:
    """The text of the checksums of files in a folder."""
    return "".join(f"{_sum(path)}  {path.relative_to(folder).as_posix()}\n" for path in sorted(files))


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_dataset(folder: Path, repeated_steps: int = 100) -> str:
    """Check the datasets in a folder.

    Every file has its checksum. Minari loads every episode, and each ends once. In each dataset, the recovered
    environment repeats the first ``repeated_steps`` of the first and the last episode to the bit.

    Returns
    -------
    words
        What was checked, in one line.

    Raises
    ------
    ValueError
        If a file is missing or differs, or an episode is not as it should be.
    """
    sums = _check_sums(folder)
    found = sorted((folder / NAMESPACE).glob(f"*-v{VERSION}/data"))
    if not found:
        raise ValueError(f"{folder}: holds no datasets")
    episodes = steps = 0
    for path in found:
        dataset = _loaded(path)
        for episode in dataset.iterate_episodes():
            ends = episode.terminations | episode.truncations
            if not ends[-1] or ends[:-1].any():
                raise ValueError(f"{dataset.id}, episode {episode.id}: must end once, at its last step")
        for number in {0, len(dataset) - 1}:
            _repeat(dataset, number, repeated_steps)
        episodes, steps = episodes + len(dataset), steps + dataset.total_steps
    return f"{sums} files, {len(found)} datasets, {episodes} episodes, {steps} steps"


def _check_sums(folder: Path) -> int:
    try:
        lines = read_limited(folder / SUMS).decode("utf-8").splitlines()
        listed = [(words[0], words[1]) for words in (line.split("  ", 1) for line in lines)]
    except (OSError, ValueError, IndexError) as error:
        raise ValueError(f"{folder}: holds no complete dataset ({SUMS} is missing or damaged)") from error
    for expected, name in listed:
        path = folder / name
        if not path.resolve().is_relative_to(folder.resolve()) or not path.is_file():
            raise ValueError(f"{path}: is missing")
        if _sum(path) != expected:
            raise ValueError(f"{path}: has another checksum than {SUMS} says")
    return len(listed)


def _loaded(path: Path) -> Any:
    import minari

    try:
        return minari.MinariDataset(path)
    except Exception as error:
        raise ValueError(f"{path}: cannot be loaded: {error}") from error


def _repeat(dataset: Any, number: int, steps: int) -> None:
    """Drive the first steps of an episode again, in the environment that the dataset names."""
    episode = dataset[number]
    (metadata,) = dataset.storage.get_episode_metadata([number])
    env = dataset.recover_environment()
    observation, _ = env.reset(seed=metadata["seed"], options=metadata["options"])
    for step in range(min(steps, len(episode.actions)) + 1):
        for name, part in observation.items():
            if not np.array_equal(part, episode.observations[name][step]):
                raise ValueError(f"{dataset.id}, episode {number}: {name} differs at step {step} when it is repeated")
        if step < len(episode.actions):
            observation, reward, *_ = env.step(episode.actions[step])
            if np.float32(reward) != episode.rewards[step]:
                raise ValueError(f"{dataset.id}, episode {number}: the reward differs at step {step}")
    env.close()
