"""State of each robot of a batch in arrays of fixed size, and the settings as compiled functions
read them.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import AgentConfig
from limslam_agent.kernels.tables import POSE, REPEATS, Filter, empty_walls
from limslam_agent.slam.consistent.pending_readings import (
    SIDES,
    Belief,
    Pending,
    most_clones,
    pending_of,
    sides_of,
)
from limslam_agent.slam.consistent.step_settings import step_settings
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec

STEP, REFUSED = range(5, 7)
"""Places in ``Filter.counts`` after those of a single filter: the step, and how many readings were
skipped.
"""


@dataclass(frozen=True)
class Capacity:
    """How much each robot's state has room for.

    Attributes
    ----------
    landmarks
        Lines of the filter. A wall segment for which there is no room does not become a landmark.
    clones
        Poses that are cloned for pending readings. If there is no room, the oldest clone and its
        readings are removed, as ``PendingReadingsConfig.max_clones`` does after each update. 0
        means as many as can ever be needed.
    bins
        Length of a landmark in bins of 5 cm. Hits beyond that length are not counted.
    cells
        Side of the grid, in cells. The grid holds the area that was seen last: when the robot sees
        beyond it, the grid moves along, and cells at the opposite side are forgotten.

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
                raise ValueError(
                    f"a capacity's {name} must be {least} or more, not {getattr(self, name)}"
                )


class States(NamedTuple):
    """All that is known of n robots. For one robot, the first axis of each array is missing.

    Attributes
    ----------
    belief
        What is estimated.
    contact
        (n, beams): what :func:`limslam_agent.slam.core.contact.slip` remembers.
    ticks
        (n, 2): what ``core.encoder_ticks.tick_by`` has found of the encoders, m.
    repeats
        (n, beams, 13): what ``kernels.repeats`` has found of the beams.
    grid, window
        Occupancy (n, cells, cells); the cell (row, column) of the world is stored at these numbers
        modulo ``cells``. Row and column (n, 2) of the lowest world cell that the grid holds.
    """

    belief: Belief
    contact: FloatArray
    ticks: FloatArray
    repeats: FloatArray
    grid: NDArray[np.int16]
    window: IntArray


class Spec(NamedTuple):
    """What does not change.

    Attributes
    ----------
    settings
        An array of one record: ``StepSettings``, and further numbers of ``AgentConfig`` and
        ``RobotSpec``.
    table, sides
        As of ``pending_readings.Setup``.
    limits
        As of ``kernels.readings.sort_readings`` (4, beams), m.
    schedule
        ``RobotSpec.schedule``.
    """

    settings: NDArray[np.void]
    table: FloatArray
    sides: IntArray
    limits: FloatArray
    schedule: IntArray


def spec_of(robot: RobotSpec, config: AgentConfig, estimator: ConsistentConfig) -> Spec:
    """The part of a robot and of its settings that compiled functions need."""
    std = config.range_std
    grid = config.grid
    given: dict[str, Any] = step_settings(
        estimator, RangeSensor(std, cone=robot.cone), std
    )._asdict()
    given |= {
        "wheel_variance": config.noise.wheel_variance,
        "axle": robot.axle,
        "radius": robot.radius,
    }
    given |= {name: getattr(grid, name) for name in ("cell", "seen_through", "hit", "limit")}
    # A record is one argument of a compiled function; a tuple of thirty numbers would be thirty
    # arguments.
    kinds = {bool: np.bool_, int: np.int64, float: np.float64}
    settings = np.array(
        [tuple(given.values())], dtype=[(name, kinds[type(value)]) for name, value in given.items()]
    )
    return Spec(
        settings,
        np.array(robot.beam_table),
        sides_of(robot, estimator.pending.beams),
        np.stack((robot.min_ranges, robot.max_ranges, robot.too_near, robot.too_far)),
        robot.schedule.copy(),
    )


def states_for(
    robot: RobotSpec, config: ConsistentConfig, num_envs: int, capacity: Capacity
) -> States:
    """Arrays for the states of a number of robots, all zero."""
    enough = most_clones(config.pending.batch, config.pending.max_clones, 1)
    clones = min(capacity.clones or enough, enough)
    size = POSE + 2 * capacity.landmarks + POSE * clones
    widest = min(
        max(sum(beam.side == side for beam in robot.beams) for side in SIDES), config.pending.beams
    )
    robots = [pending_of(1, clones * widest)] * num_envs
    return States(
        belief=Belief(
            Filter(
                x=np.zeros((num_envs, size)),
                P=np.zeros((num_envs, size, size)),
                by_errors=np.zeros((num_envs, size, 0)),
                anchors=np.zeros((num_envs, capacity.landmarks, 2)),
                clones=np.zeros((num_envs, clones), dtype=np.int64),
                counts=np.zeros((num_envs, 7), dtype=np.int64),
            ),
            empty_walls(capacity.landmarks, capacity.bins, num_envs),
            Pending(*(np.stack(each) for each in zip(*robots, strict=True))),
        ),
        contact=np.zeros((num_envs, len(robot.beams))),
        ticks=np.zeros((num_envs, 2)),
        repeats=np.zeros((num_envs, len(robot.beams), REPEATS)),
        grid=np.zeros((num_envs, capacity.cells, capacity.cells), dtype=np.int16),
        window=np.zeros((num_envs, 2), dtype=np.int64),
    )
