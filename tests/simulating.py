"""A simulation to test on, and a client of one: one world of each profile, shared, so only one at a time of each."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.clock import VirtualClock
from uavaccel.kinematics import Quaternion, Vector, VelocityGoal
from uavaccel.sim.flight import of_velocity
from uavaccel.sim.poses import HERE, LEVEL
from uavaccel.sim.profile import NATIVE, Profile
from uavaccel.sim.simulation import DeferredReply, Simulation
from uavaccel.sim.world import World
from uavaccel.wire.api import Api
from uavaccel.wire.latency import QUANTILES, ZERO_LATENCY, Latency, LatencyConfig
from uavaccel.wire.session import Client
from uavaccel.wire.transport import VirtualTransport, modelled_simulation

NORTH, EAST = VelocityGoal((1.0, 0.0, 0.0)), VelocityGoal((0.0, 1.0, 0.0))


def put_vehicle(
    world: World, position_m: Vector, orientation_wxyz: Quaternion = LEVEL, velocity_m_s: Vector = HERE
) -> None:
    """Put a world's only vehicle somewhere, whose autopilot and rotors go on."""
    world.check_place(position_m, orientation_wxyz)
    mujoco.mj_resetData(world.model, world.data)
    world.lead.put(position_m, orientation_wxyz, velocity_m_s)
    world.lead.clear_contacts()
    mujoco.mj_kinematics(world.model, world.data)
    world.clearance.check_now()
    world.failed = False


_worlds: dict[Profile, World] = {}


def world_of(profile: Profile) -> World:
    """The profile's world; a new one if a test before has added vehicles, which stay."""
    if profile not in _worlds or len(_worlds[profile].vehicles) > 1:
        _worlds[profile] = World("blocks", profile)
    return _worlds[profile]


def simulate(clock_speed: float = 1.0, profile: Profile = NATIVE, **options: Any) -> Simulation:
    """A settled hover at wall time 0, running, with API control."""
    simulation = Simulation(world_of(profile), clock_speed, **options)
    simulation.reset(0)
    simulation.lead.api_control = True
    return simulation


def always(microseconds: float) -> tuple[float, ...]:
    """Quantiles of a latency that is always the same."""
    return (microseconds,) * len(QUANTILES)


def start(
    clock_speed: float = 1.0,
    latency: LatencyConfig = ZERO_LATENCY,
    seed: int = 0,
    profile: Profile = NATIVE,
    transport: type[VirtualTransport] = VirtualTransport,
) -> Client:
    """A game on a simulated wall clock, as a session starts one."""
    world_of(profile).reset()
    draws = Latency(latency, np.random.SeedSequence(seed))
    simulation = modelled_simulation(world_of(profile), clock_speed, draws)
    client = Client(transport(Api(simulation), VirtualClock(), draws), clock_speed)
    client.start_game(clock_speed)
    return client


def fly_velocity(simulation: Simulation, goal: VelocityGoal, duration_s: float, wall_ns: int) -> DeferredReply:
    """A command to the leading vehicle, as moveByVelocity gives it."""
    ticks = simulation.profile.command_ticks(duration_s)
    return simulation.lead.fly(of_velocity(goal), ticks, wall_ns)


def go_to(simulation: Simulation, tick: int) -> int:
    """Let wall time pass until the tick is due; the wall time."""
    wall_ns = simulation.pacer.wall_due(tick)
    simulation.advance_to(wall_ns)
    return wall_ns


def position(simulation: Simulation) -> NDArray[np.float64]:
    return np.array(simulation.world.lead.state["position"])


def answer(reply: DeferredReply) -> Any:
    assert reply.due_wall_ns is not None, "the reply is not due yet"
    return reply.value
