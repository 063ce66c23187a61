"""``limslam score``: the metrics of any SLAM system, from the files that it has written."""

from pathlib import Path
from typing import Annotated

import typer

from limslam_agent.cli.options import told

_TRUTH, _ESTIMATE, _MAP = "Truth", "Estimate", "Map"


def score(
    estimated: Annotated[
        Path | None, told(_ESTIMATE, "Estimated trajectory (TUM: t x y z qx qy qz qw).", True, "--est")
    ] = None,
    true: Annotated[Path | None, told(_TRUTH, "True trajectory (TUM), of other times too.")] = None,
    relations: Annotated[Path | None, told(_TRUTH, "Known relative poses instead of a true trajectory.")] = None,
    covariances: Annotated[
        Path | None,
        told(
            _ESTIMATE, "Covariances of the estimated poses: lines t xx xy xh yy yh hh, or covariance_est.npz of a run."
        ),
    ] = None,
    align: Annotated[
        str,
        told(
            _ESTIMATE,
            "How the frame of the estimate is moved first: none, start (equal first poses) or path (all poses).",
        ),
    ] = "none",
    max_difference: Annotated[float, told(_ESTIMATE, "Most that the times of two poses may differ, s.")] = 0.01,
    walls: Annotated[Path | None, told(_MAP, "Estimated walls: a map.json.", True, "--map")] = None,
    world: Annotated[str | None, told(_MAP, "The true walls: a world file or a world's name.")] = None,
    robot: Annotated[str, told(_MAP, "Robot that drove, which decides what can be seen.")] = "paper",
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
