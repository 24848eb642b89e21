"""Calls of flight and state against the physics they speak of: values, units, goals, what ends what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tests.simulating import answer, simulate
from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.sim.profile import AIRSIM, NATIVE, Profile
from uavaccel.sim.sensors.earth import geographic
from uavaccel.sim.vehicle.goal import Goal, of_velocity
from uavaccel.wire import arguments
from uavaccel.wire.api import Api
from uavaccel.wire.flight_api import facing
from uavaccel.wire.game_api import decode_state, encode_state
from uavaccel.wire.settings import Settings
from uavaccel.wire.types import EPOCH_NS

MS = 1_000_000
MAX_DOF, FORWARD_ONLY = 0, 1
STILL = {"is_rate": True, "yaw_or_rate": 0.0}
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


def test_states_are_those_of_the_physics() -> None:
    """Field by field against the simulation's own arrays; acceleration against a difference of velocities."""
    api = flown()
    before = api.simulation.kinematics()
    told = result_of(api, "getMultirotorState", ["SimpleFlight"], 702 * MS)
    state, world = told["kinematics_estimated"], api.simulation.world
    assert [state["position"][axis] for axis in ("x_val", "y_val", "z_val")] == list(world.lead.state["position"])
    now = api.simulation.kinematics()
    assert tuple(state["orientation"][axis] for axis in ("w_val", "x_val", "y_val", "z_val")) == now.orientation_wxyz
    for name, vector in (
        ("linear_velocity", now.linear_velocity_m_s),
        ("angular_velocity", now.angular_velocity_rad_s),
        ("linear_acceleration", now.linear_acceleration_m_s2),
        ("angular_acceleration", now.angular_acceleration_rad_s2),
    ):
        assert tuple(state[name][axis] for axis in ("x_val", "y_val", "z_val")) == vector, name
    assert told["timestamp"] - EPOCH_NS == now.time_ns == before.time_ns + NATIVE.tick_ns
    moved = np.subtract(now.position_m, before.position_m) / NATIVE.tick_s
    np.testing.assert_allclose(moved, now.linear_velocity_m_s, atol=0.01)
    assert told["kinematics_estimated"] == result_of(api, "simGetGroundTruthKinematics", [], 702 * MS)
    pose = result_of(api, "simGetVehiclePose", [], 702 * MS)
    assert pose == {"position": state["position"], "orientation": state["orientation"]}
    assert result_of(api, "uavaccelState", [], 702 * MS) == encode_state(now)


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


@pytest.mark.parametrize(("method", "third", "goal"), [
    ("moveByVelocity", 0.5, VelocityGoal((0.0, 2.0, 0.5), None, math.pi / 2, False)),
    ("moveByVelocityZ", -12.0, VelocityGoal((0.0, 2.0, 0.0), -12.0, math.pi / 2, False)),
])  # fmt: skip
def test_forward_only_reaches_the_goal_and_the_vehicle_turns(
    method: str, third: float, goal: VelocityGoal, monkeypatch: pytest.MonkeyPatch
) -> None:
    api, flown = new_api(), []
    fly = api.simulation.lead.fly

    def noting(goal: Goal, ticks: int, wall_ns: int) -> Any:
        flown.append((goal, ticks, wall_ns))
        return fly(goal, ticks, wall_ns)

    monkeypatch.setattr(api.simulation.lead, "fly", noting)
    mode = {"is_rate": False, "yaw_or_rate": 0.0}
    result_of(api, method, [0.0, 2.0, third, 4.0, FORWARD_ONLY, mode, ""], 2 * MS)
    assert flown == [(of_velocity(goal), 2000, 2 * MS)]
    api.simulation.advance_to(4000 * MS)
    state = api.simulation.kinematics()
    w, _, _, z = state.orientation_wxyz
    assert 2 * math.atan2(z, w) == pytest.approx(math.pi / 2, abs=0.1)
    assert state.linear_velocity_m_s[1] == pytest.approx(2.0, abs=0.5)
    if goal.height_m is not None:
        assert state.position_m[2] < -11.0


def test_what_lasts_for_ever_lasts_very_long() -> None:
    """AirSim's clients write 3e38."""
    api = new_api()
    result_of(api, "moveByVelocity", [0.0, 0.0, 0.0, 3e38, MAX_DOF, STILL])
    [(start, end)] = api.simulation.lead.log
    assert (end - start) * NATIVE.tick_s == 1e9


@pytest.mark.parametrize(("method", "answered"), [("moveByVelocity", True), ("moveByVelocityZ", False)])
def test_a_command_of_no_duration_ends_the_one_that_runs(method: str, answered: bool) -> None:
    api = new_api()
    running = result_of(api, "moveByVelocity", [1.0, 0.0, 0.0, 1.0, MAX_DOF, STILL])
    assert result_of(api, method, [1.0, 0.0, 0.0, 0.0, MAX_DOF, STILL], 10 * MS) is answered
    assert answer(running) is False
    assert list(api.simulation.lead.log) == [(0, 5)]


@pytest.mark.parametrize(("method", "params", "told", "controlled"), [
    ("hover", [], False, True),
    ("cancelLastTask", [], None, True),
    ("enableApiControl", [False], None, False),
    ("reset", [], None, False),
])  # fmt: skip
def test_what_ends_a_command(method: str, params: list[Any], told: Any, controlled: bool) -> None:
    api = new_api()
    running = result_of(api, "moveByVelocity", [1.0, 0.0, 0.0, 1.0, MAX_DOF, STILL])
    assert result_of(api, method, params, 10 * MS) is told
    assert answer(running) is False
    assert running.due_wall_ns == 10 * MS
    assert result_of(api, "isApiControlEnabled") is controlled


