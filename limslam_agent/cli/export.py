"""``limslam export``: a finished run in the formats of other programs."""

from pathlib import Path
from typing import Annotated

import typer


def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a finished run or replay.")],
    *,
    csv: Annotated[bool, typer.Option("--csv", help="Tables: trajectories, walls, and the log of readings.")] = False,
    dxf: Annotated[bool, typer.Option("--dxf", help="Walls and paths for a CAD program: map.dxf.")] = False,
    bag: Annotated[bool, typer.Option("--bag", help="A ROS 2 bag, which Foxglove opens, too: the folder bag.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the files.", show_default="DIR/export")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
) -> None:
    """Write a finished run in the formats of other programs."""
    from limslam_agent.output.formats.export import export_run
    from limslam_env.messages import printable

    wanted = {"csv": csv, "dxf": dxf, "bag": bag}
    formats = [name for name, is_wanted in wanted.items() if is_wanted]
    if not formats:
        raise ValueError("a format is needed: --csv, --dxf or --bag")
    for path in export_run(folder, out or folder / "export", formats, force=force):
        typer.echo(printable(f"written     {path}"))
