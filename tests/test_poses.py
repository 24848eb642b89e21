"""Poses upon poses, and what of arrays and places goes over the wire and back."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uavaccel.sim.poses import Pose, from_degrees
from uavaccel.sim.sensors.earth import GeoPoint, geographic, local
from uavaccel.units import euler_from_quaternion
from uavaccel.wire import rpc

metres = st.floats(-1e4, 1e4)
degrees = st.floats(-179.0, 179.0)
poses = st.builds(
    lambda x, y, z, roll, pitch, yaw: Pose((x, y, z), from_degrees(roll, pitch, yaw)),
    *[metres] * 3, degrees, st.floats(-89.0, 89.0), degrees,
)  # fmt: skip


@given(poses, poses, poses)
def test_poses_are_put_upon_each_other_in_any_grouping_and_taken_off_again(a: Pose, b: Pose, c: Pose) -> None:
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
    assert local(geographic(place, home), home) == pytest.approx(place, abs=1e-4)


@given(arrays(np.float32, st.integers(0, 300), elements=st.floats(width=32)), st.text(), st.binary())
def test_arrays_are_packed_as_lists_among_anything_else(numbers: np.ndarray, text: str, data: bytes) -> None:
    value = [{"name": text, "pixels": numbers, "more": [data, None, numbers]}, 3, True]
    plain = [{"name": text, "pixels": numbers.tolist(), "more": [data, None, numbers.tolist()]}, 3, True]
    told = msgpack.unpackb(rpc.pack(value))
    assert repr(told) == repr(plain)  # not a number is no number's equal
