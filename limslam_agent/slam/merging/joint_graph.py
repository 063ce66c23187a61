"""One graph of local maps over two logs: rounds of the smoothing, begun with a placement of the second log.

A match between the logs is a loop between two chains. It is found, supported, weighted and removed like every other
loop (:mod:`limslam_agent.slam.graph.rounds`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import LoopVerdict
from limslam_agent.slam.graph.chunk_graph import carry_over
from limslam_agent.slam.graph.key_poses import KeyPoses, Trajectory
from limslam_agent.slam.graph.loop_search import loops_along_the_way
from limslam_agent.slam.graph.rounds import Candidates, LogProblem, Round, do_round, is_settled
from limslam_agent.slam.merging.chains import Chain, joined_keys, joined_trajectory, local_of_both
from limslam_agent.slam.merging.placements import Placement, solved
from limslam_agent.slam.merging.placing import Pieces
from limslam_env.geometry import FloatArray, IntArray

_START, _TRIAL = "guard", 2


@dataclass(frozen=True, eq=False)
class JointMap:
    """Two logs that were smoothed as one graph.

    Attributes
    ----------
    first, second
        The logs.
    keys, trajectory
        The key poses of both logs and their trajectory, in the frame of the first log.
    score
        G of the map of both logs.
    verdicts
        The verdicts on all loops of the last round.
    chunk_keys
        The key pose (c,) in the middle of each chunk.
    hop_keys, hop_errors
        The key poses (h,) at which the hops between chunks begin, and the chi-squares (h,) of the hops by the local
        smoothing.
    """

    first: Chain
    second: Chain
    keys: KeyPoses
    trajectory: Trajectory
    score: float
    verdicts: list[LoopVerdict]
    chunk_keys: IntArray
    hop_keys: IntArray
    hop_errors: FloatArray

    @property
    def cross_loops(self) -> list[LoopVerdict]:
        """The loops between the logs."""
        border = np.searchsorted(self.chunk_keys, len(self.first.keys))
        return [each for each in self.verdicts if (each.loop.first < border) != (each.loop.second < border)]


def joint_map(
    first: Chain,
    second: Chain,
    known: Pieces,
    local: Pieces,
    placement: Placement,
    config: GraphConfig,
    report: Callable[[str], None],
) -> JointMap:
    """Smooth two logs as one graph, begun with a placement of the second log.

    There are two starts. One keeps the loops of the second log, and the other one forgets them: loops that are wrong
    have bent the second log, and loops between the logs show where. The start with the higher score G goes on.
    """
    middles = np.array([each.middle for each in local.maps])
    by_local = solved(known, second.local.poses[middles], placement.members)
    starts = [
        replace(second, smoothed=carry_over(second.keys, trajectory, middles, poses))
        for trajectory, poses in ((second.smoothed, placement.poses), (second.local, by_local))
    ]
    searches = [_Search(first, start, config, report).advanced(_TRIAL) for start in starts]
    return max(searches, key=lambda each: each.best.score).advanced(len(config.rounds.hops) - 1).result


@dataclass(eq=False)
class _Search:
    """Rounds of the smoothing of both logs, begun with the smoothed trajectories of the chains."""

    first: Chain
    second: Chain
    config: GraphConfig
    report: Callable[[str], None]

    def __post_init__(self) -> None:
        data = replace(
            self.first.data,
            max_range=max(self.first.data.max_range, self.second.data.max_range),
            range_std=max(self.first.data.range_std, self.second.data.range_std),
        )
        self._log = LogProblem(
            joined_keys(self.first, self.second), local_of_both(self.first, self.second), data, self.config
        )
        self._trajectory = joined_trajectory(self.first.smoothed, self.second.smoothed)
        self._rounds: list[Round] = []

    @property
    def best(self) -> Round:
        """The round with the highest score."""
        return max(self._rounds, key=lambda each: each.score)

    @property
    def result(self) -> JointMap:
        """The map of the best round."""
        best = self.best
        return JointMap(
            self.first, self.second, self._log.keys, best.trajectory, best.score, best.verdicts, best.middles,
            *self._log.bends(best.trajectory),
        )  # fmt: skip

    def advanced(self, end: int) -> "_Search":
        """Do rounds up to a number of rounds, or until two rounds have not raised the score."""
        while len(self._rounds) < end and not is_settled(self._rounds):
            number = len(self._rounds) + 1
            self.report(f"both logs, round {number} of at most {len(self.config.rounds.hops) - 1}")
            trajectory = self._log.unbent(self._trajectory, number)
            chunks = self._log.chunks(trajectory, number)
            candidates = Candidates(chunks, loops_along_the_way(chunks))
            self._rounds.append(do_round(self._log, trajectory, number, candidates, _START))
            self._trajectory = self._rounds[-1].trajectory
        return self
