"""Frames and units against SciPy's rotations, and decimals that stay what was written."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uavaccel import units
from uavaccel.errors import UserError

finite = st.floats(-1e6, 1e6)
vectors = arrays(np.float64, (4, 3), elements=finite)
quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 1e-3)

Array = NDArray[np.float64]


def rotation(wxyz: Array) -> Rotation:
    return Rotation.from_quat(wxyz, scalar_first=True)


def unit(quaternion: Array) -> Array:
    return quaternion / np.linalg.norm(quaternion)


def test_north_east_down_is_forward_left_up() -> None:
    assert units.ned_to_mujoco([1.0, 2.0, 3.0]).tolist() == [1.0, -2.0, -3.0]
    assert units.quaternion_ned_to_mujoco([1.0, 2.0, 3.0, 4.0]).tolist() == [1.0, 2.0, -3.0, -4.0]


@given(vectors)
def test_the_frames_turn_into_each_other(vector: Array) -> None:
    assert np.array_equal(units.mujoco_to_ned(units.ned_to_mujoco(vector)), vector)


@given(quaternions, vectors)
def test_attitudes_and_vectors_turn_alike(quaternion: Array, body: Array) -> None:
    """Body to world and then to MuJoCo's axes, or the other way round: the same."""
    attitude = rotation(quaternion)
    in_mujoco = rotation(units.quaternion_ned_to_mujoco(quaternion))
    expected = units.ned_to_mujoco(attitude.apply(body))
    np.testing.assert_allclose(in_mujoco.apply(units.ned_to_mujoco(body)), expected, atol=1e-6)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_angles_are_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> None:
    wxyz = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat(scalar_first=True)
    np.testing.assert_allclose(units.euler_from_quaternion(wxyz), (roll, pitch, yaw), atol=1e-7)


def test_a_nose_up_by_a_quarter_turn_has_a_pitch() -> None:
    wxyz = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]) * (1 + 1e-15)
    assert units.euler_from_quaternion(wxyz)[1] == pytest.approx(np.pi / 2)


@given(quaternions, quaternions)
def test_attitude_difference_is_the_angle_between(a: Array, b: Array) -> None:
    expected = (rotation(a).inv() * rotation(b)).magnitude()
    assert units.attitude_difference_rad(unit(a), unit(b)) == pytest.approx(expected, abs=1e-6)


@given(quaternions)
def test_equal_attitudes_differ_by_nothing(quaternion: Array) -> None:
    """Nor does the float32 that an attitude may have passed through count for more than it is."""
    attitude = unit(quaternion)
    assert units.attitude_difference_rad(attitude, attitude) == 0.0
    assert units.attitude_difference_rad(attitude, -attitude) == 0.0
    assert units.attitude_difference_rad(attitude, attitude.astype(np.float32)) < 1e-6


def test_attitude_differences_of_many() -> None:
    level, turned = [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]
    difference = units.attitude_difference_rad([level, level], [level, turned])
    assert difference.tolist() == pytest.approx([0.0, np.pi])


def test_decimals_are_exact() -> None:
    assert units.exact(0.1) == Fraction(1, 10)
    assert units.exact("1.5") == Fraction(3, 2)
    assert units.exact(np.float64(0.33)) == Fraction(33, 100)
    assert units.exact(1e-5) == Fraction(1, 100_000)
    assert units.exact(Fraction(1, 3)) == Fraction(1, 3)


@given(st.integers(1, 10**7), st.sampled_from([2_000_000, 3_000_000]))
def test_whole_ticks_are_counted_exactly(ticks: int, tick_ns: int) -> None:
    assert units.ticks_exactly(ticks * tick_ns / units.NS_PER_S, tick_ns, "t_move_s") == ticks


@pytest.mark.parametrize(("seconds", "ticks"), [(0.1, 50), (0.2, 100), (0.33, 165), (0.5, 250), (1.0, 500)])
def test_the_native_step_divides_the_papers_times(seconds: float, ticks: int) -> None:
    assert units.ticks_exactly(seconds, 2_000_000, "t_move_s") == ticks


@pytest.mark.parametrize(
    ("seconds", "near"),
    [(0.333, "0.332 and 0.334"), (0.001, "0.002 and 0.004"), (0.0, "0.002 and 0.004"), (-0.1, "0.002")],
)
def test_a_time_that_does_not_fit_is_refused(seconds: float, near: str) -> None:
    with pytest.raises(UserError, match=rf"^t_move_s: {seconds:g} s is not .* 2 ms; {near}") as refusal:
        units.ticks_exactly(seconds, 2_000_000, "t_move_s")
    assert "\n" not in str(refusal.value)


@given(st.integers(-(10**18), 10**18), st.integers(1, 10**12))
def test_division_rounds_up(numerator: int, denominator: int) -> None:
    quotient = units.ceil_div(numerator, denominator)
    assert quotient * denominator >= numerator > (quotient - 1) * denominator


def test_seconds_and_plain_numbers() -> None:
    assert units.seconds_to_ns(0.33) == 330_000_000
    assert units.seconds_to_ns(1.008) == 1_008_000_000
    assert units.plain(np.float32(0.5)) == 0.5
    assert units.plain(np.arange(3)) == [0, 1, 2]
    assert units.plain("text") == "text"
