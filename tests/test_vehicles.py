"""Several vehicles in one world: each its own frame, command and state; the first flies as if it were alone."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.flying import FOR_EVER, STRAIGHT, call, fly, go_on, hovering, place, point, wait
from uavaccel.errors import UserError
from uavaccel.sim.profile import AIRSIM, NATIVE, Profile
from uavaccel.sim.scene.model import DRONE_GROUP, OTHERS_GROUP
from uavaccel.sim.sensors.earth import geographic
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle import autopilot, goal
from uavaccel.sim.vehicle.goal import Yaw
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Samples, Start, Vehicle
from uavaccel.sim.world import START_M, World
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.settings import Settings
from uavaccel.wire.types import EPOCH_NS

ASIDE = {"X": 5, "Y": 5}
MANY = 50
STILL = point(0, 0, 0)
PLACE = [0.0, 0.0, -9.0]
LEVEL = {"position": point(0, 0, -9), "orientation": {"w_val": 1.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0}}
PLACED = {**LEVEL, "linear_velocity": STILL, "angular_velocity": STILL}
BY_CALLS: dict[str, list[Any]] = {  # parameters of every call that names a vehicle
    "isApiControlEnabled getMultirotorState simGetGroundTruthKinematics simGetVehiclePose simGetCollisionInfo": [],
    "hover cancelLastTask getRotorStates simGetGroundTruthEnvironment getHomeGeoPoint": [],
    "enableApiControl armDisarm": [True],
    "simSetVehiclePose": [LEVEL, True],
    "simSetKinematics": [PLACED, True],
    "takeoff land goHome": [1.0],
    "moveToPosition": [*PLACE, 1.0, 1.0, 0, STRAIGHT, -1, 1],
    "moveToZ": [-9.0, 1.0, 1.0, STRAIGHT, -1, 1],
    "moveToGPS": [47.6, -122.1, 130.0, 1.0, 1.0, 0, STRAIGHT, -1, 1],
    "moveOnPath": [[point(0, 0, -9)], 1.0, 1.0, 0, STRAIGHT, -1, 1],
    "rotateToYaw": [1.0] * 3,
    "rotateByYawRate": [1.0] * 2,
    "moveByVelocity moveByVelocityZ moveByManual": [*PLACE, 1.0, 0, STRAIGHT],
    "moveByVelocityBodyFrame moveByVelocityZBodyFrame": [*PLACE, 1.0, 0, STRAIGHT],
    "moveByMotorPWMs moveByRollPitchYawZ moveByRollPitchYawThrottle moveByRollPitchYawrateZ": [0.1] * 5,
    "moveByRollPitchYawrateThrottle moveByAngleRatesZ moveByAngleRatesThrottle": [0.1] * 5,
    "moveByRC": [{}],
    "setAngleRateControllerGains setAngleLevelControllerGains": [[0.2] * 3] * 3,
    "setVelocityControllerGains setPositionControllerGains": [[0.2] * 3] * 3,
    "simGetImages": [[]],
    "simGetImage": ["0", 0],
    "simGetCameraInfo": ["0"],
    "getImuData getGpsData getLidarData": [""],
    "simTestLineOfSightToPoint": [{"latitude": 47.0, "longitude": -122.0, "altitude": 130.0}],
}
ARGUMENTS = {method: params for methods, params in BY_CALLS.items() for method in methods.split()}


PROFILES = pytest.mark.parametrize("profile", [NATIVE, AIRSIM], ids=["native", "airsim"])


def made(profile: Profile = NATIVE, render: bool = False, **settings: Any) -> Api:
    """A world of blocks with these settings."""
    return Api(Simulation(World("blocks", profile)), Settings.model_validate(settings), render=render)


def fleet(profile: Profile = NATIVE, **vehicles: Any) -> Api:
    """The vehicles of a settings file, all with API control."""
    api = made(profile, Vehicles=vehicles)
    for name in vehicles:
        call(api, "enableApiControl", True, name)
    return api


def pose(x: float, y: float, z: float, **orientation: float) -> dict[str, Any]:
    level = {"w_val": 1.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0}
    return {"position": point(x, y, z), "orientation": level | orientation}


def dash(api: Api, vehicle: str, vx: float, vy: float, seconds: float = 60.0) -> Any:
    return call(api, "moveByVelocity", vx, vy, 0.0, seconds, 0, STRAIGHT, vehicle)


@PROFILES
def test_the_first_flies_as_if_it_were_alone(profile: Profile) -> None:
    """To the bit, as long as they do not touch."""
    states = []
    for others in ({}, {"B": ASIDE}):
        api = fleet(profile, A={}, **others)
        dash(api, "A", 1.0, 0.5, 2.0)
        for other in others:
            call(api, "takeoff", 20.0, other)
        go_on(api, 3.0)
        states.append(api.simulation.world.lead.state)
    assert states[0].tobytes() == states[1].tobytes()
    assert place(api, "B")[2] < -0.5


def test_each_has_its_frame_and_its_command() -> None:
    api = fleet(B={"X": 5, "Y": -4, "Z": 0, "Yaw": 90}, A={}, C={"X": -5, "Yaw": -30})
    assert call(api, "listVehicles") == ["A", "B", "C"]
    assert place(api, "B").tolist() == [0.0, 0.0, 0.0]
    for name, degrees in (("A", 0.0), ("B", 90.0), ("C", -30.0)):
        turned, half = call(api, "simGetVehiclePose", name)["orientation"], math.radians(degrees) / 2
        assert list(turned.values()) == pytest.approx([math.cos(half), 0.0, 0.0, math.sin(half)], abs=1e-9)
    first = call(api, "moveToZ", -12.0, 1.0, FOR_EVER, STRAIGHT, -1.0, 1.0, "A")
    second = call(api, "moveToPosition", 2.0, 0.0, -4.0, 1.5, FOR_EVER, 0, STRAIGHT, -1.0, 1.0, "B")
    assert wait(api, first) is not None
    assert wait(api, second) is not None
    np.testing.assert_allclose(place(api, "A"), (0.0, 0.0, -12.0), atol=0.7)
    np.testing.assert_allclose(place(api, "B"), (2.0, 0.0, -4.0), atol=0.7)
    go_on(api, 6.0)
    in_world = np.array(api.scenery.pilot("B").vehicle.state["position"])
    np.testing.assert_allclose(in_world - place(api, "B"), (5.0, -4.0, -0.045), atol=2e-4)
    np.testing.assert_allclose(place(api, "B"), (2.0, 0.0, -4.0), atol=0.7)  # held in its own frame
    gps = [call(api, "getMultirotorState", name)["gps_location"] for name in ("A", "B")]
    assert gps[1]["latitude"] > gps[0]["latitude"]


QUARTER = math.pi / 2
GOALS: dict[str, tuple[list[Any], tuple[float, ...]]] = {  # as B's autopilot gets it: NED in the world, and yaw
    "moveToZ": ([-9.0, 1.0, 9.0, STRAIGHT, -1, 1], (0.0, 0.0, -1.0, 0.0)),
    "moveToPosition": ([5.0, 1.0, -4.0, 1.5, 9.0, 0, STRAIGHT, -1, 1], (1.5, 0.0, 0.0, 0.0)),
    "moveOnPath": ([[point(2, -8, -4)], 1.5, 9.0, 1, {"is_rate": False}, -1, 1], (0.0, -1.5, 0.0, -QUARTER)),
    "goHome": ([9.0], (0.5 * -2 / 21**0.5, 0.5 * -1 / 21**0.5, 0.5 * 4 / 21**0.5, 0.0)),
    "takeoff": ([9.0], (0.0, 0.0, -0.5, 0.0)),
    "land": ([9.0], (0.0, 0.0, 0.2, 0.0)),
    "rotateByYawRate": ([90.0, 1.0], (22.0, 11.0, -5.045, QUARTER)),
    "rotateToYaw": ([-90.0, 9.0, 5.0], (22.0, 11.0, -5.045, -QUARTER)),
    "moveByVelocity": ([3.0, 1.0, 0.5, 1.0, 0, STRAIGHT], (3.0, 1.0, 0.5, 0.0)),
    "moveByVelocityZ": ([3.0, 1.0, -7.0, 1.0, 0, STRAIGHT], (3.0, 1.0, -8.045, 0.0)),
    "moveByVelocityBodyFrame": ([3.0, 1.0, 0.5, 1.0, 0, STRAIGHT], (-1.0, 3.0, 0.5, 0.0)),
    "moveByVelocityZBodyFrame": ([3.0, 1.0, -7.0, 1.0, 0, STRAIGHT], (-1.0, 3.0, -8.045, 0.0)),
    "moveByManual": ([2.0, 3.0, -4.0, 1.0, 0, STRAIGHT], (1.0, -3.0, -6.045, 0.0)),
    "moveByRollPitchYawZ": ([0.1, 0.2, 0.3, -7.0, 1.0], (0.1, 0.2, -8.045, 0.3)),
    "moveByRollPitchYawrateZ": ([0.1, 0.2, 0.3, -7.0, 1.0], (0.1, 0.2, -8.045, 0.3)),
    "moveByRollPitchYawThrottle": ([0.1, 0.2, 0.3, 0.6, 1.0], (0.1, 0.2, 0.6, 0.3)),
    "moveByRollPitchYawrateThrottle": ([0.1, 0.2, 0.3, 0.6, 1.0], (0.1, 0.2, 0.6, 0.3)),
    "moveByAngleRatesZ": ([0.1, 0.2, 0.3, -7.0, 1.0], (0.1, 0.2, -8.045, 0.3)),
    "moveByAngleRatesThrottle": ([0.1, 0.2, 0.3, 0.6, 1.0], (0.1, 0.2, 0.6, 0.3)),
    "moveByMotorPWMs": ([0.1, 0.2, 0.3, 0.4, 1.0], (0.1, 0.2, 0.3, 0.4)),
}


@pytest.mark.parametrize("method", GOALS)
def test_a_command_begins_at_its_own_vehicle(method: str) -> None:
    """B faces east, 2 m north, 1 m east of and 4 m above its origin; A is elsewhere, faces north, and stays."""
    api = fleet(A={"X": -6, "Y": 2, "Z": -3}, B={"X": 20, "Y": 10, "Z": -1})
    call(api, "simSetVehiclePose", pose(2.0, 1.0, -4.0, w_val=0.5**0.5, z_val=0.5**0.5), True, "B")
    leads = api.simulation.world.lead.state["goal"].tolist()
    params, expected = GOALS[method]
    call(api, "moveByRC", {"pitch": 10_000, "roll": 5000, "throttle": 2500, "is_valid": True}, "B")
    call(api, method, *params, "B")
    assert api.scenery.vehicle("B").state["goal"].tolist() == pytest.approx(expected, abs=1e-9)
    assert api.simulation.world.lead.state["goal"].tolist() == leads
    running = [pilot.command is not None for pilot in api.simulation.pilots]
    assert running == [False, True]


def test_one_loses_control_or_its_command_and_the_other_goes_on() -> None:
    api = fleet(A={}, B=ASIDE)
    first, second = dash(api, "A", 1.0, 0.0), dash(api, "B", 0.0, 1.0)
    call(api, "cancelLastTask", "A")
    assert (first.value, second.due_wall_ns) == (False, None)
    call(api, "enableApiControl", False, "A")
    assert call(api, "isApiControlEnabled", "B") is True
    assert (call(api, "armDisarm", False, "A"), call(api, "armDisarm", False, "B")) == (False, True)
    assert (api.scenery.pilot("A").vehicle.state["armed"], api.scenery.pilot("B").vehicle.state["armed"]) == (1, 0)


@pytest.mark.parametrize("origin_m", [(5.0, -4.0, -2.0), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize(("of", "held"), [
    (goal.velocity((1.0, 2.0, 3.0), Yaw(0.5)), (0, 0, 0)),
    (goal.velocity_z(1.0, 2.0, 3.0, Yaw(0.5)), (0, 0, 1)),
    (goal.position((1.0, 2.0, 3.0), Yaw(0.5)), (1, 1, 1)),
    (goal.attitude(1.0, 2.0, Yaw(0.5), 3.0, autopilot.POSITION), (0, 0, 1)),
    (goal.attitude(1.0, 2.0, Yaw(0.5), 3.0, autopilot.THROTTLE), (0, 0, 0)),
    (goal.body_rates(1.0, 2.0, 0.5, 3.0, autopilot.POSITION), (0, 0, 1)),
    (goal.motors(1.0, 2.0, 3.0, 0.5), (0, 0, 0)),
])  # fmt: skip
def test_of_a_goal_positions_alone_are_in_the_vehicles_own_frame(of: goal.Goal, held: Any, origin_m: Any) -> None:
    vehicle = Vehicle("B", NATIVE, Start(START_M), Samples(25, 0), "B/", origin_m)
    vehicle.set_goal(of)
    places = [value + held * origin for value, held, origin in zip((1, 2, 3), held, origin_m, strict=True)]
    assert vehicle.state["goal"].tolist() == [*places, 0.5]
    modes = [int(vehicle.state[name]) for name in ("xy_mode", "z_mode", "yaw_mode")]
    assert modes == [of.xy_mode, of.z_mode, of.yaw_mode]


def test_all_fly_in_the_same_air() -> None:
    """At 3 km its density is 0.909 kg/m^3, at AirSim's 122 m 1.211: rotors of the same speed lift less."""
    lifts_m_s2 = []
    for above_sea_m in (3000, 122):
        origin = {"Latitude": 47, "Longitude": -122, "Altitude": above_sea_m}
        own = {"OriginGeopoint": origin, "Wind": {"X": 3, "Y": -1}, "Vehicles": {"A": {}, "B": ASIDE}}
        world, settings = World("blocks", NATIVE), Settings.model_validate(own)
        settings.prepare(world)
        api = Api(Simulation(world), settings, render=False)
        assert call(api, "simAddVehicle", "C", "simpleflight", pose(-5.0, -5.0, 0.0), "") is True
        for name in "ABC":
            call(api, "enableApiControl", True, name)
            call(api, "moveByMotorPWMs", *[0.9] * 4, 1.0, name)
        go_on(api, 0.2)
        states = [call(api, "simGetGroundTruthKinematics", name) for name in "ABC"]
        lifts_m_s2.append([9.80665 - state["linear_acceleration"]["z_val"] for state in states])
        for wind in ([3.0, -1.0, 0.0], [0.0, 2.0, -0.5]):
            assert [vehicle.state["wind"].tolist() for vehicle in world.vehicles] == [wind] * 3
            call(api, "simSetWind", point(0.0, 2.0, -0.5))
        assert lifts_m_s2[-1] == pytest.approx([lifts_m_s2[-1][0]] * 3, rel=3e-3)
    assert np.array(lifts_m_s2[0]) / lifts_m_s2[1] == pytest.approx([0.909 / 1.211] * 3, rel=0.02)


