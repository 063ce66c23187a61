"""The options of ``limslam replay``, read and checked, and the calibration of the odometry that they start."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from limslam_agent.config.presets import AgentConfig, ConsistentConfig, OdometryConfig, preset, self_calibrating
from limslam_agent.logs.directions import direction_of
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.relations import Relations, read_relations
from limslam_agent.logs.ros_topics import Topics
from limslam_agent.replay.calibration import OdometryBias, estimate_bias, select, within
from limslam_env.interface import NominalNoise


def numbers(option: str, text: str, count: int | None = None, low: float = -1e6) -> list[float]:
    """Numbers out of a text like ``1,2.5``.

    Raises
    ------
    ValueError
        If it is no such list, has not ``count`` of them, or one is below ``low`` or out of all bounds.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"{option}: {text!r} is not a list of numbers like 1,2.5") from None
    if count is not None and len(values) != count:
        raise ValueError(f"{option}: {count} numbers are needed, not {len(values)}")
    if not all(math.isfinite(value) and low <= value <= 1e6 for value in values):
        raise ValueError(f"{option}: {text!r} holds a number that is out of bounds")
    return values


def odometry_config(noise: str | None, bias: str | None, odometry: OdometryConfig | None = None) -> OdometryConfig:
    """The settings in ``--odometry-noise`` and ``--odometry-bias``.

    Parameters
    ----------
    noise, bias
        The options' texts; None changes nothing.
    odometry
        The settings that are changed; the defaults when None.

    Raises
    ------
    ValueError
        If one of them is not what it should be.
    """
    odometry = odometry or OdometryConfig()
    if noise is not None:
        along, per_metre, per_radian = numbers("--odometry-noise", noise, 3, low=0.0)
        odometry = replace(
            odometry,
            distance_variance=along**2,
            turn_variance_per_metre=math.radians(per_metre) ** 2,
            turn_variance_per_radian=math.radians(per_radian) ** 2,
        )
    if bias is not None:
        turn, scale = numbers("--odometry-bias", bias if "," in bias else f"{bias},1", 2)
        if not 0.01 <= scale <= 100.0:
            raise ValueError(f"--odometry-bias: the scale must lie between 0.01 and 100, not {scale:g}")
        odometry = replace(odometry, turn_bias=math.radians(turn), distance_scale=scale)
    return odometry


def replay_config(name: str, noise: float, odometry_noise: str | None, odometry_bias: str | None) -> AgentConfig:
    """The settings of a preset with what ``--noise``, ``--odometry-noise`` and ``--odometry-bias`` say.

    Raises
    ------
    ValueError
        If one of them is not what it should be.
    """
    config = preset(name, NominalNoise(noise))
    return replace(config, odometry=odometry_config(odometry_noise, odometry_bias))


def with_self_calibration(config: AgentConfig, *, enabled: bool) -> AgentConfig:
    """The settings with what ``--self-calibrate`` says.

    Raises
    ------
    ValueError
        If the preset's estimator cannot calibrate by itself.
    """
    if isinstance(config.estimator, ConsistentConfig):
        return self_calibrating(config, "always" if enabled else "never")
    if enabled:
        raise ValueError(f"--self-calibrate goes with the presets graph and consistent, not with {config.preset}")
    return config


