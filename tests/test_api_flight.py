"""Calls of flight and state against the physics they speak of: values, units, goals, what ends what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest

from tests.simulating import simulate
from uavaccel.kinematics import Kinematics
from uavaccel.sim.profile import NATIVE, Profile
from uavaccel.sim.sensors.earth import geographic
from uavaccel.wire import arguments
from uavaccel.wire.api import Api
from uavaccel.wire.flight_api import facing
from uavaccel.wire.game_api import decode_state, encode_state
from uavaccel.wire.settings import Settings

MS = 1_000_000
MAX_DOF, FORWARD_ONLY = 0, 1
STATE = Kinematics(
    time_ns=123,
    position_m=(1.0, 2.0, 3.0),
    orientation_wxyz=(4.0, 5.0, 6.0, 7.0),
    linear_velocity_m_s=(8.0, 9.0, 10.0),
    angular_velocity_rad_s=(11.0, 12.0, 13.0),
    linear_acceleration_m_s2=(14.0, 15.0, 16.0),
    angular_acceleration_rad_s2=(17.0, 18.0, 19.0),
)


def new_api(clock_speed: float = 1.0, profile: Profile = NATIVE) -> Api:
    """With API control, running, at wall time 0."""
    return Api(simulate(clock_speed, profile), render=False)


def result_of(api: Api, method: str, params: Sequence[Any] = (), wall_ns: int = 0) -> Any:
    api.simulation.advance_to(wall_ns)
    return api.call(method, params, wall_ns)


def flown() -> Api:
    """In the middle of a turn, so that no number of the state is 0, 1 or another's."""
    api = new_api()
    result_of(api, "moveByVelocity", [1.0, -2.0, 0.5, 2.0, MAX_DOF, {"is_rate": True, "yaw_or_rate": 40.0}])
    api.simulation.advance_to(700 * MS)
    return api


# --- states -------------------------------------------------------------------------------------------------


def test_a_state_survives_the_wire() -> None:
    assert encode_state(STATE) == [123, *(float(n) for n in range(1, 20))]
    assert decode_state(encode_state(STATE)) == STATE


def test_gps_is_a_sphere_around_airsims_origin() -> None:
    """A degree of latitude is a 360th of the circumference; of longitude, the cosine of the latitude times that."""
    degree_m = 2 * math.pi * 6_378_137.0 / 360
    north = geographic((degree_m / 100, 0.0, -7.0), Settings().home)
    assert north == pytest.approx((47.641468 + 0.01, -122.140165, 122.0 + 7.0), abs=1e-9)
    east = geographic((0.0, degree_m / 1000, 0.0), Settings().home)
    assert east.longitude == pytest.approx(-122.140165 + 0.001 / math.cos(math.radians(47.641468)), abs=1e-9)
    api = flown()
    told = result_of(api, "getMultirotorState", [], 700 * MS)["gps_location"]
    place = geographic(api.simulation.kinematics().position_m, Settings().home)
    assert tuple(told[key] for key in ("latitude", "longitude", "altitude")) == place


# --- goals --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("velocity", "drivetrain", "mode", "yaw", "is_rate"), [
    ((1.0, 1.0, 0.0), MAX_DOF, {"is_rate": True, "yaw_or_rate": 90.0}, math.pi / 2, True),
    ((1.0, 1.0, 0.0), MAX_DOF, {"is_rate": False, "yaw_or_rate": 90.0}, math.pi / 2, False),
    ((1.0, 1.0, 0.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 0.0}, math.pi / 4, False),
    ((1.0, -1.0, 0.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 10.0}, math.radians(-35.0), False),
    ((-1.0, 0.0, 0.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 90.0}, -math.pi / 2, False),
    ((1.0, 1.0, 0.0), FORWARD_ONLY, {"is_rate": True, "yaw_or_rate": 90.0}, math.pi / 2, True),
    ((0.3, 0.4, 9.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 90.0}, 0.0, True),  # .5 m/s: no direction
    ((0.3, 0.41, 0.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 0.0}, math.atan2(0.41, 0.3), False),
    ((1.0, 0.0, 0.0), MAX_DOF, {}, 0.0, True),
])  # fmt: skip
def test_yaw_follows_the_direction_of_travel_if_asked_to(
    velocity: tuple[float, float, float], drivetrain: int, mode: Any, yaw: float, is_rate: bool
) -> None:
    found = facing(*velocity[:2], drivetrain, arguments.yaw_mode(mode, "yaw_mode"))
    assert found[0] == pytest.approx(yaw)
    assert found[1] is is_rate


# --- arguments ----------------------------------------------------------------------------------------------


def test_a_pose_is_taken_apart_and_its_attitude_made_a_unit() -> None:
    place = {"x_val": 1, "y_val": 2.0, "z_val": -3.0}
    turned = {"w_val": 0.0, "x_val": 0.0, "y_val": 3.0, "z_val": 4.0}
    assert arguments.pose({"position": place, "orientation": turned}, "pose") == (
        (1.0, 2.0, -3.0),
        (0.0, 0.0, 0.6, 0.8),
    )


def test_flags_may_be_numbers_and_yaw_is_in_degrees() -> None:
    assert [arguments.flag(value, "it") for value in (True, False, 1, 0)] == [True, False, True, False]
    assert arguments.yaw_mode({"is_rate": False, "yaw_or_rate": 180}, "it") == (math.pi, False)
    assert arguments.yaw_mode({}, "it") == (0.0, True)
