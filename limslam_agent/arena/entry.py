"""An entry: a folder with ``entry.toml``, which says who takes part with what."""

import hashlib
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.presets import PRESETS
from limslam_agent.config.tables import built, read_toml
from limslam_agent.runs.policies import BELIEF_POLICIES
from limslam_agent.runs.policy_file import file_and_name

MANIFEST = "entry.toml"
MOST_ROBOTS = 2
_NOT_IN_DIGEST = (
    "hidden files, __pycache__ and files outside of the folder are not part of the entry's digest"
)
_LONGEST_NAME = 60
_MOST_FILES = 1000
_MOST_BYTES = 500_000_000


@dataclass(frozen=True, kw_only=True)
class Manifest(Bounded):
    """The content of ``entry.toml``, whose keys ``docs/arena.md`` explains."""

    name: str
    authors: tuple[str, ...]
    kind: Literal["shipped", "python", "command"]
    run: str = ""
    command: tuple[str, ...] = ()
    uses: Literal["belief", "readings"]
    robots: Annotated[int, Bounds(1, MOST_ROBOTS, is_whole=True)] = 1
    preset: str = DEFAULT_PRESET
    about: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.name.strip() or len(self.name) > _LONGEST_NAME or not self.name.isprintable():
            raise ValueError(
                f"name: an entry has a name of 1 to {_LONGEST_NAME} characters, not "
                f"{self.name[:80]!r}"
            )
        if not self.authors:
            raise ValueError('authors: an entry has authors: authors = ["A. Person"]')
        if self.preset not in PRESETS:
            raise ValueError(_not_one_of("preset", self.preset, PRESETS))
        if {bool(self.command), not self.run} != {self.is_process}:
            raise ValueError("a command has the key command, and every other kind has the key run")
        self._check_run()
        if self.uses == "belief" and self.kind == "command":
            raise ValueError("uses: a command acts on readings")

    @property
    def is_process(self) -> bool:
        """Whether the entry runs in a process of its own, which may depend on time."""
        return self.kind == "command"

    def _check_run(self) -> None:
        if self.kind == "shipped" and self.run not in BELIEF_POLICIES:
            raise ValueError(_not_one_of("run", self.run, BELIEF_POLICIES))
        if self.kind != "python":
            return
        path = Path(self.run)
        if path.is_absolute() or ".." in path.parts:
            raise ValueError(f"run: {self.run!r} is not in the folder of the entry")
        if not _counts(path):
            raise ValueError(f"run: {self.run!r}: {_NOT_IN_DIGEST}")


@dataclass(frozen=True)
class Entry:
    """An entry that can be run. The digest is that of the manifest and of all other files of the
    folder.
    """

    folder: Path
    manifest: Manifest
    digest: str

    @property
    def run(self) -> str:
        """What is run: a name, or the path of a file in the folder."""
        return (
            str(self.folder / self.manifest.run)
            if self.manifest.kind == "python"
            else self.manifest.run
        )


def read_entry(folder: Path) -> Entry:
    """The entry in a folder.

    Raises
    ------
    ValueError
        If the folder has no manifest, the manifest cannot be used, or a file that it names is
        missing or not part of the digest.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: there is no such folder: an entry is a folder with {MANIFEST}")
    path = folder / MANIFEST
    if not path.is_file():
        raise ValueError(f"{folder}: has no {MANIFEST}, which says what the entry is")
    manifest = built(Manifest, read_toml(path), str(path))
    for word in manifest.command:
        is_file = not Path(word).is_absolute() and os.path.exists(folder / word)  # noqa: PTH110 (a word can be long)
        if is_file and not _counts(Path(word)):
            raise ValueError(f"{path}: command: {word!r}: {_NOT_IN_DIGEST}")
    entry = Entry(folder.absolute(), manifest, _digest(folder))
    if manifest.kind == "python":
        file_and_name(entry.run)
    return entry


def _not_one_of(name: str, value: str, choices: Iterable[str]) -> str:
    return f"{name}: {', '.join(choices)} can be chosen, not {value!r}"


def _digest(folder: Path) -> str:
    """Digest of all files of a folder, without hidden files and compiled Python."""
    found = [path for path in folder.rglob("*") if _counts(path.relative_to(folder))]
    for path in found:
        if path.is_symlink() and path.is_dir():
            raise ValueError(
                f"{path}: is a link to a folder, whose files are not part of the entry's digest"
            )
    files = sorted(path for path in found if path.is_file())
    if len(files) > _MOST_FILES or sum(path.stat().st_size for path in files) > _MOST_BYTES:
        raise ValueError(
            f"{folder}: an entry has at most {_MOST_FILES} files of {_MOST_BYTES / 1e6:g} MB "
            "together"
        )
    digest = hashlib.sha256()
    for path in files:
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def _counts(path: Path) -> bool:
    return not any(part[0] == "." or part == "__pycache__" for part in path.parts)


def manifest_table(manifest: Manifest) -> dict[str, object]:
    """A manifest as a table that JSON holds."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(manifest).items()
    }
