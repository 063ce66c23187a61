"""Statistics, on cases worked by hand and against scipy's own calls."""

import math

import numpy as np
import pytest
from scipy import stats

from limslam_agent.measurements.statistics import (
    Estimate,
    estimate,
    geometric_ratio,
    holm,
    mean,
    median,
    number,
    paired,
    signed_rank,
)

RNG = np.random.default_rng(3)


def test_medians_and_means_by_hand():
    assert median([4.0, 1.0, 3.0, 2.0]).value == 2.5
    assert mean([4.0, 1.0, 4.0]).value == 3.0
    assert median([]) is None
    assert median([7.0, 7.0]) == Estimate(7.0, None, None, 2)
    assert median([7.0, 7.0, 7.0]) == Estimate(7.0, 7.0, 7.0, 3)


def test_intervals_are_those_of_scipy_up_to_the_drawing():
    values = RNG.normal(50.0, 10.0, 100)
    for ours, statistic in ((median(values), np.median), (mean(values), np.mean)):
        theirs = stats.bootstrap((values,), statistic, method="percentile", rng=RNG).confidence_interval
        assert ours.value == pytest.approx(statistic(values), rel=1e-12)
        assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=0.5)
    assert median(values) == median(values)


def test_intervals_of_the_median_hold_the_truth_about_as_often_as_they_say():
    found = [median(values) for values in RNG.normal(size=(400, 15))]
    covered = np.mean([each.low <= 0.0 <= each.high for each in found])
    assert 0.90 <= covered <= 0.99


def test_only_the_first_axis_is_resampled():
    # Columns that differ among themselves say nothing about other rows.
    found = estimate(lambda drawn: drawn.mean(axis=(1, 2)), np.tile(np.linspace(0.0, 1.0, 9), (3, 1)))
    assert found.low == pytest.approx(found.value) == found.high


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (Estimate(0.123, 0.1, 0.2, 9), "0.12 [0.10, 0.20]"),
        (Estimate(0.123, None, None, 2), "0.12"),
        (Estimate(0.123, 0.1231, 0.1232, 9), "0.12"),
        (Estimate(-0.001, -0.2, 1e6, 9), "0.00 [-0.20, 1e+06]"),
    ],
)
def test_estimates_as_text(found, text):
    assert found.text(2) == text
    assert number(None, 2) == "\N{EN DASH}"


def test_pairs_by_hand():
    first = {1: 1.0, 2: 2.0, 3: None, 4: 4.0, 5: 0.0}
    second = {1: 2.0, 2: 6.0, 3: 1.0, 5: 3.0, 6: 1.0}
    found = paired(first, second)
    assert (found.first.tolist(), found.second.tolist()) == ([1.0, 2.0, 0.0], [2.0, 6.0, 3.0])
    assert (found.left_out, found.unpaired) == (1, 2)
    assert found.difference.value == 3.0
    assert (found.ratio.value, found.ratio.count) == (2.5, 2)
    assert paired({1: 1.0}, {2: 1.0}).difference is None


def test_ratios_are_geometric_means_with_two_standard_errors():
    found = geometric_ratio([1.0, 2.0], [2.0, 2.0], 0.0)
    # The logarithms are ln 2 and 0, so their standard deviation is ln 2 / sqrt(2), and two standard errors are ln 2.
    assert np.allclose([found.value, found.low, found.high], [math.sqrt(2.0), math.sqrt(0.5), 2.0 * math.sqrt(2.0)])
    alone = geometric_ratio([1.0], [1.5], 0.1)
    assert np.allclose([alone.value, alone.low, alone.high], [1.5, 1.5 * math.exp(-0.2), 1.5 * math.exp(0.2)])
    assert geometric_ratio([], [], 0.1) is None


def test_differences_are_tested():
    assert signed_rank(np.full(15, 3.0)) < 0.001
    assert signed_rank(np.zeros(5)) is None


def test_p_values_are_corrected_for_the_number_of_tests():
    assert holm([0.01, None, 0.04, 0.03]) == pytest.approx([0.03, None, 0.06, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []
