"""Position errors, speed-ups and intervals against values known by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial import KDTree

from uavaccel.metrics.intervals import (
    Proportion,
    bootstrap_interval,
    fisher_exact_p,
    mcnemar_exact,
    median_interval,
    student_quantile,
)
from uavaccel.metrics.speedup import combined_provenance, speedup_interval, timing_provenance
from uavaccel.metrics.stlc import stlc
from uavaccel.metrics.trajectory import (
    Trajectory,
    command_gaps_s,
    distinct,
    mean_position_rmse,
    position_rmse,
    quartiles,
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
        *((straight(6), straight(6, step_s=step_s), 0.0) for step_s in (0.051, 0.02, 0.3)),
        (straight(10), DELAYED, 0.12),
        (straight(10), LATE, float("nan")),
    ],
)
def test_rmse_is_at_equal_times(reference: Trajectory, flight: Trajectory, rmse_m: float) -> None:
    assert position_rmse(reference, flight) == pytest.approx(rmse_m, abs=1e-12, nan_ok=True)


def test_mean_rmse_over_references() -> None:
    references = [straight(4, offset_m=y) for y in (0.0, 0.2, 0.2)]
    assert mean_position_rmse([straight(4)], references) == pytest.approx([0.4 / 3])
    assert mean_position_rmse(references, references, exclude_self=True) == pytest.approx([0.2, 0.1, 0.1])


def test_a_mean_needs_references_which_are_the_games_where_these_are_excluded() -> None:
    with pytest.raises(ValueError, match="exclude_self"):
        mean_position_rmse([straight(1)], [straight(1), straight(2)], exclude_self=True)
    with pytest.raises(ValueError, match="reference"):
        mean_position_rmse([straight(1)], [])


def test_distinct_keeps_order_and_counts_bytes_not_values() -> None:
    flights = [straight(1), straight(2), straight(1), straight(2)]
    unique, index = distinct(flights)
    assert [flight.time_s.size for flight in unique] == [21, 41]
    assert index.tolist() == [0, 1, 0, 1]


def test_gaps_and_quartiles() -> None:
    assert command_gaps_s([0.0, 1.2, 2.3], [1.0, 2.2, 3.3]) == pytest.approx([0.2, 0.1])
    assert quartiles([1.0, 2.0, 3.0, 4.0, 5.0]) == (2.0, 3.0, 4.0)


@given(st.lists(st.floats(0.1, 10.0), min_size=2, max_size=20), st.integers(0, 2**32))
def test_speedup_interval_holds_the_estimate_of_constant_baselines(wall_s: list[float], seed: int) -> None:
    low, high = speedup_interval([10.0, 10.0], wall_s, seed)
    assert 10.0 / max(wall_s) <= low + 1e-9
    assert low <= high <= 10.0 / min(wall_s) + 1e-9


def test_provenance() -> None:
    assert timing_provenance("wall") == "measured"
    assert timing_provenance("virtual") == timing_provenance("lockstep") == "modelled"
    assert combined_provenance("measured", "measured") == "measured"
    assert combined_provenance("measured", "modelled") == "mixed"


def test_bootstrap_repeats_by_seed_and_covers_the_mean() -> None:
    values = np.random.default_rng(7).normal(3.0, 1.0, 200)
    first = bootstrap_interval((values,), lambda v: v.mean(axis=-1), seed=1)
    assert first == bootstrap_interval((values,), lambda v: v.mean(axis=-1), seed=1)
    half = 1.96 * values.std() / np.sqrt(200)
    assert first == pytest.approx((values.mean() - half, values.mean() + half), abs=0.02)


def test_identical_games_have_an_interval_of_zero_width() -> None:
    assert median_interval([2.0, 2.0, 2.0], seed=0) == (2.0, 2.0)


@pytest.mark.parametrize(
    ("successes", "low", "high"), [(23, 15.8, 32.2), (21, 14.2, 30.0), (30, 21.9, 39.6), (1, 0.2, 5.4), (0, 0.0, 3.7)]
)
def test_wilson_of_the_papers_table(successes: int, low: float, high: float) -> None:
    assert np.multiply(Proportion(successes, 100).interval, 100) == pytest.approx([low, high], abs=0.06)


@given(st.integers(1, 500), st.data())
def test_wilson_holds_the_ratio(games: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, games))
    won = Proportion(successes, games)
    low, high = won.interval
    assert won.ratio == successes / games
    assert 0.0 <= low <= won.ratio <= high <= 1.0


def test_a_proportion_in_a_summary_and_in_words() -> None:
    won = Proportion.of({"games": 100, "successes": 23, "other": 1})
    low, high = won.interval
    counted = {"games": 100, "successes": 23, "success_ratio": 0.23}
    assert won.as_summary() == {**counted, "wilson_low": low, "wilson_high": high}
    assert (won.text(), won.text(0, 1)) == ("23.0% [16, 32]", "23% [15.8, 32.2]")


def test_mcnemar_counts_discordant_games_only() -> None:
    first = [True] * 10 + [True] * 6 + [False] * 4
    second = [True] * 10 + [False] * 6 + [False] * 4
    result = mcnemar_exact(first, second)
    assert (result.only_first, result.only_second) == (6, 0)
    assert result.p_value == pytest.approx(2 * 0.5**6)
    assert mcnemar_exact(first, first).p_value == 1.0


# --- what SciPy computes, which the package does without --------------------------------------------------------------

OUTCOMES = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=80)


@given(OUTCOMES, st.integers(1, 400))
def test_intervals_and_exact_tests_are_scipys(outcomes: list[tuple[bool, bool]], degrees: int) -> None:
    first, second = np.array(outcomes).T
    (a, b), games = (int(first.sum()), int(second.sum())), len(outcomes)
    wilson = stats.binomtest(a, games).proportion_ci(method="wilson")
    assert Proportion(a, games).interval == pytest.approx((wilson.low, wilson.high), abs=1e-12)
    found = mcnemar_exact(first, second)
    assert (found.only_first, found.only_second) == (int((first > second).sum()), int((second > first).sum()))
    decided = found.only_first + found.only_second
    assert found.p_value == pytest.approx(stats.binomtest(found.only_first, decided).pvalue if decided else 1.0)
    fisher = stats.fisher_exact(np.array([[a, games - a], [b, games + 5 - b]])).pvalue
    assert fisher_exact_p((a, games), (b, games + 5)) == pytest.approx(fisher)
    assert student_quantile(degrees) == pytest.approx(stats.t.ppf(0.975, degrees), rel=1e-10)


@given(st.integers(0, 2**32 - 1), st.integers(1, 200), st.integers(1, 200))
def test_stlc_in_space_is_that_of_scipys_nearest_neighbours(seed: int, count: int, others: int) -> None:
    """Of ways that wander, which the search passes over in steps as long as it knows to be safe."""
    random = np.random.default_rng(seed)
    one, two = (np.cumsum(random.normal(size=(length, 3)), axis=0) for length in (count, others))
    nearest = (np.exp(-KDTree(there).query(here)[0]).mean() for here, there in ((one, two), (two, one)))
    found = stlc(np.arange(count), one, np.arange(others), two, lam=1.0)
    assert found == pytest.approx(sum(nearest), abs=1e-12)
