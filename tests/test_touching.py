"""What the vehicle touches: told once each time, with where and how; at rest it is at rest; where it cannot be put."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
import pytest

from tests.simulating import fly_velocity, go_to, put_vehicle, simulate
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.lane import layout_from
from uavaccel.sim.poses import LEVEL
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.quadrotor import air_density
from uavaccel.sim.vehicle.vehicle import Start, Vehicle
from uavaccel.sim.world import World

HULL_HALF_HEIGHT_M = 0.045  # of quadrotor.xml


def dropped(height_m: float) -> Simulation:
    """A vehicle without thrust, `height_m` up."""
    simulation = simulate()
    simulation.lead.arm(False)
    simulation.world.lead.state["rotor_input"] = simulation.world.lead.state["rotor_lagged"] = 0.0
    simulation.world.lead.state["rotor_output"] = 0.0
    put_vehicle(simulation.world, (0.0, 0.0, -height_m))
    return simulation


def test_in_the_lane_a_teleport_ends_a_collision() -> None:
    world = World("lane", NATIVE)
    put_vehicle(world, (5.0, 4.0, -2.0), velocity_m_s=(0.0, 8.0, 0.0))
    assert world.advance(500) < 500
    assert world.lead.collision_tick is not None
    assert np.abs(world.lead.state["acceleration"]).max() < 20.0, "what ends a game does not push back"
    world.teleport(world.lead, (5.0, 0.0, -2.0), LEVEL, (0.0, 0.0, 0.0))
    assert world.lead.contact_log.count == 0
    assert world.advance(100) == 100
    assert world.lead.place_m == pytest.approx((5.0, 0.0, -2.0), abs=0.2)


@pytest.mark.parametrize(("place_m", "hit"), [((29.5, 4.67, -2.0), "obstacle_00"), ((29.27, 4.8, -2.0), "wall_east")])
def test_of_two_contacts_at_once_the_deeper_is_told(place_m: tuple[float, float, float], hit: str) -> None:
    world = World("lane", NATIVE)
    world.set_lane(layout_from({"obstacles": [{"x_m": 30.0, "y_m": 4.0, "half_side_m": 0.4}]}, "test"))
    put_vehicle(world, place_m)
    world.advance(1)
    assert world.lead.contact_log.first is not None
    assert world.lead.contact_log.first.object == hit


def test_the_velocity_is_that_of_the_path_while_contacts_push() -> None:
    """Midway between two drifts, whatever pushed: a central difference of the positions, tilted on the ground."""
    simulation = dropped(0.3)
    put_vehicle(simulation.world, (0.0, 0.0, -0.3), (0.95, 0.3, 0.05, 0.0), (1.0, 0.5, 0.0))
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


def test_where_nothing_can_fly_nothing_is_put() -> None:
    refused: list[tuple[str, Any]] = [
        ("not 0.2", (0.0, 0.0, 0.2)), ("thin air", (0.0, 0.0, -44_500.0)), ("NED z", (0.0, 0.0, float("nan"))),
        ("m inside block_north", (45.0, 0.0, -6.0)),
        *(("within 10000 m", (*aside, -6.0)) for far in (-10_001.0, 10_001.0) for aside in permutations((far, 0.0))),
    ]  # fmt: skip
    ends = []
    for places in ([], refused):
        simulation = simulate()
        go_to(simulation, 100)
        fly_velocity(simulation, VelocityGoal((1.0, 0.0, 0.0)), 5.0, simulation.wall_ns)
        go_to(simulation, 300)
        for text, place in places:
            with pytest.raises(UserError, match=text):
                simulation.reset(simulation.wall_ns, place)
        go_to(simulation, 1000)
        ends.append(simulation.world.lead.kinematics())
    assert ends[0] == ends[1], "a refusal changes nothing"


def test_the_ground_and_the_top_of_the_air_can_be_flown_from() -> None:
    simulation = dropped(1.0)
    for z_m in (0.0, -HULL_HALF_HEIGHT_M, -15_000.0, 122.0 - 20_000.0):
        put_vehicle(simulation.world, (0.0, 0.0, z_m))
        go_to(simulation, simulation.world.tick + 1000)
        assert simulation.failure is None
        now = simulation.kinematics()
        assert np.isfinite(now.position_m).all()
        assert z_m < -1000.0 or -0.1 < now.position_m[2] < 0.0, "thrown"


def test_the_air_is_the_standard_atmospheres_and_never_ends() -> None:
    """Hydrostatic balance, integrated over geopotential heights: 6.5 K per km colder up to 11 km, then no more."""
    heights_m = np.arange(0.0, 20_000.0)
    temperature = np.maximum(288.15 - 0.0065 * (heights_m + 0.5), 216.65)
    pressure = 101_325 * np.exp(-np.cumsum(9.80665 / (287.053 * temperature)))  # at the metre's upper end
    for height_m in (1, 122, 5_000, 10_999, 11_001, 11_500, 15_000, 19_999):
        kelvin = max(288.15 - 0.0065 * height_m, 216.65)
        altitude_m = 6_378_137.0 * height_m / (6_378_137.0 - height_m)
        assert air_density(altitude_m) == pytest.approx(pressure[height_m - 1] / 287.053 / kelvin, rel=1e-3)
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


def test_a_vehicle_has_settled_that_rests_for_a_second_on_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that moves once more after 0.9 s is given another second, in all of which its ticks do not count."""
    world = World("blocks", NATIVE)
    world.lead.start = Start((0.0, 0.0, -0.045), idle=True)
    world.reset()
    monkeypatch.setattr(Vehicle, "landed", property(lambda vehicle: vehicle.tick not in (0, 450)))
    world.settle()
    assert (world.tick, round(world.data.time / NATIVE.tick_s)) == (0, 450 + 500)