def test_one_may_be_added_while_others_fly() -> None:
    """A flight goes on to the bit; the newcomer stands, and its name is taken."""
    ends = []
    for adding in (False, True):
        api = hovering_alone()
        dash(api, "", 1.0, 1.0)
        go_on(api, 1.0)
        if adding:
            assert call(api, "simAddVehicle", "New", "simpleflight", pose(3.0, -6.0, 0.0), "") is True
        go_on(api, 2.0)
        ends.append(place(api))
    assert np.array_equal(ends[0], ends[1])
    assert call(api, "listVehicles") == ["New", "SimpleFlight"]
    call(api, "enableApiControl", True, "New")
    fly(api, "takeoff", 20.0, "New")
    np.testing.assert_allclose(place(api, "New"), (0.0, 0.0, -2.0), atol=0.6)
    assert call(api, "listVehicles") == ["New", "SimpleFlight"]


def test_a_newcomer_stands_level_at_its_pose() -> None:
    """A quarter turn to the right and on its side: of the latter nothing is left; its own frame is not turned."""
    api, half = hovering_alone(), 0.5**0.5
    tilted = {"w_val": half * half, "x_val": half * half, "y_val": half * half, "z_val": half * half}
    call(api, "simAddVehicle", "New", "SimpleFlight", pose(3.0, -6.0, -1.0, **tilted))
    vehicle = api.scenery.vehicle("New")
    assert vehicle.place_m == pytest.approx((3.0, -6.0, -1.045))
    told = call(api, "simGetVehiclePose", "New")
    assert list(told["position"].values()) == pytest.approx([0.0, 0.0, 0.0])
    assert list(told["orientation"].values()) == pytest.approx([half, 0.0, 0.0, half])
    call(api, "simSetVehiclePose", pose(2.0, 0.0, -3.0), True, "New")
    assert vehicle.place_m == pytest.approx((5.0, -6.0, -4.045))


