"""Settings of the agent, the presets (named settings that the command line knows), and the
ablations of them.
"""

from dataclasses import dataclass, replace
from typing import Annotated

from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.bounds import Bounded, Bounds, Count, CountOrNone, Positive
from limslam_agent.config.consistent import ConsistentConfig, WhenToCalibrate
from limslam_agent.config.graph import GraphConfig
from limslam_agent.config.published import FilterConfig, PublishedConfig
from limslam_agent.config.shared import OdometryConfig
from limslam_agent.config.smoother import RenewalConfig, SmootherConfig
from limslam_env.interface import NominalNoise
from limslam_env.messages import described

UNTIL = ("seen", "walls")
"""When an exploration is over: when everything was seen, or when the walls are whole, too."""


@dataclass(frozen=True)
class GridConfig(Bounded):
    """The low-resolution occupancy grid."""

    cell: Positive = 0.10  # Side of a cell, m
    # What a beam adds to the cells that it crosses, and what it subtracts from the cell in which it
    # ends
    seen_through: CountOrNone = 1
    hit: CountOrNone = 4
    limit: Annotated[int, Bounds(1, 10_000, is_whole=True)] = (
        20  # A cell's value stays between minus and plus this
    )


@dataclass(frozen=True)
class PolicyConfig(Bounded):
    """Exploration: when it is over, how fast the robot is, and which frontiers count."""

    # When exploration is over: when everything was ``seen``, so that there is no frontier left, or
    # when the ``walls`` are whole, so that the robot has also looked at every stretch where free
    # ground ends and the map has no wall
    until: str = "seen"
    # Cruising speed while exploring, m/s. A slower robot measures more points on each metre of
    # wall.
    speed: Positive = 0.20
    min_frontier: Count = (
        3  # Least number of cells of a frontier: smaller ones are mostly gaps between beams
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.until not in UNTIL:
            raise ValueError(f"until must be {' or '.join(UNTIL)}, not {self.until!r}")


EstimatorConfig = PublishedConfig | ConsistentConfig
"""Settings of an estimator. Their type says which estimator is used."""

ESTIMATORS: dict[str, EstimatorConfig] = {
    "consistent": ConsistentConfig(),
    "paper": PublishedConfig(),
    "odometry": PublishedConfig(filter=FilterConfig(correct=False)),
    "graph": ConsistentConfig(),
}
"""The estimator's settings in each preset. The preset ``graph`` also smooths a run or a log after
its end.
"""

PRESETS = tuple(ESTIMATORS)


@dataclass(frozen=True)
class AgentConfig(Bounded):
    """Everything that an agent is told, besides its robot. ``AgentConfig()`` is the preset
    ``graph``.

    Attributes
    ----------
    preset
        Name of the preset that these settings started from.
    estimator
        Settings of the estimator, which turns readings into a map. Their type chooses the
        estimator: `PublishedConfig` or `ConsistentConfig`.
    noise
        Nominal noise of the robot, as its data sheets give it.
    min_range_std
        Least standard deviation of a range that any estimator assumes, m: a sensor quantises its
        ranges.
    odometry
        Noise and bias of the odometry of a recorded log.
    grid
        The occupancy grid.
    policy
        Exploration.
    free_space_counts
        Whether a reading that ends in free space contradicts the map. False while such a reading
        may show the body of another robot.
    finds_places
        Whether a lost robot looks for its place in its map. Only a single robot with wheels and the
        consistent estimator can do so.
    smoothing
        The graph of local maps that smooths a recorded log of poses after its end. None leaves the
        log as the filter saw it.
    smooths_runs
        Whether the line smoother smooths a run, or a recorded log of wheel travel, after its end.
        Only the associations of the consistent estimator can be smoothed.
    renewal
        When the line smoother also renews the online estimate of a single robot with wheel
        encoders. None for never.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from limslam_agent import AgentConfig
    >>> from limslam_env import NominalNoise
    >>> config = replace(AgentConfig(), noise=NominalNoise(0.02), smooths_runs=False)
    >>> config.preset
    'graph'
    """

    preset: str = DEFAULT_PRESET
    estimator: EstimatorConfig = ESTIMATORS[DEFAULT_PRESET]
    noise: NominalNoise = NominalNoise()
    min_range_std: Positive = 0.005
    odometry: OdometryConfig = OdometryConfig()
    grid: GridConfig = GridConfig()
    policy: PolicyConfig = PolicyConfig()
    free_space_counts: bool = True
    finds_places: bool = True
    smoothing: GraphConfig | None = GraphConfig()
    smooths_runs: bool = True
    renewal: RenewalConfig | None = RenewalConfig()

    @property
    def run_smoothing(self) -> SmootherConfig | None:
        """Settings of the line smoother for a run of this estimator. None if runs are not, or
        cannot be, smoothed.

        The smoother estimates the errors of the odometry where the filter may do so.
        """
        if not self.smooths_runs or not isinstance(self.estimator, ConsistentConfig):
            return None
        return SmootherConfig(self.estimator.self_calibration.calibrate)

    @property
    def can_recover(self) -> bool:
        """Whether a lost robot looks for its place in its map."""
        return self.finds_places and isinstance(self.estimator, ConsistentConfig)

    @property
    def range_std(self) -> float:
        """Standard deviation of a range that the estimator assumes, m."""
        return max(self.noise.range_std, self.min_range_std)


def preset(name: str, noise: NominalNoise | None = None) -> AgentConfig:
    """The settings of a preset.

    Parameters
    ----------
    name
        One of ``PRESETS``: ``consistent``, ``paper`` (the published method), ``odometry`` (the
        published method without corrections) or ``graph`` (like ``consistent``, and a run or a log
        is smoothed after its end).
    noise
        Nominal noise of the robot; that of ideal ranges when None.

    Raises
    ------
    ValueError
        If there is no such preset.

    Examples
    --------
    >>> from limslam_agent import preset
    >>> from limslam_env import NominalNoise
    >>> preset("consistent", NominalNoise(range_std=0.02)).smooths_runs
    False
    """
    if name not in ESTIMATORS:
        raise ValueError(f"no preset is called {described(name)}; there are {', '.join(PRESETS)}")
    smooths = name == "graph"
    return AgentConfig(
        preset=name,
        estimator=ESTIMATORS[name],
        noise=noise or NominalNoise(),
        smoothing=GraphConfig() if smooths else None,
        smooths_runs=smooths,
        renewal=RenewalConfig() if smooths else None,
    )


def with_until(config: AgentConfig, until: str) -> AgentConfig:
    """The same settings, with an exploration that is over when everything was ``seen`` or when the
    ``walls`` are whole.

    Raises
    ------
    ValueError
        If ``until`` is neither.

    Examples
    --------
    >>> from limslam_agent import preset, with_until
    >>> with_until(preset("graph"), "walls").policy.until
    'walls'
    """
    return replace(config, policy=replace(config.policy, until=until))


def self_calibrating(config: AgentConfig, calibrate: WhenToCalibrate = "always") -> AgentConfig:
    """The same settings, with an estimator that estimates the constant errors of the odometry then.
    Raises a ValueError if the estimator cannot do that.
    """
    if not isinstance(config.estimator, ConsistentConfig):
        raise ValueError("only the consistent estimator can calibrate odometry by itself")  # noqa: TRY004 (a setting)
    calibration = replace(config.estimator.self_calibration, calibrate=calibrate)
    return replace(config, estimator=replace(config.estimator, self_calibration=calibration))


NO_GATE = 1e6
"""A gap that is longer than any gap between end points, m. It is finite, since settings are written
as JSON.
"""

# Group, name and value of the setting that an ablation changes.
_ABLATED = {
    "no-ekf": ("filter", "correct", False),
    "no-loop-closing": ("closing", "enabled", False),
    "no-end-gate": ("association", "max_end_gap", NO_GATE),
    "only-best-line": ("hough", "only_best", True),
}

ABLATIONS = tuple(_ABLATED)


def ablated(config: AgentConfig, ablation: str) -> AgentConfig:
    """The same settings with one part of the method switched off, which shows what that part
    contributes. Raises a ValueError if there is no such ablation, or the estimator has no such
    part.
    """
    if ablation not in ABLATIONS:
        raise ValueError(f"no ablation is called {ablation!r}; there are {', '.join(ABLATIONS)}")
    group, name, value = _ABLATED[ablation]
    if isinstance(config.estimator, ConsistentConfig):
        if ablation != "no-loop-closing":
            raise ValueError(
                f"{ablation} switches off a part of the published method: it needs the preset paper"
            )
        group = "merging"
    changed = replace(getattr(config.estimator, group), **{name: value})
    return replace(config, estimator=replace(config.estimator, **{group: changed}))
