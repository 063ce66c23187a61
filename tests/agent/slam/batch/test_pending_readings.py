"""The batch collects the readings that the plain pending readings collect."""

import numpy as np
from support.batch_stages import ROBOT, cached, estimator_config, observations, spec

from limslam_agent.slam.batch import pending_readings
from limslam_agent.slam.batch.state import BEAM, CLONE, DRIVEN, DRIVEN_AT, DRIVEN_THEN, FRESH, PENDING, RANGE, TURNED
from limslam_agent.slam.batch.state import TURNED_AT as AT
from limslam_agent.slam.consistent.pending_readings import SIDES, PendingReadings
from limslam_agent.slam.core.front_end import FrontEnd

is_due, collect = cached(pending_readings.is_due), cached(pending_readings.collect)
has_ended, readings_of = cached(pending_readings.has_ended), cached(pending_readings.readings_of)


def test_a_drive_is_collected_alike() -> None:
    config, settings, beams = estimator_config(), spec().settings[0], spec().beams
    plain, front = PendingReadings(ROBOT, config.pending, config.pending.beams), FrontEnd(ROBOT)
    travel, pending, counts = np.zeros(7), np.zeros((3, 900, 4)), np.zeros(13, dtype=np.int64)
    travel[DRIVEN_AT] = travel[AT] = -np.inf
    generator, number, ended = np.random.default_rng(0), 0, 0
    for step, seen in enumerate(observations()[:200]):
        increment = np.array([0.02, 0.01, 0.03]) * generator.random()
        # Between the blocks of readings nothing is seen, so that walls end.
        ranges = np.asarray(seen["ranges"], dtype=float) if step % 40 < 15 else ROBOT.max_ranges
        plain.move(increment)
        front.accept({"ranges": ranges})
        travel[DRIVEN] += np.hypot(*increment[:2])
        travel[TURNED] += abs(increment[2])
        due = plain.is_due(front)
        assert is_due(travel, front.hits, settings, beams) == due
        if due:
            plain.collect(front, number)
            collect(counts, travel, pending, ranges, front.hits, beams, number)
            number += 1
        for side, name in enumerate(SIDES):
            assert has_ended(counts, travel, side, 0.2) == plain.has_ended(name, 0.2)
            ended += plain.has_ended(name, 0.2)
            assert counts[FRESH + side] == plain.fresh[name]
            rows = pending[side, : counts[PENDING + side]]
            expected = [(each.clone, each.beam, each.distance, each.driven) for each in plain.by_side[name]]
            np.testing.assert_allclose(rows[:, [CLONE, BEAM, RANGE, DRIVEN_THEN]], np.reshape(expected, (-1, 4)))
    assert number > 20
    assert ended > 20
    clones = np.arange(3, number)
    for side, name in enumerate(SIDES):
        rows = pending[side, : counts[PENDING + side]]
        rows = rows[rows[:, CLONE] >= 3]
        places, found = readings_of(rows, clones, beams, 0.02)
        expected_readings = plain.readings(name)
        kept = expected_readings.select(np.flatnonzero(expected_readings.clones >= 3))
        np.testing.assert_array_equal(clones[places], kept.clones)
        np.testing.assert_array_equal(
            found, np.column_stack((kept.origins, kept.angles, kept.ranges, np.full(len(kept.ranges), 0.02)))
        )