@pytest.mark.parametrize("name", ["\0", "A\0B", "\n", "A\tB", "\udcff", "A" * 257, "", "A/B", "SimpleFlight"])
def test_one_that_cannot_be_added_changes_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor does one of which no model can be made."""

    def full(*_: object, **__: object) -> None:
        raise MemoryError("no room for a model")

    ends = []
    for refused in (True, False):
        api = hovering_alone()
        dash(api, "", 1.0, 1.0)
        if refused:
            with pytest.raises(rpc.RpcError, match="a vehicle cannot be called"):
                call(api, "simAddVehicle", name, "simpleflight", pose(3.0, -6.0, 0.0), "")
            monkeypatch.setattr("uavaccel.sim.world.load_scene", full)
            with pytest.raises(rpc.RpcError, match="no room for a model"):
                call(api, "simAddVehicle", "New", "simpleflight", pose(3.0, -6.0, 0.0), "")
            monkeypatch.undo()
        go_on(api, 1.0)
        ends.append(place(api).tolist())
        assert call(api, "listVehicles") == ["SimpleFlight"]
    assert ends[0] == ends[1]
    call(api, "reset")
    assert place(api)[2] == START_M[2]


def hovering_alone() -> Api:
    """In a world of its own, which may be populated."""
    api = made()
    call(api, "enableApiControl", True)
    return api


def test_two_that_meet_have_touched_each_other() -> None:
    api = fleet(A={}, B=ASIDE)
    call(api, "simSetVehiclePose", pose(2.0 - 5.0, -5.0, -9.97), True, "B")  # 2 m before A, in B's frame
    dash(api, "A", 2.0, 0.0)
    dash(api, "B", -2.0, 0.0)
    go_on(api, 2.0)
    told = {name: call(api, "simGetCollisionInfo", name) for name in ("A", "B")}
    assert [told[name]["has_collided"] for name in ("A", "B")] == [True, True]
    assert (told["A"]["object_name"], told["B"]["object_name"]) == ("B", "A")
    assert told["A"]["normal"]["x_val"] < -0.9 < 0.9 < told["B"]["normal"]["x_val"]
    apart = told["B"]["position"]["x_val"] + 5.0 - told["A"]["position"]["x_val"]
    assert apart == pytest.approx(2 * 0.3418, abs=0.03), "each in its own frame"
    for name in ("A", "B"):
        where, impact = (np.array(list(told[name][key].values())) for key in ("position", "impact_point"))
        assert np.linalg.norm(impact - where) < 0.5


def test_a_games_collision_is_its_first_in_the_leads_frame() -> None:
    api = fleet(A={"X": -6, "Y": 2})
    first_ns = None
    for north in (3.0, 9.0):
        call(api, "simSetVehiclePose", pose(north, 0.0, -1.0), True, "A")
        fly(api, "moveByVelocity", 0.0, 0.0, 4.0, 1.0, 0, STRAIGHT, "A")
        found = call(api, "uavaccelCollision")
        first_ns = first_ns or found["time_ns"]
        assert (found["object"], found["time_ns"]) == ("ground", first_ns)
        assert found["position_m"] == pytest.approx([3.0, 0.0, -0.05], abs=0.1)
    latest_ns = call(api, "simGetCollisionInfo")["time_stamp"] - EPOCH_NS
    assert latest_ns > first_ns


def test_a_camera_sees_the_others_and_not_its_own_vehicle() -> None:
    """By MuJoCo's groups: the leading vehicle's cameras leave out its own."""
    model = fleet(A={}, B=ASIDE).simulation.world.model
    for body, groups in (("quadrotor", {DRONE_GROUP, 3}), ("B/quadrotor", {OTHERS_GROUP, 3})):
        assert set(model.geom_group[model.geom_bodyid == model.body(body).id]) == groups


def test_reset_brings_all_to_their_starts() -> None:
    api = fleet(A={}, B=ASIDE)
    running = dash(api, "B", 0.0, 2.0)
    fly(api, "takeoff", 20.0, "A")
    call(api, "reset")
    assert running.value is False
    assert place(api, "A").tolist() == list(START_M)
    assert place(api, "B").tolist() == [0.0, 0.0, 0.0]
    assert not call(api, "isApiControlEnabled", "B")
    assert not call(api, "simGetCollisionInfo", "B")["has_collided"]


@pytest.mark.parametrize(("vehicles", "text"), [
    ({"A": {"X": 45, "Z": -3}}, "Vehicles.A: position: .* inside block_north"),
    ({"A": {"Z": 3}}, "Vehicles.A: position: NED z has to be"),
    ({"A": {"X": 2e4}}, "Vehicles.A: position: north and east have to be within 10000 m"),
    ({"A": {}, "B/1": ASIDE}, "Vehicles: a vehicle cannot be called 'B/1'"),
])  # fmt: skip
def test_places_that_cannot_be_are_named(vehicles: Any, text: str) -> None:
    with pytest.raises(UserError, match=text):
        fleet(**vehicles)


def test_a_swarm_that_starts_at_one_place_starts_side_by_side() -> None:
    """As Unreal spawns what would touch; each vehicle's own frame begins where it does."""
    names = [f"D{number:02}" for number in range(20)]
    swarm: dict[str, Any] = {name: {"X": 1.0, "Y": -2.0, "Z": 0.0} for name in names}
    api = fleet(**swarm)
    places = [in_world(api, name) for name in names]
    assert min(np.linalg.norm(a - b) for a, b in pairwise(places)) == pytest.approx(0.75)
    assert [place(api, name).tolist() for name in names] == [[0.0, 0.0, 0.0]] * 20
    hovering = fleet(A={}, B={})
    assert place(hovering, "A").tolist() == place(hovering, "B").tolist() == list(START_M)
    assert in_world(hovering, "B").tolist() == [START_M[0], START_M[1] + 0.75, START_M[2]]


