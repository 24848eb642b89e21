"""AirSim's flight commands: where they end, when, with what answer, and what happens then."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.flying import FOR_EVER, STRAIGHT, call, fly, go_on, hovering, place, point, wait
from tests.simulating import simulate, world_of
from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.sim.flight.tasks import FollowPath, Land, MoveByManual, RotateToYaw, check_lookahead
from uavaccel.sim.profile import AIRSIM, NATIVE, Profile
from uavaccel.sim.sensors.earth import GeoPoint, geographic, ned_of
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle import autopilot
from uavaccel.sim.vehicle.goal import Yaw, of_velocity
from uavaccel.sim.vehicle.quadrotor import density_ratio
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S, euler_from_quaternion
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.session import open_session
from uavaccel.wire.settings import Settings
from uavaccel.wire.types import EPOCH_NS

PROFILES = pytest.mark.parametrize("profile", [NATIVE, AIRSIM], ids=["native", "airsim"])
ON_THE_GROUND = Settings.model_validate({"Vehicles": {"Drone": {"X": 3, "Y": -2, "Yaw": 90}}})
HOME = Settings().home
AUTO, ADAPTIVE = -1.0, 1.0
MAX_DOF, FORWARD_ONLY = 0, 1


def attitude(api: Api) -> tuple[float, float, float]:
    return euler_from_quaternion(api.simulation.kinematics().orientation_wxyz)


@pytest.fixture
def grounded() -> Api:
    """Standing on the ground, idle, with API control."""
    api = Api(Simulation(World("blocks", NATIVE)), ON_THE_GROUND, render=False)
    call(api, "enableApiControl", True)
    return api


# --- paths ----------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    ("given_m", "adaptive", "ahead_m"),
    [(2.0, 2.0, 2.0), (2.0, 0.5, 2.0), (3.0, 0.0, 3.0), (AUTO, 0.5, 0.6 * 3.0), (AUTO, 0.0, 0.8 * 3.0)],
)
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


@PROFILES
@pytest.mark.parametrize("goal", [(12.0, -5.0, -13.0), (0.0, 15.0, -10.0)])
def test_a_place_is_reached_and_then_held(goal: tuple[float, float, float], profile: Profile) -> None:
    api = hovering(profile)
    result, seconds = fly(
        api, "moveToPosition", *goal, 2.0, FOR_EVER, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE, "SimpleFlight"
    )
    distance = math.dist((0.0, 0.0, -10.0), goal)
    assert result is True, "it flew past"
    assert distance / 2.0 < seconds < distance / 2.0 + 2.0
    assert math.dist(place(api), goal) < 0.5
    go_on(api, 8.0)
    assert math.dist(place(api), goal) < 1.0
    np.testing.assert_allclose(api.simulation.kinematics().linear_velocity_m_s, 0.0, atol=0.05)


@pytest.mark.parametrize(("profile", "hover_ms"), [(NATIVE, 60), (AIRSIM, 63)], ids=["native", "airsim"])
def test_position_hold_sets_in_after_the_last_goal(profile: Profile, hover_ms: int) -> None:
    """A path's last goal is a turn of its loop older than its end."""
    api = hovering(profile)
    fly(api, "moveToPosition", 5.0, 0.0, -10.0, 2.0, FOR_EVER, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE)
    loop_ms = profile.loop_ticks * profile.tick_ns / 1e6
    go_on(api, (hover_ms - loop_ms - profile.tick_ns / 1e6) / 1e3)
    assert api.simulation.world.lead.state["xy_mode"] == autopilot.VELOCITY
    go_on(api, profile.tick_s)
    assert api.simulation.world.lead.state["xy_mode"] == autopilot.POSITION


TO_HERE = (2.0, FOR_EVER, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE)
AT_ONCE: dict[str, Any] = {  # commands that end without a goal of their own: parameters from where the vehicle is
    "moveToZ": lambda here: (here[2], 2.0, FOR_EVER, STRAIGHT, AUTO, ADAPTIVE),
    "moveToPosition": lambda here: (here[0] + 0.4, here[1], here[2], *TO_HERE),
    "moveOnPath": lambda here: ([point(*here), point(*here)], *TO_HERE),
    "moveToGPS": lambda here: (*geographic(tuple(here.tolist()), HOME), *TO_HERE),
    "hover": lambda here: (),
    "cancelLastTask": lambda here: (),
    "land": lambda here: (0.0,),
    "goHome": lambda here: (0.0,),
    "rotateToYaw": lambda here: (90.0, 0.0, 5.0),
    "rotateByYawRate": lambda here: (90.0, 0.0),
    "moveByVelocity": lambda here: (1.0, 0.0, 0.0, 0.0, MAX_DOF, STRAIGHT),
    "moveByManual": lambda here: (3.0, 3.0, -10.0, 0.5, MAX_DOF, STRAIGHT),
}


@pytest.mark.parametrize("method", AT_ONCE)
@pytest.mark.parametrize("after_s", [0.03, 0.5], ids=["before the hold", "in the hold"])
def test_a_command_without_a_goal_leaves_position_hold_alone(method: str, after_s: float) -> None:
    """A vehicle that brakes, and is told to go where it is: as if nothing had been said (OffboardApi.hpp)."""
    flown = []
    for asked in (False, True):
        api = hovering()
        fly(api, "moveByVelocity", 5.0, 2.0, 0.0, 3.0, MAX_DOF, STRAIGHT)
        go_on(api, after_s)
        if asked:
            call(api, method, *AT_ONCE[method](place(api)))
        go_on(api, 3.0)
        state = api.simulation.world.lead.state
        flown.append((place(api).tolist(), state["goal"].tolist(), int(state["xy_mode"])))
    assert flown[0][2] == autopilot.POSITION
    assert flown[0] == flown[1]


def test_a_second_loop_without_sticks_lets_position_hold_set_in() -> None:
    """While the command runs: 60 ms after the last goal."""
    api = hovering()
    call(api, "moveByRC", {"pitch": 10_000.0, "is_valid": True})
    call(api, "moveByManual", 3.0, 3.0, -10.0, 3.0, MAX_DOF, STRAIGHT)
    go_on(api, 1.0)
    call(api, "moveByRC", {"is_valid": False})
    go_on(api, 0.058)
    assert api.simulation.world.lead.state["xy_mode"] == autopilot.VELOCITY
    go_on(api, 0.004)
    assert api.simulation.world.lead.state["xy_mode"] == autopilot.POSITION


def test_a_path_that_takes_too_long_or_is_interrupted_answers_false() -> None:
    api = hovering()
    assert fly(api, "moveToZ", -30.0, 1.0, 2.0, STRAIGHT, AUTO, ADAPTIVE) == (False, 2.0)
    first = call(api, "moveToZ", -5.0, 1.0, FOR_EVER, STRAIGHT, AUTO, ADAPTIVE)
    go_on(api, 1.0)
    second = call(api, "moveToPosition", 9.0, 0.0, -9.0, 3.0, FOR_EVER, 0, STRAIGHT, AUTO, ADAPTIVE)
    assert (first.value, second.due_wall_ns) == (False, None)
    call(api, "cancelLastTask")
    assert (second.value, second.due_wall_ns) == (False, api.simulation.wall_ns)


def test_forward_only_faces_the_way() -> None:
    api = hovering()
    ahead = {"is_rate": False, "yaw_or_rate": 0.0}
    fly(api, "moveToPosition", 0.0, 20.0, -10.0, 3.0, FOR_EVER, FORWARD_ONLY, ahead, AUTO, ADAPTIVE)
    assert attitude(api)[2] == pytest.approx(math.pi / 2, abs=0.1)


@pytest.mark.parametrize(
    ("given_m", "velocity_m_s", "adaptive", "ahead_m"),
    [  # AirSim's own: 30 or 40 periods of 20 ms, and 0.75 m at least
        (-1.0, 10.0, 1.0, 6.0),
        (-1.0, 10.0, 0.0, 8.0),
        (-1.0, 10.0, -1.0, 8.0),
        (-1.0, 1.0, 1.0, 0.75),
        (-1.0, 1.0, 0.0, 0.8),
        (3.0, 10.0, 1.0, 3.0),
        (0.5, 25.0, 1.0, 0.5),
    ],
)
def test_a_path_looks_as_far_ahead_as_it_is_told_or_as_airsim_does(
    given_m: float, velocity_m_s: float, adaptive: float, ahead_m: float
) -> None:
    """AirSim's own: 30 or 40 periods of 20 ms, and 0.75 m at least."""
    assert check_lookahead(given_m, velocity_m_s, adaptive) == pytest.approx(ahead_m)


@pytest.mark.parametrize(("velocity_m_s", "back_m_s"), [(5.0, 1.0), (3.1, 1.0), (3.0, 3.0), (0.8, 0.8)])
def test_who_flies_faster_than_3_m_s_past_the_end_turns_back_at_1_m_s(velocity_m_s: float, back_m_s: float) -> None:
    """10 m north, and 15 m after the first turn; a place on the way is left at the speed that was asked for."""
    points = np.array([(0.0, 0.0, -9.0), (10.0, 0.0, -9.0)])
    task = FollowPath(points, velocity_m_s, 99.0, False, 0.0, True, 3.0, 1.0)
    for north_m, speed_m_s in ((0.0, velocity_m_s), (2.0, velocity_m_s), (15.0, -back_m_s)):
        now = Kinematics(0, (north_m, 0.0, -9.0), (1.0, 0.0, 0.0, 0.0), (0, 0, 0), (0, 0, 0))
        goal, result = task.turn(now, 0.02)
        assert goal is not None
        assert goal.values == pytest.approx((speed_m_s, 0.0, 0.0, 0.0))
        assert result is None


