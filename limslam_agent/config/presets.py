"""Settings of the agent, one frozen dataclass a stage, and the presets that put them together."""

from dataclasses import dataclass, field

from limslam_agent.config.consistent import CloneConfig, SelfCalibrationConfig, StraightConfig
from limslam_agent.config.exploration import GridConfig, PolicyConfig, TeamConfig
from limslam_agent.config.published import (
    AssociationConfig,
    BufferConfig,
    FilterConfig,
    HoughConfig,
    LoopClosingConfig,
    MapConfig,
    OdometryConfig,
)
from limslam_env.interface import NominalNoise

__all__ = [
    "PRESETS",
    "AgentConfig",
    "AssociationConfig",
    "BufferConfig",
    "CloneConfig",
    "FilterConfig",
    "GridConfig",
    "HoughConfig",
    "LoopClosingConfig",
    "MapConfig",
    "OdometryConfig",
    "PolicyConfig",
    "SelfCalibrationConfig",
    "StraightConfig",
    "TeamConfig",
    "preset",
]


@dataclass(frozen=True)
class AgentConfig:
    """Everything that an agent is told, besides its robot.

    Attributes
    ----------
    preset
        Name of the preset that these settings began as.
    estimator
        ``published`` or ``consistent``: how readings become a map.
    noise
        Nominal noise of the robot, as its builder knows it.
    """

    preset: str = "paper"
    estimator: str = "published"
    noise: NominalNoise = field(default_factory=NominalNoise)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    buffer: BufferConfig = field(default_factory=BufferConfig)
    hough: HoughConfig = field(default_factory=HoughConfig)
    association: AssociationConfig = field(default_factory=AssociationConfig)
    closing: LoopClosingConfig = field(default_factory=LoopClosingConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
    map: MapConfig = field(default_factory=MapConfig)
    team: TeamConfig = field(default_factory=TeamConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    clones: CloneConfig = field(default_factory=CloneConfig)
    self_calibration: SelfCalibrationConfig = field(default_factory=SelfCalibrationConfig)

    def __post_init__(self) -> None:
        if self.self_calibration.enabled and self.estimator != "consistent":
            raise ValueError("only the consistent estimator can calibrate odometry by itself")

    @property
    def range_std(self) -> float:
        """Standard deviation that a range is credited with, m."""
        return max(self.noise.range_std, self.filter.min_range_std)


PRESETS = ("consistent", "paper", "odometry")


def preset(name: str, noise: NominalNoise | None = None) -> AgentConfig:
    """The settings of a preset.

    Raises
    ------
    ValueError
        If there is no such preset.
    """
    if name not in PRESETS:
        raise ValueError(f"no preset is called {name!r}; there are {', '.join(PRESETS)}")
    return AgentConfig(
        preset=name,
        estimator="consistent" if name == "consistent" else "published",
        noise=noise or NominalNoise(),
        filter=FilterConfig(correct=name != "odometry"),
    )