@PROFILES
def test_vehicles_that_start_in_the_air_are_handed_over_at_rest(profile: Profile) -> None:
    """AirSim's have fallen by the time that a script connects; their frames begin where they started."""
    api = made(profile, Vehicles={"A": {"Z": -2.0}, "B": {"X": 4.0, "Z": -0.1}})
    api.simulation.settle(0)
    assert api.simulation.time_ns == 0
    for name, high_m in (("A", 2.0), ("B", 0.1)):
        assert place(api, name) == pytest.approx((0.0, 0.0, high_m), abs=2e-3)
        told = call(api, "getMultirotorState", name)
        assert told["landed_state"] == 0
        forces = told["kinematics_estimated"]["linear_acceleration"]
        assert list(forces.values()) == pytest.approx([0.0] * 3, abs=1e-3)
        call(api, "enableApiControl", True, name)
        call(api, "takeoff", 20.0, name)  # refused while a vehicle moves
    go_on(api, 5.0)
    assert call(api, "simGetCollisionInfo", "A")["time_stamp"] == EPOCH_NS
    assert in_world(api, "A")[2] == pytest.approx(-2.0, abs=0.55)


def test_a_pose_inside_an_object_becomes_one_beside_it() -> None:
    api, inside = hovering_alone(), pose(45.0, 0.0, -6.0)
    with pytest.raises(rpc.RpcError, match="inside block_north"):
        call(api, "simSetVehiclePose", inside, False)
    call(api, "simSetVehiclePose", inside, True)
    put = place(api)
    assert 0.5 < np.linalg.norm(put - (45.0, 0.0, -6.0)) < 8.0
    go_on(api, 0.1)
    assert np.linalg.norm(place(api) - put) < 0.1, "nothing throws it"


