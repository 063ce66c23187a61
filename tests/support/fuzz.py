"""Mutates valid files of every format that the project reads, and checks that each reader answers
as documented.
"""

import gzip
import io
import json
import random
import signal
import tempfile
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from support.bags import distance, odometry, scan, storage_of, write_bag
from support.data import own_log

from benchmarks.suite.store import read_rows
from benchmarks.suite.suite import load_suite
from limslam_agent import read_log
from limslam_agent.cli.settings import Given, ReplayOptions, replay_agent, run_config, run_options
from limslam_agent.cli.show import true_edges
from limslam_agent.logs.relations import read_relations
from limslam_agent.output.finished_run import read_run
from limslam_agent.output.summary import replay_summary, run_summary
from limslam_agent.policies.learned.learned import SHIPPED, WEIGHTS
from limslam_agent.policies.learned.network import load_network
from limslam_env import load_world
from limslam_env.messages import LONGEST_MESSAGE

LONGEST_S = 5
EXTREMES = (
    "0",
    "-0.0",
    "-1",
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "9" * 400,
    "2.5",
    "true",
    "null",
    '""',
    "[]",
    "{}",
    "[[]]",
    '"\\u001b[2J"',
    '"\\ud800"',
    "-9223372036854775809",
    "4294967296",
    "x" * 3000,
    "9" * 5000,
    "1979-05-27",
    "{ a = 1 }",
    "[",
    "]",
    "=",
    ",",
    "'",
    '"',
    "0x",
    "\0",
    "#",
    "[[walls]]",
    "1_0",
    "\\u0000",
)


@dataclass(frozen=True)
class Target:
    """A format: the files of a valid input by their names, the one that is mutated, and what reads
    it.
    """

    name: str
    files: dict[str, bytes]
    mutated: str
    read: Callable[[Path], Any]


# Valid inputs


def _drive() -> list[Any]:
    turns = [(10.0 + 0.1 * step, 0.05 * step) for step in range(8)]
    return [
        each for at, x in turns for each in (odometry(at, x), scan(at, [1.0, 2.0, 3.0, 2.0, 1.0]))
    ]


def _ranges() -> list[Any]:
    turns = [(10.0 + 0.1 * step, 0.05 * step) for step in range(8)]
    names = ("/left", "/right")
    return [
        each
        for at, x in turns
        for each in (odometry(at, x), *(distance(at, 1.0, name) for name in names))
    ]


def _content(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def _log_npz() -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **own_log(5))
    return file.getvalue()


WORLD = (
    'name = "some"\nsize = [4.0, 4.0]\nwalls = [[0, 0, 4, 0], [4, 0, 4, 4], [4, 4, 0, 4], [0, 4, '
    "0, 0]]\n"
    "obstacles = [[[1, 1], [1.5, 1], [1.2, 1.5]]]\ndoors = [[1, 0, 2, 0]]\nstarts = [[2.5, 2.5, "
    "0.5]]\n"
    "loop = [[2, 2], [3, 2], [3, 3]]\n"
)
SUITE = (
    'name = "some"\ndescription = "words"\n[[grid]]\nworlds = ["square", "random:0..1"]\nnoises = '
    "[0.0, 0.02]\n"
    'seeds = { first = 0, count = 2 }\npresets = ["paper"]\npolicies = ["frontier"]\nmax_time = '
    "10.0\n"
)
SETTINGS = (
    'preset = "consistent"\nnoise = 0.02\nseed = 3\n[agent.grid]\ncell = '
    "0.1\n[agent.noise]\nwheel_variance = 2e-5\n"
)
MAP = (
    "image: some.{}\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: "
    "0.65\nfree_thresh: 0.196\n"
)


def _room() -> np.ndarray[Any, np.dtype[np.uint8]]:
    cells = np.full((40, 50), 254, dtype=np.uint8)
    cells[[0, -1]] = 0
    cells[:, [0, -1]] = 0
    cells[10:15, 20:26] = 0
    return cells


def _run_folder() -> dict[str, bytes]:
    tum = "".join(f"{time} 0 0 0 0 0 0 1\n" for time in range(5)).encode()
    result = {
        "metrics": {"coverage": 0.9, "time": 5.0},
        "cost": {"slam_ms_mean": 1.0},
        "seed": 1,
        "config": {
            "world": "env1",
            "noise": 0.02,
            "preset": "paper",
            "robot": {"axle": 0.16},
            "agent": {},
        },
    }
    texts = {
        "result.json": json.dumps(result),
        "map.json": json.dumps({"segments": [[0, 0, 1, 1]]}),
    }
    files = {name: text.encode() for name, text in texts.items()}
    return files | {"trajectory_est.tum": tum, "trajectory_true.tum": tum, "log.npz": _log_npz()}


def _shown(folder: Path) -> None:
    run = read_run(folder)
    metrics = run.result.get("metrics")
    cost = run.result.get("cost")
    if isinstance(metrics, dict) and isinstance(cost, dict):
        _ = replay_summary(metrics) if run.is_replay else run_summary(metrics, cost)
    _ = run.title, true_edges(run)


