"""Success over trainings and lanes: intervals against formulas, and against how often simulated truths are covered."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import t

from uavaccel.metrics.intervals import Proportion
from uavaccel.metrics.success import Success, covariance

Won = NDArray[np.bool_]


def test_trainings_and_not_games_decide_where_there_are_several() -> None:
    ratios = [0.9, 0.5, 0.7]
    several = Success(tuple(Proportion(round(1000 * ratio), 1000) for ratio in ratios)).estimate
    width = t.ppf(0.975, 2) * np.std(ratios, ddof=1) / np.sqrt(3)
    assert several.value == pytest.approx(0.7)
    assert several.interval == pytest.approx((0.7 - width, 1.0))
    pooled = Success((Proportion(2100, 3000),)).estimate
    assert pooled.interval == Proportion(2100, 3000).interval
    assert several.low < pooled.low < pooled.high < several.high


def test_trainings_that_all_fail_are_no_surer_than_their_games() -> None:
    assert Success((Proportion(0, 4),) * 3).estimate.interval == Proportion(0, 12).interval
    assert Success.on_lanes(np.ones((3, 4))).estimate.interval == Proportion(12, 12).interval


def test_of_one_training_the_lanes_are_its_games() -> None:
    won = np.arange(300) < 250
    alone = Success.on_lanes([won])
    assert alone.estimate.interval == alone.pooled.interval == Proportion(250, 300).interval


def test_lanes_that_are_hard_for_all_widen_the_interval() -> None:
    """Ten trainings that each win 240 of 300: different lanes, or all the same ones, which count as one training's."""
    apart, alike = (
        Success.on_lanes([np.roll(np.arange(300) < 240, shift * number) for number in range(10)]).estimate
        for shift in (30, 0)
    )
    assert apart.interval == Proportion(2400, 3000).interval
    assert alike.interval == pytest.approx(Proportion(240, 300).interval, abs=0.005)


def test_the_more_trainings_differ_the_wider_the_interval() -> None:
    widths = []
    for apart in (0, 5, 20, 60):
        of = [np.roll(np.arange(300) < 200 + apart * step, 37 * number) for number, step in enumerate((-1, 0, 1))]
        low, high = Success.on_lanes(of).estimate.interval
        widths.append(high - low)
    assert widths == sorted(widths)
    assert widths[-1] > 3 * widths[0]


def flown(rng: np.random.Generator, easy: NDArray[np.float64], policies: int, lanes: float, skill: float) -> Won:
    """Games of policies whose skills scatter, on lanes (n,) of different ease."""
    skills = skill * rng.standard_normal((policies, 1))
    return rng.random((policies, len(easy))) < 1 / (1 + np.exp(-(2 + skills + lanes * easy)))


@pytest.mark.parametrize(("lanes", "skill"), [(0.0, 0.0), (1.5, 0.0), (0.0, 0.5), (1.5, 0.5)])
@pytest.mark.parametrize("policies", [3, 10])
def test_intervals_cover_what_other_trainings_win_on_other_lanes(policies: int, lanes: float, skill: float) -> None:
    rng = np.random.default_rng(0)
    true = float(np.mean(1 / (1 + np.exp(-(2 + np.hypot(lanes, skill) * rng.standard_normal(400_000))))))
    ends = [
        Success.on_lanes(flown(rng, rng.standard_normal(100), policies, lanes, skill)).estimate.interval
        for _ in range(400)
    ]
    assert np.mean([low <= true <= high for low, high in ends]) > 0.91  # of 400
    assert true == pytest.approx(np.mean(ends), abs=0.04)


@pytest.mark.parametrize("same_policies", [False, True])
def test_ratios_and_differences_cover_and_are_narrower_in_pairs(same_policies: bool) -> None:
    """Of two kinds of policies, or of the same ones flown in two ways; the truth is 1, or 0."""
    rng, covered, widths = np.random.default_rng(1), [], []
    for _ in range(300):
        easy = rng.standard_normal(100)
        skills = 0.7 * rng.standard_normal((2, 5, 1))
        chance = 1 / (1 + np.exp(-(2 + skills[[0, 0 if same_policies else 1]] + 1.5 * easy)))
        first, second = (Success.on_lanes(won) for won in rng.random(chance.shape) < chance)
        unpaired = Success(second.policies)
        for true, paired, plain in (
            (1.0, first.ratio(second, same_policies), first.ratio(unpaired)),
            (0.0, first.difference(second, same_policies), first.difference(unpaired)),
        ):
            covered.append(paired.low <= true <= paired.high)
            widths.append((paired.high - paired.low) / (plain.high - plain.low))
    assert np.mean(covered) > 0.93
    assert np.mean(widths) < (0.75 if same_policies else 0.99)


def test_a_policy_against_itself_does_not_differ() -> None:
    won = Success.on_lanes([np.arange(300) < 195 + 2 * number for number in range(5)])
    assert won.difference(won, same_policies=True).value == 0.0
    low, high = won.difference(won, same_policies=True).interval
    assert high - low < 0.1 * (won.difference(won).high - won.difference(won).low)


def test_lanes_that_are_not_the_same_are_not_paired() -> None:
    short, long = (Success.on_lanes([np.arange(count) < 40]) for count in (50, 100))
    assert long.ratio(short) == long.ratio(Success(short.policies))


def test_the_parts_of_a_variance_add_up() -> None:
    """Of policies that win all or nothing, of lanes that all win or none, and of games by turns."""
    policies, lanes = np.eye(2)[0][:, None].repeat(4, 1), np.tile([0.0, 1.0, 0.0, 1.0], (2, 1))
    assert covariance(policies, policies) == pytest.approx((0.25, 0.0, 0.0))
    assert covariance(lanes, lanes) == pytest.approx((0.0, 1 / 12, 0.0))
    assert covariance(policies, lanes) == pytest.approx((0.0, 0.0, 0.0))