def test_a_penetration_is_that_of_the_moment() -> None:
    """Fast against a face: the depth at each reading while the contact lasts."""
    api = hovering_alone()
    world = api.simulation.world
    motion = {"linear_velocity": point(15, 0, 0), "angular_velocity": STILL}
    call(api, "simSetKinematics", pose(41.0, 0.0, -6.0) | motion, True)
    deepest_m, own = 0.0, mujoco.MjData(world.model)
    for _ in range(100):
        go_on(api, 0.002)
        own.qpos[:] = world.data.qpos
        mujoco.mj_fwdPosition(world.model, own)
        told_m = call(api, "simGetCollisionInfo")["penetration_depth"]
        if own.ncon and world.lead.field["contacts"][0]:
            assert told_m == pytest.approx(-own.contact.dist[: own.ncon].min(), abs=1e-9)
            deepest_m = max(deepest_m, told_m)
    assert deepest_m > 0.02


def test_who_leads() -> None:
    """The first by the alphabet as in AirSim, or who is watched; who is not created is not there."""
    settings = Settings.model_validate({"Vehicles": {"Z": {}, "B": ASIDE}})
    assert settings.vehicle == "B"
    watched = {"Vehicles": {"Z": {"IsFpvVehicle": True}, "B": ASIDE, "A": {"AutoCreate": False}}}
    assert Settings.model_validate(watched).vehicle == "Z"
    assert [name for name, _ in Settings.model_validate(watched).created()] == ["B", "Z"]


def test_in_computer_vision_mode_a_vehicle_is_a_camera_that_stays() -> None:
    """Below the ground too."""
    api = made(SimMode="ComputerVision")
    assert call(api, "listVehicles") == ["ComputerVision"]
    for down in (-3.0, 3.0):
        call(api, "simSetVehiclePose", pose(7.0, 1.0, down), True)
        go_on(api, 2.0)
        assert call(api, "simGetVehiclePose")["position"] == point(*place(api)) == point(7.0, 1.0, down)
    assert api.simulation.time_ns == 4_000_000_000
    for method, params in (("takeoff", [1.0]), ("enableApiControl", [True]), ("getMultirotorState", [])):
        with pytest.raises(rpc.RpcError, match="this is simulation-only API or this vehicle does not exist"):
            call(api, method, *params)


def test_each_senses_for_itself() -> None:
    """Every number is the vehicle's own, in its own frame: none is the leading one's."""
    lidar = {"Sensors": {"eye": {"SensorType": 6, "Enabled": True, "DrawDebugPoints": False}}}
    api = fleet(A={}, B={"X": 20, "Y": 10, "Z": -1} | lidar)
    call(api, "simSetVehiclePose", pose(1.0, 2.0, -4.0, z_val=1.0), True, "B")
    in_world = np.array([21.0, 12.0, -5.045])
    state = call(api, "getMultirotorState", "B")["gps_location"]
    environment = call(api, "simGetGroundTruthEnvironment", "B")
    assert environment["geo_point"] == state
    assert list(environment["position"].values()) == pytest.approx([1.0, 2.0, -4.0])
    assert state["altitude"] == pytest.approx(122.0 + 5.045, abs=1e-3)
    assert call(api, "getHomeGeoPoint", "B")["latitude"] > call(api, "getHomeGeoPoint", "A")["latitude"]
    camera = call(api, "simGetCameraInfo", "front_center", "B")["pose"]["position"]
    assert list(camera.values()) == pytest.approx([1.0, 2.46, -4.0], abs=1e-6), "it looks east"
    seen = list(call(api, "simGetObjectPose", "B")["position"].values())
    assert seen == pytest.approx(in_world.tolist()), "objects are told in the world's frame"
    assert call(api, "simListSceneObjects", "[AB]") == ["A", "B"]
    assert call(api, "simSetObjectPose", "B", pose(21.0, 12.0, -6.045), True) is True
    assert place(api, "B") == pytest.approx([1.0, 2.0, -5.0])
    points = np.reshape(call(api, "getLidarData", "eye", "B")["point_cloud"], (-1, 3))
    assert np.linalg.norm(points, axis=1).min() > 1.0, "it does not see itself"
    with pytest.raises(rpc.RpcError, match="No lidar with name eye exist on vehicle"):
        call(api, "getLidarData", "eye", "A")


def test_each_takes_off_over_its_own_place() -> None:
    api = fleet(A={"X": -6, "Y": 2}, B=ASIDE)
    begun = {name: in_world(api, name) for name in ("A", "B")}
    call(api, "moveToPosition", 3.0, -2.0, -2.0, 2.0, FOR_EVER, 0, STRAIGHT, -1.0, 1.0, "B")
    go_on(api, 8.0)
    call(api, "land", 30.0, "B")
    go_on(api, 15.0)
    begun["B"] = in_world(api, "B")
    assert begun["B"][:2] == pytest.approx((8.0, 3.0), abs=0.7), "not at its origin"
    for name in ("A", "B"):
        fly(api, "takeoff", 20.0, name)
        go_on(api, 3.0)
        risen = in_world(api, name) - begun[name]
        assert risen == pytest.approx((0.0, 0.0, -2.0), abs=0.55)
        assert np.hypot(*risen[:2]) < 0.1


