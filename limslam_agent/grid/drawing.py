"""Which readings an occupancy grid shows, and when."""

from collections import deque

from limslam_agent.dropouts import Dropouts
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

_MOST_WAITING = 16


class ReadingDrawer:
    """Draws the readings of one robot into an occupancy grid.

    If the robot's beams miss walls now and then, a reading that saw nothing waits until so many of
    the same beam have followed that the sensor hardly misses as often in a row. Without that, each
    drop-out would open ground behind a wall, and an explorer would look at the borders of that
    ground for ever.

    Parameters
    ----------
    robot
        Its body and beams.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self._dropouts = Dropouts(robot)
        # Pose, readings, and those among them that saw nothing and are not drawn yet, of the last
        # steps.
        self._waiting = deque[tuple[FloatArray, FloatArray, BoolArray]](maxlen=_MOST_WAITING)
        self._frame = 0

    def draw(
        self,
        grid: OccupancyGrid,
        frame: int,
        pose: FloatArray,
        ranges: FloatArray,
        measured: BoolArray,
    ) -> None:
        """Draw the readings of the next step, and those before that the step has confirmed.

        Parameters
        ----------
        frame
            Number of the map's frame. Readings that wait are forgotten when it changes.
        pose
            Estimated pose (3,), m, m, rad.
        ranges, measured
            Readings (n_beams,), m, and which of them are new.
        """
        dropouts = self._dropouts
        dropouts.note(ranges, measured)
        enough = dropouts.enough
        if enough == 1:
            self._waiting.clear()
            grid.update(pose, self._robot, ranges, measured)
            return
        if frame != self._frame:
            self._waiting.clear()
            self._frame = frame
        waits = measured & (dropouts.in_a_row > 0) & (dropouts.in_a_row < enough)
        grid.update(pose, self._robot, ranges, measured & ~waits)
        self._draw_confirmed(grid, measured & (dropouts.in_a_row >= enough))
        self._waiting.append((pose, ranges, waits))
        self._forget(measured & (dropouts.in_a_row == 0))

    def _draw_confirmed(self, grid: OccupancyGrid, beams: BoolArray) -> None:
        """Draw the readings of some beams (n_beams,) that wait."""
        if beams.any():
            for pose, ranges, waits in self._waiting:
                if (waits & beams).any():
                    grid.update(pose, self._robot, ranges, waits & beams)
            self._forget(beams)

    def _forget(self, beams: BoolArray) -> None:
        """Let no reading of some beams (n_beams,) wait any longer."""
        for _, _, waits in self._waiting:
            waits[beams] = False
