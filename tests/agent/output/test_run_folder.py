"""The folder of a run: one process at a time, nothing lost, nothing half-written, nothing left
behind.
"""

import errno
import os
import signal
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from itertools import count
from pathlib import Path

import pytest

from limslam_agent.output.atomic_write import atomic_write
from limslam_agent.output.claims import ClaimedError, OutputError, clear_up
from limslam_agent.output.finished_run import FolderError, read_run
from limslam_agent.output.provenance import versions
from limslam_agent.output.run_folder import RESULT_FILE, new_folder

_PRELUDE = """
import os, signal

left = {number}
def deadly(function):
    def call(*arguments, **options):
        global left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **options)
    return call
for name in ("mkdir", "rmdir", "rename", "replace", "unlink", "fsync"):
    setattr(os, name, deadly(getattr(os, name)))
"""


def dies_at_call(number: int, code: str, cwd: Path) -> bool:
    """Run code that is killed just before its n-th change of the file system. Whether there was
    such a call.
    """
    program = _PRELUDE.format(number=number) + code
    ended = subprocess.run(
        [sys.executable, "-c", program],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode in {0, -9}, ended.stderr
    return ended.returncode == -9


FILES = ("a.txt", "b.txt", RESULT_FILE)

WRITE_FOLDER = f"""
from pathlib import Path
from limslam_agent.output.run_folder import new_folder
with new_folder(Path("run"), force=True) as folder:
    for name in {FILES}:
        (folder.beside / name).write_text("new")
"""

WRITE_FILE = """
from pathlib import Path
from limslam_agent.output.atomic_write import atomic_write
with atomic_write(Path("film.gif")) as beside:
    beside.write_text("new" * 1000)
"""

HOLD = """
import sys
from pathlib import Path
from limslam_agent.output.run_folder import new_folder
with new_folder(Path("run")) as folder:
    (folder.beside / "half").write_text("half")
    print("ready", flush=True)
    sys.stdin.read()
"""


def fill(folder: Path, words: str) -> None:
    for name in FILES:
        (folder / name).write_text(words)


def write(target: Path, words: str, **options: bool) -> Path:
    with new_folder(target, **options) as folder:
        fill(folder.beside, words)
    return folder.target


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def texts(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def whole(words: str) -> dict[str, str]:
    return dict.fromkeys(FILES, words)


def test_a_second_process_is_refused_at_its_start(tmp_path):
    with new_folder(tmp_path / "run") as folder:
        with (
            pytest.raises(ClaimedError, match="run: another process is writing there"),
            new_folder(tmp_path / "run"),
        ):
            pytest.fail("the place was claimed twice")
        fill(folder.beside, "first")
    assert texts(tmp_path / "run") == whole("first")
    assert names(tmp_path) == ["run"]


def test_with_the_default_name_both_results_survive(tmp_path):
    with (
        new_folder(tmp_path / "run", numbered=True) as first,
        new_folder(tmp_path / "run", numbered=True) as second,
    ):
        fill(first.beside, "first")
        fill(second.beside, "second")
    assert texts(first.target) == whole("first")
    assert texts(second.target) == whole("second")
    assert names(tmp_path) == ["run", "run-2"]
    assert write(tmp_path / "run", "third", numbered=True) == tmp_path / "run-3"


def write_beside_another(target: Path) -> None:
    with new_folder(target) as folder:
        fill(folder.beside, "own")
        target.mkdir()
        fill(target, "another's")


def test_results_that_came_meanwhile_are_kept_and_so_are_the_own(tmp_path):
    with pytest.raises(OutputError, match=r"already holds .*these results are in .*run-2"):
        write_beside_another(tmp_path / "run")
    assert texts(tmp_path / "run") == whole("another's")
    assert texts(tmp_path / "run-2") == whole("own")
    assert names(tmp_path) == ["run", "run-2"]


def stop_halfway(target: Path) -> None:
    with new_folder(target, force=True) as folder:
        (folder.beside / "half").touch()
        raise KeyboardInterrupt


def test_an_error_leaves_the_earlier_results_and_nothing_else(tmp_path):
    write(tmp_path / "deep" / "run", "old")
    with pytest.raises(KeyboardInterrupt):
        stop_halfway(tmp_path / "deep" / "run")
    assert texts(tmp_path / "deep" / "run") == whole("old")
    assert names(tmp_path / "deep") == ["run"]
    with pytest.raises(KeyboardInterrupt):
        stop_halfway(tmp_path / "new" / "run")
    assert names(tmp_path) == ["deep"]


def test_a_full_disk_is_told_with_the_name_of_the_folder(tmp_path):
    with pytest.raises(OSError, match="No space left") as caught, new_folder(tmp_path / "run"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.filename == str(tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_kill_at_any_moment_of_force_leaves_the_old_or_the_new_results(tmp_path):
    found = set()
    for number in count(1):
        place = tmp_path / str(number)
        place.mkdir()
        write(place / "run", "old")
        was_killed = dies_at_call(number, WRITE_FOLDER, place)
        clear_up(place)
        assert names(place) == ["run"], number
        assert texts(place / "run") in (whole("old"), whole("new")), number
        found.add((place / "run" / RESULT_FILE).read_text())
        if not was_killed:
            break
    assert number > 5
    assert found == {"old", "new"}


def test_a_kill_at_any_moment_of_a_file_leaves_the_old_or_the_new_file(tmp_path):
    film = tmp_path / "film.gif"
    for number in count(1):
        film.write_text("old")
        was_killed = dies_at_call(number, WRITE_FILE, tmp_path)
        with atomic_write(tmp_path / "other.txt") as beside:
            beside.write_text("the next start")
        assert names(tmp_path) == ["film.gif", "other.txt"], number
        assert film.read_text() in {"old", "new" * 1000}, number
        if not was_killed:
            break
    assert number > 2


def test_results_that_a_kill_took_from_their_place_can_be_shown(tmp_path):
    write(tmp_path / "run", "old")
    (tmp_path / "run").rename(tmp_path / ".run.limslam-old")
    with pytest.raises(FolderError, match="is not JSON"):  # the content of this test's file
        read_run(tmp_path / "run")
    assert names(tmp_path) == ["run"]


def test_only_what_dead_processes_left_is_removed_at_the_next_start(tmp_path):
    write(tmp_path / "dead", "old")
    (tmp_path / "dead").rename(tmp_path / ".dead.limslam-old")
    (tmp_path / ".dead.limslam-new").mkdir()
    (tmp_path / ".bashrc").touch()
    with subprocess.Popen(
        [sys.executable, "-c", HOLD],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as live:
        assert live.stdout.readline() == "ready\n"
        write(tmp_path / "next", "new")
        assert names(tmp_path) == [
            ".bashrc",
            ".run.limslam-lock",
            ".run.limslam-new",
            "dead",
            "next",
        ]
        assert texts(tmp_path / "dead") == whole("old")
        live.send_signal(signal.SIGKILL)
    write(tmp_path / "next", "newer", force=True)
    assert names(tmp_path) == [".bashrc", "dead", "next"]
    assert texts(tmp_path / "next") == whole("newer")


def test_a_package_that_is_not_installed_has_an_unknown_version(monkeypatch):
    def not_installed(package):
        raise PackageNotFoundError(package)

    assert versions()["limslam"] != "unknown"
    monkeypatch.setattr("limslam_agent.output.provenance.version", not_installed)
    assert set(versions().values()) - {versions()["python"]} == {"unknown"}