def test_each_flies_to_the_place_on_the_earth_that_it_is_told() -> None:
    """By its own origin: the same degrees lead both to one place in the world, whose degrees these are."""
    api = fleet(A={"X": -6, "Y": 2}, B=ASIDE)
    north = math.degrees(12.0 / 6_378_137)
    for name, height in (("A", 122.0 + 6.0), ("B", 122.0 + 9.0)):
        where = [47.641468 + north, -122.140165, height]
        fly(api, "moveToGPS", *where, 4.0, 30.0, 0, STRAIGHT, -1.0, 1.0, name)
        go_on(api, 3.0)
        assert in_world(api, name) == pytest.approx((12.0, 0.0, 122.0 - height), abs=0.6)


def in_world(api: Api, name: str) -> NDArray[np.float64]:
    return np.array(api.scenery.pilot(name).vehicle.state["position"])


@pytest.mark.parametrize("frame", ["VehicleInertialFrame", "SensorLocalFrame"])
def test_a_lidar_scans_around_its_own_vehicle(frame: str) -> None:
    """All of a scan: as many azimuths for each channel, the upmost channel first; the ground where it is."""
    lidar = {
        "SensorType": 6, "NumberOfChannels": 4, "PointsPerSecond": 4_000, "HorizontalFOVEnd": 360, "DataFrame": frame,
        "VerticalFOVUpper": -20, "VerticalFOVLower": -50, "X": 0.5, "Yaw": 90,
    }  # fmt: skip
    api = fleet(A={}, B={"X": -20, "Y": 10, "Z": -1, "Sensors": {"eye": lidar}})
    call(api, "simSetVehiclePose", pose(2.0, 1.0, -4.0), True, "B")
    told = call(api, "getLidarData", "eye", "B")
    points = np.reshape(told["point_cloud"], (-1, 3)).astype(float)
    assert list(told["pose"]["position"].values()) == pytest.approx([2.5, 1.0, -4.0])
    eye = [2.5, 1.0, -4.0] if frame == "VehicleInertialFrame" else [0.0, 0.0, 0.0]
    assert points.shape == (400, 3)
    rays = points - eye
    down = np.degrees(np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])))
    np.testing.assert_allclose(down, np.repeat([20.0, 30.0, 40.0, 50.0], 100), atol=1e-3)
    bearing = np.degrees(np.arctan2(rays[:, 1], rays[:, 0])) - (90.0 if frame == "VehicleInertialFrame" else 0.0)
    turned = (bearing - np.tile(np.arange(100) * 3.6, 4) + 180) % 360 - 180
    np.testing.assert_allclose(turned, 0.0, atol=1e-3)
    np.testing.assert_allclose(rays[:, 2], 1.045 + 4.0, atol=1e-4)  # its frame begins 1.045 m above the ground


def test_a_lidar_sees_other_vehicles_and_not_the_one_that_carries_it() -> None:
    """From 0.3 m above its middle, straight down: A on the ground, B on A, 4 m above it."""
    lidar = {"SensorType": 6, "NumberOfChannels": 1, "Z": -0.3, "VerticalFOVUpper": -89.9, "VerticalFOVLower": -89.9}
    sensors = {"Sensors": {"eye": lidar | {"DataFrame": "SensorLocalFrame"}}}
    api = fleet(A={"X": 0, "Y": 0} | sensors, B=ASIDE | sensors)
    call(api, "simSetVehiclePose", pose(-5.0, -5.0, -4.0), True, "B")
    down = {}
    for name in ("A", "B"):
        points = np.reshape(call(api, "getLidarData", "eye", name)["point_cloud"], (-1, 3))
        down[name] = float(np.median(points[:, 2]))
    assert down["A"] == pytest.approx(0.345, abs=1e-3)
    assert down["B"] == pytest.approx(4.3, abs=0.1), "A's upper side"
    assert down["B"] < 4.3


def test_a_distance_is_measured_through_its_own_vehicle() -> None:
    """From its middle: down to the ground, up into nothing, and from above down to the other vehicle's upper side."""
    quiet = {"SensorType": 5, "UncorrelatedNoiseSigma": 0.0}
    sensors = {"Sensors": {"Down": quiet | {"Pitch": -90}, "Up": quiet | {"Pitch": 90, "MaxDistance": 30}}}
    api = fleet(A={"X": 0, "Y": 0} | sensors, B=ASIDE | sensors)

    def told(sensor: str, vehicle: str) -> float:
        return float(call(api, "getDistanceSensorData", sensor, vehicle)["distance"])

    for name in ("A", "B"):
        call(api, "simSetVehiclePose", pose(0.0, 0.0, -6.0), True, name)
        assert [told(sensor, name) for sensor in ("Down", "Up")] == pytest.approx([6.045, 30.0], abs=1e-3)
    call(api, "simSetVehiclePose", pose(-5.0, -5.0, -10.0), True, "B")  # 4 m above A
    assert told("Down", "B") == told("Up", "A") == pytest.approx(4.0 - 0.02, abs=1e-3), "the body, not the hull"


def test_a_vehicle_sees_past_itself_and_not_past_others() -> None:
    api = fleet(A={}, B=ASIDE)

    def sees(vehicle: str, *place_m: Any) -> bool:
        return bool(
            call(api, "simTestLineOfSightToPoint", geographic(place_m, api.scenery.settings.home)._asdict(), vehicle)
        )

    call(api, "simSetVehiclePose", pose(5.0, 5.0, -6.0), True, "A")
    call(api, "simSetVehiclePose", pose(0.0, 0.0, -10.0), True, "B")
    for vehicle in ("A", "B"):
        assert sees(vehicle, 10.0, 12.0, -8.0)
        assert not sees(vehicle, 60.0, 5.0, -5.0), "behind block_north"
    assert not sees("B", 5.0, 5.0, -2.0), "A is below it"
    assert not sees("A", 5.0, 5.0, -14.0), "B is above it"
    call(api, "simSetVehiclePose", pose(0.0, 9.0, -10.0), True, "B")
    assert sees("A", 5.0, 5.0, -14.0)


