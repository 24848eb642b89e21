"""Frames, units and poses against SciPy's rotations; decimals that stay as written; arrays and places on the wire."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uavaccel import units
from uavaccel.errors import UserError
from uavaccel.sim.earth import GeoPoint, geodetic, local
from uavaccel.sim.poses import Pose, from_degrees
from uavaccel.units import euler_from_quaternion
from uavaccel.wire import rpc

finite = st.floats(-1e6, 1e6)
vectors = arrays(np.float64, (4, 3), elements=finite)
quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 1e-3)

Array = NDArray[np.float64]


def rotation(wxyz: Array) -> Rotation:
    return Rotation.from_quat(wxyz, scalar_first=True)


def unit(quaternion: Array) -> Array:
    return quaternion / np.linalg.norm(quaternion)


@given(quaternions, vectors)
def test_north_east_down_becomes_forward_left_up(quaternion: Array, body: Array) -> None:
    """Body to world and then to MuJoCo's axes, or the other way round: the same."""
    assert units.ned_to_mujoco([1.0, 2.0, 3.0]).tolist() == [1.0, -2.0, -3.0]
    assert np.array_equal(units.mujoco_to_ned(units.ned_to_mujoco(body)), body)
    attitude = rotation(quaternion)
    in_mujoco = rotation(units.quaternion_ned_to_mujoco(quaternion))
    expected = units.ned_to_mujoco(attitude.apply(body))
    np.testing.assert_allclose(in_mujoco.apply(units.ned_to_mujoco(body)), expected, atol=1e-6)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_angles_are_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> None:
    wxyz = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat(scalar_first=True)
    np.testing.assert_allclose(units.euler_from_quaternion(wxyz), (roll, pitch, yaw), atol=1e-7)
    nose_up = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]) * (1 + 1e-15)
    assert units.euler_from_quaternion(nose_up)[1] == pytest.approx(np.pi / 2)


@given(quaternions, quaternions)
def test_an_attitude_difference_is_the_angle_between(a: Array, b: Array) -> None:
    """Nor does the float32 that an attitude may have passed through count for more than it is."""
    expected = (rotation(a).inv() * rotation(b)).magnitude()
    first, second = unit(a), unit(b)
    assert units.attitude_difference_rad([first, first], [second, -first]).tolist() == [
        pytest.approx(expected, abs=1e-6),
        0.0,
    ]
    assert units.attitude_difference_rad(first, first) == 0.0
    assert units.attitude_difference_rad(first, first.astype(np.float32)) < 1e-6


@pytest.mark.parametrize(
    ("number", "exact"), [(0.1, "1/10"), ("1.5", "3/2"), (np.float64(0.33), "33/100"), (1e-5, "1/100000")]
)
def test_decimals_are_exact(number: Any, exact: str) -> None:
    assert units.exact(number) == units.exact(Fraction(exact)) == Fraction(exact)


@given(st.integers(1, 10**7), st.sampled_from([2_000_000, 3_000_000]))
@example(165, 2_000_000)  # 0.33 s, one of the paper's
def test_whole_ticks_are_counted_exactly(ticks: int, tick_ns: int) -> None:
    assert units.ticks_exactly(ticks * tick_ns / units.NS_PER_S, tick_ns, "t_move_s") == ticks


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
    for tenths_ms in range(20_000):  # those of 0.0157 s and 1.001 s end below a whole nanosecond
        assert units.seconds_to_ns(tenths_ms / 10_000) == tenths_ms * 100_000
    assert units.plain(np.float32(0.5)) == 0.5
    assert units.plain(np.arange(3)) == [0, 1, 2]
    assert units.plain("text") == "text"


# --- poses ------------------------------------------------------------------------------------------------------------


metres = st.floats(-3e5, 3e5)
degrees = st.floats(-179.0, 179.0)
poses = st.builds(
    lambda x, y, z, roll, pitch, yaw: Pose((x, y, z), from_degrees(roll, pitch, yaw)),
    *[metres] * 3, degrees, st.floats(-89.0, 89.0), degrees,
)  # fmt: skip


@given(poses, poses, poses)
def test_poses_are_composed_in_any_grouping_and_taken_off_again(a: Pose, b: Pose, c: Pose) -> None:
    left, right = a.of(b).of(c), a.of(b.of(c))
    np.testing.assert_allclose(left.position_m, right.position_m, atol=1e-7)
    np.testing.assert_allclose(left.matrix(), right.matrix(), atol=1e-9)
    back = a.inwards_pose(a.of(b))
    np.testing.assert_allclose(back.position_m, b.position_m, atol=1e-7)
    np.testing.assert_allclose(back.matrix(), b.matrix(), atol=1e-9)
    np.testing.assert_allclose(a.of(b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)


@given(degrees, st.floats(-89.0, 89.0), degrees)
def test_angles_are_turned_by_yaw_pitch_roll(roll: float, pitch: float, yaw: float) -> None:
    told = np.degrees(euler_from_quaternion(from_degrees(roll, pitch, yaw)))
    np.testing.assert_allclose(told, (roll, pitch, yaw), atol=1e-6)


@given(st.floats(-80.0, 80.0), st.floats(-179.0, 179.0), st.tuples(metres, metres, metres))
def test_places_around_any_home_come_back(latitude: float, longitude: float, place: tuple[float, float, float]) -> None:
    home = GeoPoint(latitude, longitude, 100.0)
    assert local(geodetic(place, home), home) == pytest.approx(place, abs=1e-4)


@given(arrays(np.float32, st.integers(0, 300), elements=st.floats(width=32)), st.text(), st.binary())
def test_arrays_are_packed_as_lists_among_anything_else(numbers: np.ndarray, text: str, data: bytes) -> None:
    value = [{"name": text, "pixels": numbers, "more": [data, None, numbers]}, 3, True]
    plain = [{"name": text, "pixels": numbers.tolist(), "more": [data, None, numbers.tolist()]}, 3, True]
    told = msgpack.unpackb(rpc.pack(value))
    assert repr(told) == repr(plain)  # not a number is no number's equal
