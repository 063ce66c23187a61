"""Settings of one run in the simulator, and which of them do not go together."""

from dataclasses import dataclass, field
from pathlib import Path

from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.presets import AgentConfig, ablated, preset, with_until
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.saved_map import read_saved_map
from limslam_agent.policies.frontier_policy import least_reach, short_reach
from limslam_agent.runs.policies import TOUR, check_policy
from limslam_env.config import NoiseConfig
from limslam_env.envs.arguments import MAX_ROBOTS
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.worlds.formats.loading import WorldSource, load_world
from limslam_env.worlds.regions import start_region
from limslam_env.worlds.world import WorldError

LONGEST_TIME = 1e6
"""Longest simulated time of a run, s."""


@dataclass(frozen=True)
class RunConfig:
    """Settings of a run: those of the options of ``limslam run`` that have the same names, and
    these.

    Attributes
    ----------
    world
        Name, file or world.
    settings
        The agent's settings before the ablation. The preset's settings by default.
    until
        As the option. None leaves this to the settings, whose default is ``seen``.
    prior_map
        As the option ``map``.
    true_noise
        The simulator's noise. Its ``sensor_noise`` is replaced by ``noise``.
    driver
        What the results call the policies that :func:`run_episode` is given. Empty calls them by
        ``policy``.

    Raises
    ------
    ValueError
        If a number is out of bounds, a preset or policy does not exist, the settings do not go
        together, or the world cannot be used or has no loop to drive laps on.
    """

    world: WorldSource = "env1"
    noise: float = 0.0
    preset: str = DEFAULT_PRESET
    seed: int = 0
    max_time: float = 1800.0
    laps: int = 0
    robot: RobotSpec = field(default_factory=RobotSpec)
    robots: int = 1
    ablation: str | None = None
    policy: str = "frontier"
    limit: bool = False
    settings: AgentConfig | None = None
    true_noise: NoiseConfig = field(default_factory=NoiseConfig)
    until: str | None = None
    kidnap_at: float | None = None
    prior_map: Path | None = None
    unknown_starts: bool = False
    imu: bool = False
    driver: str = ""

    def __post_init__(self) -> None:
        _ = self.agent
        if not 1 <= self.robots <= MAX_ROBOTS:
            raise ValueError(f"there can be 1 to {MAX_ROBOTS} robots, not {self.robots}")
        if not 0.0 < self.max_time <= LONGEST_TIME:
            raise ValueError(
                f"the longest time must be above 0 s and up to {LONGEST_TIME:g} s, not "
                f"{self.max_time:g}"
            )
        self._check_kidnapping()
        self._check_prior_map()
        self._check_unknown_starts()
        if self.laps < 0:
            raise ValueError(f"laps must be 0 or more, not {self.laps}")
        check_policy(self.policy, self.laps, self.robots)
        if self.seed < 0:
            raise ValueError(f"a seed is 0 or more, not {self.seed}")
        world = load_world(self.world)
        if (self.laps or self.policy == TOUR) and len(world.loop) < 3:
            raise WorldError(f"world {world.name!r} has no loop to drive laps on")
        world.check(self.robot.radius)

    def _check_prior_map(self) -> None:
        if self.prior_map is None:
            return
        if self.robots > 1 or self.laps or self.limit or not self.agent.can_recover:
            raise ValueError(
                "a map of an earlier run is for one robot that explores with the preset graph or "
                "consistent"
            )
        OccupancyGrid.of(read_saved_map(self.prior_map).grid, self.agent.grid)

    def _check_unknown_starts(self) -> None:
        if not self.unknown_starts:
            return
        if self.robots != 2:
            raise ValueError(f"unknown starts are for two robots, not {self.robots}")
        if self.laps or self.limit or self.policy != "frontier" or not self.agent.can_recover:
            raise ValueError(
                "unknown starts are for the policy frontier with the preset graph or consistent"
            )

    def _check_kidnapping(self) -> None:
        if self.kidnap_at is None:
            return
        if not 0.0 < self.kidnap_at <= LONGEST_TIME:
            raise ValueError(
                f"a robot is kidnapped after 0 s and within {LONGEST_TIME:g} s, not at "
                f"{self.kidnap_at:g} s"
            )
        if self.robots > 1 or self.limit:
            what = (
                "one of several robots"
                if self.robots > 1
                else "a run that is compared with the offline optimum"
            )
            raise ValueError(f"{what} cannot be kidnapped")

    @property
    def agent(self) -> AgentConfig:
        """The agent's settings, with the noise that the agent is told."""
        config = self.settings or preset(self.preset, NominalNoise(self.noise))
        if self.until is not None:
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
        if (
            self.policy.startswith("frontier")
            and not self.laps
            and self.robot.reach < least_reach(self.robot, cell)
        ):
            found.append(f"{short_reach(self.robot, cell)}: the robot follows walls instead")
        return found
