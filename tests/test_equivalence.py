"""Equivalence: intervals of ratios and differences against formulas written out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uavaccel.metrics.equivalence import (
    Estimate,
    all_of,
    difference_estimate,
    exceeds,
    mean_estimate,
    opposite,
    ratio_estimate,
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


def test_a_lone_value_has_no_width_and_none_is_refused() -> None:
    assert mean_estimate([3.0]) == Estimate(3.0, 3.0, 3.0)
    with pytest.raises(ValueError, match="at least one"):
        mean_estimate([])
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
