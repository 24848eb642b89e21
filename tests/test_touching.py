"""What the vehicle touches: told once each time, with where and how; at rest it is at rest; where it cannot be put."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.simulating import fly_velocity, go_to, simulate
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.poses import LEVEL
from uavaccel.sim.profile import AIRSIM, NATIVE, Profile
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.quadrotor import air_density
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Start
from uavaccel.sim.world import World
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.types import EPOCH_NS

PROFILES = pytest.mark.parametrize("profile", [NATIVE, AIRSIM], ids=lambda profile: profile.name)
HULL_HALF_HEIGHT_M, HULL_RADIUS_M = 0.045, 0.3418  # of quadrotor.xml
BLOCK_FACE_M = 42.0  # south face of blocks.xml's block_north


def vector(field: dict[str, float]) -> list[float]:
    return [field["x_val"], field["y_val"], field["z_val"]]


def collision(simulation: Simulation, api: Api) -> dict[str, Any]:
    info: dict[str, Any] = api.call("simGetCollisionInfo", [], simulation.wall_ns)
    return info


def dropped(profile: Profile, height_m: float) -> tuple[Simulation, Api]:
    """A vehicle without thrust, `height_m` up."""
    simulation = simulate(1.0, profile)
    simulation.lead.arm(False)
    simulation.world.lead.state["rotor_input"] = simulation.world.lead.state["rotor_lagged"] = 0.0
    simulation.world.lead.state["rotor_output"] = 0.0
    simulation.world.place((0.0, 0.0, -height_m))
    return simulation, Api(simulation)


@PROFILES
def test_every_touch_is_told_once_and_a_reset_forgets_it(profile: Profile) -> None:
    simulation, api = dropped(profile, 0.6)
    assert not collision(simulation, api)["has_collided"]
    fall_s = (2 * (0.6 - HULL_HALF_HEIGHT_M) / 9.80665) ** 0.5
    for touch in (1, 2):
        if touch == 2:  # lifted off, and dropped again
            simulation.world.data.qpos[2] = 0.6
            simulation.world.data.qvel[:] = 0.0
            start_s = simulation.world.tick * profile.tick_s
        else:
            start_s = 0.0
        go_to(simulation, round((start_s + fall_s) / profile.tick_s) - 2)
        assert not collision(simulation, api)["has_collided"]
        go_to(simulation, simulation.world.tick + 6)
        first, again = collision(simulation, api), collision(simulation, api)
        assert (first["has_collided"], again["has_collided"]) == (True, False)
        assert first["object_name"] == again["object_name"] == "ground"
        assert first["collision_count"] == touch
        stamp_s = (first["time_stamp"] - EPOCH_NS - simulation.time_of(0)) / 1e9
        assert stamp_s == pytest.approx(start_s + fall_s, abs=2 * profile.tick_s)
        np.testing.assert_allclose(vector(first["normal"]), [0.0, 0.0, -1.0], atol=1e-9)
        x, y, z = vector(first["impact_point"])
        assert np.hypot(x, y) <= HULL_RADIUS_M + 1e-9
        assert z == pytest.approx(0.0, abs=9.81 * fall_s * profile.tick_s)
        below_m = HULL_HALF_HEIGHT_M - simulation.world.data.qpos[2]  # of the hull's lower end at this moment
        assert first["penetration_depth"] == pytest.approx(below_m, abs=1e-9)
        assert 0.0 < below_m < 9.81 * fall_s * 6 * profile.tick_s
        if touch == 1:
            go_to(simulation, simulation.world.tick + round(0.5 / profile.tick_s))
            collision(simulation, api)
            simulation.world.lead.contact_log.count = 1  # however often it bounced
    api.call("reset", [], simulation.wall_ns)
    assert collision(simulation, api)["has_collided"] is False
    assert collision(simulation, api)["object_name"] == ""


def test_another_object_is_another_touch_during_the_first() -> None:
    """On the ground, pushed against a block's south face."""
    simulation, api = dropped(NATIVE, HULL_HALF_HEIGHT_M)
    simulation.world.place((BLOCK_FACE_M - HULL_RADIUS_M - 0.05, 0.0, -HULL_HALF_HEIGHT_M))
    go_to(simulation, 200)
    assert collision(simulation, api)["object_name"] == "ground"
    count = simulation.world.lead.contact_log.count
    simulation.world.data.qvel[0] = 1.5
    while (info := collision(simulation, api))["object_name"] == "ground" and simulation.world.tick < 400:
        go_to(simulation, simulation.world.tick + 1)
    assert (info["has_collided"], info["object_name"]) == (True, "block_north")
    assert simulation.world.lead.contact_log.count > count
    np.testing.assert_allclose(vector(info["normal"]), [-1.0, 0.0, 0.0], atol=1e-6)
    assert vector(info["impact_point"])[0] == pytest.approx(BLOCK_FACE_M, abs=0.01)
    assert simulation.world.lead.contact_log.first is not None
    assert simulation.world.lead.contact_log.first.object == "ground"