def test_a_path_of_no_points_ends_what_runs_and_is_followed() -> None:
    api = hovering()
    running = call(api, "moveByVelocity", 1.0, 0.0, 0.0, 5.0, MAX_DOF, STRAIGHT)
    assert call(api, "moveOnPath", [], 2.0, 60.0, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE) is True
    assert running.value is False


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


# --- take-off, land, home -------------------------------------------------------------------------


def test_from_the_ground_up_and_down_again(grounded: Api) -> None:
    """Two metres up and down, in the vehicle's own frame; its state says whether it stands."""
    go_on(grounded, 0.5)
    assert call(grounded, "getMultirotorState")["landed_state"] == 0
    np.testing.assert_allclose(place(grounded), 0.0, atol=2e-3)
    for _ in range(2):
        _, seconds = fly(grounded, "takeoff", 20.0, "Drone")
        assert place(grounded)[2] == pytest.approx(-2.0, abs=0.5)
        assert 3.0 < seconds < 5.0
        assert call(grounded, "getMultirotorState")["landed_state"] == 1
        result, seconds = fly(grounded, "land", 60.0)
        assert result is True
        assert call(grounded, "getMultirotorState")["landed_state"] == 0
        np.testing.assert_allclose(place(grounded), 0.0, atol=0.03)
        go_on(grounded, 1.0)
    assert call(grounded, "armDisarm", False) is True
    assert call(grounded, "armDisarm", False) is False
    go_on(grounded, 0.2)
    assert grounded.simulation.world.lead.state["rotor_output"].max() < 1e-9
    assert call(grounded, "armDisarm", True) is True
    go_on(grounded, 0.2)
    assert call(grounded, "getMultirotorState")["landed_state"] == 0, "armed, it idles"
    assert grounded.simulation.world.lead.state["rotor_output"] == pytest.approx(0.1 / 1.5, abs=1e-3)


@PROFILES
@pytest.mark.parametrize("x_m", [3.0, 4.0, 6.0])
def test_a_landing_from_a_level_hover_ends_on_the_ground(x_m: float, profile: Profile) -> None:
    """MuJoCo's contact of a cylinder with a plane throws it up where it is upright but for rounding errors."""
    api = hovering(profile)
    fly(api, "moveToPosition", x_m, 0.0, -5.0, 2.0, FOR_EVER, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE)
    assert fly(api, "land", 60.0)[0] is True
    assert call(api, "getMultirotorState")["landed_state"] == 0
    assert place(api)[2] == pytest.approx(-0.045, abs=2e-3)


STARTS = {"on the ground": 0.0, "in the ground": 0.03, "on a block": -6.0}


@PROFILES
@pytest.mark.parametrize("z", STARTS.values(), ids=list(STARTS))
def test_a_standing_vehicle_is_landed_from_the_first_tick(z: float, profile: Profile) -> None:
    """After the start, after each reset, and as a newcomer; AirSim's ground lock has accelerations of 0 too."""
    x = -45.0 if z < 0 else 3.0  # block_south's middle
    world = World("blocks", profile)
    settings = {"Vehicles": {"Drone": {"X": x, "Y": 1, "Z": z, "Yaw": 30}}}
    api = Api(Simulation(world), Settings.model_validate(settings), render=False)
    places = []
    for begun in range(3):
        if begun == 2:
            newcomer = pose_beside(x + 2.0)
            newcomer["position"]["z_val"] = z
            call(api, "simAddVehicle", "Second", "SimpleFlight", newcomer)
        elif begun:
            call(api, "reset")
        name = "Second" if begun == 2 else "Drone"
        for _ in range(50):
            told = call(api, "getMultirotorState", name)
            assert told["landed_state"] == 0
            for motion in ("linear_velocity", "linear_acceleration", "angular_velocity"):
                moved = list(told["kinematics_estimated"][motion].values())
                np.testing.assert_allclose(moved, 0.0, atol=1e-5)
            places.append(place(api, name))
            go_on(api, profile.tick_s)
        assert call(api, "simGetCollisionInfo", name)["has_collided"]
        np.testing.assert_allclose(api.scenery.pilot(name).vehicle.state["position"][2], min(z, 0) - 0.045, atol=2e-4)
    np.testing.assert_allclose(places, 0.0, atol=1e-6)


def test_home_is_where_the_vehicle_began_and_reset_brings_it_back(grounded: Api) -> None:
    fly(grounded, "takeoff", 20.0)
    fly(grounded, "moveToPosition", 6.0, 4.0, -3.0, 3.0, FOR_EVER, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE)
    _, seconds = fly(grounded, "goHome", 60.0)
    assert np.linalg.norm(place(grounded)) < 0.6
    assert seconds > math.hypot(6, 4, 3) / 0.5
    call(grounded, "reset")
    assert place(grounded).tolist() == [0.0, 0.0, 0.0]
    assert attitude(grounded)[2] == pytest.approx(math.pi / 2)
    assert call(grounded, "isApiControlEnabled") is False
    assert grounded.simulation.world.lead.kinematics().position_m == (0.0, 0.0, 0.0)
    assert grounded.simulation.world.lead.state["position"] == pytest.approx((3.0, -2.0, -0.045), abs=2e-4)


