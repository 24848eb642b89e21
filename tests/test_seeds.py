"""Statistics in which a training is one sample: intervals and tests over seeds and games, and equivalence."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from uavaccel.metrics.estimates import (
    Estimate,
    all_of,
    difference_estimate,
    exceeds,
    mean_estimate,
    opposite,
    ratio_estimate,
    within,
)
from uavaccel.metrics.intervals import Proportion, hierarchical_interval, permutation_p, sign_flip_p

permutation_test: Any = stats.permutation_test  # its stubs know no plain lists
games = st.lists(st.sampled_from([0.0, 1.0]), min_size=1, max_size=12)
trainings = st.lists(games, min_size=1, max_size=6)
ratios = st.lists(st.integers(0, 8).map(lambda won: won / 8), min_size=2, max_size=5)


@given(trainings, st.integers(0, 3))
def test_an_interval_lies_within_the_seeds_games_and_repeats(samples: list[list[float]], seed: int) -> None:
    low, high = hierarchical_interval(samples, seed, resamples=50)
    assert min(map(min, samples)) <= low <= high <= max(map(max, samples))
    assert (low, high) == hierarchical_interval(samples, seed, resamples=50)
    lost = [[1.0 - game for game in sample] for sample in samples]
    assert hierarchical_interval(lost, seed, resamples=50) == pytest.approx((1.0 - high, 1.0 - low))


def test_of_one_seed_the_interval_is_binomial() -> None:
    low, high = hierarchical_interval([np.arange(300) < 60], 0, resamples=20_000)
    expected = stats.binom(300, 0.2).ppf([0.025, 0.975]) / 300
    np.testing.assert_allclose((low, high), expected, atol=0.004)


def test_of_seeds_that_differ_it_is_as_wide_as_they_do() -> None:
    """Two seeds win all, two none: the number of winners drawn is binomial, of four at 1/2. All weigh the same."""
    assert hierarchical_interval([np.zeros(1000), np.ones(2)], 1) == (0.0, 1.0)
    sure = [np.full(1000, won) for won in (1.0, 1.0, 0.0, 0.0)]
    assert hierarchical_interval(sure, 0) == (0.0, 1.0)
    alike = [np.arange(1000) % 2] * 4
    low, high = hierarchical_interval(alike, 0)
    assert 0.4 < low < 0.5 < high < 0.6


@given(ratios, ratios)
def test_a_permutation_test_is_scipys(first: list[float], second: list[float]) -> None:
    expected = permutation_test(
        (first, second), lambda a, b: abs(np.mean(a) - np.mean(b)), n_resamples=np.inf, alternative="greater"
    )
    assert permutation_p(first, second) == pytest.approx(expected.pvalue)
    assert permutation_p(second, first) == permutation_p(first, second)


@given(ratios)
def test_swapping_signs_is_scipys(differences: list[float]) -> None:
    zeros = np.zeros(len(differences))
    expected = permutation_test(
        (differences, zeros), lambda a, b: abs(np.mean(a - b)), permutation_type="samples",
        n_resamples=np.inf, alternative="greater", vectorized=False,
    )  # fmt: skip
    assert sign_flip_p(differences) == pytest.approx(expected.pvalue)


def test_the_least_p_is_that_of_all_ways_there_are() -> None:
    assert permutation_p(np.zeros(10), np.ones(10)) == 2 / 184_756
    assert permutation_p(np.zeros(5), np.ones(5)) == 2 / 252
    assert sign_flip_p(np.ones(10)) == 2 / 1024
    assert permutation_p([1.0], [0.0, 0.0]) is None
    assert sign_flip_p([1.0]) is None


def test_beyond_what_can_be_counted_ways_are_drawn() -> None:
    rng = np.random.default_rng(0)
    same, other = rng.random(12), rng.random(12)
    p = permutation_p(same, other)
    assert p == permutation_p(same, other)
    expected = permutation_test((same, other), lambda a, b: abs(np.mean(a) - np.mean(b)), n_resamples=20_000,
                                alternative="greater", rng=np.random.default_rng(1)).pvalue  # fmt: skip
    assert p == pytest.approx(expected, abs=0.02)
    assert sign_flip_p([1.0] * 15 + [-1.0] * 5) == pytest.approx(2 * stats.binom(20, 0.5).cdf(5), abs=0.002)


def test_what_was_seen_is_one_of_the_ways_that_are_drawn() -> None:
    """200 000 draws meet nothing as rare: p is never 0."""
    assert permutation_p(np.arange(20), 100 + np.arange(20)) == 1 / 200_001
    assert sign_flip_p(np.ones(40)) == 1 / 200_001


def test_another_seed_draws_other_ways() -> None:
    values = np.random.default_rng(0).random(24)
    for test in (
        lambda seed: permutation_p(values[:12], values[12:], seed),
        lambda seed: sign_flip_p(values - 0.4, seed),
    ):
        assert test(1) != test(2) == pytest.approx(test(1), abs=0.01)
        assert test(1) == test(1)
    assert permutation_p(values[:5], values[5:10], 1) == permutation_p(values[:5], values[5:10], 2)
    assert sign_flip_p(values[:5], 1) == sign_flip_p(values[:5], 2)


# --- equivalence ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("interval", "above_one", "inside"),
    [
        ((1.1, 1.2), True, True),
        ((0.8, 1.25), None, True),
        ((0.7, 0.79), False, False),
        ((0.7, 0.9), False, None),
        ((1.3, 1.4), True, False),
        ((1.0, 1.3), None, None),
        ((0.9, 1.0), False, True),
    ],
)
def test_an_interval_shows_holding_failing_or_nothing(
    interval: tuple[float, float], above_one: bool | None, inside: bool | None
) -> None:
    assert exceeds(interval, 1.0) is above_one
    assert within(interval, (0.8, 1.25)) is inside


def test_parts_of_a_claim() -> None:
    assert all_of([True, True]) is True
    assert all_of([True, None]) is None
    assert all_of([None, False]) is False
    assert [opposite(each) for each in (True, False, None)] == [False, True, None]


def test_a_lone_value_has_no_width_and_none_is_refused() -> None:
    assert mean_estimate([3.0]) == Estimate(3.0, 3.0, 3.0)
    assert ratio_estimate(Estimate(3, 3, 3), Estimate(4, 4, 4)) == pytest.approx((0.75, 0.75, 0.75))
    with pytest.raises(ValueError, match="at least one"):
        mean_estimate([])
    with pytest.raises(ValueError, match="to 0"):
        ratio_estimate(Estimate(1.0, 1.0, 1.0), Estimate(0.0, 0.0, 0.1))


def test_ends_of_a_ratio_solve_movers_equation() -> None:
    """At an end r the interval of p - r q, made of theirs, ends at 0."""
    p, q = (Estimate(each.ratio, *each.interval) for each in (Proportion(13, 100), Proportion(21, 100)))
    ratio = ratio_estimate(p, q)
    for r, end_p, end_q, sign in ((ratio.low, p.low, q.high, -1), (ratio.high, p.high, q.low, 1)):
        assert p.value - r * q.value + sign * np.hypot(p.value - end_p, r * (q.value - end_q)) == pytest.approx(0)
    assert ratio.low < 0.62 < 1 < ratio.high, "the paper's 21 to 13 of 100 may be no loss at all"


@pytest.mark.parametrize(
    ("p", "q", "low", "high"),
    [
        # 2 - r = sqrt(1 + r^2), whose squares cancel; 2 - r = -sqrt(1 + r^2 / 4)
        ((2, 1, 3), (1, 0.5, 2), 0.75, (4 + np.sqrt(7)) / 1.5),
        # r = sqrt(1 + r^2 / 4)
        ((0, 0, 1), (1, 0.5, 2), 0.0, 2 / np.sqrt(3)),
        # 2 - r = r; q may be 0
        ((2, 2, 2), (1, 0, 2), 1.0, np.inf),
        # 1 - r = -sqrt(1 + r^2 / 4)
        ((1, 0, 2), (1, 0.5, 1.5), 0.0, 8 / 3),
    ],
)
def test_ends_of_a_ratio_solve_movers_equation_on_its_edges_too(
    p: tuple[float, ...], q: tuple[float, ...], low: float, high: float
) -> None:
    assert ratio_estimate(Estimate(*p), Estimate(*q)) == pytest.approx((p[0] / q[0], low, high))


def test_none_won_of_many_has_an_upper_end() -> None:
    none, all_but = (Estimate(each.ratio, *each.interval) for each in (Proportion(0, 300), Proportion(290, 300)))
    ratio = ratio_estimate(none, all_but)
    assert (ratio.value, ratio.low) == (0.0, 0.0)
    assert 0.01 < ratio.high < 0.02
    assert ratio_estimate(all_but, Estimate(0.01, 0.0, 0.03)).high == np.inf


@given(st.integers(0, 50), st.integers(1, 50))
def test_a_ratio_lies_in_its_interval(first: int, second: int) -> None:
    p, q = (Estimate(each.ratio, *each.interval) for each in (Proportion(first, 50), Proportion(second, 50)))
    ratio = ratio_estimate(p, q)
    assert 0 <= ratio.low <= ratio.value * (1 + 1e-9)
    assert ratio.value <= ratio.high * (1 + 1e-9)


def test_a_difference_of_the_same_games_is_newcombes() -> None:
    """Row (a) of Table II of Stat. Med. 17 (1998), method 10: of 50 pairs 36 both, 12 and 2 one alone, none neither."""
    both, first, second, neither = 36, 12, 2, 0
    p, q = (Estimate(won.ratio, *won.interval) for won in (Proportion(both + first, 50), Proportion(both + second, 50)))
    margins = (both + first) * (second + neither) * (both + second) * (first + neither)
    found = difference_estimate(p, q, (both * neither - first * second) / np.sqrt(margins))
    assert found == pytest.approx((0.2, 0.0569, 0.3404), abs=2e-4)


def test_what_goes_together_narrows_a_ratio_and_a_difference() -> None:
    p, q = (Estimate(each.ratio, *each.interval) for each in (Proportion(260, 300), Proportion(250, 300)))
    for of in (ratio_estimate, difference_estimate):
        ends = [of(p, q, correlation).interval for correlation in (-0.5, 0.0, 0.5, 0.9)]
        assert all(wide[0] < narrow[0] < narrow[1] < wide[1] for wide, narrow in pairwise(ends))
    few = Estimate(0.1, 0.0, 0.4)
    assert ratio_estimate(few, few, 1.0) == ratio_estimate(few, few)  # where pairing has no root, nothing is claimed
