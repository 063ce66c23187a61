"""``limslam worlds``: list the shipped worlds, check a world file, convert some, draw one."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limslam_agent.cli.options import Overwrite, PlanOptions
from limslam_agent.cli.run import file_name
from limslam_agent.command_options import takes, with_told
from limslam_agent.terminal import print_table, say, warn

if TYPE_CHECKING:
    from limslam_env.worlds.world import World

worlds = typer.Typer(
    name="worlds", help="List the shipped worlds; check, convert and draw world files."
)

# A building as large as that is rare, and a plan in feet or inches is not.
_LARGE = 150.0

# The grid that is searched grows as the robot shrinks.
_SMALLEST_RADIUS = 0.02
_LARGEST_RADIUS = 10.0

Radius = Annotated[float, typer.Option(help="Radius of the robot, m.")]

_HEADINGS = ("name", "size, m", "walls", "obstacles", "doors", "starts", "loop", "id")


@worlds.callback(invoke_without_command=True)
def list_worlds(context: typer.Context) -> None:
    """List the shipped worlds."""
    if context.invoked_subcommand is not None:
        return
    from limslam_env.worlds.formats.loading import load_world, shipped_worlds

    places = {name: load_world(name) for name in shipped_worlds()}
    ids = _gym_ids()
    print_table(
        [_HEADINGS, *(_row(name, place, ids.get(name, "")) for name, place in places.items())]
    )


@worlds.command()
@takes(PlanOptions)
def check(
    world: Annotated[
        str, typer.Argument(metavar="FILE", help="A world file, or the name of a shipped world.")
    ],
    radius: Radius = 0.10,
    **told: Any,
) -> None:
    """Check whether a robot can be used in a world, and show the reason if it cannot, or where its
    outline is open.
    """
    import numpy as np

    from limslam_env.messages import LONGEST_VALUE, counted, one_line
    from limslam_env.worlds.regions import start_region
    from limslam_env.worlds.world import named

    _check_radius(radius)
    place = with_told(PlanOptions(), told).load(world)
    width, height = np.ptp(place.edges.reshape(-1, 2), axis=0)
    notes = [*place.notes]
    if max(width, height) > _LARGE:
        notes.append(f"its walls measure {width:.0f} x {height:.0f} m: are its lengths in m?")
    warn([one_line(f"{world}: {note}") for note in notes])
    with named(world):
        place.check(radius)
    region = start_region(place, radius)
    typer.echo(
        f"{one_line(place.name, LONGEST_VALUE)}: {place.size[0]:g} x {place.size[1]:g} m, "
        f"{counted(len(place.walls), 'wall')}, "
        f"{counted(len(place.obstacles), 'obstacle')}, {counted(len(place.doors), 'door')}, "
        f"{counted(len(place.starts), 'start')}, {region.area:.1f} m^2 of floor within reach"
    )
    if region.warning:
        warn([one_line(f"{world}: {region.warning}{place.opening_note(radius)}")])


@worlds.command()
@takes(PlanOptions)
def convert(
    source: Annotated[
        str, typer.Argument(help="A world file of any kind, or the name of a shipped world.")
    ],
    target: Annotated[
        Path, typer.Argument(help="Where to write it: .toml, or .yaml with a .pgm beside it.")
    ],
    *,
    force: Overwrite = False,
    **told: Any,
) -> None:
    """Write a world in another format."""
    from limslam_agent.output.atomic_write import check_target
    from limslam_env.worlds.formats.loading import write_world

    files = [target, target.with_suffix(".pgm")] if target.suffix in {".yaml", ".yml"} else [target]
    for file in files:
        check_target(file, force=force)
    place = with_told(PlanOptions(), told).load(source)
    warn([f"{source}: {note}" for note in place.notes])
    write_world(place, target)
    say(f"world       {target}")


@worlds.command("import")
def import_maps(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A folder of pictures (.png, .pgm, .jpg, .bmp).")
    ],
    metres_per_pixel: Annotated[float, typer.Option(help="Side of a pixel, m.")],
    out: Annotated[Path, typer.Option(help="Folder of the worlds.")] = Path("worlds"),
    *,
    force: Overwrite = False,
) -> None:
    """Write each picture of a folder as a world file, such as the maps of exploration papers, which
    say where robots start.
    """
    from limslam_agent.output.atomic_write import check_target
    from limslam_env.messages import counted
    from limslam_env.worlds.formats.loading import load_world, write_world
    from limslam_env.worlds.formats.pictures import SUFFIXES

    pictures = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not pictures:
        raise ValueError(f"{folder}: no pictures there ({', '.join(SUFFIXES)})")
    places = [load_world(path, metres_per_pixel=metres_per_pixel) for path in pictures]
    targets = [out / f"{path.stem}.toml" for path in pictures]
    for target in targets:
        check_target(target, force=force)
    out.mkdir(parents=True, exist_ok=True)
    for place, target in zip(places, targets, strict=True):
        write_world(place, target)
    say(f"worlds      {counted(len(targets), 'world')} in {out}")


@worlds.command()
@takes(PlanOptions)
def draw(
    world: Annotated[
        str | None,
        typer.Argument(
            metavar="FILE",
            help="A world file of any kind, or the name of a shipped world.",
            show_default="an empty plan",
        ),
    ] = None,
    over: Annotated[
        Path | None, typer.Option(help="Picture of a plan to draw over (.png, .jpg).")
    ] = None,
    radius: Radius = 0.10,
    out: Annotated[
        Path | None, typer.Option(help="Write this file (.html).", show_default="NAME.html")
    ] = None,
    *,
    force: Overwrite = False,
    **told: Any,
) -> None:
    """Write a page on which a world is drawn: open it in any browser, and save the world there."""
    from limslam_agent.draw.page import picture_address, write_drawing_page
    from limslam_agent.output.atomic_write import check_target
    from limslam_env.worlds.formats.tables import world_table

    _check_radius(radius)
    table: dict[str, Any] = {"name": "world", "walls": []}
    if world is not None:
        place = with_told(PlanOptions(), told).load(world)
        warn([f"{world}: {note}" for note in place.notes])
        table = world_table(place)
    target = out or Path(f"{file_name(table['name'])}.html")
    check_target(target, "a page", (".html", ".htm"), force=force)
    picture = "" if over is None else picture_address(over)
    size = write_drawing_page(target, table, radius, picture)
    say(f"page        {target} ({size / 1e6:.1f} MB)")


def _check_radius(radius: float) -> None:
    if not _SMALLEST_RADIUS <= radius <= _LARGEST_RADIUS:
        raise ValueError(
            f"--radius: {_SMALLEST_RADIUS:g} to {_LARGEST_RADIUS:g} m can be checked, not "
            f"{radius:g}"
        )


def _gym_ids() -> dict[str, str]:
    """Gymnasium's id of each shipped world that has one of its own."""
    import gymnasium as gym

    import limslam_env  # noqa: F401 (registers the ids)

    ours = {name: spec for name, spec in gym.registry.items() if name.startswith("LimSlam-")}
    return {
        spec.kwargs["world"]: name
        for name, spec in ours.items()
        if isinstance(spec.kwargs.get("world"), str)
    }


def _row(name: str, world: "World", gym_id: str) -> tuple[str, ...]:
    counts = (
        str(len(things)) for things in (world.walls, world.obstacles, world.doors, world.starts)
    )
    loop = "yes" if len(world.loop) else "no"
    return (name, f"{world.size[0]:g} x {world.size[1]:g}", *counts, loop, gym_id)
