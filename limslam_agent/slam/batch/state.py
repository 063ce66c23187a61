"""State of each robot of a batch in arrays of fixed size, and the settings as compiled functions read them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import AgentConfig
from limslam_agent.slam.consistent.pending_readings import SIDES, thinned
from limslam_agent.slam.core.contact import new_memory
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.core.hough import bin_size, max_distance
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec

# Places in ``Filter.counts``; those of FRESH and PENDING are followed by one place for each further side.
LINES, CLONES, NEXT_CLONE, STEP, FRESH, PENDING, CLOSURES, OVERFLOWS, REFUSED = 0, 1, 2, 3, 4, 7, 10, 11, 12
# Places in ``States.travel``; that of LAST_HIT is followed by one place for each further side.
DRIVEN, TURNED, DRIVEN_AT, TURNED_AT, LAST_HIT = 0, 1, 2, 3, 4
# Columns of ``States.pending``.
CLONE, BEAM, RANGE, DRIVEN_THEN = 0, 1, 2, 3
# Columns of ``Spec.beams``. The occupancy grid uses the first six.
FROM_X, FROM_Y, TOWARDS_X, TOWARDS_Y, TOO_NEAR, TOO_FAR, ANGLE, FARTHEST, PERIOD, SIDE = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
# Columns of ``Walls.table``.
LOW, LENGTH, GROUPS, READINGS = 0, 1, 2, 3
# Rows of ``Walls.counted`` and of ``Walls.reached``.
HITS, MISSES = 0, 1
LEAST, MOST = 0, 1


@dataclass(frozen=True)
class Capacity:
    """How much each robot's state has room for.

    Attributes
    ----------
    landmarks
        Lines of the filter. A wall segment for which there is no room does not become a landmark.
    clones
        Poses that are cloned for pending readings. If there is no room, the oldest clone and its readings are removed,
        as ``PendingReadingsConfig.max_clones`` does after each update. 0 means as many as can ever be needed.
    bins
        Length of a landmark in bins of 5 cm. Hits beyond that length are not counted.
    cells
        Side of the grid, in cells. The grid holds the area that was seen last: when the robot sees beyond it, the grid
        moves along, and cells at the opposite side are forgotten.

    Raises
    ------
    ValueError
        If a capacity is too small.
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
    """The state of ``CloneEKF`` for n robots: pose, lines and clones. For one robot, the first axis is missing.

    P is stored without its redundant half: the pose's rows in ``top``, and the lower triangle in ``rest``. A prediction
    changes only ``top``, which is short, and a clone appends to the end of ``rest``.

    Attributes
    ----------
    x, top, rest
        State (n, s) and covariance: (n, 3, s), and (n, s (s + 1) / 2) in which row i begins at i (i + 1) / 2.
    anchors
        Of the lines (n, landmarks, 2), m.
    clones
        Numbers of the clones (n, clones), in order.
    counts
        (n, 13), numbers of lines, clones and so on, whose places are named above.
    """

    x: FloatArray
    top: FloatArray
    rest: FloatArray
    anchors: FloatArray
    clones: IntArray
    counts: IntArray


class Walls(NamedTuple):
    """Extents of the landmarks of n robots, as ``WallExtent`` counts them.

    Attributes
    ----------
    table
        (n, landmarks, 4): first bin, number of bins, updates, readings.
    counted, reached
        (n, landmarks, 2, bins): beams that ended and that passed; least and largest position of a hit, m.
    seen, behind
        (n, landmarks, 2, 2) and (n, landmarks), as in ``wall_map.Wall``.
    """

    table: IntArray
    counted: NDArray[np.int32]
    reached: FloatArray
    seen: FloatArray
    behind: FloatArray


class States(NamedTuple):
    """All that is estimated for n robots. For one robot, the first axis of each array is missing.

    Attributes
    ----------
    filter, walls
        Poses, lines and clones, and the extents of the landmarks.
    travel
        (n, 7): distance driven (m) and angle turned (rad), both now and at the last collection of readings, and the
        distance driven at the last hit of each side.
    pending
        (n, 3, most, 4): the pending readings of each side: clone, beam, range (m), distance driven (m).
    contact
        (n, 1 + 2 beams): what :func:`limslam_agent.slam.core.contact.slip` remembers.
    grid, window
        Occupancy (n, cells, cells); the cell (row, column) of the world is stored at these numbers modulo ``cells``.
        Row and column (n, 2) of the lowest world cell that the grid holds.
    """

    filter: Filter
    walls: Walls
    travel: FloatArray
    pending: FloatArray
    contact: FloatArray
    grid: NDArray[np.int16]
    window: IntArray


