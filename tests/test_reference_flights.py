"""Flights of AirSim's own flight code, flown again: `airsim` profile, zero latency, one message at a time.

The issue times of the recorded commands are replayed through the API; when they end, when position hold sets in and
how the vehicle flies is ours. See data/simpleflight/README.md.
"""

from __future__ import annotations

import csv
import gzip
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulating import put_vehicle
from uavaccel.sim.profile import AIRSIM
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle import autopilot
from uavaccel.sim.vehicle.quadrotor import density_ratio
from uavaccel.sim.world import World
from uavaccel.units import attitude_difference_rad, euler_from_quaternion
from uavaccel.wire.api import Api

DATA = Path(__file__).parent / "data" / "simpleflight"
AIRSIM_TICK_S = 0.003000064  # nanoseconds that passed through a double
SETTLED_M, SETTLED_M_S = (0.0, 0.0, -9.99595261), (0.0, 0.0, 0.000152719746)
# The aim is 2 cm RMS up to 15 s. What is left is the rounding of AirSim's floats and of the files, 0.33 mm RMS at the
# most; flown one tick late, a flight misses at least one of these bounds by far.
POSITION_RMS_M = 1e-3
VELOCITY_RMS_M_S, RATE_RMS_RAD_S, ATTITUDE_RMS_RAD = 5e-4, 1e-4, 1e-4

T_MOVE_S = {
    "A1_airstart_vel0": 10.0,
    "B_vx1_10s": 10.0,
    "B05_vx1_0p5s": 0.5,
    "B01_vx1_0p1s": 0.1,
    "D_climb_descend": 5.0,
    "F_sq_T1_r1": 1.0,
    "F_sq_T1_r24": 1.0,
    "G_sq_T1_r4_gap100ms": 1.0,
    "H1_vx1_yawrate30_6s": 6.0,
    "H2_fwdonly_vx1_vy1_6s": 6.0,
    "I_fig2": 1.0,
}
CASES = ["A_hover", *T_MOVE_S]
DRIVETRAIN = {"H2_fwdonly_vx1_vy1_6s": (1, {"is_rate": False, "yaw_or_rate": 0.0})}
YAW_RATE = {"H1_vx1_yawrate30_6s": (0, {"is_rate": True, "yaw_or_rate": 30.0})}
FACING = {"is_rate": False, "yaw_or_rate": 40.0}
STRAIGHT = (0, {"is_rate": True, "yaw_or_rate": 0.0})

Array = NDArray[np.float64]
Columns = dict[str, Array]


class Event(NamedTuple):
    tick: int
    kind: str
    velocity: tuple[float, ...]


