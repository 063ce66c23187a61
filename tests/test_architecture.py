"""What may import what, what importing loads, and the length of functions."""

import ast
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest

GEOMETRY = "limslam_env.geometry"
INTERFACE = "limslam_env.interface"
# The last two are about text only.
WHAT_AN_AGENT_MAY_KNOW = {
    GEOMETRY,
    INTERFACE,
    "limslam_env.messages",
    "limslam_env.toml_text",
}


def env(*names: str) -> set[str]:
    return {f"limslam_env.{name}" for name in names}


def agent(*names: str) -> set[str]:
    return {f"limslam_agent.{name}" for name in names}


# For each package, and each module beside the packages: which others it may import. A package may
# always import itself.
ENV = {
    "limslam_env": env("config", "interface"),
    "limslam_env.geometry": env("messages"),
    "limslam_env.interface": {GEOMETRY},
    "limslam_env.messages": set(),
    "limslam_env.canvas": {GEOMETRY},
    "limslam_env.overlay": {GEOMETRY},
    "limslam_env.toml_text": set(),
    "limslam_env.config": {GEOMETRY, *env("messages")},
    "limslam_env.robots": {GEOMETRY, INTERFACE},
    "limslam_env.worlds": {GEOMETRY, *env("canvas", "messages", "kernels")},
    # A world may be named by the seed of a floor plan.
    "limslam_env.worlds.formats": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("worlds", "worlds.generation", "messages"),
    },
    "limslam_env.worlds.generation": {GEOMETRY, *env("worlds", "config", "messages")},
    "limslam_env.linking": set(),
    "limslam_env.compilation": env("kept_code", "linking", "messages"),
    "limslam_env.kept_code": env("messages"),
    "limslam_env.kernels": {GEOMETRY, *env("compilation")},
    "limslam_env.simulation": {*WHAT_AN_AGENT_MAY_KNOW, *env("config", "worlds", "kernels")},
    "limslam_env.batch": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env(
            "compilation",
            "config",
            "worlds",
            "worlds.formats",
            "worlds.generation",
            "kernels",
            "simulation",
        ),
    },
    "limslam_env.rendering": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("canvas", "overlay", "worlds", "simulation"),
    },
    "limslam_env.envs": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env(
            "config",
            "robots",
            "worlds",
            "worlds.formats",
            "worlds.generation",
            "simulation",
            "batch",
            "overlay",
            "rendering",
        ),
    },
    "limslam_env.metrics": {GEOMETRY, *env("worlds")},
    "limslam_env.bounds": {*WHAT_AN_AGENT_MAY_KNOW, *env("worlds", "simulation")},
}
ESTIMATORS = agent("slam.published", "slam.consistent")
AGENT = {
    "limslam_agent.readings": {*WHAT_AN_AGENT_MAY_KNOW, *agent("kernels")},
    "limslam_agent.dropouts": {*WHAT_AN_AGENT_MAY_KNOW, *agent("kernels")},
    "limslam_agent.safe_files": {"limslam_env.messages"},
    "limslam_agent.map_file": {GEOMETRY, *agent("safe_files")},
    "limslam_agent.endings": set(),
    "limslam_agent.notebooks": set(),
    "limslam_agent.terminal": env("messages"),
    "limslam_agent.command_options": agent("config"),
    "limslam_agent.robot_file": {*WHAT_AN_AGENT_MAY_KNOW, *env("robots"), *agent("config")},
    "limslam_agent.config": {*WHAT_AN_AGENT_MAY_KNOW, *agent("safe_files")},
    "limslam_agent.kernels": {GEOMETRY, *env("compilation")},
    "limslam_agent.slam.core": {*WHAT_AN_AGENT_MAY_KNOW, *agent("config", "kernels", "readings")},
    "limslam_agent.slam.published": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent("config", "kernels", "slam.core"),
    },
    "limslam_agent.slam.consistent": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent("config", "kernels", "slam.core"),
    },
    "limslam_agent.slam.batch": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("compilation"),
        *agent("config", "kernels", "readings", "slam.core", "slam.consistent"),
    },
    "limslam_agent.slam.graph": {GEOMETRY, *env("compilation")},
    "limslam_agent.slam.line_graph": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("compilation"),
        *agent("config", "kernels", "slam.core", "slam.consistent", "slam.graph"),
    },
    "limslam_agent.slam.map_graph": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("compilation"),
        *agent("config", "kernels", "slam.graph"),
    },
    "limslam_agent.slam": {*WHAT_AN_AGENT_MAY_KNOW, *agent("config", "slam.core"), *ESTIMATORS},
    "limslam_agent.record": WHAT_AN_AGENT_MAY_KNOW,
    "limslam_agent.grid": {*WHAT_AN_AGENT_MAY_KNOW, *agent("config", "dropouts", "kernels")},
    "limslam_agent.status": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent("dropouts", "config", "grid", "kernels", "readings", "record", "slam.core"),
    },
    "limslam_agent.belief": {*WHAT_AN_AGENT_MAY_KNOW, *agent("grid", "output", "status")},
    "limslam_agent.places": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent(
            "belief",
            "config",
            "slam",
            "slam.core",
            "grid",
            "kernels",
            "readings",
            "status",
            "record",
            "map_file",
            "safe_files",
        ),
    },
    "limslam_agent.policies": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent("belief", "config", "grid", "kernels"),
    },
    "limslam_agent.policies.learned": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("compilation"),
        *agent("belief", "config", "grid", "kernels", "policies", "safe_files"),
    },
    "limslam_agent.mapping": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent("belief", "config", "grid", "output", "places", "policies", "record", "status"),
        *agent("slam", "slam.consistent", "slam.core", "slam.line_graph"),
    },
    "limslam_agent.wrappers": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("compilation", "overlay"),
        *agent("belief", "config", "grid", "mapping", "slam.batch"),
    },
    "limslam_agent.logs": {*WHAT_AN_AGENT_MAY_KNOW, *agent("readings", "safe_files")},
    "limslam_agent.measurements": {*WHAT_AN_AGENT_MAY_KNOW, *agent("output", "safe_files")},
    "limslam_agent.output": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("canvas"),
        *agent("slam.core", "grid", "map_file", "safe_files"),
    },
    "limslam_agent.output.formats": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent("grid", "output", "places", "safe_files"),
    },
    "limslam_agent.replay": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent(
            "config",
            "slam.core",
            "slam.line_graph",
            "slam.map_graph",
            "grid",
            "logs",
            "mapping",
            "output",
            "places",
        ),
        *agent("status"),
    },
    "limslam_agent.two_logs": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent(
            "config",
            "slam.core",
            "slam.line_graph",
            "slam.map_graph",
            "grid",
            "kernels",
            "logs",
            "output",
            "places",
        ),
        *agent("record", "replay", "status"),
    },
    "limslam_agent.live": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent("config", "endings", "logs", "mapping", "output", "places", "policies", "replay"),
    },
    "limslam_agent.live.ros2": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent("config", "grid", "live", "logs", "output.formats"),
    },
    "limslam_agent.video": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *env("canvas"),
        *agent("grid", "output", "slam.core"),
    },
    "limslam_agent.draw": agent("inspect", "output", "safe_files"),
    "limslam_agent.inspect": {
        *WHAT_AN_AGENT_MAY_KNOW,
        *agent(
            "config",
            "grid",
            "mapping",
            "output",
            "policies",
            "slam",
            "slam.core",
            "status",
            "video",
        ),
    },
}
# These put the simulator and the agent together. No other package of the agent may import them.
COMPOSITION = {
    "limslam_agent",
    "limslam_agent.__main__",
    "limslam_agent.runs",
    "limslam_agent.arena",
    "limslam_agent.cli",
    "limslam_agent.live.emulator",
}
# Benchmarks may use all of the simulator and the agent. Among themselves: suite <- analysis,
# training, scoreboard <- speed; growth beside.
BENCHMARKS = {
    "benchmarks": set(),
    "benchmarks.suite": set(),
    "benchmarks.analysis": {"benchmarks.suite"},
    "benchmarks.training": {"benchmarks.suite"},
    "benchmarks.scoreboard": {"benchmarks.suite"},
    "benchmarks.speed": {"benchmarks.scoreboard"},
    "benchmarks.growth": set(),
    "benchmarks.peers": {"benchmarks.suite"},
    "benchmarks.__main__": {
        "benchmarks.suite",
        "benchmarks.analysis",
        "benchmarks.training",
        "benchmarks.scoreboard",
        "benchmarks.speed",
        "benchmarks.growth",
        "benchmarks.peers",
    },
}
RULES = ENV | AGENT | BENCHMARKS
COMPILED = {
    "limslam_env.kernels",
    "limslam_agent.kernels",
    "limslam_agent.slam.batch",
    "limslam_agent.slam.graph",
    "limslam_agent.slam.line_graph",
    "limslam_agent.slam.map_graph",
}
SEEDED = {
    "default_rng",
    "Generator",
    "SeedSequence",
    "BitGenerator",
    "PCG64",
    "PCG64DXSM",
    "Philox",
    "SFC64",
}