def test_land_in_the_air_takes_its_time() -> None:
    """Idle rotors hold nothing: from the first tick the vehicle falls."""
    settings = Settings.model_validate({"Vehicles": {"Drone": {"X": 3, "Z": -2}}})
    told = call(Api(Simulation(World("blocks", NATIVE)), settings, render=False), "getMultirotorState")
    assert told["landed_state"] == 1
    assert told["kinematics_estimated"]["linear_acceleration"]["z_val"] == pytest.approx(8.7, abs=0.1)
    api = hovering()
    assert fly(api, "land", 3.0) == (False, 3.0)
    assert place(api)[2] == pytest.approx(-10.0 + 0.2 * 3.0, abs=0.1)


def test_who_moves_cannot_take_off() -> None:
    api = hovering()
    running = call(api, "moveByVelocity", 2.0, 0.0, 0.0, 5.0, MAX_DOF, STRAIGHT)
    go_on(api, 1.0)
    with pytest.raises(rpc.RpcError, match="Cannot perform takeoff because vehicle is already moving with velo"):
        call(api, "takeoff", 20.0)
    assert running.value is False


def test_without_api_control_a_task_has_no_effect() -> None:
    api = hovering()
    call(api, "enableApiControl", False)
    assert fly(api, "takeoff", 20.0) == (False, 20.0)
    np.testing.assert_allclose(place(api), (0.0, 0.0, -10.0), atol=0.02)


# --- headings -------------------------------------------------------------------------------------


@PROFILES
@pytest.mark.parametrize("yaw", [60.0, -170.0, 270.0])
def test_the_vehicle_turns_to_a_heading(yaw: float, profile: Profile) -> None:
    api = hovering(profile)
    result, seconds = fly(api, "rotateToYaw", yaw, 20.0, 5.0)
    assert result is True
    assert abs(math.remainder(attitude(api)[2] - math.radians(yaw), 2 * math.pi)) <= math.radians(5.0)
    assert abs(api.simulation.kinematics().angular_velocity_rad_s[2]) <= 0.01
    assert seconds < 5.0
    np.testing.assert_allclose(place(api), (0.0, 0.0, -10.0), atol=0.1)


def test_a_heading_is_passed_the_short_way_round() -> None:
    """AirSim's own loop never ends here: it measures the margin through north."""
    api = hovering()
    fly(api, "rotateToYaw", -90.0, 20.0, 5.0)
    assert fly(api, "rotateToYaw", 180.0, 20.0, 5.0)[0] is True


def test_the_vehicle_turns_at_a_rate() -> None:
    api = hovering()
    assert fly(api, "rotateByYawRate", 40.0, 3.0) == (True, 3.0)
    assert api.simulation.kinematics().angular_velocity_rad_s[2] == pytest.approx(math.radians(40), abs=0.02)
    assert call(api, "rotateByYawRate", 40.0, 0.0) is True


# --- for a time -----------------------------------------------------------------------------------

TIMED: list[tuple[str, tuple[Any, ...]]] = [
    ("moveByVelocity", (0.5, 0.0, 0.0, MAX_DOF, STRAIGHT)),
    ("moveByVelocityZ", (0.5, 0.0, -10.0, MAX_DOF, STRAIGHT)),
    ("moveByVelocityBodyFrame", (0.5, 0.0, 0.0, MAX_DOF, STRAIGHT)),
    ("moveByVelocityZBodyFrame", (0.5, 0.0, -10.0, MAX_DOF, STRAIGHT)),
    ("moveByManual", (1.0, 1.0, -10.0, MAX_DOF, STRAIGHT)),
    ("moveByRollPitchYawZ", (0.0, 0.0, 0.0, -10.0)),
    ("moveByRollPitchYawThrottle", (0.0, 0.0, 0.0, 0.59)),
    ("moveByRollPitchYawrateZ", (0.0, 0.0, 0.0, -10.0)),
    ("moveByRollPitchYawrateThrottle", (0.0, 0.0, 0.0, 0.59)),
    ("moveByAngleRatesZ", (0.0, 0.0, 0.0, -10.0)),
    ("moveByAngleRatesThrottle", (0.0, 0.0, 0.0, 0.59)),
    ("moveByMotorPWMs", (0.59, 0.59, 0.59, 0.59)),
    ("rotateByYawRate", (10.0,)),
]


