"""Statistics of the benchmark, on cases worked by hand and against scipy's own calls."""

import numpy as np
import pytest
from scipy import stats

from benchmarks.analysis.statistics import (
    Estimate,
    compare,
    interquartile_mean,
    interquartile_means,
    median,
    medians,
    paired,
    share,
)

RNG = np.random.default_rng(3)


def test_the_median_by_hand():
    assert median([5.0, 1.0, 3.0]).value == 3.0
    assert median([4.0, 1.0, 3.0, 2.0]).value == 2.5


def test_the_interquartile_mean_by_hand():
    # Of eight values two go at each end: (3 + 4 + 5 + 6) / 4; an outlier changes nothing.
    assert interquartile_mean([1, 2, 3, 4, 5, 6, 7, 800]).value == 4.5


@pytest.mark.parametrize("count", [3, 4, 10, 11, 40])
def test_intervals_are_those_of_scipy(count):
    values = np.sort(RNG.normal(size=count))
    for ours, statistic in (
        (median(values), np.median),
        (interquartile_mean(values), lambda x, axis: stats.trim_mean(x, 0.25, axis=axis)),
    ):
        theirs = stats.bootstrap(
            (values,), statistic, n_resamples=2000, method="percentile", rng=np.random.default_rng(0)
        ).confidence_interval
        assert ours.value == pytest.approx(statistic(values, axis=0))
        assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high))
        assert ours.count == count


def test_intervals_of_the_median_hold_the_truth_about_as_often_as_they_say():
    found = medians(list(RNG.normal(size=(400, 15))))
    covered = np.mean([each.low <= 0.0 <= each.high for each in found])
    assert 0.90 <= covered <= 0.99


def test_intervals_of_the_interquartile_mean_hold_the_truth_about_as_often_as_they_say():
    found = interquartile_means(list(RNG.normal(size=(400, 15))))
    covered = np.mean([each.low <= 0.0 <= each.high for each in found])
    assert 0.88 <= covered <= 0.99


def test_the_same_values_in_any_order_and_company_give_the_same_interval():
    values = RNG.normal(size=12)
    alone = median(values)
    assert median(values[::-1]) == alone
    assert medians([RNG.normal(size=12), values, RNG.normal(size=3)])[1] == alone


def test_values_that_are_all_alike_have_an_interval_of_no_width():
    assert median([2.0] * 5) == Estimate(2.0, 2.0, 2.0, 5)


@pytest.mark.parametrize("values", [[7.0], [7.0, 7.0]])
def test_fewer_than_three_values_have_no_interval(values):
    assert median(values) == Estimate(7.0, None, None, len(values))


def test_no_values_have_no_median():
    assert median([]) is None
    assert medians([np.array([]), np.array([1.0])]) == [None, Estimate(1.0, None, None, 1)]


def test_a_share_by_hand():
    # Clopper and Pearson: none of 10 has the upper limit 1 - 0.025^(1/10).
    none = share(0, 10)
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(1.0 - 0.025**0.1)
    assert share(0, 0) is None
    with pytest.raises(ValueError, match="11 of 10"):
        share(11, 10)


def test_pairs_by_hand():
    first = {1: 1.0, 2: 2.0, 3: 4.0, 4: None, 5: 9.0}
    second = {1: 2.0, 2: 1.0, 3: 4.0, 4: 3.0, 6: 9.0}
    found = compare(first, second)
    # Differences 1, -1, 0 and ratios 2, 0.5, 1; seed 4 failed under one, 5 and 6 were done under one only.
    assert (found.difference.value, found.ratio.value) == (0.0, 1.0)
    assert (found.pairs, found.left_out, found.unpaired) == (3, 1, 2)


def test_pairing_takes_out_what_the_seeds_have_in_common():
    hard = {seed: 100.0 * seed for seed in range(10)}
    harder = {seed: value + 1.0 for seed, value in hard.items()}
    found = compare(hard, harder).difference
    assert (found.low, found.value, found.high) == (1.0, 1.0, 1.0)


def test_a_ratio_to_nothing_is_left_out_of_the_ratios_alone():
    found = compare({0: 0.0, 1: 2.0}, {0: 1.0, 1: 6.0})
    assert (found.pairs, found.ratio.value, found.ratio.count) == (2, 3.0, 1)


def test_settings_without_a_seed_in_common_have_no_pairs():
    found = compare({0: 1.0}, {1: 1.0, 2: 2.0})
    assert (found.difference, found.ratio, found.pairs, found.unpaired) == (None, None, 0, 3)
    assert paired({}, {}).unpaired == 0
