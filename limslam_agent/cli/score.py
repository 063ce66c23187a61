"""``limslam score``: the metrics of any SLAM system, from the files that it has written."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limslam_agent.cli.options import Overwrite
from limslam_agent.command_options import takes
from limslam_agent.config.help import Help
from limslam_agent.terminal import say, warn

if TYPE_CHECKING:
    from limslam_env.interface import RobotSpec

_TRUTH = "Truth"
_ESTIMATE = "Estimate"
_MAP = "Map"

ALIGNMENTS = ("none", "start", "path")
"""How the frame of an estimate can be moved onto that of the truth."""


@dataclass(frozen=True)
class ScoreOptions:
    """What is scored, and with what: the options of ``limslam score``."""

    estimated: Annotated[
        Path | None,
        Help(_ESTIMATE, "Estimated trajectory (TUM: t x y z qx qy qz qw).", True, "--est"),
    ] = None
    true: Annotated[Path | None, Help(_TRUTH, "True trajectory (TUM), of other times too.")] = None
    relations: Annotated[
        Path | None, Help(_TRUTH, "Known relative poses instead of a true trajectory.")
    ] = None
    covariances: Annotated[
        Path | None,
        Help(
            _ESTIMATE,
            "Covariances of the estimated poses: lines t xx xy xh yy yh hh, or covariance_est.npz "
            "of a run.",
        ),
    ] = None
    align: Annotated[
        str,
        Help(
            _ESTIMATE,
            "How the frame of the estimate is moved first: none, start (equal first poses) or "
            "path (all poses).",
        ),
    ] = "none"
    max_difference: Annotated[
        float, Help(_ESTIMATE, "Most that the times of two poses may differ, s.")
    ] = 0.01
    walls: Annotated[Path | None, Help(_MAP, "Estimated walls: a map.json.", True, "--map")] = None
    world: Annotated[str | None, Help(_MAP, "The true walls: a world file or a world's name.")] = (
        None
    )
    robot: Annotated[str, Help(_MAP, "Robot that drove, which decides what can be seen.")] = "paper"

    def __post_init__(self) -> None:
        if self.align not in ALIGNMENTS:
            raise ValueError(f"--align: {', '.join(ALIGNMENTS)} can be chosen, not {self.align!r}")
        if not 0.0 <= self.max_difference < math.inf:
            raise ValueError(
                f"--max-difference: must be at least 0 s and finite, not {self.max_difference:g}"
            )
        if self.estimated is None and self.walls is None:
            raise ValueError(
                "something to score is needed: --est FILE.tum, or --map map.json with --world"
            )
        if (self.walls is None) != (self.world is None):
            raise ValueError(
                "--map and --world go together: a map is scored against the walls of a world"
            )
        if self.estimated is not None and self.true is None and self.relations is None:
            raise ValueError(
                f"{self.estimated}: needs something to compare with: --true FILE.tum, or "
                "--relations FILE"
            )
        needs = {"--true": self.true, "--relations": self.relations}
        if self.estimated is None and any(needs.values()):
            raise ValueError(
                f"{next(name for name, file in needs.items() if file)} needs --est FILE.tum"
            )
        if self.true is None and (self.covariances is not None or self.align != "none"):
            raise ValueError("--covariances and --align need --est and --true")


@takes(ScoreOptions)
def score(
    out: Annotated[
        Path | None, typer.Option(help="Also write the metrics into this file (.json).")
    ] = None,
    *,
    force: Overwrite = False,
    **told: Any,
) -> None:
    """Score the trajectory and the map of any SLAM system by the metrics of this project."""
    from limslam_agent.output.atomic_write import atomic_write, check_target
    from limslam_agent.output.export import write_json
    from limslam_agent.robot_file import robot_named

    if out is not None:
        check_target(out, force=force)
    options = ScoreOptions(**{name: value for name, value in told.items() if value is not None})
    scores = _scores(options, robot_named(options.robot))
    width = max(map(len, scores))
    say(*(f"{name:{width}}  {_figure(value)}" for name, value in scores.items()))
    if out is not None:
        with atomic_write(out) as beside:
            write_json(beside, scores)
        say(f"written to {out}")


def _scores(options: ScoreOptions, robot: "RobotSpec") -> dict[str, float | int | None]:
    """All metrics that the files allow, by the names of ``docs/metrics.md``."""
    import numpy as np

    from limslam_agent.logs.relations import read_relations, relation_errors, summary
    from limslam_agent.output.finished_run import read_walls
    from limslam_agent.output.tum import out_of_plane, read_tum
    from limslam_agent.runs.score_files import map_scores, read_pairs, trajectory_scores
    from limslam_env.worlds.formats.loading import load_world

    scores: dict[str, float | int | None] = {}
    pairs = None
    motion = np.zeros(3)
    if options.estimated is not None and options.true is not None:
        pairs = read_pairs(
            options.true, options.estimated, options.covariances, options.max_difference
        )
        warn([*out_of_plane(options.true), *out_of_plane(options.estimated), *pairs.doubts()])
        motion = pairs.alignment(options.align)
        scores |= trajectory_scores(pairs.moved(motion))
    if options.estimated is not None and options.relations is not None:
        if options.true is None:
            warn(out_of_plane(options.estimated))
        scores |= summary(
            relation_errors(read_relations(options.relations), *read_tum(options.estimated))
        )
    if options.walls is not None and options.world is not None:
        scores |= map_scores(
            load_world(options.world), robot, read_walls(options.walls), motion, pairs
        )
    return scores


def _figure(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.4g}"