def test_a_teleport_keeps_the_velocity_and_what_was_touched() -> None:
    """As AirSim's setPose: only reading sets has_collided back."""
    simulation, api = dropped(NATIVE, 0.1)
    go_to(simulation, 300)
    simulation.world.data.qvel[:3] = 0.7, 0.0, 0.0
    pose = {
        "position": {"x_val": 0.0, "y_val": 0.0, "z_val": -0.1},
        "orientation": {"w_val": 1.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0},
    }
    api.call("simSetVehiclePose", [pose, True], simulation.wall_ns)
    assert simulation.kinematics().linear_velocity_m_s[0] == pytest.approx(0.7, abs=0.01)
    assert collision(simulation, api)["has_collided"]
    assert not collision(simulation, api)["has_collided"]
    go_to(simulation, 600)
    info = collision(simulation, api)
    assert (info["has_collided"], info["object_name"]) == (True, "ground")


@PROFILES
def test_a_vehicle_on_the_ground_is_at_rest_and_landed(profile: Profile) -> None:
    simulation, api = dropped(profile, HULL_HALF_HEIGHT_M)
    states = []
    for flying in (False, True):
        if flying:
            simulation.reset(simulation.wall_ns)
        go_to(simulation, simulation.world.tick + round(2.0 / profile.tick_s))
        states.append(api.call("getMultirotorState", [], simulation.wall_ns)["landed_state"])
        now = simulation.kinematics()
        np.testing.assert_allclose(now.linear_acceleration_m_s2, 0.0, atol=1e-3)
        np.testing.assert_allclose(now.linear_velocity_m_s, 0.0, atol=1e-4)
        np.testing.assert_allclose(now.angular_acceleration_rad_s2, 0.0, atol=1e-2)
    assert states == [0, 1]


def test_a_teleport_leaves_the_vehicle_where_it_was_told_to_be() -> None:
    """A little inside of a block's top too, which is no ground."""
    world = simulate().world
    for place in ((3.0, 4.0, -7.0), (-45.0, 0.0, -6.0), (-45.0, 0.0, -6.001)):
        world.teleport(world.lead, place, LEVEL)
        assert world.lead.place_m == place
    world.teleport(world.lead, (3.0, 4.0, 5.0), LEVEL)
    assert world.lead.place_m == pytest.approx((3.0, 4.0, -HULL_HALF_HEIGHT_M), abs=1e-9)


def test_in_the_lane_a_teleport_ends_a_collision() -> None:
    world = World("lane", NATIVE)
    world.place((5.0, 4.0, -2.0), velocity_m_s=(0.0, 8.0, 0.0))
    assert world.advance(500) < 500
    assert world.lead.collision_tick is not None
    world.teleport(world.lead, (5.0, 0.0, -2.0), LEVEL, (0.0, 0.0, 0.0))
    assert world.lead.contact_log.count == 0
    assert world.advance(100) == 100
    assert world.lead.place_m == pytest.approx((5.0, 0.0, -2.0), abs=0.2)


def test_in_free_fall_it_is_not_landed_and_feels_gravity() -> None:
    simulation, _ = dropped(NATIVE, 5.0)
    go_to(simulation, 20)
    assert not simulation.world.lead.landed
    np.testing.assert_allclose(simulation.kinematics().linear_acceleration_m_s2, [0, 0, 9.80665], atol=0.05)


def test_the_velocity_is_that_of_the_path_while_contacts_push() -> None:
    """Midway between two drifts, whatever pushed: a central difference of the positions, tilted on the ground."""
    simulation, _ = dropped(NATIVE, 0.3)
    simulation.world.place((0.0, 0.0, -0.3), (0.95, 0.3, 0.05, 0.0), (1.0, 0.5, 0.0))
    dt, positions, velocities, touching = NATIVE.tick_s, [], [], []
    for tick in range(300):
        go_to(simulation, tick)
        positions.append(np.array(simulation.kinematics().position_m))
        velocities.append(np.array(simulation.kinematics().linear_velocity_m_s))
        touching.append(bool(simulation.world.lead.state["contacts"]))
    central = (np.array(positions)[2:] - np.array(positions)[:-2]) / (2 * dt)
    pushed = np.array(touching)[:-2] & np.array(touching)[1:-1] & np.array(touching)[2:]
    assert pushed.sum() > 20
    error = np.linalg.norm(central - np.array(velocities)[1:-1], axis=1)
    without_push = 0.5 * dt * 9.8
    assert np.median(error[pushed]) < 0.5 * without_push


# --- where it can be put ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ((0.0, 0.0, 0.2), "not 0.2"),
        ((0.0, 0.0, -44_500.0), "thin air"),
        ((0.0, 0.0, float("nan")), "NED z"),
        ((45.0, 0.0, -6.0), "m inside block_north"),
    ],
)
def test_where_nothing_can_fly_nothing_is_put(place: Any, text: str) -> None:
    ends = []
    for refused in (False, True):
        simulation = simulate()
        go_to(simulation, 100)
        fly_velocity(simulation, VelocityGoal((1.0, 0.0, 0.0)), 5.0, simulation.wall_ns)
        go_to(simulation, 300)
        if refused:
            with pytest.raises(UserError, match=text):
                simulation.world.place(place)
            with pytest.raises(UserError, match=text):
                simulation.reset(simulation.wall_ns, place)
        go_to(simulation, 1000)
        ends.append(simulation.world.lead.kinematics())
    assert ends[0] == ends[1], "a refusal changes nothing"


