"""STLC against its definition, its closed forms and its known blindness."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uavaccel.metrics.stlc import mean_stlc, stlc, stlc_matrix
from uavaccel.metrics.trajectory import Trajectory, position_rmse, trajectory

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


@given(flights(), flights(), LAMBDAS)
def test_symmetry_is_exact(r: Trajectory, s: Trajectory, lam: float) -> None:
    assert stlc(*r, *s, lam) == stlc(*s, *r, lam)


@settings(max_examples=200)
@given(flights(), flights(), LAMBDAS)
def test_equals_its_definition(r: Trajectory, s: Trajectory, lam: float) -> None:
    assert stlc(*r, *s, lam) == pytest.approx(brute_force(r, s, lam), abs=1e-12)


@given(flights(), flights(), LAMBDAS)
def test_lies_between_zero_and_two(r: Trajectory, s: Trajectory, lam: float) -> None:
    assert 0.0 <= stlc(*r, *s, lam) <= 2.0


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


def test_mean_over_references_and_without_itself() -> None:
    base = square_laps(1)
    references = [Trajectory(base.time_s, base.position_m + dz) for dz in (0.0, 0.1, 0.3)]
    matrix = stlc_matrix(references, references)
    assert mean_stlc(references[:1], references) == pytest.approx([matrix[0].mean()])
    without = mean_stlc(references, references, exclude_self=True)
    assert without == pytest.approx([(matrix[i].sum() - 2.0) / 2 for i in range(3)])


def test_identical_replicas_score_exactly_two() -> None:
    games = [square_laps(2) for _ in range(5)]
    assert np.array_equal(mean_stlc(games, games, exclude_self=True), np.full(5, 2.0))


def test_a_lone_reference_has_nothing_to_compare_with() -> None:
    assert np.isnan(mean_stlc([square_laps(1)], [square_laps(1)], exclude_self=True)).all()


@given(st.lists(flights(), min_size=1, max_size=4), st.lists(flights(), min_size=1, max_size=4))
def test_the_matrix_is_bit_equal_to_single_pairs(games: list[Trajectory], references: list[Trajectory]) -> None:
    matrix = stlc_matrix(games, references)
    single = [[stlc(*game, *reference) for reference in references] for game in games]
    assert np.array_equal(matrix, np.array(single))