def test_a_camera_sees_through_its_own_vehicle_alone() -> None:
    """By rays: what is detected, and the normals of surfaces, of which the sky has none."""
    mast = {"X": 5, "Y": 5, "Z": -30, "Pitch": -90}
    small = [{"ImageType": 6, "Width": 33, "Height": 33, "FOV_Degrees": 20}]
    settings: dict[str, Any] = {"CameraDefaults": {"CaptureSettings": small}, "ExternalCameras": {"mast": mast}}
    api = made(render=True, **settings, Vehicles={"A": {"X": -30, "Y": -30}, "B": ASIDE})

    def normals(camera: str, vehicle: str, external: bool) -> NDArray[np.uint8]:
        request = {"camera_name": camera, "image_type": 6, "compress": False}
        (picture,) = call(api, "simGetImages", [request], vehicle, external)
        return np.frombuffer(picture["image_data_uint8"], np.uint8).reshape(33, 33, 3)

    for vehicle in ("A", "B"):
        call(api, "simSetVehiclePose", pose(0.0, 0.0, -6.0), True, vehicle)
        call(api, "simSetCameraPose", "0", pose(0.0, 0.0, 0.0), vehicle)
        assert call(api, "simAddDetectionFilterMeshName", "0", 0, "block_north", vehicle) is None
        assert [each["name"] for each in call(api, "simGetDetections", "0", 0, vehicle)] == ["block_north"]
        call(api, "simSetCameraPose", "0", pose(0.0, 0.0, 0.0, w_val=0.5**0.5, y_val=-(0.5**0.5)), vehicle)
        ground = normals("0", vehicle, False)
        assert (ground == np.array([255, 128, 128], np.uint8)).all(), "blue, which is up, and nothing of itself"
        for other in ("A", "B"):  # below the mast, one after the other
            call(api, "simSetVehiclePose", pose(0.0, 90.0, -6.0), True, other)
        local = {"A": (35.0, 35.0), "B": (0.0, 0.0)}[vehicle]
        call(api, "simSetVehiclePose", pose(*local, -28.0, w_val=0.9, x_val=0.436), True, vehicle)
        seen = normals("mast", "", True)
        assert not (seen[16, 16] == [255, 128, 128]).all(), "a side of the tilted vehicle"
        assert (seen[0, 0] == [255, 128, 128]).all()


def test_noise_is_each_vehicles_own_and_each_axis_own() -> None:
    biased = {"Sensors": {"field": {"SensorType": 4, "NoiseSigma": 0.0, "NoiseBias": 0.3}}}
    quiet = {"Sensors": {"field": {"SensorType": 4, "NoiseSigma": 0.0}}}
    errors = []
    for kind in (biased, quiet):
        api = fleet(A=kind, B=ASIDE | kind)
        told = [call(api, "getMagnetometerData", "", name)["magnetic_field_body"] for name in ("A", "B")]
        errors.append(np.array([list(each.values()) for each in told]))
    bias = errors[0] - errors[1]
    assert len(np.unique(bias.round(6))) == 6
    assert 0.01 < np.abs(bias).max() <= 0.3
    api = fleet(A={}, B=ASIDE)
    call(api, "takeoff", 20.0, "A")
    for method, field in (("getImuData", "angular_velocity"), ("getBarometerData", "pressure")):
        told = [call(api, method, "", name)[field] for name in ("A", "B")]
        assert told[0] != told[1]


def test_a_receiver_tells_where_its_vehicle_is_now() -> None:
    api = fleet(A={}, B={"X": 20, "Y": 10})
    call(api, "simSetVehiclePose", pose(0.0, 0.0, -30.0), True, "B")
    go_on(api, 5.0)
    before = call(api, "getGpsData", "", "B")
    call(api, "simSetVehiclePose", pose(100.0, -50.0, -30.0), True, "B")
    go_on(api, 0.5)
    after = call(api, "getGpsData", "", "B")
    begun, ended = (each["gnss"]["geo_point"] for each in (before, after))
    degree_m = np.pi * 6_378_137 / 180
    assert (ended["latitude"] - begun["latitude"]) * degree_m == pytest.approx(100.0, rel=0.01)
    east_m = (ended["longitude"] - begun["longitude"]) * degree_m * np.cos(np.radians(begun["latitude"]))
    assert east_m == pytest.approx(-50.0, rel=0.01)
    assert after["time_stamp"] - before["time_stamp"] == 500_000_000
    there = call(api, "simGetGroundTruthEnvironment", "B")["geo_point"]
    assert ended["latitude"] == pytest.approx(there["latitude"], abs=1e-6)


def test_ids_that_were_given_stay_when_a_vehicle_is_added() -> None:
    api = fleet(A={}, B=ASIDE)
    given = {"block_north": 200, "B": 201}
    for name, number in given.items():
        assert call(api, "simSetSegmentationObjectID", name, number, False) is True
    call(api, "simAddVehicle", "C", "simpleflight", pose(-9.0, 9.0, 0.0), "")
    assert {name: call(api, "simGetSegmentationObjectID", name) for name in given} == given
    call(api, "simSetSegmentationObjectID", "C", 7, False)
    assert [call(api, "simGetSegmentationObjectID", name) for name in ("A", "B", "C")][1:] == [201, 7]


