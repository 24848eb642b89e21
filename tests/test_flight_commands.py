"""AirSim's flight commands: where they end, when, with what answer, and what happens then."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.flying import FOR_EVER, STRAIGHT, call, fly, go_on, hovering, place, point, pose
from tests.simulating import world_of
from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.sim.earth import GeoPoint, ned_of
from uavaccel.sim.flight import FollowPath, Land, RotateToYaw, check_lookahead, of_velocity, stick_goal
from uavaccel.sim.profile import AIRSIM, NATIVE, Profile
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle import autopilot
from uavaccel.wire.flight_api import rc_data_map, sticks

PROFILES = pytest.mark.parametrize("profile", [NATIVE, AIRSIM], ids=["native", "airsim"])
AUTO, ADAPTIVE = -1.0, 1.0
MAX_DOF = 0


def carrot(path: list[Any], travelled: float, ahead: float) -> tuple[float, Any]:
    """How far along a path, and where, the place is that is `ahead` of what was travelled; at most its end."""
    corners = np.array(path, float)
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    along = min(travelled + ahead, lengths.sum())
    reached = np.concatenate([[0.0], np.cumsum(lengths)])
    return along, np.array([np.interp(along, reached, corners[:, axis]) for axis in range(3)])


def followed(
    simulation: Simulation, path: list[Any], speed: float, ahead: float, adaptive: float = 1.0
) -> tuple[Any, float]:
    """The same flight by a loop of this test's, on arc lengths: where it ends, and after how long."""
    begun, period = simulation.world.tick, math.ceil(0.02 / simulation.profile.tick_s)
    path = [simulation.world.lead.state["position"].copy(), *path]
    total = carrot(path, 0.0, 1e9)[0]
    travelled = error = gained = 0.0
    while carrot(path, travelled, ahead + error)[0] < total or gained > 0:
        goal, here = carrot(path, travelled, ahead + error)[1], simulation.world.lead.state["position"].copy()
        way, distance = goal - here, np.linalg.norm(goal - here)
        velocity = np.zeros(3) if distance < 0.5 else way / distance * min(speed, distance / 0.02)
        if abs(way[2]) <= 0.5:
            velocity[2] = 0.0
        simulation.world.lead.set_goal(of_velocity(VelocityGoal(tuple(velocity))))
        simulation.world.advance(period)
        last = carrot(path, travelled, 0.0)[1]
        chord, moved = goal - last, simulation.world.lead.state["position"] - last
        if not chord.any():
            break
        gained = float(moved @ chord / np.linalg.norm(chord))
        error = adaptive * float(np.linalg.norm(moved - gained * chord / np.linalg.norm(chord)))
        travelled = carrot(path, travelled, max(gained, 0.0))[0]
    took = (simulation.world.tick - begun) * simulation.profile.tick_s
    return simulation.world.lead.state["position"].copy(), took


PATHS = [
    ([(8.0, 4.0, -12.0)], 3.0),
    ([(0.3, 0.0, -10.0)], 1.0),
    ([(0.0, 0.0, -4.0)], 2.0),
    ([(10.0, 0.0, -10.0), (10.0, 10.0, -9.0), (0.0, 10.0, -9.0), (0.0, 0.0, -10.0)], 4.0),
]


@PROFILES
@pytest.mark.parametrize(("path", "speed"), PATHS)
def test_paths_are_followed_as_airsim_does(path: list[Any], speed: float, profile: Profile) -> None:
    api = hovering(profile)
    where, took_s = followed(api.simulation, path, speed, max(0.6 * speed, 0.75))
    api = hovering(profile)
    result, seconds = fly(
        api, "moveOnPath", [point(*corner) for corner in path], speed, 60.0, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE
    )
    assert isinstance(result, bool)
    assert seconds == pytest.approx(took_s, abs=1e-9)
    np.testing.assert_allclose(place(api), where, atol=1e-6)


CORNERS = [(10.0, 0.0, -10.0), (10.0, 10.0, -9.0), (0.0, 0.0, -10.0)]
WAYS: dict[str, tuple[list[Any], tuple[Any, ...], tuple[Any, ...]]] = {  # by method: path, its parameters, and the turn
    "moveOnPath": (CORNERS, ([point(*corner) for corner in CORNERS],), (MAX_DOF, STRAIGHT)),
    "moveToPosition": ([(12.0, -5.0, -13.0)], (12.0, -5.0, -13.0), (MAX_DOF, STRAIGHT)),
    "moveToZ": ([(0.0, 0.0, -14.0)], (-14.0,), (STRAIGHT,)),
}


