"""Equivalence: intervals against formulas written out, and against how often simulated games are covered."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import t

from uavaccel.metrics.equivalence import (
    Estimate,
    all_of,
    exceeds,
    mean_estimate,
    opposite,
    ratio_estimate,
    success_estimate,
    within,
)
from uavaccel.metrics.intervals import Proportion


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


def test_trainings_and_not_games_decide_where_there_are_several() -> None:
    ratios = [0.9, 0.5, 0.7]
    several = success_estimate([Proportion(round(1000 * ratio), 1000) for ratio in ratios])
    width = t.ppf(0.975, 2) * np.std(ratios, ddof=1) / np.sqrt(3)
    assert several.value == pytest.approx(0.7)
    assert several.interval == pytest.approx((0.7 - width, 1.0))
    pooled = success_estimate([Proportion(2100, 3000)])
    assert pooled.interval == Proportion(2100, 3000).interval
    assert several.low < pooled.low < pooled.high < several.high


def test_trainings_that_all_fail_are_no_surer_than_their_games() -> None:
    assert success_estimate([Proportion(0, 4)] * 3).interval == Proportion(0, 12).interval


def test_a_lone_value_has_no_width_and_none_is_refused() -> None:
    assert mean_estimate([3.0]) == Estimate(3.0, 3.0, 3.0)
    for wrong in (lambda: mean_estimate([]), lambda: success_estimate([])):
        with pytest.raises(ValueError, match="at least one"):
            wrong()
    with pytest.raises(ValueError, match="to 0"):
        ratio_estimate(Estimate(1.0, 1.0, 1.0), Estimate(0.0, 0.0, 0.1))


def test_a_ratio_of_sure_numbers_is_sure() -> None:
    assert ratio_estimate(Estimate(3, 3, 3), Estimate(4, 4, 4)) == pytest.approx((0.75, 0.75, 0.75))


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


def test_intervals_cover_what_they_estimate() -> None:
    """600 experiments of five trainings that differ, and 2 000 of a ratio of two successes."""
    rng = np.random.default_rng(0)

    def trained() -> Estimate:
        talent = rng.beta(14, 6, 5)  # a mean of .7, standard deviation .1
        return success_estimate([Proportion(int(rng.binomial(100, each)), 100) for each in talent])

    @cache
    def alone(won: int) -> Estimate:
        return success_estimate([Proportion(won, 200)])

    successes = [trained() for _ in range(600)]
    won = rng.binomial(200, (0.45, 0.9), (2000, 2)).tolist()
    ratios = [ratio_estimate(alone(first), alone(second)) for first, second in won]
    covered = [
        np.mean([estimate.low <= true <= estimate.high for estimate in estimates])
        for estimates, true in ((successes, 0.7), (ratios, 0.5))
    ]
    assert covered[0] > 0.93
    assert 0.93 < covered[1] < 0.975