@pytest.mark.opengl
def test_each_sees_through_its_own_cameras() -> None:
    """Downwards, from different heights; and ahead, where one looks at the other's back."""
    api = made(render=True, Vehicles={"A": {"X": 0, "Y": 0}, "B": {"X": -30, "Y": -30, "Yaw": 180}})
    heights = {"A": 10.0, "B": 25.0}
    for name, height_m in heights.items():
        call(api, "simSetVehiclePose", pose(0.0, 0.0, 0.045 - height_m), True, name)
        request = {"camera_name": "3", "image_type": 1, "pixels_as_float": True, "compress": False}
        (picture,) = call(api, "simGetImages", [request], name)
        depth_m = np.reshape(picture["image_data_float"], (144, 256))
        np.testing.assert_allclose(depth_m[70:74, 120:136], height_m - 0.12, rtol=2e-3)
        told = list(picture["camera_position"].values())
        assert told == pytest.approx([0.0, 0.0, 0.045 - height_m + 0.12], abs=1e-6)


# --- poses and winds ------------------------------------------------------------------------------


def test_kinematics_can_be_set() -> None:
    api = hovering()
    turned = {"w_val": 0.8, "z_val": 0.6}
    state = pose(3.0, 4.0, -12.0, **turned)
    state |= {"linear_velocity": point(5.0, -1.0, 0.5), "angular_velocity": point(0.1, 0.2, -0.3)}
    call(api, "simSetKinematics", state, True)
    now = call(api, "simGetGroundTruthKinematics")
    for name in ("position", "orientation", "linear_velocity", "angular_velocity"):
        assert list(now[name].values()) == pytest.approx(list(state[name].values()), abs=1e-9), name
    go_on(api, 0.1)
    assert place(api)[:2] == pytest.approx((3.5, 3.9), abs=0.05)


@pytest.mark.parametrize("z", [0.0, 0.02, 0.5, 3.0, 200.0])
@pytest.mark.parametrize("turn", [{}, {"w_val": 0.7071, "y_val": 0.7071}], ids=["level", "on its nose"])
def test_a_pose_in_the_ground_is_on_it(z: float, turn: dict[str, float]) -> None:
    """AirSim takes any, and its collisions push the vehicle out; nothing throws it."""
    asked, hull_m = pose(3.0, 4.0, z, **turn), 0.3418 if turn else 0.045
    for method, params in (
        ("simSetVehiclePose", [asked, True]),
        ("simSetKinematics", [asked | {"linear_velocity": STILL, "angular_velocity": STILL}, True]),
        ("simSetObjectPose", ["SimpleFlight", asked, True]),
    ):
        api = hovering()
        call(api, "armDisarm", False)
        call(api, "enableApiControl", False)
        call(api, method, *params)
        assert place(api) == pytest.approx((3.0, 4.0, -hull_m), abs=2e-3)
        for _ in range(20):
            go_on(api, 0.02)
            assert -hull_m - 0.02 < place(api)[2] < 0.0


def test_newcomers_stand_on_the_ground_side_by_side() -> None:
    """As Unreal adjusts what it spawns; of several at once one that is too near to another is refused with all."""
    api = hovering_alone()
    for name in ("Second", "Third", "Fourth"):
        call(api, "simAddVehicle", name, "SimpleFlight", pose(5.0, 0.2, 2.0))
        assert call(api, "getMultirotorState", name)["landed_state"] == 0
    stand = [vehicle.place_m for vehicle in api.simulation.world.vehicles[1:]]
    np.testing.assert_allclose(stand, [(5.0, east, -0.045) for east in (0.2, 0.95, 1.7)], atol=2e-4)
    for near in ((5.0, 0.3, -0.2), (20.5, 0.0, -5.0)):
        far = AddedVehicle("Far", Start((20.0, 0.0, -5.0)))
        with pytest.raises(UserError, match=r"Near would start less than 0\.75 m from (Second|Far)"):
            api.simulation.add_vehicles([far, AddedVehicle("Near", Start(near))])
    assert len(api.simulation.pilots) == len(api.simulation.world.vehicles) == 4


@pytest.mark.parametrize("profile", [NATIVE, AIRSIM], ids=["native", "airsim"])
def test_no_wind_that_is_allowed_ends_the_flight(profile: Profile) -> None:
    api = hovering(profile)
    for wind in ((100.0, 0.0, 0.0), (0.0, 0.0, -100.0), (57.0, -57.0, 57.0)):
        call(api, "reset")
        api.simulation.world.set_wind(wind)
        go_on(api, 5.0)
        assert api.simulation.failure is None
        assert np.isfinite(place(api)).all()
    with pytest.raises(UserError, match=r"wind: .* is not a wind of at most 100 m/s"):
        api.simulation.world.set_wind((0.0, 100.1, 0.0))
    api.simulation.world.set_wind((0.0, 0.0, 0.0))


# --- many -----------------------------------------------------------------------------------------


def test_many_fly_and_the_last_command_wins() -> None:
    world = World("blocks", NATIVE)
    simulation = Simulation(world)
    places = [(-20.0 + 3 * (index % 10), -15.0 + 3 * (index // 10), -15.0) for index in range(1, MANY)]
    simulation.add_vehicles([AddedVehicle(f"V{index}", Start(place_m)) for index, place_m in enumerate(places)])
    api = Api(simulation, render=False)
    names = [vehicle.name for vehicle in world.vehicles]
    replies: dict[str, list[Any]] = {name: [] for name in names}
    for name in names:
        call(api, "enableApiControl", True, name)
    for turn in range(3):
        for index, name in enumerate(names):
            replies[name].append(call(api, "moveByVelocityZ", 0.0, 0.0, -16.0 - index % 3, 9.0, 0, STRAIGHT, name))
        go_on(api, 0.5 + turn)
    go_on(api, 9.0)
    assert all([reply.value for reply in replies[name]] == [False, False, True] for name in names)
    heights = [place(api, name)[2] for name in names]
    np.testing.assert_allclose(heights, [-16.0 - index % 3 for index in range(MANY)], atol=0.2)