def test_control_is_given_and_taken() -> None:
    api = new_api()
    result_of(api, "enableApiControl", [False])
    assert result_of(api, "armDisarm", [True]) is False
    running = result_of(api, "moveByVelocity", [1.0, 0.0, 0.0, 1.0, MAX_DOF, STILL])
    result_of(api, "enableApiControl", [True], 10 * MS)
    assert running.due_wall_ns is None, "to give control ends nothing"
    assert result_of(api, "isApiControlEnabled", ["SimpleFlight"]) is True
    assert result_of(api, "armDisarm", [False]) is True
    assert not api.simulation.world.lead.state["armed"]
    assert result_of(api, "armDisarm", [True]) is True
    assert api.simulation.world.lead.state["armed"]


# --- the clock ----------------------------------------------------------------------------------------------


def test_pause_run_and_continue() -> None:
    api = new_api(10.0)
    result_of(api, "simPause", [True], 1 * MS)
    assert result_of(api, "simIsPaused") is True
    api.simulation.advance_to(3 * MS)
    assert api.simulation.world.tick == 5
    result_of(api, "simPause", [False], 3 * MS)
    assert result_of(api, "simIsPaused", [], 3 * MS) is False
    api.simulation.advance_to(4 * MS)
    assert api.simulation.world.tick == 10


@pytest.mark.parametrize(("method", "amount"), [("simContinueForTime", 0.002), ("uavaccelContinueFor", 20 * MS)])
def test_airsims_continue_for_is_wall_time_and_ours_simulated(method: str, amount: Any) -> None:
    api = new_api(10.0)
    result_of(api, "simPause", [True])
    reply = result_of(api, method, [amount], 1 * MS)
    api.simulation.advance_to(3 * MS - 1)
    assert not reply.due_wall_ns
    api.simulation.advance_to(3 * MS)
    assert reply.due_wall_ns == 3 * MS
    state = encode_state(api.simulation.kinematics())
    assert reply.encode(reply.value) == (None if method == "simContinueForTime" else state)
    assert api.simulation.world.tick == 10
    assert result_of(api, "simIsPaused", [], 9 * MS) is True


def test_a_game_begins_paused_controlled_and_recording() -> None:
    api = flown()
    running = api.simulation.lead.command
    assert running is not None
    told = result_of(api, "uavaccelStartGame", [2.5, -4.0], 800 * MS)
    simulation = api.simulation
    assert answer(running.reply) is False
    assert decode_state(told) == simulation.kinematics()
    assert simulation.kinematics().position_m == (0.0, 0.0, -4.0)
    assert (simulation.paused, simulation.lead.api_control, simulation.world.recording) == (True, True, True)
    assert (float(simulation.clock_speed), simulation.world.tick, len(simulation.lead.log)) == (2.5, 0, 0)
    assert decode_state(result_of(api, "uavaccelStartGame", [1.0], 800 * MS)).position_m == (0.0, 0.0, -10.0)


def test_speed_is_counted_since_the_reset() -> None:
    api = new_api(10.0)
    result_of(api, "uavaccelSetClockSpeed", [20.0], 1 * MS)
    told = result_of(api, "uavaccelSpeed", [], 3 * MS)
    assert told == {
        "clock_speed": 20.0,
        "real_time_factor": 50 / 3,
        "simulated_ns": 50 * MS,
        "wall_ns": 3 * MS,
        "lost_wall_ns": 0,
        "failure": None,
    }


def test_airsims_wall_timer_notes_when_it_was_due_and_when_it_ended() -> None:
    """Its lateness on a real clock is the difference: what `timer_us` is measured from."""
    api = new_api(10.0, AIRSIM)
    result_of(api, "uavaccelTrace", [True])
    result_of(api, "simPause", [True])
    result_of(api, "simContinueForTime", [0.03], 1 * MS)
    api.simulation.advance_to(31 * MS + 54_321)
    events = [
        event[:2] for event in result_of(api, "uavaccelTrace", [False], 40 * MS) if event[0] in ("timer", "pause")
    ]
    assert events == [["pause", 0], ["timer", 31 * MS], ["pause", 31 * MS + 54_321]]


# --- arguments ----------------------------------------------------------------------------------------------


def test_a_pose_is_taken_apart_and_its_attitude_made_a_unit() -> None:
    place = {"x_val": 1, "y_val": 2.0, "z_val": -3.0}
    turned = {"w_val": 0.0, "x_val": 0.0, "y_val": 3.0, "z_val": 4.0}
    assert arguments.pose({"position": place, "orientation": turned}, "pose") == (
        (1.0, 2.0, -3.0),
        (0.0, 0.0, 0.6, 0.8),
    )


@pytest.mark.parametrize("value", [-1e6, 0, 1e6])
def test_places_within_a_thousand_kilometres(value: float) -> None:
    assert arguments.coordinate(value, "z") == value


def test_flags_may_be_numbers_and_yaw_is_in_degrees() -> None:
    assert [arguments.flag(value, "it") for value in (True, False, 1, 0)] == [True, False, True, False]
    assert arguments.yaw_mode({"is_rate": False, "yaw_or_rate": 180}, "it") == (math.pi, False)
    assert arguments.yaw_mode({}, "it") == (0.0, True)
