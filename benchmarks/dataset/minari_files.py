"""The files of Minari: one dataset for each policy, compressed, with the truth in a group that Minari does not read."""

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.dataset.drives import Arrays, DatasetConfig
from benchmarks.suite.store import Row, series_path
from limslam_agent.safe_files import load_arrays

if TYPE_CHECKING:
    import h5py

NAMESPACE, VERSION = "limslam", 0
DATA_FILE = "data/main_data.hdf5"

_ROWS_PER_CHUNK = 256
"""Steps that are compressed together. A learner that reads whole episodes is served by large chunks."""

DESCRIPTIONS = {
    "frontier": "The frontier explorer, which maps and plans, at 0.2 m/s.",
    "frontier_fast": "The frontier explorer at the top speed of 0.3 m/s.",
    "learned": "The shipped learned explorer, at 0.3 m/s: a network that chooses a heading twice a second, and the"
    " frontier explorer where little is left to see.",
    "random": "Straight drives in random directions.",
    "wall_follower": "A wall follower.",
}


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

    import limslam_env

    env = config.environment()
    with datasets_in(folder), warnings.catch_warnings():
        # A project without a mail address has none to give.
        warnings.filterwarnings("ignore", message=".*(code_permalink|author_email).*", category=UserWarning)
        return minari.create_dataset_from_buffers(
            dataset_id(policy), [], env=env, eval_env=env, algorithm_name=policy, author="The LimSLAM authors",
            description=DESCRIPTIONS[policy], data_format="hdf5", jpeg_encoding=False,
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


@contextmanager
def datasets_in(folder: Path) -> Iterator[None]:
    """Let Minari keep its datasets in a folder."""
    name = "MINARI_DATASETS_PATH"
    before = os.environ.get(name)
    os.environ[name] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