def _set_up(path: Path) -> None:
    given = Given.read(path, {})
    options = run_options(given)
    run_config(given, options)


def _set_up_replay(path: Path) -> None:
    given = Given.read(path, {})
    replay_agent(given, given.merged(ReplayOptions()))


def _checked(path: Path) -> None:
    world = load_world(path)
    assert np.isfinite(world.edges).all()
    world.check(0.1)


def targets() -> list[Target]:
    """Every format with a valid input."""
    from PIL import Image

    lines = "".join(
        f"FLASER 181 {' '.join(['1.5'] * 181)} {at} 0 0 {at} 0 0 {at} host {at}\nODOM {at} 0 0 0 "
        f"0 0 {at} host {at}\n"
        for at in range(1, 5)
    ).encode()
    table = b"t,x,y,theta,r_-90,r_0,r_90\n" + b"".join(
        b"%d,0.1,0.2,0.3,1,,2.5\n" % at for at in range(6)
    )
    row = {
        "world": "env1",
        "noise": 0.02,
        "robots": 1,
        "preset": "paper",
        "policy": "frontier",
        "ablation": None,
        "laps": 0,
        "seed": 1,
        "metrics": {"coverage": 0.5},
        "key": "k",
    }
    walls = [[0, 0, 4, 0], [4, 0, 4, 4], [4, 4, 0, 4], [0, 4, 0, 0]]
    png = io.BytesIO()
    Image.fromarray(_room()).save(png, "PNG")
    pgm = b"P5\n50 40\n255\n" + _room().tobytes()
    plain = b"P2\n50 40\n255\n" + " ".join(map(str, _room().ravel())).encode()
    relations = b"1 2 0.1 0 0 0 0 0.2 # words\n" * 4
    single = [
        Target("world.toml", {"w.toml": WORLD.encode()}, "w.toml", _checked),
        Target(
            "walls.json",
            {"w.json": json.dumps({"id": "w", "walls": walls}).encode()},
            "w.json",
            _checked,
        ),
        Target(
            "house.json",
            {"h.json": json.dumps({"id": "h", "verts": [[0, 0], [4, 0], [4, 4]]}).encode()},
            "h.json",
            _checked,
        ),
        Target("carmen", {"l.clf": lines}, "l.clf", _log),
        Target("carmen.gz", {"l.gz": gzip.compress(lines)}, "l.gz", _log),
        Target("table", {"l.csv": table}, "l.csv", _log),
        Target("table.gz", {"l.csv.gz": gzip.compress(table)}, "l.csv.gz", _log),
        Target("log.npz", {"l.npz": _log_npz()}, "l.npz", _log),
        Target("relations", {"r": relations}, "r", read_relations),
        Target("suite", {"s.toml": SUITE.encode()}, "s.toml", lambda path: load_suite(str(path))),
        Target("results", {"r.jsonl": json.dumps(row).encode() + b"\n"}, "r.jsonl", read_rows),
        Target("run.toml", {"r.toml": SETTINGS.encode()}, "r.toml", _set_up),
        Target(
            "replay.toml",
            {"r.toml": b'preset = "paper"\nbeams = "1,2"\nmax_range = 3.0\n'},
            "r.toml",
            _set_up_replay,
        ),
        Target("weights", {"w.npz": (WEIGHTS / SHIPPED).read_bytes()}, "w.npz", load_network),
    ]
    maps = [
        Target(
            f"map {name}",
            {"m.yaml": MAP.format(suffix).encode(), f"some.{suffix}": picture},
            mutated,
            _map,
        )
        for suffix, picture in (("pgm", pgm), ("png", png.getvalue()), ("pgm", plain))
        for name, mutated in (
            (f"yaml {picture[:2]!r}", "m.yaml"),
            (f"{picture[:2]!r}", f"some.{suffix}"),
        )
    ]
    folder = _run_folder()
    shown = [
        Target(f"show {name}", folder, name, lambda path: _shown(path.parent)) for name in folder
    ]
    return single + maps + shown + _bags()


def _map(path: Path) -> None:
    _checked(path.parent / "m.yaml")


def _log(path: Path) -> None:
    log = read_log(path)
    assert not np.isinf(log.ranges).any()
    assert np.isfinite(log.wheels if log.odometry is None else log.odometry).all()


def _bags() -> list[Target]:
    found = []
    for kind in ("ros1", "sqlite", "mcap"):
        for content, messages in (("scan", _drive()), ("range", _ranges())):
            with tempfile.TemporaryDirectory() as folder:
                path = write_bag(Path(folder), messages, kind)
                if kind == "ros1":
                    found.append(
                        Target(f"ros1 {content}", {path.name: path.read_bytes()}, path.name, _log)
                    )
                    continue
                storage = storage_of(path).name
                files = _content(path)
                found.append(
                    Target(f"{kind} {content}", files, storage, lambda path: _log(path.parent))
                )
                found.append(
                    Target(f"{kind} {content} alone", {storage: files[storage]}, storage, _log)
                )
                found.append(
                    Target(
                        f"{kind} {content} yaml",
                        files,
                        "metadata.yaml",
                        lambda path: _log(path.parent),
                    )
                )
    return found


