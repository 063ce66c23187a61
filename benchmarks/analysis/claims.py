"""The claims of the paper, and their verdicts from the results.

A claim consists of its words, its place in the paper, and a function that checks it in the rows of the published
method. The paper gives no numerical criteria. The criteria are choices of this project, and are stated in the evidence.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.analysis import claim_checks as checks
from benchmarks.analysis.claim_checks import Finding, Results
from benchmarks.suite.store import Row


@dataclass(frozen=True)
class Claim:
    """A claim of the paper.

    Attributes
    ----------
    words
        The text of the claim.
    source
        The place of the claim in the paper.
    check
        The function that computes the finding from the results.
    """

    words: str
    source: str
    check: Callable[[Results], Finding]


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim.

    Attributes
    ----------
    claim, source
        The text of the claim, and its place in the paper.
    outcome
        ``confirmed``, ``partly``, ``not confirmed``, ``undecided`` (the interval contains both answers, and more runs
        are needed) or ``not tried in these rows``.
    evidence
        The supporting numbers: medians with 95 % intervals, numbers of runs, and the criterion.
    """

    claim: str
    source: str
    outcome: str
    evidence: str


def claims(rows: Sequence[Row], folder: Path | None = None) -> list[Verdict]:
    """Judge each claim of the paper by the rows.

    Parameters
    ----------
    rows
        Rows of one folder of results.
    folder
        Folder of the rows. Claims about the course of a run need its series, and are not tried without a folder.
    """
    results = Results(rows, folder)
    found = ((claim, claim.check(results)) for claim in CLAIMS)
    return [Verdict(claim.words, claim.source, finding.outcome, finding.evidence) for claim, finding in found]


CLAIMS = (
    *(
        Claim(
            f"{world}, no noise, one robot: a fairly correct map, small parts of walls missing, nothing false in it",
            f"3.1, Fig. {figure}a",
            checks.clean_map(world),
        )
        for world, figure in (("env1", 7), ("env2", 8), ("env3", 9))
    ),
    Claim("env1: artificial obstacles arise with sensor noise", "3.1, Fig. 7b, c", checks.obstacles_grow("env1")),
    Claim("env3: a few artificial obstacles appear with noise", "3.1, Fig. 9c", checks.obstacles_grow("env3")),
    Claim(
        "env2: noise brings wrong associations", "3.1, Fig. 8b, c",
        checks.by_noise("env2", "association_right_share", falls=True),
    ),
    Claim("env2: one robot finds the door without noise", "3.1, Fig. 8a", checks.door_open("env2", 0.0, 1)),
    Claim("env2: one robot loses the door at 2 cm", "3.1, Fig. 8b", checks.door_lost("env2", 0.02, 1)),
    Claim("env2: two robots keep the door at 2 cm", "3.2, Fig. 11", checks.door_open("env2", 0.02, 2)),
    Claim(
        "Two robots overcome some of the noise in env1", "3.2, Fig. 10b, c",
        checks.two_robots("wall_f1_aligned", "aligned F1", world="env1", only_noisy=True),
    ),
    Claim(
        "Two robots improve the map of env3, above all with noise", "3.2, Fig. 12",
        checks.two_robots("wall_f1_aligned", "aligned F1", world="env3", only_noisy=True),
    ),
    Claim(
        "Two robots raise the rate of right associations", "4; 3.2, Fig. 11",
        checks.two_robots("association_right_share", "share of right associations"),
    ),
    Claim("Two robots halve the exploration time", "5; 4", checks.time_is_halved),
    *(
        Claim(
            f"Four laps: the error in {name} grows without the EKF and is stable with it",
            f"4, Fig. {figure}", checks.error_is_stable(component),
        )
        for component, (name, figure) in enumerate((("x", 13), ("y", 14), ("heading", 15)))
    ),
    Claim("The EKF improves the pose", "4", checks.filter_improves_the_pose),
    Claim("The EKF lets the map be better", "4", checks.worse_without("no-ekf", "the EKF")),
    Claim("The EKF gains more, the farther the robot drives", "4", checks.gain_grows),
    Claim("Loop closing increases the success", "5; 2.5", checks.worse_without("no-loop-closing", "loop closing")),
    Claim(
        "End points must be checked, or different walls are taken for one", "2.4, Fig. 2",
        checks.worse_without("no-end-gate", "the check"),
    ),
)  # fmt: skip
"""All claims, in the order of the paper."""