@cache
def events(case: str) -> list[Event]:
    with (DATA / "events.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["case"] == case]
    found = []
    for row in rows:
        kind, _, velocity = row["event"].partition("(")
        numbers = tuple(float(word) for word in velocity.rstrip(")").split())
        found.append(Event(int(row["tick"]), re.sub(r"_\d+$", "", kind), numbers))
    return found


def ticks_of(case: str, kind: str) -> list[int]:
    return [event.tick for event in events(case) if event.kind == kind]


@cache
def reference(name: str) -> Columns:
    """Columns of a CSV, and the ticks of its rows."""
    with gzip.open(DATA / f"{name}.csv.gz", "rt") as file:
        table = np.genfromtxt(file, delimiter=",", names=True)
    columns = {column: table[column] for column in table.dtype.names or ()}
    return columns | {"tick": np.rint(columns["t_s"] / AIRSIM_TICK_S)}


def stack(columns: Columns, names: str) -> Array:
    return np.stack([columns[name] for name in names.split()], axis=1)


class Flight(NamedTuple):
    """The vehicle at every tick, and what the simulation logged."""

    state: NDArray[Any]
    commands: Array

    def at(self, ticks: Array, field: str) -> Array:
        return np.asarray(self.state[field][ticks.astype(int)])

    def hover_ticks(self) -> list[int]:
        """Ticks at which position hold sets in."""
        held = self.state["xy_mode"] == autopilot.POSITION
        return (1 + np.flatnonzero(held[1:] & ~held[:-1])).tolist()


@pytest.fixture(scope="module")
def world() -> World:
    return World("blocks", AIRSIM)


@pytest.fixture(scope="module")
def fly(world: World) -> Callable[[str], Flight]:
    return cache(lambda case: replay(world, case))


def replay(world: World, case: str) -> Flight:
    """Issue the case's commands at the ticks at which AirSim had them issued."""
    simulation = Simulation(world)
    simulation.reset(0, SETTLED_M)
    put_vehicle(world, SETTLED_M, velocity_m_s=SETTLED_M_S)
    if case == "A1_airstart_vel0":
        start_at_rest(world)
    simulation.lead.api_control = True
    api = Api(simulation)
    options = (DRIVETRAIN | YAW_RATE).get(case, STRAIGHT)
    states = [world.lead.state.copy()]
    stop = world.watch(1, lambda tick: states.append(world.lead.state.copy()))
    for event in events(case):
        wall_ns = simulation.pacer.wall_due(event.tick)
        simulation.advance_to(wall_ns)
        if event.kind == "cmd_issue":
            api.call("moveByVelocity", (*event.velocity, T_MOVE_S[case], *options), wall_ns)
    stop()
    return Flight(np.array(states), simulation.lead.log.ticks().astype(float))


@pytest.mark.parametrize(
    ("calls", "way_m", "attitude"),
    [
        pytest.param(
            [
                ("setAngleRateControllerGains", [0.25] * 3, [0.0, 0.5, 0.5], [0.0] * 3),
                ("moveByVelocity", 2, -1, -0.5, 1, 0, FACING),
            ],
            (0.7227, -0.3573, -0.4285),
            (0.89936, -0.03936, -0.0301, 0.43439),
            id="integral gains of rates",
        ),
        pytest.param(
            [
                ("setAngleRateControllerGains", [0.25] * 3, [0.1] * 3, [0.004] * 3),
                ("moveByVelocity", 2, -1, -0.5, 1, 0, FACING),
            ],
            (0.7177, -0.3553, -0.5438),
            (0.91109, -0.03854, -0.03185, 0.40916),
            id="and derivative ones",
        ),
        pytest.param(
            [
                ("setVelocityControllerGains", [0.2, 0.2, 2.0], [0.5, 0.5, 2.0], [0.0] * 3),
                ("moveByVelocity", 2, -1, 0, 1, *STRAIGHT),
                ("moveByMotorPWMs", *[0.6] * 4, 0.2),
                ("moveByVelocity", 2, -1, 0, 1, *STRAIGHT),
            ],
            (4.2439, -2.1103, -0.1022),
            (0.99658, 0.0366, 0.07396, -0.00467),
            id="motor commands begin integrals anew",
        ),
    ],
)
def test_gains_of_a_client_fly_as_in_airsim(
    world: World, calls: list[tuple[Any, ...]], way_m: tuple[float, ...], attitude: tuple[float, ...]
) -> None:
    """The way and the attitude at its end are those of AirSim's own flight code, from the settled hover."""
    simulation = Simulation(world)
    simulation.reset(0, SETTLED_M)
    simulation.lead.api_control = True
    api = Api(simulation)
    for name, *params in calls:
        api.call(name, params, simulation.wall_ns)
        while simulation.lead.command is not None:
            simulation.advance_to(simulation.pacer.wall_due(world.tick + 1))
    assert world.lead.state["position"] - SETTLED_M == pytest.approx(way_m, abs=1e-3)
    assert world.lead.state["quaternion"] == pytest.approx(attitude, abs=2e-4)


def start_at_rest(world: World) -> None:
    """Motors and integrators at zero, 10 m up."""
    world.reset((0.0, 0.0, -10.0))
    for name in ("rotor_input", "rotor_lagged", "rotor_output", "z_integral"):
        world.lead.state[name] = 0
    put_vehicle(world, (0.0, 0.0, -10.0))


def rms(errors: Array) -> float:
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))


@pytest.mark.parametrize("case", CASES)
def test_a_reference_flight_is_flown_again_to_its_tick(fly: Callable[[str], Flight], case: str) -> None:
    flight, expected = fly(case), reference(case)
    ticks = expected["tick"]
    attitude = stack(expected, "qw qx qy qz")
    angle = attitude_difference_rad(flight.at(ticks, "quaternion"), attitude)
    assert rms(flight.at(ticks, "position") - stack(expected, "x y z")) < POSITION_RMS_M
    assert rms(flight.at(ticks, "velocity") - stack(expected, "vx vy vz")) < VELOCITY_RMS_M_S
    assert rms(flight.at(ticks, "rate") - stack(expected, "wx wy wz")) < RATE_RMS_RAD_S
    assert rms(angle[:, None]) < ATTITUDE_RMS_RAD
    assert flight.commands[:, 0].tolist() == ticks_of(case, "cmd_issue")
    assert flight.commands[:, 1].tolist() == ticks_of(case, "cmd_end")
    assert flight.hover_ticks() == ticks_of(case, "hover_mode"), "position hold sets in where AirSim's does"


