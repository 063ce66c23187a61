"""Errors of the smoothed path of a recorded log, and of drives that were never recorded but could have been.

``python -m benchmarks.log_variations LOG RELATIONS [VARIATION...]`` prints a line for each variation. A variation is a
list of settings in one argument, such as ``"mirrored beams=90,45,0,-45,-90 noise=0.05"``; "" is the log as it is. The
settings are the fields of :class:`Variation`. Only the smoothing is done, without the filter in front of it.
"""

import sys
import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.logs.log_reader import read_log
from limslam_agent.logs.relations import Relations, read_relations, relation_errors, summary
from limslam_agent.replay.smoothing import log_data
from limslam_agent.slam.graph.key_poses import LogData, integrate
from limslam_agent.slam.graph.smooth import smooth_log
from limslam_env.geometry import FloatArray, se2

_ABOUT = np.array([0.0, 0.0, np.pi])
_POSITION_NOISE = 0.02  # m per square root of a metre


@dataclass(frozen=True)
class Variation:
    """A variation of a log.

    Attributes
    ----------
    beams, max_range
        Directions of the beams that are used, deg, and their longest range, m.
    noise
        Stated standard deviation of the ranges, m.
    hop
        Distance driven between local maps, m.
    mirrored, backwards
        Whether left and right are exchanged, and whether the robot drives the same way back.
    turn, gain, scale
        Errors added to odometry: heading per metre, deg; share of turns; share of distances.
    odometry_noise, range_noise, seed
        Standard deviations of noise that is added: of the heading in deg per square root of a metre (and 2 cm per
        square root of a metre of both components), and of the ranges, m; and the seed of both.
    """

    beams: tuple[float, ...] = (90.0, 54.0, 18.0, -18.0, -54.0, -90.0)
    max_range: float = 5.0
    noise: float = 0.02
    hop: float = 2.5
    mirrored: bool = False
    backwards: bool = False
    turn: float = 0.0
    gain: float = 0.0
    scale: float = 0.0
    odometry_noise: float = 0.0
    range_noise: float = 0.0
    seed: int = 1


def variation(text: str) -> Variation:
    """Read a variation such as ``"mirrored beams=90,0,-90 noise=0.05"``.

    Raises
    ------
    ValueError
        If a setting is not known.
    """
    known = asdict(Variation())
    found: dict[str, Any] = {}
    for part in text.split():
        name, _, value = part.partition("=")
        if name not in known:
            raise ValueError(f"{name} is no setting of a variation; settings are {', '.join(known)}")
        if name == "beams":
            found[name] = tuple(float(each) for each in value.split(","))
        else:
            found[name] = True if isinstance(known[name], bool) else type(known[name])(value)
    return Variation(**found)


def varied(data: LogData, relations: Relations, how: Variation) -> tuple[LogData, Relations]:
    """The log and its relations in a variation."""
    if how.backwards:
        data, relations = _backwards(data, relations)
    if how.mirrored:
        data, relations = _mirrored(data, relations)
    generator = np.random.default_rng(how.seed)
    moves = _moves(data)
    root = np.sqrt(np.hypot(moves[:, :1], moves[:, 1:2]))
    moves[:, 2] += np.radians(how.turn) * moves[:, 0] + how.gain * moves[:, 2]
    moves[:, :2] *= 1.0 + how.scale
    if how.odometry_noise:
        stds = root * np.array([_POSITION_NOISE, _POSITION_NOISE, np.radians(how.odometry_noise)])
        moves += stds * generator.standard_normal(moves.shape)
    ranges = np.where(
        data.hit, data.ranges + how.range_noise * generator.standard_normal(data.ranges.shape), data.ranges
    )
    return replace(data, odometry=integrate(np.zeros(3), moves), ranges=ranges, range_std=how.noise), relations


def _moves(data: LogData) -> FloatArray:
    return se2.between(data.odometry[:-1], data.odometry[1:])


def _mirrored(data: LogData, relations: Relations) -> tuple[LogData, Relations]:
    """Left and right exchanged."""
    sign = np.array([1.0, -1.0, -1.0])
    origins = data.origins * sign[:2]
    data = replace(data, odometry=data.odometry * sign, angles=-data.angles, origins=origins)
    return data, replace(relations, relative=relations.relative * sign)


def _backwards(data: LogData, relations: Relations) -> tuple[LogData, Relations]:
    """The drive from its end to its begin. The robot looks the other way, so that it drives ahead."""
    end = data.time[0] + data.time[-1]
    moves = _turned_about(se2.inverse(_moves(data))[::-1])
    data = replace(
        data,
        time=(end - data.time)[::-1].copy(),
        odometry=integrate(np.zeros(3), moves),
        ranges=data.ranges[::-1].copy(),
        hit=data.hit[::-1].copy(),
        angles=se2.wrap_angle(data.angles + np.pi),
        origins=-data.origins,
    )
    times = end - relations.start_time, end - relations.end_time
    return data, Relations(*times, _turned_about(relations.relative))


def _turned_about(motions: FloatArray) -> FloatArray:
    """Motions (k, 3) of a robot that looks the other way."""
    about = np.broadcast_to(_ABOUT, motions.shape)
    return se2.compose(se2.compose(about, motions), about)


def main(arguments: list[str]) -> None:
    """Print a line for each variation."""
    path, known, *texts = arguments
    for text in texts or [""]:
        how = variation(text)
        log = read_log(path, how.beams, how.max_range)
        assert log.odometry is not None  # noqa: S101 (relations belong to logs of odometry poses)
        data, relations = varied(log_data(log, log.odometry, how.noise), read_relations(known), how)
        config = GraphConfig()
        begin = time.process_time()
        found = smooth_log(data, np.zeros(3), replace(config, maps=replace(config.maps, hop=how.hop)))
        seconds = time.process_time() - begin
        errors = summary(relation_errors(relations, data.time, found.poses, data.odometry))
        metres, degrees, loops = (
            errors[f"{name}"] for name in ("relation_error_m", "relation_error_deg", "loop_relation_error_m")
        )
        print(
            f"{text or 'as recorded'}: {metres:.3f} m / {degrees:.2f} deg, loops {loops:.3f} m, "
            f"G {found.score:.3f}, {found.start}, {seconds:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