def with_duration(method: str, params: tuple[Any, ...], seconds: float) -> tuple[Any, ...]:
    """AirSim's order: the drivetrain and the yaw mode come after the duration."""
    rest = 2 if MAX_DOF in params[-2:-1] and params[-1] is STRAIGHT else 0
    return (*params[: len(params) - rest], seconds, *params[len(params) - rest :])


@pytest.mark.parametrize(("profile", "asked_s", "took_s"), [
    (NATIVE, 0.025, 0.024), (NATIVE, 1 / 30, 0.034), (NATIVE, 0.5, 0.5), (AIRSIM, 0.1, 0.105), (AIRSIM, 0.5, 0.504),
])  # fmt: skip
@pytest.mark.parametrize(("method", "params"), TIMED, ids=[method for method, _ in TIMED])
def test_a_command_for_a_time_takes_it_and_may_be_interrupted(
    method: str, params: tuple[Any, ...], profile: Profile, asked_s: float, took_s: float
) -> None:
    api = hovering(profile)
    result, seconds = fly(api, method, *with_duration(method, params, asked_s))
    assert result is True
    nearest = took_s if method != "moveByManual" else math.ceil(asked_s / 0.02 - 1e-9) * 0.02
    assert seconds == pytest.approx(took_s if profile is AIRSIM else nearest, abs=1e-9)
    running = call(api, method, *with_duration(method, params, 1.0), "SimpleFlight")
    go_on(api, 0.05)
    assert call(api, "hover") is False
    assert running.value is False


def test_our_own_client_keeps_to_exact_times() -> None:
    with open_session("lockstep") as session:
        client = session.start_game(1.0)
        future = client.move_async(VelocityGoal((1.0, 0.0, 0.0)), 0.025)
        client.run()
        with pytest.raises(rpc.RpcError, match="not a positive multiple of the physics step of 2 ms"):
            client.join(future)


def test_body_frame_is_the_heading_at_the_beginning() -> None:
    api = hovering()
    fly(api, "rotateToYaw", 90.0, 20.0, 0.5)
    go_on(api, 3.0)
    before = place(api)
    turning = {"is_rate": True, "yaw_or_rate": 30.0}
    fly(api, "moveByVelocityBodyFrame", 2.0, 0.0, 0.0, 4.0, MAX_DOF, turning)
    north, east, _ = place(api) - before
    assert east > 4.0
    assert abs(north) < 1.5
    before = place(api)
    fly(api, "moveByVelocityZBodyFrame", 0.0, 2.0, -12.0, 4.0, MAX_DOF, STRAIGHT)
    assert place(api)[2] < before[2] - 0.5


# --- attitudes, rates, motors, sticks, gains ------------------------------------------------------


@PROFILES
def test_attitudes_and_rates_are_reached(profile: Profile) -> None:
    api = hovering(profile)
    fly(api, "moveByRollPitchYawZ", 0.1, -0.15, 0.8, -10.0, 2.0)
    assert attitude(api) == pytest.approx((0.1, -0.15, 0.8), abs=0.02)
    assert place(api)[0] > 0.0, "nose down is forward"
    api = hovering(profile)
    fly(api, "moveByRollPitchYawrateThrottle", 0.1, 0.0, 0.5, 0.62, 1.5)
    assert attitude(api)[:2] == pytest.approx((0.1, 0.0), abs=0.02)
    assert api.simulation.kinematics().angular_velocity_rad_s[2] == pytest.approx(0.5, abs=0.03)
    assert api.simulation.world.lead.state["rotor_input"].mean() == pytest.approx(0.62, abs=1e-6)
    api = hovering(profile)
    fly(api, "moveByAngleRatesZ", 0.2, -0.1, 0.3, -10.0, 1.5)
    assert api.simulation.kinematics().angular_velocity_rad_s == pytest.approx((0.2, -0.1, 0.3), abs=0.02)


def test_motors_turn_as_told_and_say_so() -> None:
    """At full power 4.1794 N, .0556 N m and 669.857 rad/s, which goes with the root of them (RotorParams.hpp)."""
    api, shares = hovering(), (0.2, 0.4, 0.6, 1.0)
    hover = call(api, "getRotorStates")
    lift = sum(rotor["thrust"] for rotor in hover["rotors"])
    assert lift * density_ratio(api.simulation.world.lead.parameters, -10.0) == pytest.approx(9.80665, rel=1e-4)
    assert hover["timestamp"] == EPOCH_NS + api.simulation.time_ns
    fly(api, "moveByMotorPWMs", 0.2, 0.4, 0.6, 2.0, 0.1)
    rotors = call(api, "getRotorStates")["rotors"]
    assert [rotor["thrust"] for rotor in rotors] == pytest.approx([4.1794453 * u for u in shares], rel=1e-6)
    assert [rotor["speed"] for rotor in rotors] == pytest.approx([669.857 * u**0.5 for u in shares], rel=1e-6)
    torques = [sign * 0.0555624 * u for sign, u in zip((-1, -1, 1, 1), shares, strict=True)]
    assert [rotor["torque_scaler"] for rotor in rotors] == pytest.approx(torques, rel=1e-4)