@pytest.mark.parametrize("case", ["B_vx1_10s", "D_climb_descend", "F_sq_T1_r1"])
def test_rotors_are_commanded_and_lag_as_in_airsim(fly: Callable[[str], Flight], case: str) -> None:
    flight, expected = fly(case), reference(f"{case}_rotors")
    ticks = expected["tick"]
    assert len(ticks) > 3000
    for field, column in (("rotor_input", "cmd"), ("rotor_output", "uf")):
        ours, theirs = flight.at(ticks, field), stack(expected, " ".join(f"{column}{i}" for i in range(4)))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-4)


def test_a_command_lasts_the_first_multiple_of_21_ms() -> None:
    for t_move_s, lasts_s in (
        *[(0.1, 0.105), (0.2, 0.210), (0.5, 0.504), (1.0, 1.008), (5.0, 5.019), (6.0, 6.006), (10.0, 10.017)],
        *[(0.001, 0.021), (0.021, 0.021), (0.0211, 0.042), (0.105, 0.105), (0.33, 0.336)],
    ):
        assert AIRSIM.command_ticks(t_move_s) * AIRSIM.tick_s == pytest.approx(lasts_s, abs=1e-12)


@pytest.mark.parametrize("gap_ticks", [0, 17, 20, 21, 34])
def test_only_a_gap_of_63_ms_brings_position_hold(world: World, gap_ticks: int) -> None:
    """51 ms and 60 ms bring none; the vertical integrator is then not reset either."""
    simulation = Simulation(world)
    simulation.reset(0)
    simulation.lead.api_control = True
    due = simulation.pacer.wall_due
    api = Api(simulation)
    api.call("moveByVelocity", (1, 0, 0, 0.5, *STRAIGHT), 0)
    end_tick = 168
    held = []
    while world.tick < end_tick + gap_ticks:
        simulation.advance_to(due(world.tick + 1))
        held.append(world.lead.state["xy_mode"] == autopilot.POSITION)
    integral = float(world.lead.state["z_integral"])
    api.call("moveByVelocity", (1, 0, 0, 0.5, *STRAIGHT), due(world.tick))
    simulation.advance_to(due(world.tick + 1))
    assert any(held[end_tick:]) == (gap_ticks >= 21)
    assert (world.lead.state["z_integral"] == 0.0) == (gap_ticks >= 21)
    assert gap_ticks >= 21 or world.lead.state["z_integral"] == pytest.approx(integral, abs=2e-3)


def test_squares_climb_and_turn_as_in_airsim(fly: Callable[[str], Flight]) -> None:
    """Two of AirSim's peculiarities: -0.337 m a round, and 27.65 degrees of yaw in 24 rounds."""
    flight = fly("F_sq_T1_r24")
    ends = flight.commands[3::4, 1].astype(int)
    assert len(ends) == 24
    heights = flight.state["position"][ends, 2]
    assert np.diff(heights) == pytest.approx(-0.337, abs=2e-3)
    assert np.diff(heights).mean() == pytest.approx(-0.337, abs=5e-4)
    yaw = euler_from_quaternion(flight.state["quaternion"][ends[-1]])[2]
    assert np.degrees(yaw) == pytest.approx(27.65, abs=0.01)


def test_the_quadrotor_is_airsims(world: World) -> None:
    """Mass and inertia come from the MJCF model, the rest from AirSim's objects as constants.txt has them."""
    text = (DATA / "constants.txt").read_text()
    ours = world.lead.parameters

    def constants(pattern: str) -> list[float]:
        match = re.search(pattern, text)
        assert match is not None
        return [float(number) for number in match.groups()]

    number = r"(-?[\d.]+)"
    mass, *inertia = constants(rf"mass {number} kg; inertia diag {number} {number} {number}")
    thrust, torque, lag_s = constants(rf"max_thrust {number} N, max_torque {number} N m, tc {number} s")
    arm_x, arm_y = constants(rf"rotor 0 pos {number} {number}")
    faces = [constants(rf"drag face n \({axis}\) factor {number}")[0] for axis in ("1 0 0", "0 1 0", "0 0 1")]
    assert ours["mass_kg"] == mass
    assert ours["inertia_kg_m2"] == pytest.approx(inertia, rel=1e-6)
    assert [ours["max_thrust_n"], ours["max_torque_n_m"]] == pytest.approx([thrust, torque], rel=1e-6)
    assert ours["rotor_keep"] == pytest.approx(np.exp(-0.003 / lag_s))
    assert [ours["rotor_arm_m"]] * 2 == pytest.approx([arm_x, arm_y], abs=1e-6)
    assert ours["drag_factor_m2"] == pytest.approx(faces, rel=1e-6)
    assert density_ratio(ours, -10.0) == pytest.approx(constants(rf"ratio {number};")[0], rel=1e-5)
    assert ours["gravity_m_s2"] == constants(rf"gravity {number} m")[0]