@pytest.mark.parametrize(("given_m", "adaptive", "ahead_m"), [(2.0, 2.0, 2.0), (3.0, 0.0, 3.0), (AUTO, 0.5, 0.6 * 3.0)])
@pytest.mark.parametrize("method", ["moveOnPath", "moveToPosition", "moveToZ"])
def test_the_lookahead_adapts_to_the_distance_from_the_path(
    method: str, given_m: float, adaptive: float, ahead_m: float
) -> None:
    """By the share that was asked for; around corners, and in a wind that pushes the vehicle off a straight way."""
    (path, towards, turn), ends = WAYS[method], []
    for ours in (True, False):
        api = hovering()
        world = api.simulation.world
        world.set_wind((0.0, 10.0, 0.0))
        if ours:
            where, seconds = followed(api.simulation, path, 3.0, ahead_m, adaptive)
        else:
            _, seconds = fly(api, method, *towards, 3.0, 60.0, *turn, given_m, adaptive)
            where = place(api)
        world.set_wind((0.0, 0.0, 0.0))  # which a new simulation of the world would keep
        ends.append([*where, seconds])
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


def test_a_path_looks_as_far_ahead_as_it_is_told_or_as_airsim_does() -> None:
    """AirSim's own: 30 or 40 periods of 20 ms, and 0.75 m at least."""
    for given_m, velocity_m_s, adaptive, ahead_m in (
        *((-1.0, 10.0, 1.0, 6.0), (-1.0, 10.0, 0.0, 8.0), (-1.0, 10.0, -1.0, 8.0), (-1.0, 1.0, 1.0, 0.75)),
        *((-1.0, 1.0, 0.0, 0.8), (3.0, 10.0, 1.0, 3.0), (0.5, 25.0, 1.0, 0.5)),
    ):
        assert check_lookahead(given_m, velocity_m_s, adaptive) == pytest.approx(ahead_m)


@pytest.mark.parametrize(("velocity_m_s", "back_m_s"), [(5.0, 1.0), (3.1, 1.0), (3.0, 3.0), (0.8, 0.8)])
def test_who_flies_faster_than_3_m_s_past_the_end_turns_back_at_1_m_s(velocity_m_s: float, back_m_s: float) -> None:
    """10 m north, and 15 m after the first turn; a place on the way is left at the speed that was asked for."""
    points = np.array([(0.0, 0.0, -9.0), (10.0, 0.0, -9.0)])
    task = FollowPath(points, velocity_m_s, 99.0, False, autopilot.STRAIGHT_ON, 3.0, 1.0)
    for north_m, speed_m_s in ((0.0, velocity_m_s), (2.0, velocity_m_s), (15.0, -back_m_s)):
        now = Kinematics(0, (north_m, 0.0, -9.0), (1.0, 0.0, 0.0, 0.0), (0, 0, 0), (0, 0, 0))
        goal, result = task.turn(now, 0.02)
        assert goal is not None
        assert goal.values == pytest.approx((speed_m_s, 0.0, 0.0, 0.0))
        assert result is None


def test_geographic_places() -> None:
    """A second of arc along the meridian, and along the parallel, of the WGS 84 ellipsoid at 45 degrees north.

    The figures are those of EarthUtils.hpp's single precision; in doubles they are 30.870, 0, 0 and 0, 21.902, 10.
    """
    home, second = GeoPoint(45.0, 7.0, 100.0), 1 / 3600
    north = ned_of(GeoPoint(45.0 + second, 7.0, 100.0), home)
    east = ned_of(GeoPoint(45.0, 7.0 + second, 90.0), home)
    assert north == pytest.approx((30.8720341, 0.0147571564, -0.240663528), abs=1e-6)
    assert east == pytest.approx((-0.0865855217, 21.9391937, 9.81291008), abs=1e-6)
    api = hovering()
    goal = (47.641468 + 1e-4, -122.140165, 132.0, 4.0, FOR_EVER, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE)
    assert fly(api, "moveToGPS", *goal)[0] is True
    assert place(api)[0] == pytest.approx(11.13, abs=0.5)


@pytest.mark.parametrize("seed", range(3))
def test_a_command_in_other_words_is_the_same_flight(seed: int) -> None:
    """Of the second vehicle, whose frame, place, attitude and manner of turning are its own."""
    rng = np.random.default_rng(seed)
    api, forward_only = hovering(), seed % 2
    call(api, "simAddVehicle", "B", "SimpleFlight", pose(rng.uniform(5.0, 9.0), 6.0, -3.0))
    ahead, right, north, east = rng.uniform(-3.0, 3.0, 4)
    down, yaw, z = rng.uniform(-1.0, 1.0), rng.uniform(-math.pi, math.pi), rng.uniform(-9.0, -7.0)
    there = pose(north, east, -5.0, w_val=math.cos(yaw / 2), z_val=math.sin(yaw / 2))
    velocity = (ahead * math.cos(yaw) - right * math.sin(yaw), ahead * math.sin(yaw) + right * math.cos(yaw))
    how = (forward_only, {"is_rate": seed == 2, "yaw_or_rate": rng.uniform(-90.0, 90.0)})
    pace = (rng.uniform(1.0, 5.0), 9.0)
    way, place_m = (*pace, *how, 2.5, 0.5), (ahead, right, z)
    home = GeoPoint(**call(api, "getHomeGeoPoint", "B"))
    gps = GeoPoint(home.latitude + 3e-5, home.longitude - 2e-5, home.altitude - z)
    climb = (0.5, 9.0, STRAIGHT, AUTO, ADAPTIVE)
    for one, other in (
        (("moveByVelocityBodyFrame", ahead, right, down, 1.0, *how), ("moveByVelocity", *velocity, down, 1.0, *how)),
        (("moveByVelocityZBodyFrame", ahead, right, z, 1.0, *how), ("moveByVelocityZ", *velocity, z, 1.0, *how)),
        (("moveOnPath", [point(*place_m)], *way), ("moveToPosition", *place_m, *way)),
        (("moveToGPS", *gps, *way), ("moveToPosition", *ned_of(gps, home), *way)),
        (("moveToZ", z, *pace, *how[1:], AUTO, 0.5), ("moveToPosition", north, east, z, *pace, 0, *how[1:], AUTO, 0.5)),
        (("takeoff", 9.0), ("moveToZ", -7.0, *climb)),
        (("goHome", 9.0), ("moveToPosition", 0.0, 0.0, 0.0, *climb[:2], 0, *climb[2:])),
    ):
        ends = []
        for method, *parameters in (one, other):
            call(api, "reset")
            call(api, "enableApiControl", True, "B")
            call(api, "simSetVehiclePose", there, True, "B")
            call(api, method, *parameters, "B")
            go_on(api, 0.3)
            goal = api.scenery.vehicle("B").state["goal"]
            ends.append([*goal, *place(api, "B"), *api.scenery.pilot("B").kinematics().orientation_wxyz])
        assert ends[0] == pytest.approx(ends[1], abs=1e-6), one
        assert not np.allclose(ends[0][:3], 0.0)


def moving(yaw_deg: float = 0.0, down_m_s: float = 0.0, turning_rad_s: float = 0.0) -> Kinematics:
    half = math.radians(yaw_deg) / 2
    turned = (math.cos(half), 0.0, 0.0, math.sin(half))
    return Kinematics(0, (1.0, 2.0, -3.0), turned, (0.4, 0.0, down_m_s), (0.0, 0.0, turning_rad_s))


@pytest.mark.parametrize(("down_m_s", "ends"), [
    ([0.0] * 20, 11), ([0.05] * 20, 11), ([-0.3] * 20, 11), ([0.2] * 7 + [0.0] * 20, 18),
    ([0.0] * 10 + [0.06] + [0.0] * 20, 22), ([0.0] * 6 + [0.2] + [0.0] * 6 + [0.2] + [0.0] * 20, 25),
])  # fmt: skip
def test_a_landing_ends_after_eleven_turns_without_descent(down_m_s: list[float], ends: int) -> None:
    """Of more than 0.05 m/s; what was counted before a descent does not count after it."""
    land = Land(60.0)
    turns = [land.turn(moving(down_m_s=speed), 0.02 * number) for number, speed in enumerate(down_m_s[:ends], start=1)]
    assert [turn.result for turn in turns] == [None] * (ends - 1) + [True]
    assert {turn.goal.values for turn in turns if turn.goal} == {(0.0, 0.0, 0.2, 0.0)}


@pytest.mark.parametrize(("timeout_s", "results"), [(1.0, [None, False, False]), (0.0, [False] * 3)])
def test_a_landing_that_descends_ends_at_its_timeout(timeout_s: float, results: list[bool | None]) -> None:
    land = Land(timeout_s)
    assert [land.turn(moving(down_m_s=0.2), at_s).result for at_s in (0.98, 1.0, 1.02)] == results


@pytest.mark.parametrize(("yaw_deg", "turning_rad_s", "to_deg", "expected", "result"), [
    (24.0, 0.0, 30.0, (False, 30.0), None), (36.0, 0.0, 30.0, (False, 30.0), None),
    (26.0, 0.009, 30.0, (True, 0.0), True), (34.0, -0.009, 30.0, (True, 0.0), True),
    (30.0, 0.011, 30.0, (True, 0.0), None), (30.0, -0.011, 30.0, (True, 0.0), None),
    (178.0, 0.0, -178.0, (True, 0.0), True), (-174.0, 0.0, 178.0, (False, 178.0), None),
    (0.0, 0.0, 180.0, (False, 180.0), None),
])  # fmt: skip
def test_a_turn_arrives_within_its_margin_and_at_rest(
    yaw_deg: float, turning_rad_s: float, to_deg: float, expected: tuple[bool, float], result: bool | None
) -> None:
    """Within 5 degrees it turns no further, and it has arrived once it turns by less than 0.01 rad/s."""
    task = RotateToYaw((7.0, 8.0, -9.0), math.radians(to_deg), math.radians(5.0), 2.0)
    now, (is_rate, to) = moving(yaw_deg, turning_rad_s=turning_rad_s), expected
    goal, ended = task.turn(now, 1.98)
    assert goal is not None
    assert goal.yaw_mode == (autopilot.RATE if is_rate else autopilot.ANGLE)
    assert goal.values == pytest.approx((7.0, 8.0, -9.0, math.radians(to)))
    assert ended is result
    assert task.turn(now, 2.0).result is bool(result)


def test_sticks_are_goals_where_no_program_has_control() -> None:
    """By angles of up to pi / 5.5 or, with the first switch, by rates as large; a throttle below idle idles."""
    for switches, mode in (
        (0, autopilot.TILT),
        (1, autopilot.TILT_RATE),
        (6, autopilot.TILT),
        (7, autopilot.TILT_RATE),
    ):
        sent = {"roll": 0.5, "pitch": 0.25, "throttle": 0.0, "yaw": -0.5, "switches": switches, "is_valid": True}
        told = rc_data_map(moved := sticks(sent, "rcdata"))
        assert {name: told[name] for name in sent} == {**sent, "switches": switches % 2}
        goal = stick_goal(moved)
        tilts = (0.5 * math.pi / 5.5, -0.25 * math.pi / 5.5)
        assert goal.values == pytest.approx((*tilts, 0.1 / 1.5, -0.5 * math.pi))
        assert (goal.xy_mode, goal.z_mode, goal.yaw_mode) == (mode, autopilot.THROTTLE, autopilot.RATE)


def test_an_integral_gain_beats_wind_and_a_derivative_damps() -> None:
    """Against 10 m/s from the north a proportional controller is pushed off; wind-up is what an integral is for."""
    drift, overshoot = {}, {}
    for ki, kd in ((0.0, 0.0), (0.05, 0.0), (0.0, 0.1)):
        api = hovering()
        api.simulation.world.set_wind((-10.0, 0.0, 0.0))
        call(api, "setVelocityControllerGains", [0.2, 0.2, 2.0], [ki, 0.0, 2.0], [kd, 0.0, 0.0])
        fly(api, "moveByVelocity", 0.0, 0.0, 0.0, 20.0, MAX_DOF, STRAIGHT)
        drift[ki, kd] = abs(api.simulation.kinematics().linear_velocity_m_s[0])
        api.simulation.world.set_wind((0.0, 0.0, 0.0))
        api = hovering()
        call(api, "setPositionControllerGains", [1.0, 1.0, 0.25], [0.0] * 3, [kd, kd, 0.0])
        call(api, "rotateByYawRate", 0.0, 9.0)
        call(api, "simSetVehiclePose", pose(2.0, 0.0, -10.0), True)
        reached = []
        for _ in range(90):
            go_on(api, 0.1)
            reached.append(place(api)[0])
        overshoot[ki, kd] = -min(reached)
    assert drift[0.05, 0.0] < 0.3 * drift[0.0, 0.0]
    assert overshoot[0.0, 0.1] < 0.8 * overshoot[0.0, 0.0]
    assert Simulation(world_of(NATIVE)).world.lead.parameters["full_pid"] == 0
