"""Errors of the smoothed path of a recorded log, and of drives that were never recorded but could have been.

``python -m benchmarks log-variations LOG RELATIONS [VARIATION...]`` prints a line for each variation. A variation is a
list of settings in one argument, such as ``"mirrored beams=90,45,0,-45,-90 noise=0.05"``; "" is the log as it is. The
settings are the fields of :class:`Variation`. Only the smoothing is done, without the filter in front of it.
"""

import math
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.logs.log_reader import read_log
from limslam_agent.logs.relations import Relations, read_relations, relation_errors, summary
from limslam_agent.replay.smoothing import log_data, trusted_path
from limslam_agent.replay.trust import PathSignals
from limslam_agent.slam.graph.key_poses import LogData, integrate
from limslam_agent.slam.graph.local_views import moves_of
from limslam_agent.slam.graph.reversing import with_reversing
from limslam_agent.slam.graph.smooth import GraphResult
from limslam_env.geometry import BoolArray, FloatArray, se2
from limslam_env.metrics.metrics import trajectory_metrics

_ABOUT = np.array([0.0, 0.0, np.pi])
_POSITION_NOISE = 0.02  # m per square root of a metre
_SLIP = np.radians(15.0)


@dataclass(frozen=True)
class Variation:
    """A variation of a log.

    Attributes
    ----------
    beams, max_range
        Directions of the beams that are used, deg, and their longest range, m.
    noise
        Stated standard deviation of the ranges, m.
    mirrored, backwards
        Whether left and right are exchanged, and whether the robot drives the same way back.
    odometry_noise, range_noise, seed
        Standard deviations of noise that is added: of the heading in deg per square root of a metre (and 2 cm per
        square root of a metre of both components), and of the ranges, m; and the seed of all that is drawn.
    drop_outs, slips
        Share of the readings that are lost; and number of places where the robot turns without odometry noticing it,
        by 15 deg (standard deviation).
    points
        Readings of walls that are left in a metre of driving, by leaving out whole scans; 0 for all.
    """

    beams: tuple[float, ...] = (90.0, 54.0, 18.0, -18.0, -54.0, -90.0)
    max_range: float = 5.0
    noise: float = 0.02
    mirrored: bool = False
    backwards: bool = False
    odometry_noise: float = 0.0
    range_noise: float = 0.0
    seed: int = 1
    drop_outs: float = 0.0
    slips: int = 0
    points: float = 0.0


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
    data, relations = _driven(data, relations, how)
    generator = np.random.default_rng(how.seed)
    moves = _with_errors(data, how, generator)
    ranges = np.where(
        data.hit, data.ranges + how.range_noise * generator.standard_normal(data.ranges.shape), data.ranges
    )
    hit = data.hit & (generator.random(data.hit.shape) >= how.drop_outs) if how.drop_outs else data.hit
    hit = _thinned(hit, moves, how.points) if how.points else hit
    odometry = integrate(np.zeros(3), moves)
    return replace(data, odometry=odometry, ranges=ranges, hit=hit, range_std=how.noise), relations


def _driven(data: LogData, relations: Relations, how: Variation) -> tuple[LogData, Relations]:
    """The log in the direction in which it is driven, and its relations."""
    if how.backwards:
        data, relations = _backwards(data, relations)
    if how.mirrored:
        data, relations = _mirrored(data, relations)
    return data, relations


def _thinned(hit: BoolArray, moves: FloatArray, most: float) -> BoolArray:
    """The hits (n, b) of so many scans, evenly spread, that ``most`` of them are left in a metre of driving."""
    share = min(1.0, most * float(np.hypot(moves[:, 0], moves[:, 1]).sum()) / max(1, int(hit.sum())))
    number = np.cumsum(hit.any(axis=1))
    return np.asarray(hit & (np.floor(share * number) > np.floor(share * (number - 1)))[:, None])


