"""``limslam score``: the metrics of any SLAM system, from the files that it has written."""

from pathlib import Path
from typing import Annotated

import typer

_TRUTH, _ESTIMATE, _MAP = "Truth", "Estimate", "Map"


def score(
    estimated: Annotated[
        Path | None,
        typer.Option("--est", help="Estimated trajectory (TUM: t x y z qx qy qz qw).", rich_help_panel=_ESTIMATE),
    ] = None,
    true: Annotated[
        Path | None, typer.Option("--true", help="True trajectory (TUM), of other times too.", rich_help_panel=_TRUTH)
    ] = None,
    relations: Annotated[
        Path | None,
        typer.Option(help="Known relative poses instead of a true trajectory.", rich_help_panel=_TRUTH),
    ] = None,
    covariances: Annotated[
        Path | None,
        typer.Option(
            help="Covariances of the estimated poses: lines t xx xy xh yy yh hh, or covariance_est.npz of a run.",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None,
    align: Annotated[
        str,
        typer.Option(
            help="How the frame of the estimate is moved first: none, start (equal first poses) or path (all poses).",
            rich_help_panel=_ESTIMATE,
        ),
    ] = "none",
    max_difference: Annotated[
        float, typer.Option(help="Most that the times of two poses may differ, s.", rich_help_panel=_ESTIMATE)
    ] = 0.01,
    walls: Annotated[
        Path | None, typer.Option("--map", help="Estimated walls: a map.json.", rich_help_panel=_MAP)
    ] = None,
    world: Annotated[
        str | None, typer.Option(help="The true walls: a world file or a world's name.", rich_help_panel=_MAP)
    ] = None,
    robot: Annotated[
        str, typer.Option(help="Robot that drove, which decides what can be seen.", rich_help_panel=_MAP)
    ] = "paper",
    out: Annotated[Path | None, typer.Option(help="Also write the metrics into this file (.json).")] = None,
    *,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Score the trajectory and the map of any SLAM system by the metrics of this project."""
    from limslam_agent.cli.settings import robot_named
    from limslam_agent.output.atomic_write import atomic_write, check_target
    from limslam_agent.output.export import write_json
    from limslam_agent.runs.score_files import ScoredFiles
    from limslam_env.messages import printable

    if out is not None:
        check_target(out, force=force)
    files = ScoredFiles(
        estimated, true, relations, covariances, align, max_difference, walls, world, robot_named(robot)
    )
    scores = files.scores()
    width = max(map(len, scores))
    for name, value in scores.items():
        typer.echo(f"{name:{width}}  {_figure(value)}")
    if out is not None:
        with atomic_write(out) as beside:
            write_json(beside, scores)
        typer.echo(printable(f"written to {out}"))


def _figure(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.4g}"