def test_after_throttle_and_new_gains_the_vertical_integrator_is_new() -> None:
    api = hovering()
    fly(api, "moveByVelocity", 0.0, 0.0, -1.0, 2.0, MAX_DOF, STRAIGHT)
    assert abs(api.simulation.world.lead.state["z_integral"]) > 0.05
    fly(api, "moveByRollPitchYawThrottle", 0.0, 0.0, 0.0, 0.6, 0.02)
    call(api, "moveByVelocity", 0.0, 0.0, -1.0, 2.0, MAX_DOF, STRAIGHT)
    go_on(api, 0.002)
    assert api.simulation.world.lead.state["z_integral"] == 0.0
    go_on(api, 1.0)
    assert abs(api.simulation.world.lead.state["z_integral"]) > 0.05
    call(api, "setPositionControllerGains", [0.25] * 3, [0.0] * 3, [0.0] * 3)
    go_on(api, 0.002)
    assert api.simulation.world.lead.state["z_integral"] == 0.0


def test_sticks_fly_where_no_program_has_control_and_until_a_reset() -> None:
    """Valid ones, through commands too, which have no effect; the lowest switch asks for rates."""
    tilt, api = math.pi / 5.5, hovering()
    for controlled, valid in ((True, True), (True, False), (False, False), (False, True)):
        call(api, "reset")
        call(api, "enableApiControl", controlled)
        sticks = {"roll": 0.25, "pitch": 0.1, "throttle": 0.6, "yaw": 0.0, "is_valid": valid}
        call(api, "moveByRC", sticks, "SimpleFlight")
        go_on(api, 1.0)
        flown = (0.25 * tilt, -0.1 * tilt) if valid and not controlled else (0.0, 0.0)
        assert attitude(api)[:2] == pytest.approx(flown, abs=0.01)
        told = call(api, "getMultirotorState")["rc_data"]
        assert [told[name] for name in sticks] == list(sticks.values())
        assert told["is_initialized"] is valid
    assert fly(api, "moveByVelocity", 0.0, 0.0, 0.0, 0.5, MAX_DOF, STRAIGHT) == (True, 0.5)
    assert attitude(api)[:2] == pytest.approx((0.25 * tilt, -0.1 * tilt), abs=0.01)
    call(api, "moveByRC", {"roll": 0.25, "throttle": 0.6, "switches": 3, "is_valid": True})
    go_on(api, 1.0)
    assert api.simulation.kinematics().angular_velocity_rad_s == pytest.approx((0.25 * tilt, 0.0, 0.0), abs=0.01)
    assert call(api, "getMultirotorState")["rc_data"]["switches"] == 1
    call(api, "reset")
    told = call(api, "getMultirotorState")["rc_data"]
    assert (told["roll"], told["throttle"], told["is_valid"]) == (0.0, 0.0, False)
    go_on(api, 1.0)
    assert attitude(api) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)


def test_manual_flight_follows_the_sticks() -> None:
    api = hovering()
    running = call(api, "moveByManual", 3.0, 3.0, -10.0, 3.0, MAX_DOF, STRAIGHT)
    call(api, "moveByRC", {"pitch": 10_000.0, "is_valid": True})
    assert wait(api, running) is True
    north, east, _ = place(api)
    straight = hovering()
    fly(straight, "moveByVelocityZ", 3.0, 0.0, -10.0, 3.0, MAX_DOF, STRAIGHT)
    assert north == pytest.approx(place(straight)[0], rel=0.05)
    assert abs(east) < 0.01


def test_arming_what_is_armed_changes_nothing_and_what_was_not_idles() -> None:
    api = hovering()
    call(api, "moveByVelocity", 2.0, -1.0, 0.5, 9.0, MAX_DOF, STRAIGHT)
    state = api.simulation.world.lead.state
    assert call(api, "armDisarm", True) is True
    assert state["goal"].tolist() == [2.0, -1.0, 0.5, 0.0]
    assert call(api, "armDisarm", False) is True
    assert (state["goal"].tolist(), int(state["armed"])) == ([2.0, -1.0, 0.5, 0.0], 0)
    assert call(api, "armDisarm", False) is False
    assert call(api, "armDisarm", True) is True
    assert (state["goal"].tolist(), int(state["armed"])) == ([0.0, 0.0, pytest.approx(0.1 / 1.5), 0.0], 1)


def turned_by(degrees: float) -> tuple[float, float, float, float]:
    half = math.radians(degrees) / 2
    return math.cos(half), 0.0, 0.0, math.sin(half)


FREE, AT_THIRTY = Yaw(), Yaw(math.radians(30.0), False)