# Mutations


def mutated(content: bytes, generator: random.Random) -> bytes:
    """A valid input with one to four mutations."""
    if content[:2] == b"PK" and generator.random() < 0.5:
        return _member_mutated(content, generator)
    if content[:2] == b"\x1f\x8b" and generator.random() < 0.7:
        return gzip.compress(_several(gzip.decompress(content), generator))
    return _several(content, generator)


def _several(content: bytes, generator: random.Random) -> bytes:
    for _ in range(generator.randint(1, 4)):
        content = generator.choice(MUTATIONS)(content, generator)
    return content


def _member_mutated(content: bytes, generator: random.Random) -> bytes:
    """A zip file whose members are whole, but one of them has a mutated header or mutated data."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    chosen = generator.choice(sorted(members))
    head = members[chosen][:128]
    members[chosen] = _several(head, generator) + members[chosen][128:]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file.getvalue()


def _flip(content: bytes, generator: random.Random) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(generator.randint(1, 6)):
        changed[generator.randrange(len(changed))] = generator.randrange(256)
    return bytes(changed)


def _cut(content: bytes, generator: random.Random) -> bytes:
    return content[: generator.randint(0, len(content))]


def _chunk(content: bytes, generator: random.Random) -> tuple[int, int]:
    begin = generator.randint(0, len(content))
    return begin, min(begin + generator.randint(1, 200), len(content))


def _double(content: bytes, generator: random.Random) -> bytes:
    begin, end = _chunk(content, generator)
    return content[:end] + content[begin:end] * generator.choice((1, 2, 50)) + content[end:]


def _drop(content: bytes, generator: random.Random) -> bytes:
    begin, end = _chunk(content, generator)
    return content[:begin] + content[end:]


def _swap(content: bytes, generator: random.Random) -> bytes:
    begin, end = _chunk(content, generator)
    other, last = _chunk(content, generator)
    return content[:begin] + content[other:last] + content[end:]


def _replace_number(content: bytes, generator: random.Random) -> bytes:
    """Replace one value of a text: a number, a quoted text or a list, as TOML, JSON, YAML and
    tables have them.
    """
    spans = []
    begin = None
    for place, byte in enumerate(content[:20_000]):
        is_part = chr(byte) in "0123456789.+-eE"
        if is_part and begin is None:
            begin = place
        elif not is_part and begin is not None:
            spans.append((begin, place))
            begin = None
    if not spans:
        return _flip(content, generator)
    first, last = generator.choice(spans)
    return content[:first] + generator.choice(EXTREMES).encode() + content[last:]


MUTATIONS = (_flip, _cut, _double, _drop, _swap, _replace_number, _replace_number, _replace_number)


# Runs


def examine(target: Target, folder: Path, generator: random.Random) -> str | None:
    """Read one mutated input. What went wrong, or None: the reader read it, or refused it as
    documented.
    """
    for name, content in target.files.items():
        (folder / name).write_bytes(
            mutated(content, generator) if name == target.mutated else content
        )
    begin = time.process_time()
    found = None
    signal.alarm(10 * LONGEST_S)
    try:
        target.read(folder / target.mutated)
    except ValueError as error:
        message = str(error)
        # Options have no file, and a world that is loaded is called by its name.
        is_named = (
            str(folder) in message or target.mutated == "r.toml" or message.startswith("world ")
        )
        if not is_named or "\n" in message or len(message) > 2 * LONGEST_MESSAGE:
            found = (
                f"a refusal that is not one short line about the file: {type(error).__name__} "
                f"{message[:200]!r}"
            )
    except BaseException as error:  # noqa: BLE001 (whatever it is, it is what is looked for)
        place = traceback.extract_tb(error.__traceback__)[-1]
        found = (
            f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: "
            f"{str(error)[:120]!r}"
        )
    finally:
        signal.alarm(0)
    took = time.process_time() - begin
    return found or (f"took {took:.1f} s" if took > LONGEST_S else None)


def fuzz(count: int, seed: int) -> Counter[str]:
    """Examine ``count`` mutated inputs, spread over all targets. What went wrong, and how often."""
    found: Counter[str] = Counter()
    everything = targets()
    before = signal.signal(signal.SIGALRM, _too_slow)
    for number in range(count):
        target = everything[number % len(everything)]
        generator = random.Random(seed * 1_000_003 + number)  # noqa: S311
        with tempfile.TemporaryDirectory() as folder:
            problem = examine(target, Path(folder), generator)
            if problem:
                found[f"{target.name}: {problem}"] += 1
    signal.signal(signal.SIGALRM, before)
    return found


def _too_slow(*_: object) -> None:
    raise TimeoutError("the reader takes too long")
