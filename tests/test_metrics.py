"""Errors, speed-ups, intervals, tests, STLC and success, against values, definitions and formulas known by hand."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise, permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial import KDTree

from uavaccel.metrics.estimates import (
    Estimate,
    Success,
    all_of,
    covariance,
    difference_estimate,
    exceeds,
    mean_estimate,
    opposite,
    ratio_estimate,
    within,
)
from uavaccel.metrics.intervals import (
    Proportion,
    bootstrap_interval,
    fisher_exact_p,
    hierarchical_interval,
    mcnemar_exact,
    median_interval,
    permutation_p,
    sign_flip_p,
    speedup_interval,
    student_quantile,
)
from uavaccel.metrics.stlc import mean_stlc, stlc, stlc_matrix
from uavaccel.metrics.trajectory import (
    Trajectory,
    command_gaps_s,
    distinct,
    mean_position_rmse,
    position_rmse,
    quartiles,
    trajectory,
)


def straight(duration_s: float, step_s: float = 0.05, speed_m_s: float = 1.0, offset_m: float = 0.0) -> Trajectory:
    time_s = np.arange(round(duration_s / step_s) + 1, dtype=np.float64) * step_s
    return Trajectory(time_s, np.column_stack([speed_m_s * time_s, np.full_like(time_s, offset_m), 0 * time_s]))


LATE, DELAYED = (Trajectory(straight(10).time_s + by_s, straight(10).position_m) for by_s in (20.0, 0.12))


@pytest.mark.parametrize(
    ("reference", "flight", "rmse_m"),
    [
        (straight(5), straight(5, offset_m=0.25), 0.25),
        (straight(5), straight(9), 0.0),  # up to the shorter one's end
        (straight(9), straight(5), 0.0),
        (straight(9), straight(5, step_s=0.051), 0.0),
        *((straight(6), straight(6, step_s=step_s), 0.0) for step_s in (0.051, 0.02, 0.3)),
        (straight(10), DELAYED, 0.12),
        (straight(10), LATE, float("nan")),
    ],
)
def test_rmse_is_at_equal_times(reference: Trajectory, flight: Trajectory, rmse_m: float) -> None:
    assert position_rmse(reference, flight) == pytest.approx(rmse_m, abs=1e-12, nan_ok=True)


def test_distinct_keeps_order_and_counts_bytes_not_values() -> None:
    flights = [straight(1), straight(2), straight(1), straight(2)]
    unique, index = distinct(flights)
    assert [flight.time_s.size for flight in unique] == [21, 41]
    assert index.tolist() == [0, 1, 0, 1]
    assert len(distinct([straight(10), DELAYED])[0]) == 2, "the same places at other times"


def test_gaps_and_quartiles() -> None:
    assert command_gaps_s([0.0, 1.2, 2.3], [1.0, 2.2, 3.3]) == pytest.approx([0.2, 0.1])
    assert quartiles([1.0, 2.0, 3.0, 4.0, 5.0]) == (2.0, 3.0, 4.0)


@given(st.lists(st.floats(0.1, 10.0), min_size=2, max_size=20), st.integers(0, 2**32))
def test_speedup_interval_holds_the_estimate_of_constant_baselines(wall_s: list[float], seed: int) -> None:
    low, high = speedup_interval([10.0, 10.0], wall_s, seed)
    assert 10.0 / max(wall_s) <= low + 1e-9
    assert low <= high <= 10.0 / min(wall_s) + 1e-9


def test_bootstrap_repeats_by_seed_and_covers_the_mean() -> None:
    """That of identical games has no width."""
    assert median_interval([2.0, 2.0, 2.0], seed=0) == (2.0, 2.0)
    values = np.random.default_rng(7).normal(3.0, 1.0, 200)
    first = bootstrap_interval((values,), lambda v: v.mean(axis=-1), seed=1)
    assert first == bootstrap_interval((values,), lambda v: v.mean(axis=-1), seed=1)
    half = 1.96 * values.std() / np.sqrt(200)
    assert first == pytest.approx((values.mean() - half, values.mean() + half), abs=0.02)


NORMAL = np.random.default_rng(7).normal(size=400)
NORMAL = (NORMAL - NORMAL.mean()) / NORMAL.std()


@pytest.mark.parametrize(
    ("sampled", "apart"),
    [
        (lambda seed: median_interval(NORMAL, seed), 0.05),
        (lambda seed: hierarchical_interval([NORMAL[:20], NORMAL[20:50]], seed), 0.2),
        (lambda seed: speedup_interval(NORMAL + 9.0, NORMAL[:50] + 9.0, seed), 0.05),
        (lambda seed: (permutation_p(NORMAL[:9], NORMAL[9:22], seed), sign_flip_p(NORMAL[:20], seed)), 0.05),
    ],
)
def test_what_is_sampled_follows_from_its_seed(
    sampled: Callable[[int], Any], apart: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaccel.metrics.intervals.MOST_EXACT", 5000)
    assert sampled(1) == sampled(1) != sampled(2)
    assert sampled(1) == pytest.approx(sampled(2), abs=apart)


def test_intervals_of_many_games_are_those_of_normal_distributions() -> None:
    """Seeds of few games and of many vary as their own numbers of games say; a ratio as both of its parts."""
    few, many = NORMAL[:10] - NORMAL[:10].mean(), NORMAL
    low, high = hierarchical_interval([few, many] * 12, seed=0)
    variance = (few.var() / 10 + many.var() / 400) / 2 / 24
    assert (low, high) == pytest.approx((-1.96 * np.sqrt(variance), 1.96 * np.sqrt(variance)), rel=0.1)
    low, high = speedup_interval(NORMAL + 20.0, 0.5 * NORMAL[:100] + 5.0, seed=0)
    cell = 0.5 * NORMAL[:100] + 5.0
    ratio, share = 20.0 / cell.mean(), np.sqrt(1 / 20**2 / 400 + cell.var() / cell.mean() ** 2 / 100)
    assert (low, high) == pytest.approx((ratio * (1 - 1.96 * share), ratio * (1 + 1.96 * share)), rel=0.005)


def test_a_proportion_in_a_summary_and_in_words() -> None:
    won = Proportion.of({"games": 100, "successes": 23, "other": 1})
    low, high = won.interval
    counted = {"games": 100, "successes": 23, "success_ratio": 0.23}
    assert won.as_summary() == {**counted, "wilson_low": low, "wilson_high": high}
    assert (won.text(), won.text(0, 1)) == ("23.0% [16, 32]", "23% [15.8, 32.2]")


# --- what SciPy computes, which the package does without --------------------------------------------------------------

OUTCOMES = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=80)


@given(OUTCOMES, st.integers(1, 400))
def test_intervals_and_exact_tests_are_scipys(outcomes: list[tuple[bool, bool]], degrees: int) -> None:
    first, second = np.array(outcomes).T
    (a, b), games = (int(first.sum()), int(second.sum())), len(outcomes)
    wilson = stats.binomtest(a, games).proportion_ci(method="wilson")
    assert Proportion(a, games).interval == pytest.approx((wilson.low, wilson.high), abs=1e-12)
    assert 0.0 <= Proportion(a, games).interval[0] <= a / games <= Proportion(a, games).interval[1] <= 1.0
    found = mcnemar_exact(first, second)
    assert (found.only_first, found.only_second) == (int((first > second).sum()), int((second > first).sum()))
    decided = found.only_first + found.only_second
    assert found.p_value == pytest.approx(stats.binomtest(found.only_first, decided).pvalue if decided else 1.0)
    fisher = stats.fisher_exact(np.array([[a, games - a], [b, games + 5 - b]])).pvalue
    assert fisher_exact_p((a, games), (b, games + 5)) == pytest.approx(fisher)
    assert student_quantile(degrees) == pytest.approx(stats.t.ppf(0.975, degrees), rel=1e-10)


@given(st.integers(0, 2**32 - 1), st.integers(1, 200), st.integers(1, 200))
def test_stlc_in_space_is_that_of_scipys_nearest_neighbours(seed: int, count: int, others: int) -> None:
    """Of ways that wander, one after a leap, which the search passes over in steps as long as it knows to be safe."""
    random = np.random.default_rng(seed)
    one, two = (np.cumsum(random.normal(size=(length, 3)), axis=0) for length in (count, others))
    one[0] += 30.0
    nearest = (np.exp(-KDTree(there).query(here)[0]).mean() for here, there in ((one, two), (two, one)))
    found = stlc(np.arange(count), one, np.arange(others), two, lam=1.0)
    assert found == pytest.approx(sum(nearest), abs=1e-12)


# --- STLC -------------------------------------------------------------------------------------------------------------


LAMBDAS = st.floats(0.0, 1.0)


@st.composite
def flights(draw: st.DrawFn) -> Trajectory:
    n = draw(st.integers(1, 12))
    times = np.sort(draw(arrays(np.float64, n, elements=st.floats(0.0, 30.0))))
    points = draw(arrays(np.float64, (n, 3), elements=st.floats(-20.0, 20.0)))
    return trajectory(times, points)


def square_laps(laps: float, speed_m_s: float = 1.0, side_m: float = 1.0) -> Trajectory:
    """A square flown exactly, sampled every 50 ms."""
    time_s = np.arange(0, laps * 4 * side_m / speed_m_s + 1e-9, 0.05)
    corners = side_m * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]], dtype=float)
    phase = (time_s * speed_m_s / side_m) % 4
    position_m = np.column_stack([np.interp(phase, range(5), corners[:, axis]) for axis in range(3)])
    return Trajectory(time_s, position_m)


def brute_force(r: Trajectory, s: Trajectory, lam: float) -> float:
    distance = np.linalg.norm(r.position_m[:, None] - s.position_m[None], axis=-1)
    gap = np.abs(r.time_s[:, None] - s.time_s[None])
    space = np.exp(-distance.min(1)).mean() + np.exp(-distance.min(0)).mean()
    time = np.exp(-gap.min(1)).mean() + np.exp(-gap.min(0)).mean()
    return float(lam * space + (1 - lam) * time)


@given(flights(), LAMBDAS)
def test_identical_flights_score_exactly_two_for_every_lambda(flight: Trajectory, lam: float) -> None:
    assert stlc(*flight, *flight, lam) == 2.0


@settings(max_examples=200)
@given(flights(), flights(), LAMBDAS)
def test_equals_its_definition(r: Trajectory, s: Trajectory, lam: float) -> None:
    assert stlc(*r, *s, lam) == pytest.approx(brute_force(r, s, lam), abs=1e-12)
    assert 0.0 <= stlc(*r, *s, lam) == stlc(*s, *r, lam) <= 2.0


@pytest.mark.parametrize(("offset_m", "expected"), [(0.1, 1.905), (0.223, 1.800), (1.0, 1.368)])
def test_constant_offset_on_a_shared_grid(offset_m: float, expected: float) -> None:
    flight = square_laps(1)
    above = flight.position_m - np.array([0, 0, offset_m])
    score = stlc(*flight, flight.time_s, above)
    assert score == pytest.approx(1 + np.exp(-offset_m), abs=1e-12)
    assert score == pytest.approx(expected, abs=5e-4)


def test_a_missed_lap_is_invisible_to_stlc_and_plain_to_rmse() -> None:
    """The drone hovers at the start for the first of eight laps, and for half a lap of another flight."""
    reference = square_laps(8)
    for missed_samples in (40, 80):
        hover = np.repeat(reference.position_m[:1], missed_samples, axis=0)
        position_m = np.concatenate([hover, reference.position_m[:-missed_samples]])
        assert stlc(*reference, reference.time_s, position_m) == pytest.approx(2.0, abs=1e-9)
        assert position_rmse(reference, Trajectory(reference.time_s, position_m)) > 0.25


def test_means_over_references_leave_out_the_game_itself() -> None:
    """Of replicas they are exactly 2; a lone reference has nothing to compare with."""
    aside = [straight(4, offset_m=y) for y in (0.0, 0.2, 0.2)]
    assert mean_position_rmse([straight(4)], aside) == pytest.approx([0.4 / 3])
    assert mean_position_rmse(aside, aside, exclude_self=True) == pytest.approx([0.2, 0.1, 0.1])
    base, replicas = square_laps(1), [square_laps(2) for _ in range(5)]
    above = [Trajectory(base.time_s, base.position_m + dz) for dz in (0.0, 0.1, 0.3)]
    matrix = stlc_matrix(above, above)
    assert mean_stlc(above[:1], above) == pytest.approx([matrix[0].mean()])
    without = mean_stlc(above, above, exclude_self=True)
    assert without == pytest.approx([(matrix[i].sum() - 2.0) / 2 for i in range(3)])
    assert np.array_equal(mean_stlc(replicas, replicas, exclude_self=True), np.full(5, 2.0))
    assert np.isnan(mean_stlc([base], [base], exclude_self=True)).all()
    for references, said in (([straight(1), straight(2)], "exclude_self"), ([], "reference")):
        with pytest.raises(ValueError, match=said):
            mean_position_rmse([straight(1)], references, exclude_self=bool(references))


@pytest.mark.parametrize(
    ("times_s", "points_m", "lam", "said"),
    [
        ([1.0, 0.0], np.zeros((2, 3)), 0.5, "ascend"),
        ([0.0, np.nan], np.zeros((2, 3)), 0.5, "finite"),
        ([0.0], np.zeros((2, 3)), 0.5, "needs times"),
        ([], np.zeros((0, 3)), 0.5, "needs times"),
        ([0.0, 1.0], np.zeros((2, 3)), -0.1, "lam"),
        ([0.0, 1.0], np.zeros((2, 3)), 1.1, "lam"),
    ],
)
def test_what_is_no_flight_has_no_score(times_s: list[float], points_m: NDArray[Any], lam: float, said: str) -> None:
    for one, other in permutations([(times_s, points_m), ([0.0, 1.0], np.zeros((2, 3)))]):
        with pytest.raises(ValueError, match=said):
            stlc(*one, *other, lam)


@given(st.lists(flights(), min_size=1, max_size=4), st.lists(flights(), min_size=1, max_size=4))
def test_the_matrix_is_bit_equal_to_single_pairs(games: list[Trajectory], references: list[Trajectory]) -> None:
    """Also with other times of as many samples."""
    references = [*references, Trajectory(games[0].time_s * 2 - games[0].time_s[0], games[0].position_m)]
    matrix = stlc_matrix(games, references)
    single = [[stlc(*game, *reference) for reference in references] for game in games]
    assert np.array_equal(matrix, np.array(single))


# --- success over trainings and lanes ---------------------------------------------------------------------------------


Won = NDArray[np.bool_]


def test_trainings_and_not_games_decide_where_there_are_several() -> None:
    ratios = [0.9, 0.5, 0.7]
    several = Success(tuple(Proportion(round(1000 * ratio), 1000) for ratio in ratios)).estimate
    width = stats.t.ppf(0.975, 2) * np.std(ratios, ddof=1) / np.sqrt(3)
    assert several.value == pytest.approx(0.7)
    assert several.interval == pytest.approx((0.7 - width, 1.0))
    pooled = Success((Proportion(2100, 3000),)).estimate
    assert pooled.interval == Proportion(2100, 3000).interval
    assert several.low < pooled.low < pooled.high < several.high


def test_trainings_that_all_fail_are_no_surer_than_their_games() -> None:
    assert Success((Proportion(0, 4),) * 3).estimate.interval == Proportion(0, 12).interval
    assert Success.on_lanes(np.ones((3, 4))).estimate.interval == Proportion(12, 12).interval
    alone = Success.on_lanes([np.arange(300) < 250])  # whose lanes are its games
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
    for _ in range(150):
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
    one, other = (Success.on_lanes([[first], [1.0]]) for first in (0.0, 1.0))  # a single lane is not told from games
    assert (one.estimate, one.difference(other)) == (
        Success(one.policies).estimate,
        one.difference(Success(other.policies)),
    )


def test_the_parts_of_a_variance_add_up() -> None:
    """Of policies that win all or nothing, of lanes that all win or none, and of games by turns."""
    policies, lanes = np.eye(2)[0][:, None].repeat(4, 1), np.tile([0.0, 1.0, 0.0, 1.0], (2, 1))
    assert covariance(policies, policies) == pytest.approx((0.25, 0.0, 0.0))
    assert covariance(lanes, lanes) == pytest.approx((0.0, 1 / 12, 0.0))
    assert covariance(policies, lanes) == pytest.approx((0.0, 0.0, 0.0))


# --- a training as one sample ----------------------------------------------------------------------------------------

permutation_test: Any = stats.permutation_test  # its stubs know no plain lists
games = st.lists(st.sampled_from([0.0, 1.0]), min_size=1, max_size=12)
trainings = st.lists(games, min_size=1, max_size=6)
ratios = st.lists(st.integers(0, 8).map(lambda won: won / 8), min_size=2, max_size=5)


@given(trainings, st.integers(0, 3))
def test_an_interval_lies_within_the_seeds_games_and_repeats(samples: list[list[float]], seed: int) -> None:
    assume(sum(map(len, samples)) > 1)
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


def test_another_seed_draws_other_ways_where_not_all_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(0).random(11)
    for p in (lambda seed: permutation_p(values[:5], values[5:], seed), lambda seed: sign_flip_p(values - 0.4, seed)):
        with monkeypatch.context() as patch:
            assert len({p(seed) for seed in range(5)}) == 1
            patch.setattr("uavaccel.metrics.intervals.MOST_EXACT", 100)
            assert len({p(seed) for seed in range(5, 10)}) > 1


def test_what_was_seen_is_one_of_the_ways_that_are_drawn() -> None:
    """200 000 draws meet nothing as rare: p is never 0."""
    assert permutation_p(np.arange(20), 100 + np.arange(20)) == 1 / 200_001
    assert sign_flip_p(np.ones(40)) == 1 / 200_001


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


def test_of_a_lone_value_no_interval_is_known_and_none_is_refused() -> None:
    alone = [mean_estimate([3.0]).interval, median_interval([3.0], 0), hierarchical_interval([[3.0]], 0)]
    np.testing.assert_array_equal([*alone, speedup_interval([3.0, 4.0], [1.0], 0)], np.nan)
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


def test_an_end_whose_equation_has_no_root_between_is_the_unpaired_one() -> None:
    """Where twice the second's value is within its interval, or pairing takes more than the whole product."""
    for p, q, correlation, same, other in (
        ((0.5, 0.3, 0.7), (0.1, 0.02, 0.3), 0.5, "low", "high"),
        ((0.1, 0.01, 0.9), (0.1, 0.001, 0.15), 1.0, "high", "low"),
    ):
        plain, paired = (ratio_estimate(Estimate(*p), Estimate(*q), each) for each in (0.0, correlation))
        assert getattr(plain, same) == getattr(paired, same)
        assert getattr(plain, other) != getattr(paired, other)


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
