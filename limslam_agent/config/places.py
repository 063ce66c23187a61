"""Settings of finding a place again: when a match of two maps counts.

All values are choices of this project, tuned on seeds that are not reported. Lengths are in metres, angles in radians.
"""

import math
from dataclasses import dataclass

from limslam_agent.config.bounds import Angle, Bounded, Count, NonNegative, Positive, Share


@dataclass(frozen=True)
class PlaceConfig(Bounded):
    """How a local map is matched with another map, and when the match counts.

    Attributes
    ----------
    peaks
        Number of poses that are refined and compared.
    near, turn
        A point of a wall is confirmed if a wall of the other map is within ``near``, m, and their directions differ by
        less than ``turn``, rad.
    contradiction
        Price of a contradicted point, in confirmed points.
    least_walls, least_across
        Least length of confirmed walls, m, in all and across their main direction.
    forward, backward
        Least share of confirmed points among the confirmed and contradicted points: of the local map, and of the other
        map.
    known
        Least share of the local map's points that are confirmed.
    runner_up
        Largest score of another pose, as a share of the best score.
    discount, discounted
        The score of another pose counts only for the share ``discount`` if at least this number of points contradict it
        and its shares of confirmed points are less than ``forward``.
    apart, apart_turn
        Two poses are different if they are farther apart than this, m or rad.
    std, heading_std
        Standard deviations of position and heading of a match, m and rad.
    first, spacing
        Distance that a robot drives before its local map is matched for the first time, and between two matches, m.
        Two matches in succession must agree.
    lost_first, lost_spacing, turn_length
        The same for a lost robot, m, whose turn by one radian counts like ``turn_length``, m.
    lead, likeness
        Least difference between the evidence of a place and that of every other place, and largest share that another
        place has of it.
    on_map
        Least logarithm of the likelihood ratio of the contradictions at a place: of the right place, and of ground that
        the map does not have.
    found
        The same at the place of a lost robot, which must also have been the best place in the search before.
    recheck, search
        A robot whose readings changed suddenly weighs its readings since then each time that it has driven so far, and
        searches its whole map for another place less often, m.
    suspected, carried
        It is unsure, or lost, if the evidence that it was carried away is at least this: a logarithm of a likelihood
        ratio that outweighs the prior.
    supported
        Another place of the map makes a robot unsure only if its readings have at most this evidence at the believed
        pose.
    far
        For what share of its evidence a place counts that is far from the believed one, if nothing says that the robot
        was carried away.
    least_known
        A robot that is lost from a map with a smaller length of walls, m, begins a new map. Such a map is no loss, and
        the robot may never come back to its walls.
    checkpoint, checkpoints, margin
        Number of steps between two copies of the estimate, number of copies that are kept, and least number of steps by
        which a copy must be older than the first doubt about the estimate.
    longest
        Largest number of steps that are kept for the time after a robot has found its place.
    confirmed, far_confirmed
        A robot that has found its place is ``unsure`` until it has driven so far without contradictions, m, and its map
        has no frontier left. Without the last condition, it must have driven ``far_confirmed``, m.
    """

    peaks: Count = 12
    near: Positive = 0.12
    turn: Angle = math.radians(20.0)
    contradiction: NonNegative = 2.0
    least_walls: NonNegative = 4.0
    least_across: NonNegative = 0.9
    forward: Share = 0.94
    backward: Share = 0.85
    known: Share = 0.35
    runner_up: Share = 0.70
    discount: Share = 0.78
    discounted: Count = 4
    apart: Positive = 0.40
    apart_turn: Angle = math.radians(15.0)
    std: Positive = 0.05
    heading_std: Angle = math.radians(2.0)
    first: NonNegative = 1.5
    spacing: Positive = 0.5
    lost_first: NonNegative = 0.8
    lost_spacing: Positive = 0.35
    turn_length: NonNegative = 0.1
    lead: NonNegative = 25.0
    likeness: Share = 0.85
    on_map: NonNegative = 6.0
    found: NonNegative = 7.0
    recheck: Positive = 0.3
    search: Positive = 1.0
    suspected: Positive = 6.0
    carried: Positive = 10.0
    supported: NonNegative = 15.0
    far: Share = 0.3
    least_known: NonNegative = 4.0
    checkpoint: Count = 50
    checkpoints: Count = 6
    margin: Count = 100
    longest: Count = 6000
    confirmed: NonNegative = 3.0
    far_confirmed: NonNegative = 30.0