@pytest.mark.parametrize(
    ("sticks", "begun_deg", "forward_only", "yaw", "expected"),
    [  # pitch, roll, throttle and yaw out of 10 000; north, east, NED z, yaw in rad or rad/s
        ((5000, 0, 0, 0), 0, False, FREE, (1.5, 0.0, -7.0, 0.0)),
        ((0, 5000, 0, 0), 0, False, FREE, (0.0, 1.0, -7.0, 0.0)),
        ((10_000, -5000, 0, 0), 90, False, FREE, (-1.0, -3.0, -7.0, 0.0)),
        ((0, 0, 2500, 0), 0, False, FREE, (0.0, 0.0, -8.0, 0.0)),
        ((0, 0, 0, 10_000), 0, False, FREE, (0.0, 0.0, -7.0, math.radians(100))),
        ((0, 0, 0, -5000), 0, False, AT_THIRTY, (0.0, 0.0, -7.0, math.radians(-20))),
        ((0, 10_000, 0, 0), 0, True, AT_THIRTY, (0.0, 2.0, -7.0, math.radians(120))),
        ((0, 10_000, 0, 0), 0, True, FREE, (0.0, 2.0, -7.0, 0.0)),
    ],
)
def test_a_stick_is_a_share_of_its_greatest_speed(
    sticks: tuple[float, ...], begun_deg: float, forward_only: bool, yaw: Yaw, expected: tuple[float, ...]
) -> None:
    """AirSim's: 3 m/s by pitch, which is its vy_max, 2 m/s by roll, 4 m up by throttle, 100 degrees by yaw.

    Sticks are out of 10 000: pitch, roll, throttle, yaw; expected are north, east, NED z, and yaw in rad or rad/s.
    """
    pitch, roll, throttle, turn = sticks
    now = Kinematics(0, (5.0, 6.0, -7.0), turned_by(-50.0), (0, 0, 0), (0, 0, 0))
    positions, begun = np.array([roll, pitch, throttle, turn, 0.0, 1.0]), turned_by(begun_deg)
    task = MoveByManual(positions, 2.0, 3.0, -4.0, 1.0, forward_only, yaw.value, yaw.is_rate, begun)
    goal, result = task.turn(now, 0.9)
    assert goal is not None
    assert goal.values == pytest.approx(expected)
    assert (goal.xy_mode, goal.z_mode) == (autopilot.VELOCITY, autopilot.POSITION)
    assert goal.yaw_mode == (autopilot.RATE if yaw.is_rate else autopilot.ANGLE)
    assert (result, task.turn(now, 1.0).result) == (None, True)


def moving(yaw_deg: float = 0.0, down_m_s: float = 0.0, turning_rad_s: float = 0.0) -> Kinematics:
    return Kinematics(0, (1.0, 2.0, -3.0), turned_by(yaw_deg), (0.4, 0.0, down_m_s), (0.0, 0.0, turning_rad_s))


@pytest.mark.parametrize(
    ("down_m_s", "ends"),
    [
        ([0.0] * 20, 11),
        ([0.05] * 20, 11),
        ([-0.3] * 20, 11),
        ([0.2] * 7 + [0.0] * 20, 18),
        ([0.0] * 10 + [0.06] + [0.0] * 20, 22),
        ([0.0] * 6 + [0.2] + [0.0] * 6 + [0.2] + [0.0] * 20, 25),
    ],
)
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


@pytest.mark.parametrize(
    ("yaw_deg", "turning_rad_s", "to_deg", "expected", "result"),
    [  # within 5 degrees it turns no further, and it has arrived once it turns by less than 0.01 rad/s
        (24.0, 0.0, 30.0, (False, 30.0), None),
        (36.0, 0.0, 30.0, (False, 30.0), None),
        (26.0, 0.009, 30.0, (True, 0.0), True),
        (34.0, -0.009, 30.0, (True, 0.0), True),
        (30.0, 0.011, 30.0, (True, 0.0), None),
        (30.0, -0.011, 30.0, (True, 0.0), None),
        (178.0, 0.0, -178.0, (True, 0.0), True),
        (-174.0, 0.0, 178.0, (False, 178.0), None),
        (0.0, 0.0, 180.0, (False, 180.0), None),
    ],
)
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


def test_gains_act_until_the_next_simulation() -> None:
    tilts = []
    for gains in ([0.2, 0.2, 2.0], [0.1, 0.2, 2.0]):
        api = hovering()
        call(api, "setVelocityControllerGains", gains, [0.0, 0.0, 2.0], [0.0, 0.0, 0.0])
        call(api, "moveByVelocity", 1.0, 0.0, 0.0, 2.0, MAX_DOF, STRAIGHT)
        go_on(api, 0.6)
        tilts.append(attitude(api)[1])
    assert tilts[0] < 1.5 * tilts[1] < 0.0
    again = Simulation(world_of(NATIVE))
    assert again.world.lead.parameters["velocity_gain"].tolist() == [0.2, 0.2, 2.0], "AirSim's own"


