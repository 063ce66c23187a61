"""All settings of one run in the simulator, and which of them do not go together."""

from dataclasses import dataclass, field
from functools import cached_property

from limslam_agent.config.presets import AgentConfig, ablated, preset, with_until
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.saved_map import read_saved_map
from limslam_agent.policies.frontier_policy import least_reach, short_reach
from limslam_agent.runs.policies import TOUR, check_policy
from limslam_agent.runs.run_spec import LONGEST_TIME, RunSpec
from limslam_env.config import NoiseConfig
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.worlds.formats.loading import WorldSource, load_world
from limslam_env.worlds.regions import start_region
from limslam_env.worlds.world import WorldError


@dataclass(frozen=True)
class RunConfig(RunSpec):
    """A run that can be driven: its description, the robot, and the settings of the agent.

    Attributes
    ----------
    world
        Name, file or world.
    true_noise
        The simulator's noise. Its ``sensor_noise`` is replaced by ``noise``.
    robot
        Body and beams of each robot.
    settings
        The agent's settings before the ablation and ``until``. The preset's settings by default.
    driver
        What the results call the policies that :func:`run_episode` is given. Empty calls them by
        ``policy``.

    Raises
    ------
    ValueError
        If a number is out of bounds, a preset or policy does not exist, the settings do not go
        together, or the world cannot be used or has no loop to drive laps on.
    """

    # What is run can also be a world that was made in memory.
    world: WorldSource = "env1"  # type: ignore[assignment]
    true_noise: NoiseConfig = field(default_factory=NoiseConfig)
    robot: RobotSpec = field(default_factory=RobotSpec)
    settings: AgentConfig | None = None
    driver: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_policy(self.policy, self.laps, self.robots)
        can_recover = self.agent.can_recover and not (self.laps or self.limit)
        self._check_kidnapping()
        if self.map is not None:
            if self.robots > 1 or not can_recover:
                raise ValueError(
                    "a map of an earlier run is for one robot that explores with the preset graph "
                    "or consistent"
                )
            OccupancyGrid.of(read_saved_map(self.map).grid, self.agent.grid)
        if self.unknown_starts and self.robots != 2:
            raise ValueError(f"unknown starts are for two robots, not {self.robots}")
        if self.unknown_starts and (self.policy != "frontier" or not can_recover):
            raise ValueError(
                "unknown starts are for the policy frontier with the preset graph or consistent"
            )
        world = load_world(self.world)
        if (self.laps or self.policy == TOUR) and len(world.loop) < 3:
            raise WorldError(f"world {world.name!r} has no loop to drive laps on")
        world.check(self.robot.radius)

    def _check_kidnapping(self) -> None:
        if self.kidnap_at is None:
            return
        if not 0.0 < self.kidnap_at <= LONGEST_TIME:
            raise ValueError(
                f"a robot is kidnapped after 0 s and within {LONGEST_TIME:g} s, not at "
                f"{self.kidnap_at:g} s"
            )
        if self.robots > 1:
            raise ValueError("one of several robots cannot be kidnapped")
        if self.limit:
            raise ValueError("a run that is compared with the offline optimum cannot be kidnapped")

    @cached_property
    def agent(self) -> AgentConfig:
        """The agent's settings, with the noise that the agent is told."""
        config = self.settings or preset(self.preset, NominalNoise(self.noise))
        config = with_until(config, self.until)
        return config if self.ablation is None else ablated(config, self.ablation)

    @property
    def warnings(self) -> list[str]:
        """What there is to say about the world, and reasons why the run cannot explore it, one
        line each.

        They are notes of the world's reader, a small start region, an open outer wall, or beams
        that are too short for the policy.
        """
        world = load_world(self.world)
        region = start_region(world, self.robot.radius).warning
        found = [*world.notes] if region is None else [*world.notes, region]
        cell = self.agent.grid.cell
        is_too_short = self.robot.reach < least_reach(self.robot, cell)
        if self.policy.startswith("frontier") and not self.laps and is_too_short:
            found.append(f"{short_reach(self.robot, cell)}: the robot follows walls instead")
        return found
