"""The numbers that a step of the consistent estimator needs, as plain and compiled functions read
them.
"""

from typing import NamedTuple

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.slam.core.line_fit import bin_size, max_distance
from limslam_agent.slam.core.range_sensor import RangeSensor


class StepSettings(NamedTuple):
    """Numbers of ``ConsistentConfig`` under the same names, and of the range sensor.

    Attributes
    ----------
    std, growth, cone, usual_std
        Of the ``RangeSensor``, and the standard deviation of a range of usual length, m.
    min_distance, min_turn, batch, max_age, max_clones
        Of ``PendingReadingsConfig``.
    gate, closes_loops
        Of ``WallAssociationConfig``, and whether landmarks are merged.
    new_length, new_readings
        Least length of a new landmark, m, and its least number of readings for each metre of
        ``usual_std``.
    min_votes, theta_step, segment_length, only_best, r_step, near_line, segment_gap
        Of ``HoughConfig``, for this sensor: the last three are the size of a bin of distances, the
        largest distance of a point from its line, and the longest gap, m.
    """

    std: float
    growth: float
    cone: float
    usual_std: float
    min_distance: float
    min_turn: float
    batch: int
    max_age: float
    max_clones: int
    gate: float
    closes_loops: bool
    new_length: float
    new_readings: float
    min_votes: int
    theta_step: float
    segment_length: float
    only_best: bool
    r_step: float
    near_line: float
    segment_gap: float


def step_settings(config: ConsistentConfig, sensor: RangeSensor, usual_std: float) -> StepSettings:
    """The numbers for a sensor whose ranges of usual length have a standard deviation, m."""
    pending = config.pending
    hough = config.hough
    creation = config.for_ranges(usual_std).creation
    return StepSettings(
        std=sensor.std,
        growth=sensor.growth,
        cone=sensor.cone,
        usual_std=usual_std,
        min_distance=pending.min_distance,
        min_turn=pending.min_turn,
        batch=pending.batch,
        max_age=pending.max_age,
        max_clones=pending.max_clones,
        gate=config.association.gate,
        closes_loops=config.merging.enabled,
        new_length=creation.min_length,
        new_readings=creation.readings_per_std,
        min_votes=hough.min_votes,
        theta_step=float(hough.theta_step),
        segment_length=float(hough.min_length),
        only_best=hough.only_best,
        r_step=bin_size(hough, usual_std),
        near_line=max_distance(hough, usual_std),
        segment_gap=float(hough.max_gap),
    )
