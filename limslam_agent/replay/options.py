"""The options of ``limslam replay``, read and checked."""

import math
from dataclasses import replace

from limslam_agent.config.shared import OdometryConfig
from limslam_agent.logs.directions import degrees_of
from limslam_agent.logs.ros_topics import Topics


def numbers(option: str, text: str, count: int | None = None, low: float = -1e6) -> list[float]:
    """Numbers out of a text like ``1,2.5``.

    Raises
    ------
    ValueError
        If it is no such list, has not ``count`` of them, or one is below ``low`` or out of all
        bounds.
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


def odometry_config(
    noise: str | None, bias: str | None, odometry: OdometryConfig | None = None
) -> OdometryConfig:
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
            raise ValueError(
                f"--odometry-bias: the scale must lie between 0.01 and 100, not {scale:g}"
            )
        odometry = replace(odometry, turn_bias=math.radians(turn), distance_scale=scale)
    return odometry


def chosen_topics(text: str | None) -> Topics:
    """The topics in ``--topics``, each with the direction (deg) after its colon: a number or a word
    like ``left``.

    Raises
    ------
    ValueError
        If it is no list of topics, or one has something else after its colon.
    """
    if text is None:
        return {}
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise ValueError(f"--topics: {text!r} is not a list of topics like /a,/b")
    return dict(_topic(part) for part in parts)


def _topic(text: str) -> tuple[str, float | None]:
    topic, colon, direction = text.partition(":")
    if not colon:
        return topic, None
    try:
        degrees = degrees_of(direction)
    except ValueError as error:
        raise ValueError(f"--topics: {error}") from None
    return topic, degrees
