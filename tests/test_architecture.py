"""Who may import whom, read from the source with ast; and what an import loads, seen in a new interpreter."""

import ast
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import limslam_env

LAYERS = [
    {"geometry"},
    {"interface", "config", "robots", "overlay", "window", "free_space", "world", "roadmap"},
    {"map_server", "readers", "writers", "room_layout", "furnishing", "floor_plans"},
    {"kernels", "task"},
    {"random_kernels", "contact_kernels"},
    {"tile_kernels", "physics"},
    {"sensors", "odometry", "draws", "batch_kernels"},
    {"coverage", "starts"},
    {"tour_search", "tours"},
    {"batch_worlds", "batch_noise"},
    {"batch_places"},
    {"simulation", "batch"},
    {"adapter", "painter"},
    {"batch_arguments"},
    {"batch_adapter"},
    {"env", "parallel", "vector_env", "vector_parallel"},
    {"wrappers", "play", "sb3"},
]
# These stand beside the layers: they may read what a world is, and nothing that moves in it.
BESIDE = {"metrics": {"world", "geometry", "free_space", "interface"}, "association_metrics": {"geometry"}}
BESIDE["limit_model"] = {"geometry", "interface"}
BESIDE["limit_solver"] = {"geometry", "limit_model"}
BESIDE["limits"] = {"geometry", "interface", "limit_model", "limit_solver"}
BESIDE["rendering"] = BESIDE["metrics"] | {"overlay"}
# What is imported inside functions only, where it is asked for: readers need OpenCV, pictures too, a window pygame.
ON_DEMAND = {"world": {"readers", "map_server"}, "painter": {"rendering", "window"}}
# Data and the package's own front door; no room of the house.
NO_LAYER = {"", "worlds"}

COMPOSITION_ROOT = {"episode", "evaluation", "pilot", "results", "cli", "world_commands", "show_command", "recording"}
SEEDED = {"default_rng", "Generator", "SeedSequence", "BitGenerator", "PCG64", "PCG64DXSM", "Philox", "SFC64"}
LONGEST_FILE = 330
# numba's cache notices a change in the file of a kernel only, not in one that it calls: kernels stay together.
LONGEST_KERNELS = 520

# Wherever the packages are installed: the checkout, or a wheel.
ENV_FOLDER = Path(limslam_env.__file__).parent
AGENT_FOLDER = Path(next(iter(find_spec("limslam_agent").submodule_search_locations)))


def modules(folder: Path) -> dict[str, Path]:
    """Dotted names within a package, without the package's own; "" is its __init__."""
    found = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