def modules_of(top: str) -> dict[str, Path]:
    """The files of a package by their dotted names: of a checkout, or of a wheel, which has no
    benchmarks.
    """
    spec = find_spec(top)
    # Without benchmarks/ in the path, the folder tests/benchmarks answers to that name; it has no
    # __init__.py.
    if top == "benchmarks" and (spec is None or spec.origin is None):
        return {}
    folder = Path(next(iter(spec.submodule_search_locations)))
    found = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


INSTALLED = modules_of("limslam_env") | modules_of("limslam_agent")
MODULES = INSTALLED | modules_of("benchmarks")
PACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(path: Path) -> frozenset[str]:
    """Full dotted names of all that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, (
                f"{path.name}:{node.lineno} imports relatively, which this test does not follow"
            )
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def module_of(name: str) -> str:
    """The module that a name belongs to."""
    asked = name
    while name not in MODULES:
        name, dot, _ = name.rpartition(".")
        assert dot, f"{asked} is neither a module of the project nor a name in one"
    return name


def place_of(name: str) -> str:
    """The package that a module or a name in it belongs to; of modules beside the packages, the
    module itself.
    """
    name = module_of(name)
    if name in PACKAGES or name.count(".") == 1:
        return name
    return name.rpartition(".")[0]


def places_imported(names: list[str]) -> set[str]:
    """The places in the project that modules import."""
    found = frozenset[str]().union(*(imports(MODULES[name]) for name in names))
    return {place_of(name) for name in found if name.split(".")[0] in TOPS}


TOPS = {"limslam_env", "limslam_agent", "benchmarks"}
PLACES = {
    place: [name for name in MODULES if place_of(name) == place] for place in map(place_of, MODULES)
}


def test_every_package_has_a_rule():
    assert set(PLACES) == {name for name in set(RULES) | COMPOSITION if name in PLACES}


@pytest.mark.parametrize("place", [place for place in PLACES if place not in COMPOSITION])
def test_a_package_imports_only_what_its_rule_names(place):
    # What __init__ loads on demand, for users, is no import of the package.
    names = [name for name in PLACES[place] if name not in {"limslam_env", "limslam_agent"}]
    found = places_imported(names) - {place} - RULES[place]
    assert {other for other in found if place not in BENCHMARKS or other in BENCHMARKS} == set()


def test_what_is_installed_imports_no_benchmark():
    found = {
        name
        for name, path in INSTALLED.items()
        if any(full.split(".")[0] == "benchmarks" for full in imports(path))
    }
    assert found == set()


def test_no_package_is_in_an_import_circle():
    graph = {place: places_imported(names) - {place} for place, names in PLACES.items()}
    graph["limslam_env"] = graph["limslam_agent"] = set()  # they load what users ask for, on demand
    while graph:
        leaves = {place for place, others in graph.items() if not others & set(graph)}
        assert leaves, f"these import each other: {sorted(graph)}"
        graph = {place: others for place, others in graph.items() if place not in leaves}


def modules_imported(name: str) -> set[str]:
    """The files of the project that a file imports. The two packages load on demand what users ask
    for.
    """
    if name in {"limslam_env", "limslam_agent"}:
        return set()
    own = {full for full in imports(MODULES[name]) if full.split(".")[0] in TOPS}
    return {module_of(full) for full in own} - {name}


def test_no_file_is_in_an_import_circle():
    graph = {name: modules_imported(name) for name in MODULES}
    while leaves := {name for name, others in graph.items() if not others & set(graph)}:
        graph = {name: others for name, others in graph.items() if name not in leaves}
    while unused := set(graph) - set().union(*graph.values()):
        graph = {name: others for name, others in graph.items() if name not in unused}
    assert not graph


@pytest.mark.parametrize(
    ("library", "owners"),
    [
        ("pymunk", {"limslam_env.simulation.physics"}),
        (
            "numba",
            {
                "limslam_env.batch.device",
                "limslam_env.compilation",
                "limslam_env.kept_code",
                "limslam_env.linking",
            },
        ),
    ],
)
def test_these_modules_alone_import_it(library, owners):
    found = {
        name
        for name, path in INSTALLED.items()
        if any(full.split(".")[0] == library for full in imports(path))
    }
    assert found == owners


def dotted(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


@pytest.mark.parametrize("place", PLACES)
def test_random_numbers_come_from_seeded_generators(place):
    for name in PLACES[place]:
        tree = tree_of(MODULES[name])
        imported = imports(MODULES[name])
        assert not any(full == "random" or full.startswith("random.") for full in imported), name
        assert {
            full.split(".")[2] for full in imported if full.startswith("numpy.random.")
        } <= SEEDED, name
        used = {dotted(node) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        assert {
            full.split(".")[2] for full in used if full.startswith(("np.random.", "numpy.random."))
        } <= SEEDED, name
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
        unseeded = [
            node.lineno
            for node in calls
            if dotted(node.func).endswith("default_rng") and not node.args
        ]
        assert not unseeded, name


def loaded_by(names: list[str], suspects: set[str]) -> set[str]:
    """Which of the suspects a new interpreter has loaded after importing modules."""
    lines = [
        *(f"import {name}" for name in names),
        "import sys",
        f"print(*({suspects!r} & set(sys.modules)))",
    ]
    command = [sys.executable, "-c", "\n".join(lines)]
    return set(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())


def test_importing_the_env_loads_no_heavy_library():
    assert loaded_by(["limslam_env"], {"pymunk", "numba", "cv2", "pygame"}) == set()
    # What an agent draws is made of arrays.
    assert (
        loaded_by(["limslam_env.rendering.painter"], {"pymunk", "numba", "cv2", "pygame"}) == set()
    )


def test_an_environment_needs_no_library_that_takes_long_to_load():
    assert (
        loaded_by(["limslam_env.envs.env"], {"scipy.ndimage", "scipy.linalg", "matplotlib"})
        == set()
    )


def test_importing_the_agent_loads_no_simulator():
    compiled = [name for place in COMPILED & set(AGENT) for name in PLACES[place]]
    compiled += [
        "limslam_agent.policies.learned.look_ahead",
        "limslam_agent.slam.consistent.clone_ekf",
        "limslam_agent.slam.consistent.clone_filter",
        "limslam_agent.slam.consistent.merging",
        "limslam_agent.slam.consistent.step",
        "limslam_agent.wrappers.vector",
        *PLACES["limslam_agent.two_logs"],
    ]
    replay = ("smoothing", "trust")
    compiled += [f"limslam_agent.replay.{name}" for name in replay]
    parts = [name for place in AGENT for name in PLACES[place] if name not in compiled]
    assert len(parts) > 10
    unwanted = {"pymunk", "numba", "pygame"} | env(
        "worlds.world", "simulation.simulation", "envs.env"
    )
    assert loaded_by(parts, unwanted) == set()


def test_the_suspects_would_be_noticed():
    assert loaded_by(["limslam_env.envs.env"], {"pymunk", "numba"}) == {"pymunk", "numba"}


def test_only_the_published_estimator_loads_filterpy():
    assert loaded_by(["limslam_agent.mapping.mapper"], {"filterpy", "scipy.stats"}) == set()
