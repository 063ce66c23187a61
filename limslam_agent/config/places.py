"""Settings of finding a place again.

All values are choices of this project, tuned on seeds that are not reported. Lengths are in metres.
"""

from dataclasses import dataclass

from limslam_agent.config.bounds import Bounded, Count, NonNegative, Positive, Share


@dataclass(frozen=True)
class PlaceConfig(Bounded):
    """When a place is searched for, and when it counts.

    When a match of two maps counts is decided by constants beside the code (:mod:`limslam_agent.places.decision`).

    Attributes
    ----------
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

    first: NonNegative = 1.5
    spacing: Positive = 0.5
    lost_first: NonNegative = 0.8
    lost_spacing: Positive = 0.35
    turn_length: NonNegative = 0.1
    lead: NonNegative = 25.0
    likeness: Share = 0.85
    on_map: NonNegative = 6.0
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