def chosen_topics(scan: str | None, ranges: str | None, odometry: str | None) -> Topics:
    """The topics in ``--scan-topic``, ``--range-topics`` and ``--odometry-topic``.

    Raises
    ------
    ValueError
        If one of them is not what it should be.
    """
    pairs = [_range_topic(each) for each in _parts("--range-topics", ranges)]
    return Topics(_parts("--scan-topic", scan), dict(pairs), odometry)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A bias of the odometry, estimated from the log itself or from another log.

    Attributes
    ----------
    bias
        The estimated bias.
    begin, end
        The part of the log that the bias was estimated from, s; both None if that was another log.
    """

    bias: OdometryBias
    begin: float | None
    end: float | None

    def applied_to(self, odometry: OdometryConfig) -> OdometryConfig:
        """Settings that correct the bias."""
        return replace(odometry, turn_bias=self.bias.turn_per_metre, distance_scale=self.bias.distance_scale)

    def held_out(self, relations: Relations) -> Relations:
        """The relations that can be scored: those outside of the part that the bias was estimated from."""
        if self.begin is None or self.end is None:
            return relations
        return select(relations, ~within(relations, self.begin, self.end))

    @property
    def figures(self) -> dict[str, float | int]:
        """For ``result.json``."""
        bias = self.bias
        return {
            "calibration_turn_deg_per_m": math.degrees(bias.turn_per_metre),
            "calibration_turn_std_deg_per_m": math.degrees(bias.turn_std),
            "calibration_scale": bias.distance_scale,
            "calibration_scale_std": bias.scale_std,
            "calibration_relations": bias.relations,
        }

    @property
    def words(self) -> str:
        """A line for the terminal."""
        bias = self.bias
        turn = f"{math.degrees(bias.turn_per_metre):.3f} +- {math.degrees(bias.turn_std):.3f} deg/m"
        scale = f"scale {bias.distance_scale:.4f} +- {bias.scale_std:.4f}"
        relations = f"{bias.relations} relation{'' if bias.relations == 1 else 's'}"
        return f"{turn}, {scale}, from {relations} over {bias.driven:.1f} m"


@dataclass(frozen=True)
class CalibrationRun:
    """The options ``--calibrate``, ``--calibrate-until`` and ``--calibrate-log``.

    Attributes
    ----------
    relations
        File of the known motions.
    until
        Only motions within so many seconds from the log's first event count; None for all.
    log
        The log in which they were driven; None for the one that is replayed.
    """

    relations: Path | None
    until: float | None
    log: Path | None

    def __post_init__(self) -> None:
        if self.relations is None and (self.until is not None or self.log is not None):
            raise ValueError("--calibrate-until and --calibrate-log go with --calibrate, the known motions")
        if self.until is not None and not self.until > 0.0:
            raise ValueError(f"--calibrate-until: a time above 0 s is needed, not {self.until:g}")

    def estimate(
        self, recorded: RecordedLog, odometry: OdometryConfig, read: Callable[[Path], RecordedLog]
    ) -> Calibration | None:
        """Estimate the bias, if ``--calibrate`` was given.

        ``read`` opens another log in the way in which ``recorded`` was opened.

        Raises
        ------
        ValueError
            If a file cannot be used, or the motions are too few or those of another run.
        """
        if self.relations is None:
            return None
        known = read_relations(self.relations)
        run = recorded if self.log is None else read(self.log)
        begin, end = float(run.time.min()), float(run.time.max())
        if self.until is not None:
            end = min(end, begin + self.until)
        chosen = select(known, within(known, begin, end))
        try:
            bias = estimate_bias(run, chosen, odometry)
        except ValueError as error:
            raise ValueError(f"--calibrate {self.relations}: {error}") from error
        return Calibration(bias, begin, end) if self.log is None else Calibration(bias, None, None)

    @property
    def source(self) -> dict[str, str | None]:
        """The names of its files, for ``result.json``."""
        return {
            "calibration": self.relations.name if self.relations else None,
            "calibration_log": self.log.name if self.log else None,
            "calibration_until": None if self.until is None else f"{self.until:g} s",
        }


def _parts(option: str, text: str | None) -> tuple[str, ...]:
    if text is None:
        return ()
    parts = tuple(part.strip() for part in text.split(","))
    if not all(parts):
        raise ValueError(f"{option}: {text!r} is not a list of topics like /a,/b")
    return parts


def _range_topic(text: str) -> tuple[str, float | None]:
    """A topic with the direction (deg) after its colon: a number or a word like ``left``."""
    topic, colon, direction = text.partition(":")
    if not colon:
        return topic, None
    try:
        degrees = float(direction)
    except ValueError:
        named = direction_of(direction)
        if named is None:
            raise ValueError(f"--range-topics: {direction!r} is no direction: degrees, or a word like left") from None
        return topic, named
    if not -360.0 <= degrees <= 360.0:
        raise ValueError(f"--range-topics: {direction} is not within 360 deg")
    return topic, degrees
