"""A test that a dataset can be loaded: checksums, every episode by Minari's reader, and drives that are repeated."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from benchmarks.dataset.drives import TRUTH
from benchmarks.dataset.minari_files import NAMESPACE, VERSION
from limslam_agent.safe_files import read_limited

SUMS = "SHA256SUMS"
"""Checksums in the format of ``sha256sum --check``. The file is written last, so a folder with it is complete."""

_BLOCK = 1 << 20


def sums_of(folder: Path, files: Sequence[Path]) -> str:
    """The text of the checksums of files in a folder."""
    return "".join(f"{_sum(path)}  {path.relative_to(folder).as_posix()}\n" for path in sorted(files))


def _sum(path: Path) -> str:
    found = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()


def check_dataset(folder: Path, repeated_steps: int = 100) -> str:
    """Check the datasets in a folder.

    Every file has its checksum. Minari loads every episode; its arrays fit the spaces and each other, and end once. In
    each dataset, the recovered environment repeats the first ``repeated_steps`` of the first and the last episode to
    the bit.

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
            _check_episode(dataset, episode, f"{dataset.id}, episode {episode.id}")
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


def _check_episode(dataset: Any, episode: Any, label: str) -> None:
    count = len(episode.actions)
    ends = episode.terminations | episode.truncations
    parts = {"actions": (episode.actions, dataset.action_space, count)}
    parts |= {name: (part, dataset.observation_space[name], count + 1) for name, part in episode.observations.items()}
    if set(episode.observations) != set(dataset.observation_space.spaces) or TRUTH in (episode.infos or {}):
        raise ValueError(f"{label}: holds {', '.join(episode.observations)}")
    for name, (rows, space, length) in parts.items():
        _check_rows(rows, space, length, f"{label}: {name}")
    if not len(ends) == len(episode.rewards) == count or not ends[-1] or ends[:-1].any():
        raise ValueError(f"{label}: must end once, at its last step")
    if not np.isfinite(episode.rewards).all():
        raise ValueError(f"{label}: a reward is not finite")


def _check_rows(rows: Any, space: spaces.Box, length: int, label: str) -> None:
    if rows.shape != (length, *space.shape) or rows.dtype != space.dtype:
        raise ValueError(f"{label}: {rows.shape} of {rows.dtype}, not {(length, *space.shape)} of {space.dtype}")
    if not ((rows >= space.low) & (rows <= space.high)).all():
        raise ValueError(f"{label}: a value lies outside of the space")


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