@pytest.mark.parametrize("level", ["Velocity", "Position", "AngleLevel", "AngleRate"])
def test_without_gains_a_reset_still_begins_a_hover(level: str) -> None:
    api = hovering()
    call(api, f"set{level}ControllerGains", [0.0] * 3, [0.0] * 3, [0.0] * 3)
    call(api, "reset")
    np.testing.assert_allclose(place(api), (0.0, 0.0, -10.0))
    assert np.isfinite(api.simulation.world.lead.state["goal"]).all()


def test_a_controller_of_another_mode_is_a_new_one() -> None:
    """It has no error of an update before, from which a derivative would be, and nothing integrated."""
    api = hovering()
    call(api, "setVelocityControllerGains", [0.2, 0.2, 2.0], [0.05, 0.05, 2.0], [0.1, 0.1, 0.0])
    fly(api, "moveByVelocity", 3.0, 2.0, 0.0, 0.3, MAX_DOF, STRAIGHT)
    state = api.simulation.world.lead.state
    level = slice(3 * autopilot.VELOCITY_LEVEL, 3 * autopilot.VELOCITY_LEVEL + 2)
    assert state["pid_error"][level].all()
    assert state["pid_integral"][level].all()
    call(api, "hover")
    api.simulation.world.lead.hold_from(api.simulation.world.tick + 1)
    go_on(api, 0.002)
    assert state["xy_mode"] == autopilot.POSITION
    assert not state["pid_error"][level].any()
    assert not state["pid_integral"][level].any()


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
        state = pose_beside(2.0)
        call(api, "simSetVehiclePose", state, True)
        reached = []
        for _ in range(90):
            go_on(api, 0.1)
            reached.append(place(api)[0])
        overshoot[ki, kd] = -min(reached)
    assert drift[0.05, 0.0] < 0.3 * drift[0.0, 0.0]
    assert overshoot[0.0, 0.1] < 0.8 * overshoot[0.0, 0.0]
    assert Simulation(world_of(NATIVE)).world.lead.parameters["full_pid"] == 0


def pose_beside(north_m: float) -> dict[str, Any]:
    return {"position": point(north_m, 0.0, -10.0), "orientation": {"w_val": 1.0, **point(0.0, 0.0, 0.0)}}


# --- in every timing ------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["native", "airsim"])
def test_flights_are_the_same_on_every_run(profile: str) -> None:
    tracks = []
    for _ in range(2):
        with open_session("virtual", profile) as session:
            client = session.start_game(20.0)
            client.run()
            client.call("takeoff", 20.0)
            client.call("moveToPosition", 5.0, 2.0, -9.0, 3.0, FOR_EVER, 0, STRAIGHT, AUTO, ADAPTIVE, "")
            client.pause()
            tracks.append(client.recording())
    assert tracks[0].samples.tobytes() == tracks[1].samples.tobytes()
    assert np.array_equal(tracks[0].commands, tracks[1].commands)
    assert tracks[0].samples[-1, 1] > 4.0


def test_the_log_says_when_each_command_began_and_ended() -> None:
    """One that completes its way, one with a duration, one that the next interrupts, and one that is cancelled."""
    api, expected = hovering(), []
    simulation = api.simulation
    for method, params, most_s in (
        ("moveToPosition", (2.0, 0.0, -10.0, 2.0, FOR_EVER, MAX_DOF, STRAIGHT, AUTO, ADAPTIVE), FOR_EVER),
        ("moveByVelocity", (0.0, 1.0, 0.0, 0.5, MAX_DOF, STRAIGHT), FOR_EVER),
        ("land", (60.0,), 0.3),
        ("moveByVelocity", (0.0, 1.0, 0.0, 0.5, MAX_DOF, STRAIGHT), 0.2),
    ):
        begun = simulation.world.tick
        reply = call(api, method, *params)
        if most_s == FOR_EVER:
            wait(api, reply)
        else:
            go_on(api, most_s)
        expected.append((begun, simulation.world.tick))
    call(api, "cancelLastTask")
    assert list(simulation.lead.log) == expected
    lasted_s = [round((end - begun) * NATIVE.tick_s, 9) for begun, end in expected[1:]]
    assert lasted_s == [0.5, 0.3, 0.2]


@pytest.mark.parametrize("clock_speed", [1.0, 4.0])
def test_frames_are_sixtieths_of_a_second_on_the_wall(clock_speed: float) -> None:
    api = Api(simulate(clock_speed), render=False)
    call(api, "simPause", True)
    reply = call(api, "simContinueForFrames", 30)
    begun_ns = api.simulation.time_ns
    assert wait(api, reply) is not None
    assert (api.simulation.time_ns - begun_ns) / NS_PER_S == 0.5 * clock_speed
    assert api.simulation.paused
