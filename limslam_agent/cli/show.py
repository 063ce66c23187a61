"""``limslam show``, ``compare`` and ``export``: what is done with finished runs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limslam_agent.cli.options import Overwrite
from limslam_agent.terminal import in_notebook, print_table, say

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeAlias

    from matplotlib.figure import Figure

    from limslam_agent.output.finished_run import FinishedRun
    from limslam_env.geometry import FloatArray

    Draw: TypeAlias = Callable[[Figure], None]

SUFFIXES = (".png", ".pdf", ".svg")

_Out = Annotated[
    Path | None,
    typer.Option(
        help="Draw into this file (.png, .pdf, .svg) and open no window.", show_default="none"
    ),
]


def show(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="The folder of a finished run or replay.")
    ],
    out: _Out = None,
    *,
    force: Overwrite = False,
) -> None:
    """Show a finished run: its metrics, its map, and its errors over time."""
    from limslam_agent.output.atomic_write import check_target
    from limslam_agent.output.finished_run import PICTURE, part_of, read_run
    from limslam_agent.output.run_picture import SIZE, draw_run
    from limslam_agent.output.summary import record_summary, replay_summary, run_summary

    if out is not None:
        check_target(out, "a picture", SUFFIXES, force=force)
    run = read_run(folder)
    metrics, cost = (part_of(run.result, part) for part in ("metrics", "cost"))
    lines = record_summary(run.result) + (
        replay_summary(metrics) if run.is_replay else run_summary(metrics, cost)
    )
    say(f"run         {run.title}", *lines)
    edges = true_edges(run)
    title = f"LimSLAM: {run.folder.name}"
    picture = folder / PICTURE
    if (
        not _drawn(out, title, SIZE, lambda figure: draw_run(figure, run, lines, edges))
        and picture.is_file()
    ):
        say(f"picture     {picture}")


def _drawn(out: Path | None, title: str, size: tuple[float, float], draw: "Draw") -> bool:
    """Draw a figure into a file, or in a window; False if there is no window to draw in, which is
    said.
    """
    if out is not None:
        write_picture(out, size, draw)
        say(f"picture     {out}")
    elif not open_window(title, size, draw):
        typer.echo("there is no display: --out FILE.png draws the map and the errors over time")
        return False
    return True


def true_edges(run: "FinishedRun") -> "FloatArray | None":
    """The walls (k, 4), m, of the world that was run in: of the run's folder, or of a world that
    ships unchanged.
    """
    from limslam_agent.output.finished_run import WORLD
    from limslam_env.worlds.formats.loading import load_world, shipped_worlds

    name = run.config.get("world")
    path = run.folder / WORLD
    if path.is_file():
        world = load_world(path)
    elif isinstance(name, str) and name in shipped_worlds():
        world = load_world(name)
    else:
        return None
    return world.edges if world.digest == run.config.get("world_digest") else None


def write_picture(path: Path, size: tuple[float, float], draw: "Draw") -> None:
    """Draw a figure of a size in inches into a file, which appears only when it is complete."""
    from matplotlib.figure import Figure

    from limslam_agent.output.atomic_write import atomic_write

    figure = Figure(figsize=size, layout="constrained")
    draw(figure)
    with atomic_write(path) as beside:
        figure.savefig(beside, dpi=150, facecolor="white")


def open_window(title: str, size: tuple[float, float], draw: "Draw") -> bool:
    """Show a figure in a window until it is closed; False, and nothing is shown, where no window
    can be opened.
    """
    from limslam_env.rendering.window import has_display

    if not has_display() and not in_notebook():
        return False
    import matplotlib.pyplot as plt

    try:
        figure = plt.figure(title, figsize=size, layout="constrained")
    except ImportError:  # the toolkit that Matplotlib is told to use cannot be had
        return False
    try:
        # Without a toolkit for windows, Matplotlib falls back to one that only writes files.
        framework = type(figure.canvas).required_interactive_framework
        if framework is None and not in_notebook():
            return False
        draw(figure)
        plt.show()
    finally:
        plt.close(figure)
    return True


def compare(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR DIR...", help="The folders of finished runs.")
    ],
    out: _Out = None,
    *,
    force: Overwrite = False,
) -> None:
    """Compare finished runs or replays: their metrics, their maps, and their errors over time."""
    from limslam_agent.output.atomic_write import check_target
    from limslam_agent.output.finished_run import read_run
    from limslam_agent.output.run_picture import MOST_RUNS, draw_comparison, sheet_size, table_of

    if not 2 <= len(folders) <= MOST_RUNS:
        raise ValueError(f"2 to {MOST_RUNS} folders can be compared, not {len(folders)}")
    if out is not None:
        check_target(out, "a picture", SUFFIXES, force=force)
    runs = [read_run(folder).with_one_time() for folder in folders]
    print_table(table_of(runs))
    edges = [true_edges(run) for run in runs]
    size = sheet_size(len(runs))
    _drawn(out, "LimSLAM: comparison", size, lambda figure: draw_comparison(figure, runs, edges))


def export(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="The folder of a finished run or replay.")
    ],
    *,
    csv: Annotated[
        bool, typer.Option("--csv", help="Tables: trajectories, walls, and the log of readings.")
    ] = False,
    dxf: Annotated[
        bool, typer.Option("--dxf", help="Walls and paths for a CAD program: map.dxf.")
    ] = False,
    bag: Annotated[
        bool, typer.Option("--bag", help="A ROS 2 bag, which Foxglove opens, too: the folder bag.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the files.", show_default="DIR/export")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
) -> None:
    """Write a finished run in the formats of other programs."""
    from limslam_agent.output.formats.export import export_run

    wanted = {"csv": csv, "dxf": dxf, "bag": bag}
    formats = [name for name, is_wanted in wanted.items() if is_wanted]
    if not formats:
        raise ValueError("a format is needed: --csv, --dxf or --bag")
    say(
        *(
            f"written     {path}"
            for path in export_run(folder, out or folder / "export", formats, force=force)
        )
    )
