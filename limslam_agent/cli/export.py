"""``limslam export``: a finished run in the formats of other programs."""

from pathlib import Path
from typing import Annotated

import typer


def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a finished run or replay.")],
    *,
    csv: Annotated[bool, typer.Option("--csv", help="Tables: trajectories, walls, and the log of readings.")] = False,
    geojson: Annotated[bool, typer.Option("--geojson", help="Walls and paths for a GIS: map.geojson.")] = False,
    dxf: Annotated[bool, typer.Option("--dxf", help="Walls and paths for a CAD program: map.dxf.")] = False,
    bag: Annotated[bool, typer.Option("--bag", help="A ROS 2 bag: the folder bag.")] = False,
    mcap: Annotated[bool, typer.Option("--mcap", help="The same messages for Foxglove: run.mcap.")] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="A recording for the Rerun viewer: run.rrd.")] = False,
    origin: Annotated[
        str | None,
        typer.Option(help="Latitude and longitude of (0, 0), deg: LAT,LON. For --geojson.", show_default="metres"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the files.", show_default="DIR/export")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
) -> None:
    """Write a finished run in the formats of other programs."""
    from limslam_agent.output.formats.export import Format, export_run
    from limslam_env.messages import printable

    wanted = {
        Format.CSV: csv,
        Format.GEOJSON: geojson,
        Format.DXF: dxf,
        Format.BAG: bag,
        Format.MCAP: mcap,
        Format.RERUN: rerun,
    }
    formats = [name for name, is_wanted in wanted.items() if is_wanted]
    if not formats:
        raise ValueError("a format is needed: --csv, --geojson, --dxf, --bag, --mcap or --rerun")
    for path in export_run(folder, out or folder / "export", formats, _origin(origin), force=force):
        typer.echo(printable(f"written     {path}"))


def _origin(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError:
        raise ValueError(f"--origin: two numbers are needed, as in 52.52,13.40, not {text!r}") from None
    if not (abs(latitude) < 90.0 and abs(longitude) <= 180.0):
        raise ValueError(f"--origin: {text} is not a latitude and a longitude in degrees")
    return latitude, longitude