def test_the_ground_and_the_top_of_the_air_can_be_flown_from() -> None:
    simulation, _ = dropped(NATIVE, 1.0)
    for z_m in (0.0, -HULL_HALF_HEIGHT_M, -15_000.0, 122.0 - 20_000.0):
        simulation.world.place((0.0, 0.0, z_m))
        go_to(simulation, simulation.world.tick + 1000)
        assert simulation.failure is None
        now = simulation.kinematics()
        assert np.isfinite(now.position_m).all()
        assert z_m < -1000.0 or -0.1 < now.position_m[2] < 0.0, "thrown"


def test_a_place_on_the_wire_is_refused_with_one_line() -> None:
    simulation = simulate()
    pose = {
        "position": {"x_val": 0.0, "y_val": 0.0, "z_val": -3e4},
        "orientation": {"w_val": 1.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0},
    }
    with pytest.raises(rpc.RpcError, match=r"ground\), not -30000\.$"):
        Api(simulation).call("simSetVehiclePose", [pose, True], 0)


def test_the_air_is_the_standard_atmospheres() -> None:
    """Hydrostatic balance, integrated over geopotential heights: 6.5 K per km colder up to 11 km, then no more."""
    heights_m = np.arange(0.0, 20_000.0)
    temperature = np.maximum(288.15 - 0.0065 * (heights_m + 0.5), 216.65)
    pressure = 101_325 * np.exp(-np.cumsum(9.80665 / (287.053 * temperature)))  # at the metre's upper end
    for height_m in (1, 122, 5_000, 10_999, 11_001, 11_500, 15_000, 19_999):
        kelvin = max(288.15 - 0.0065 * height_m, 216.65)
        altitude_m = 6_378_137.0 * height_m / (6_378_137.0 - height_m)
        assert air_density(altitude_m) == pytest.approx(pressure[height_m - 1] / 287.053 / kelvin, rel=1e-3)


def test_air_gets_thinner_and_never_ends() -> None:
    densities = np.array([air_density(altitude) for altitude in np.linspace(-500, 60_000, 500)])
    assert np.isfinite(densities).all()
    assert (densities > 0).all()
    assert (np.diff(densities) < 0).all()


@pytest.mark.parametrize(
    ("contacts", "speed_m_s", "landed"), [(1, 0.0, True), (1, 0.049, True), (1, 0.051, False), (0, 0.0, False)]
)
def test_what_touches_something_and_rests_has_landed(contacts: int, speed_m_s: float, landed: bool) -> None:
    """In whichever direction it moves."""
    vehicle = simulate().world.lead
    vehicle.state["contacts"] = contacts
    for direction in np.eye(3):
        vehicle.state["velocity"] = speed_m_s * direction
        assert vehicle.landed is landed


def test_a_vehicle_that_is_placed_has_touched_nothing() -> None:
    simulation, _ = dropped(NATIVE, 0.5)
    world = simulation.world
    go_to(simulation, 500)
    assert (world.lead.collision_tick is not None, world.lead.contact_log.count > 0) == (True, True)
    world.place((0.0, 0.0, -5.0))
    assert (world.lead.collision_tick, world.lead.contact_log.count) == (None, 0)
    assert (world.lead.contact_log.first, world.lead.contact_log.read()) == (None, False)


def test_what_was_touched_is_known_after_another_vehicle_came() -> None:
    world = World("blocks", NATIVE)
    world.place((0.0, 0.0, -0.5))
    world.lead.state["armed"] = 0
    world.advance(500)
    log = world.lead.contact_log
    before = log.count, log.first, log.latest
    assert before[0] > 0
    world.add_vehicles([AddedVehicle("Second", Start((5.0, 0.0, -3.0)))])
    assert (world.lead.contact_log.count, world.lead.contact_log.first, world.lead.contact_log.latest) == before
    assert world.lead.contact_log.read()


def test_gains_are_restored_whichever_were_set() -> None:
    """Four levels, and what their integral and derivative parts are made of."""
    vehicle = simulate().world.lead
    names = [f"{level}_gain" for level in ("position", "velocity", "angle", "rate", "integral", "derivative")]
    names += ["z_integral_gain", "full_pid"]
    before = {name: vehicle.parameters[name].copy() for name in names}
    for level in ("position", "velocity", "angle", "rate"):
        vehicle.set_gains(level, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (0.7, 0.8, 0.9))
        assert vehicle.parameters[f"{level}_gain"].tolist() == [0.1, 0.2, 0.3]
    assert all((vehicle.parameters[name] != before[name]).any() for name in names)
    vehicle.restore_gains()
    assert all(np.array_equal(vehicle.parameters[name], before[name]) for name in names)
