"""What is kept of each robot of a batch, in arrays of a fixed size, and the settings as kernels read them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import AgentConfig
from limslam_agent.slam.consistent.pending_readings import SIDES, thinned
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec

POSE = 3

# Places in ``Filter.counts``.
LINES, CLONES, NEXT_CLONE, STEP, FRESH, WAITING, CLOSURES, NO_PLACE, REFUSED = 0, 1, 2, 3, 4, 7, 10, 11, 12
# Places in ``Minds.way``.
DRIVEN, TURNED, DRIVEN_AT, TURNED_AT, LAST_HIT = 0, 1, 2, 3, 4
# Columns of ``Minds.waiting``.
CLONE, BEAM, RANGE, DRIVEN_THEN = 0, 1, 2, 3
# Columns of ``Spec.beams``.
FROM_X, FROM_Y, TOWARDS_X, TOWARDS_Y, ANGLE, FARTHEST, TOO_NEAR, TOO_FAR, PERIOD, SIDE = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
# Columns of ``Walls.table``.
LOW, LENGTH, GROUPS, READINGS = 0, 1, 2, 3
# Rows of ``Walls.counted`` and of ``Walls.reached``.
HITS, MISSES = 0, 1
LEAST, MOST = 0, 1


@dataclass(frozen=True)
class Capacity:
    """How much there is room for, in each robot's mind.

    Attributes
    ----------
    landmarks
        Lines of the filter. A piece of wall for which there is no room founds no landmark.
    clones
        Poses that are kept for readings that wait. If there is no room, the oldest and its readings are given up, as
        ``PendingReadingsConfig.max_clones`` does from time to time. 0 is as many as can ever be wanted: then none is.
    bins
        Length of a landmark in bins of 5 cm. What lies farther is not counted.
    cells
        Side of the grid, in cells. It holds the places that were seen last: when more are seen, those at the far
        side are forgotten.

    Raises
    ------
    ValueError
        If there is no room for anything.
    """

    landmarks: int = 80
    clones: int = 0
    bins: int = 200
    cells: int = 160

    def __post_init__(self) -> None:
        for name, least in (("landmarks", 1), ("clones", 0), ("bins", 1), ("cells", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"a capacity's {name} must be {least} or more, not {getattr(self, name)}")


class Filter(NamedTuple):
    """The state of ``CloneEKF``, pose, lines and clones, for n robots; for one, the arrays without their first axis.

    P is kept once, not twice: the pose's rows in ``top``, and of the others the part up to the diagonal, one row after
    the other, in ``rest``. A prediction and a clone touch the former, which is short, and add to the end of the latter.

    Attributes
    ----------
    x, top, rest
        State (n, s) and covariance: (n, 3, s), and (n, s (s + 1) / 2) with row i from i (i + 1) / 2.
    anchors
        Of the lines (n, landmarks, 2), m.
    clones
        Numbers of the clones (n, clones), in order.
    counts
        (n, 13) how many there are of this and that.
    """

    x: FloatArray
    top: FloatArray
    rest: FloatArray
    anchors: FloatArray
    clones: IntArray
    counts: IntArray


class Walls(NamedTuple):
    """From where to where the landmarks go, as ``WallExtent`` counts it.

    Attributes
    ----------
    table
        (n, landmarks, 4) first bin, number of bins, groups of readings, readings.
    counted, reached
        (n, landmarks, 2, bins) beams that ended and passed; least and most place of a hit, m.
    """

    table: IntArray
    counted: NDArray[np.int32]
    reached: FloatArray


class Minds(NamedTuple):
    """All that is known in the heads of n robots; of one robot, the same arrays without their first axis.

    Attributes
    ----------
    filter, walls
        What is believed of poses and lines, and where the walls are on them.
    way
        (n, 7) how far the robot has come, when it last read, and when it last saw something on each side.
    waiting
        (n, 3, most, 4) readings that wait, by side: clone, beam, range (m), distance driven (m).
    grid, window
        (n, cells, cells) occupancy, cell (row, column) of the world at those modulo ``cells``; (n, 2) row and column
        of the world's cells from which on the grid holds them.
    """

    filter: Filter
    walls: Walls
    way: FloatArray
    waiting: FloatArray
    grid: NDArray[np.int16]
    window: IntArray


class Settings(NamedTuple):
    """The numbers of ``AgentConfig`` and ``RobotSpec`` that kernels need; `spec_of` says where each is from."""

    std: float
    wheel_variance: float
    axle: float
    radius: float
    min_distance: float
    min_turn: float
    batch: int
    max_age: float
    max_clones: int
    wall_end: float
    passed: float
    new_length: float
    new_length_complete: float
    new_readings: float
    max_angle_std: float
    gate: float
    far_gate: float
    left_sigmas: float
    ambiguity: float
    min_length: float
    end_slack: float
    beyond_length: float
    beyond_gate: float
    beyond_angle_std: float
    max_end_gap: float
    max_angle: float
    max_offset: float
    huber: float
    iterations: int
    first_iterations: int
    one_wall_gate: float
    min_overlap: float
    through_sigmas: float
    through_slack: float
    closes_loops: bool
    min_votes: int
    r_step: float
    theta_step: float
    near_line: float
    near_corner: float
    piece_gap: float
    gap_ahead: float
    piece_length: float
    only_best: bool
    kink_gate: float
    min_kink: float
    curve_gate: float
    end_zone: float
    end_gate: float
    cell: float
    seen_through: int
    hit: int
    limit: int


_KINDS = Settings.__annotations__


class Spec(NamedTuple):
    """What kernels are told: an array of one ``Settings``, and the beams (b, 10), whose columns are named above."""

    settings: NDArray[np.void]
    beams: FloatArray


def spec_of(robot: RobotSpec, config: AgentConfig, estimator: ConsistentConfig) -> Spec:
    """What kernels need of a robot, of its settings, and of those of its estimator."""
    std = config.range_std
    hough, update, extents = estimator.hough, estimator.update, estimator.extents
    creation = estimator.for_ranges(std).creation
    sides = np.full(len(robot.beams), -1)
    for number, side in enumerate(SIDES):
        sides[thinned([beam.side == side for beam in robot.beams], estimator.pending.beams)] = number
    by_name = (estimator.pending, estimator.segmentation, estimator.association, update, config.grid)
    given = {name: getattr(group, name) for group in by_name for name in Settings._fields if hasattr(group, name)}
    given |= {
        "std": std,
        "wheel_variance": config.noise.wheel_variance,
        "axle": robot.axle,
        "radius": robot.radius,
        "passed": estimator.pending.complete_after,
        "left_sigmas": update.residual_sigmas,
        "new_length": creation.min_length,
        "new_length_complete": creation.min_length_complete,
        "new_readings": creation.readings_per_std,
        "max_angle_std": creation.max_angle_std,
        "first_iterations": creation.iterations,
        "through_sigmas": extents.through_sigmas,
        "through_slack": extents.through_slack,
        "closes_loops": estimator.merging.enabled,
        "one_wall_gate": estimator.merging.gate,
        "min_overlap": estimator.merging.min_overlap,
        "min_votes": hough.min_votes,
        "r_step": max(hough.r_step, 3.0 * std),
        "theta_step": hough.theta_step,
        "near_line": max(hough.max_offset, 2.5 * std),
        "near_corner": max(hough.max_offset, 2.5 * std),
        "piece_gap": hough.max_gap,
        "piece_length": hough.min_length,
        "only_best": hough.only_best,
    }
    kinds = {"float": np.float64, "int": np.int64, "bool": np.bool_}
    # One record is one argument to a kernel; a tuple of sixty numbers would be sixty.
    fields = [(name, kinds[kind if isinstance(kind, str) else kind.__name__]) for name, kind in _KINDS.items()]
    settings = np.array([tuple(given[name] for name in _KINDS)], dtype=fields)
    return Spec(settings, beams_of(robot, sides))


def beams_of(robot: RobotSpec, sides: IntArray) -> FloatArray:
    """The beams (b, 10) as kernels read them."""
    return np.ascontiguousarray(
        np.column_stack(
            (
                robot.beam_origins, robot.beam_directions, robot.beam_angles, robot.max_ranges, robot.too_near,
                robot.too_far, [beam.period for beam in robot.beams], sides,
            )
        )
    )  # fmt: skip


def most_clones(robot: RobotSpec, config: ConsistentConfig) -> int:
    """How many clones can ever be wanted at a time.

    A side that has ``batch`` fresh readings is looked through, and then no more than ``max_clones`` are kept. Each
    clone since then has brought a fresh reading to a side, and no side has ``batch`` of them.
    """
    del robot
    return config.pending.max_clones + len(SIDES) * (config.pending.batch - 1) + 1


def minds_for(robot: RobotSpec, config: ConsistentConfig, num_envs: int, capacity: Capacity) -> Minds:
    """Arrays for the minds of a number of robots, of which nothing is known."""
    clones = min(capacity.clones or most_clones(robot, config), most_clones(robot, config))
    size = POSE + 2 * capacity.landmarks + POSE * clones
    widest = min(max(sum(beam.side == side for beam in robot.beams) for side in SIDES), config.pending.beams)
    shape, bins = (num_envs, capacity.landmarks), capacity.bins
    belief = Filter(
        x=np.zeros((num_envs, size)),
        top=np.zeros((num_envs, POSE, size)),
        rest=np.zeros((num_envs, size * (size + 1) // 2)),
        anchors=np.zeros((*shape, 2)),
        clones=np.zeros((num_envs, clones), dtype=np.int64),
        counts=np.zeros((num_envs, 13), dtype=np.int64),
    )
    walls = Walls(
        table=np.zeros((*shape, 4), dtype=np.int64),
        counted=np.zeros((*shape, 2, bins), dtype=np.int32),
        reached=np.zeros((*shape, 2, bins)),
    )
    return Minds(
        filter=belief,
        walls=walls,
        way=np.zeros((num_envs, 7)),
        waiting=np.zeros((num_envs, len(SIDES), clones * widest, 4)),
        grid=np.zeros((num_envs, capacity.cells, capacity.cells), dtype=np.int16),
        window=np.zeros((num_envs, 2), dtype=np.int64),
    )
