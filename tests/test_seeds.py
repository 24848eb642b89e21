"""Statistics in which a training is one sample: intervals over seeds and games, tests over seeds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from uavaccel.metrics.seeds import hierarchical_interval, permutation_p, sign_flip_p

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
    """Two seeds win all, two none: the number of winners drawn is binomial, of four at 1/2."""
    sure = [np.full(1000, won) for won in (1.0, 1.0, 0.0, 0.0)]
    assert hierarchical_interval(sure, 0) == (0.0, 1.0)
    alike = [np.arange(1000) % 2] * 4
    low, high = hierarchical_interval(alike, 0)
    assert 0.4 < low < 0.5 < high < 0.6


def test_seeds_weigh_the_same_whatever_their_games() -> None:
    low, high = hierarchical_interval([np.zeros(1000), np.ones(2)], 1)
    assert (low, high) == (0.0, 1.0)


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
