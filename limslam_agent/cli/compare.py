"""``limslam compare``: several finished runs side by side."""

from pathlib import Path
from typing import Annotated

import typer

from limslam_agent.cli.show import check_target, open_window, true_edges, write_picture


def compare(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR DIR...", help="The folders of finished runs.")],
    out: Annotated[
        Path | None,
        typer.Option(help="Draw into this file (.png, .pdf, .svg) and open no window.", show_default="none"),
    ] = None,
    *,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Compare finished runs or replays: their metrics, their maps, and their errors over time."""
    from limslam_agent.cli.worlds import table
    from limslam_agent.output.comparison_picture import MOST_RUNS, draw_comparison, sheet_size, table_of
    from limslam_agent.output.finished_run import read_run
    from limslam_env.messages import printable

    if not 2 <= len(folders) <= MOST_RUNS:
        raise ValueError(f"2 to {MOST_RUNS} folders can be compared, not {len(folders)}")
    if out is not None:
        check_target(out, force=force)
    runs = [read_run(folder).with_one_time() for folder in folders]
    for line in table(table_of(runs)).splitlines():
        typer.echo(printable(line))
    edges = [true_edges(run) for run in runs]
    size = sheet_size(len(runs))
    if out is not None:
        write_picture(out, size, lambda figure: draw_comparison(figure, runs, edges))
        typer.echo(printable(f"picture     {out}"))
    elif not open_window("LimSLAM: comparison", size, lambda figure: draw_comparison(figure, runs, edges)):
        typer.echo("there is no display: --out FILE.png draws the maps and the errors over time")