def _with_errors(data: LogData, how: Variation, generator: np.random.Generator) -> FloatArray:
    """Motions (n - 1, 3) of odometry with the errors of a variation."""
    moves = moves_of(data)
    root = np.sqrt(np.hypot(moves[:, :1], moves[:, 1:2]))
    if how.odometry_noise:
        stds = root * np.array([_POSITION_NOISE, _POSITION_NOISE, np.radians(how.odometry_noise)])
        moves += stds * generator.standard_normal(moves.shape)
    if how.slips:
        places = generator.choice(len(moves), how.slips, replace=False)
        moves[places, 2] += _SLIP * generator.standard_normal(how.slips)
    return moves


def _mirrored(data: LogData, relations: Relations) -> tuple[LogData, Relations]:
    """Left and right exchanged."""
    sign = np.array([1.0, -1.0, -1.0])
    origins = data.origins * sign[:2]
    data = replace(data, odometry=data.odometry * sign, angles=-data.angles, origins=origins)
    return data, replace(relations, relative=relations.relative * sign)


def _backwards(data: LogData, relations: Relations) -> tuple[LogData, Relations]:
    """The drive from its end to its begin. The robot looks the other way, so that it drives ahead."""
    end = data.time[0] + data.time[-1]
    moves = _turned_about(se2.inverse(moves_of(data))[::-1])
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


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came out of a variation: the smoothed log, its signals, its errors, and the processor time, s.

    ``aligned`` has the root mean square errors of the positions by odometry and of the smoothed path after rigid
    alignment, m. They are not numbers where the true path is not known.
    """

    found: GraphResult
    signals: PathSignals
    errors: dict[str, Any]
    seconds: float
    aligned: tuple[float, float] = (math.nan, math.nan)

    @property
    def words(self) -> str:
        """One line for the screen."""
        metres, degrees, loops = (
            np.nan if (value := self.errors[f"{name}"]) is None else value
            for name in ("relation_error_m", "relation_error_deg", "loop_relation_error_m")
        )
        signals = self.signals
        signs = f"{signals.position_std:.2f} m expected, {signals.contradicted_share:.3f} contradicted"
        where = f"{signs}, {self.found.kind}, {self.seconds:.0f} s"
        return f"{metres:.3f} m / {degrees:.2f} deg, loops {loops:.3f} m, {signals.status.level}, {where}"


def outcome(path: Path, known: Path, how: Variation, truth: tuple[FloatArray, FloatArray] | None = None) -> Outcome:
    """Smooth a log in a variation, and compare the path with the relations in the file ``known``.

    ``truth`` has times (k,), s, and the true poses (k, 3) at these times, with headings that are not wrapped.
    """
    log = read_log(path, how.beams, how.max_range)
    assert log.odometry is not None  # noqa: S101 (tables of wheel travel are refused where no robot is given)
    recorded, known_relations = log_data(log, log.odometry, how.noise), read_relations(known)
    data, relations = varied(recorded, known_relations, how)
    config = GraphConfig()
    begin = time.process_time()
    directed = with_reversing(data, config)
    found, signals = trusted_path(directed, np.zeros(3), config)
    seconds = time.process_time() - begin
    errors = summary(relation_errors(relations, data.time, found.poses, data.odometry))
    if truth is None:
        return Outcome(found, signals, errors, seconds)
    places = np.column_stack([np.interp(recorded.time, truth[0], each) for each in truth[1].T])
    true = _driven(replace(recorded, odometry=places), known_relations, how)[0].odometry
    odometry, smoothed = (_aligned_error(true, poses) for poses in (data.odometry, found.poses))
    return Outcome(found, signals, errors, seconds, (odometry, smoothed))


def _aligned_error(true: FloatArray, poses: FloatArray) -> float:
    """Root mean square error of the positions of poses (n, 3) after rigid alignment, m."""
    found = trajectory_metrics(true, poses)["ate_aligned_m"]
    return math.nan if found is None else found