class Settings(NamedTuple):
    """The settings of ``AgentConfig`` and ``RobotSpec`` that compiled functions need, under the same names."""

    std: float
    cone: float
    wheel_variance: float
    axle: float
    radius: float
    min_distance: float
    min_turn: float
    batch: int
    max_age: float
    max_clones: int
    new_length: float
    new_readings: float
    gate: float
    closes_loops: bool
    min_votes: int
    r_step: float
    theta_step: float
    near_line: float
    segment_gap: float
    segment_length: float
    only_best: bool
    cell: float
    seen_through: int
    hit: int
    limit: int


_KINDS = Settings.__annotations__


class Spec(NamedTuple):
    """What does not change: an array of one ``Settings``, and the beams (b, 10), whose columns are named above."""

    settings: NDArray[np.void]
    beams: FloatArray


def spec_of(robot: RobotSpec, config: AgentConfig, estimator: ConsistentConfig) -> Spec:
    """The part of a robot and of its settings that compiled functions need."""
    std = config.range_std
    hough, creation = estimator.hough, estimator.for_ranges(std).creation
    sides = np.full(len(robot.beams), -1)
    for number, side in enumerate(SIDES):
        sides[thinned([beam.side == side for beam in robot.beams], estimator.pending.beams)] = number
    by_name = (estimator.pending, estimator.association, config.grid)
    given = {name: getattr(group, name) for group in by_name for name in Settings._fields if hasattr(group, name)}
    given |= {
        "std": std,
        "cone": robot.cone,
        "wheel_variance": config.noise.wheel_variance,
        "axle": robot.axle,
        "radius": robot.radius,
        "new_length": creation.min_length,
        "new_readings": creation.readings_per_std,
        "closes_loops": estimator.merging.enabled,
        "min_votes": hough.min_votes,
        "r_step": bin_size(hough, std),
        "theta_step": hough.theta_step,
        "near_line": max_distance(hough, std),
        "segment_gap": hough.max_gap,
        "segment_length": hough.min_length,
        "only_best": hough.only_best,
    }
    kinds = {"float": np.float64, "int": np.int64, "bool": np.bool_}
    # A record is one argument of a compiled function; a tuple of thirty numbers would be thirty arguments.
    fields = [(name, kinds[kind if isinstance(kind, str) else kind.__name__]) for name, kind in _KINDS.items()]
    settings = np.array([tuple(given[name] for name in _KINDS)], dtype=fields)
    return Spec(settings, beams_of(robot, sides))


def beams_of(robot: RobotSpec, sides: IntArray) -> FloatArray:
    """The beams (b, 10) as compiled functions read them."""
    return np.ascontiguousarray(
        np.column_stack(
            (
                robot.beam_origins, robot.beam_directions, robot.too_near, robot.too_far, robot.beam_angles,
                robot.max_ranges, [beam.period for beam in robot.beams], sides,
            )
        )
    )  # fmt: skip


def most_clones(robot: RobotSpec, config: ConsistentConfig) -> int:
    """Largest number of clones that can be needed at a time.

    A side with ``batch`` fresh readings is processed, and then at most ``max_clones`` clones remain. Each clone since
    then has brought a fresh reading to a side, and no side has ``batch`` of them.
    """
    del robot
    return config.pending.max_clones + len(SIDES) * (config.pending.batch - 1) + 1


def states_for(robot: RobotSpec, config: ConsistentConfig, num_envs: int, capacity: Capacity) -> States:
    """Arrays for the states of a number of robots, all zero."""
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
        seen=np.zeros((*shape, 2, 2)),
        behind=np.zeros(shape),
    )
    return States(
        filter=belief,
        walls=walls,
        travel=np.zeros((num_envs, 7)),
        pending=np.zeros((num_envs, len(SIDES), clones * widest, 4)),
        contact=np.zeros((num_envs, len(new_memory(len(robot.beams))))),
        grid=np.zeros((num_envs, capacity.cells, capacity.cells), dtype=np.int16),
        window=np.zeros((num_envs, 2), dtype=np.int64),
    )