ENV, AGENT = modules(ENV_FOLDER), modules(AGENT_FOLDER)
ALL = {
    f"{folder.name}.{name}".rstrip("."): path
    for folder in (ENV_FOLDER, AGENT_FOLDER)
    for name, path in modules(folder).items()
}


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path) -> set[str]:
    """Full dotted names of all that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno} imports relatively, which this test does not follow"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def rooms(path: Path, package: str) -> set[str]:
    """The modules of a package that a file imports, by their first name; "" for the package itself."""
    known = {name.split(".")[0] for name in (ENV if package == "limslam_env" else AGENT)}
    parts = [name.split(".") for name in imports(path)]
    return {inner[0] if inner and inner[0] in known else "" for first, *inner in parts if first == package}


def layer_of(name: str) -> int:
    room = name.split(".", maxsplit=1)[0]
    (layer,) = [number for number, names in enumerate(LAYERS) if room in names]
    return layer


def test_every_module_of_the_env_has_a_place():
    placed = set().union(*LAYERS, BESIDE, NO_LAYER)
    assert {name.split(".")[0] for name in ENV} <= placed


@pytest.mark.parametrize("name", [name for name in ENV if name.split(".")[0] not in {*BESIDE, *NO_LAYER}])
def test_no_module_of_the_env_imports_a_later_layer(name):
    imported = rooms(ENV[name], "limslam_env") - {name.split(".")[0]} - ON_DEMAND.get(name, set())
    assert "" not in imported, "the package's front door is for users"
    assert all(layer_of(other) <= layer_of(name) for other in imported), imported


def test_geometry_is_a_leaf():
    for name, path in ENV.items():
        if name.split(".")[0] == "geometry":
            outside = {full.split(".")[0] for full in imports(path)} - {"limslam_env", "numpy", "math", "typing"}
            assert not outside
            assert rooms(path, "limslam_env") <= {"geometry"}


@pytest.mark.parametrize("name", sorted(BESIDE))
def test_metrics_and_rendering_stand_on_the_world_alone(name):
    assert rooms(ENV[name], "limslam_env") <= BESIDE[name]


@pytest.mark.parametrize("name", sorted(ON_DEMAND))
def test_what_is_loaded_on_demand_is_not_imported_at_the_top(name):
    # Below "if TYPE_CHECKING" nothing is loaded.
    top = [node for node in tree_of(ENV[name]).body if isinstance(node, ast.Import | ast.ImportFrom)]
    modules_at_top = {node.module for node in top if isinstance(node, ast.ImportFrom)}
    assert not modules_at_top & {f"limslam_env.{room}" for room in ON_DEMAND[name]}


@pytest.mark.parametrize("name", ENV)
def test_the_env_never_imports_the_agent(name):
    assert not any(full.split(".")[0] == "limslam_agent" for full in imports(ENV[name]))


@pytest.mark.parametrize("name", AGENT)
def test_an_agent_cannot_read_the_truth(name):
    # The front door names all there is, and loads nothing: see below.
    if name in COMPOSITION_ROOT | {""}:
        return
    assert rooms(AGENT[name], "limslam_env") <= {"geometry", "interface"}
    assert not rooms(AGENT[name], "limslam_agent") & COMPOSITION_ROOT, "it would get at the env through them"


@pytest.mark.parametrize(
    ("library", "owners"),
    [
        ("pymunk", {"limslam_env.physics"}),
        ("numba", {"limslam_env.kernels", "limslam_agent.batch_compile"}),
    ],
)
def test_these_modules_alone_import_it(library, owners):
    importers = {name for name, path in ALL.items() if any(full.split(".")[0] == library for full in imports(path))}
    assert importers == owners


def test_only_the_batch_knows_its_kernels():
    users = {name for name in AGENT if any(room.startswith("batch_") for room in rooms(AGENT[name], "limslam_agent"))}
    assert users == {name for name in AGENT if is_of_batch(name)} - {"batch_compile", "batch_state"}


def is_of_batch(name: str) -> bool:
    """Whether a module is compiled, for many robots at once, or uses what is; who has one robot never loads it."""
    return name.startswith("batch_") or name == "vector_wrappers"


def dotted(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


@pytest.mark.parametrize("name", ALL)
def test_no_module_draws_from_global_random_state(name):
    imported = imports(ALL[name])
    assert not any(full == "random" or full.startswith("random.") for full in imported)
    assert {full.split(".")[2] for full in imported if full.startswith("numpy.random.")} <= SEEDED
    used = {dotted(node) for node in ast.walk(tree_of(ALL[name])) if isinstance(node, ast.Attribute)}
    drawn = {full.split(".")[2] for full in used if full.startswith(("np.random.", "numpy.random."))}
    assert drawn <= SEEDED


@pytest.mark.parametrize("name", ALL)
def test_every_generator_is_seeded(name):
    calls = [node for node in ast.walk(tree_of(ALL[name])) if isinstance(node, ast.Call)]
    unseeded = [node.lineno for node in calls if dotted(node.func).endswith("default_rng") and not node.args]
    assert not unseeded


@pytest.mark.parametrize("name", ALL)
def test_no_file_is_too_long(name):
    longest = LONGEST_KERNELS if name == "limslam_env.kernels" else LONGEST_FILE
    assert len(ALL[name].read_text(encoding="utf-8").splitlines()) <= longest


def loaded_by(names: list[str], suspects: set[str]) -> set[str]:
    """Which of the suspects a new interpreter has loaded after importing modules."""
    lines = [*(f"import {name}" for name in names), "import sys", f"print(*({suspects!r} & set(sys.modules)))"]
    command = [sys.executable, "-c", "\n".join(lines)]
    return set(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())


def test_importing_the_env_loads_no_heavy_library():
    assert loaded_by(["limslam_env"], {"pymunk", "numba", "cv2", "pygame"}) == set()


def test_importing_the_agent_loads_no_simulator():
    parts = [
        f"limslam_agent.{name}".rstrip(".") for name in AGENT if name not in COMPOSITION_ROOT and not is_of_batch(name)
    ]
    assert len(parts) > 10
    unwanted = {"pymunk", "numba", "pygame", "limslam_env.world", "limslam_env.simulation", "limslam_env.env"}
    assert loaded_by(parts, unwanted) == set()


def test_the_suspects_would_be_noticed():
    assert loaded_by(["limslam_env.env"], {"pymunk", "numba"}) == {"pymunk", "numba"}
