"""What a robot believes: the data that mapping hands to the policies."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.unfinished import Faces
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray, no_rows
from limslam_env.messages import counted


@dataclass(frozen=True, eq=False)
class Guess:
    """A place where a lost robot may be.

    Attributes
    ----------
    pose
        Pose (3,) of the robot's present frame in the earlier map, m and rad.
    log_odds
        Logarithm of the likelihood ratio of this place and of ground that the earlier map does not
        have.
    grid
        Occupancy grid of the earlier map.
    """

    pose: FloatArray
    log_odds: float
    grid: GridView


@dataclass(frozen=True, eq=False)
class Belief:
    """Everything that a policy may use to choose an action.

    A :class:`~limslam_agent.mapping.mapper.Mapper` makes the belief of each robot. Only
    ``other_goals`` and ``other_looks`` are added by the team, because they come from the policies
    and not from the map.

    Attributes
    ----------
    pose
        Estimated pose (3,) in the world frame: x (m), y (m), heading (rad).
    covariance
        Covariance of the estimated pose (3, 3). It grows while the robot is lost.
    ranges
        Latest range readings (n_beams,), m, as `limslam_agent.readings` defines them. NaN where
        there is no reading.
    segments
        Walls of the map (N, 4) as x1, y1, x2, y2 in the world frame, m.
    grid
        Occupancy grid.
    other_poses
        Estimated poses (m, 3) of the other robots in the team's order. Empty for a single robot.
    other_goals
        Goals (k, 2), m, of those other robots that have a goal.
    other_looks
        Stretches of border that other robots have looked at, or are about to look at.
    status
        Whether the estimate can be trusted.
    frame
        Number of times that the frame of poses and map has changed
        (:class:`~limslam_agent.mapping.mapper.Mapper`). Plans that were made in another frame mean
        nothing.
    map_number
        Number of the map. In another frame with the same number, the map is the same, but was
        moved. What a policy has settled there, such as places that cannot be reached, remains so.
    guesses
        Where a lost robot may be. Empty for a robot that is not lost.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_agent import Mapper
    >>> env = gym.make("LimSlam-Env1-v0", sensor_noise=0.02).unwrapped
    >>> observation, info = env.reset(seed=0)
    >>> mapper = Mapper(env.robot, start_pose=info["pose"])
    >>> mapper.step(observation)
    >>> mapper.belief.status.level, mapper.belief.pose.shape
    ('ok', (3,))
    """

    pose: FloatArray
    covariance: FloatArray
    ranges: FloatArray
    segments: FloatArray
    grid: GridView
    other_poses: FloatArray = field(default_factory=lambda: no_rows(3))
    other_goals: FloatArray = field(default_factory=lambda: no_rows(2))
    other_looks: Sequence[Faces] = ()
    status: Status = field(default_factory=Status)
    frame: int = 0
    map_number: int = 0
    guesses: Sequence[Guess] = ()

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        from limslam_agent.output.drawing import map_png

        robots = {"est": [self.pose[None], *self.other_poses[:, None]]}
        others = {"covariances": [self.covariance], "grid": self.grid}
        title = f"{counted(len(self.segments), 'wall')}, {self.status.level}"
        return map_png(title, self.segments, robots, remark=self.status.reason, **others)
