"""A simulation's state, taken out and put back: what Simulation.get_state and set_state do."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from uavaccel.clock import Pacer
from uavaccel.sim.deferred_reply import Continue, DeferredReply
from uavaccel.sim.saved import State, number_or_none, optional, part, under
from uavaccel.sim.tally import Speed

if TYPE_CHECKING:
    from uavaccel.sim.simulation import Simulation


def of(simulation: Simulation) -> State:
    """All that its flight from here on depends on."""
    state: State = {"clock_speed": str(simulation.clock_speed), "anchor": list(simulation.pacer.anchored)}
    state |= {"time0_ns": simulation.time0_ns, "wall_ns": simulation.wall_ns}
    state |= {"paused": simulation.paused, "api_control": simulation.api_control}
    state |= {"failure": simulation.failure or "", "speed": list(vars(simulation.speed).values())}
    period = simulation.period
    state |= {"running.period_end_tick": optional(period.end_tick if period else None)}
    state |= {"running.period_end_wall_ns": optional(period.end_wall_ns if period else None)}
    state |= under("running", simulation.lead.get_state())
    state |= under("commands", simulation.commands.get_state())
    for pilot in simulation.pilots[1:]:
        kept = pilot.get_state() | under("log", pilot.log.get_state()) | {"api_control": pilot.api_control}
        state |= under(f"pilots.{pilot.vehicle.name}", kept)
    return (
        state | under("frames", simulation.frames.get_state()) | under("world", simulation.world.get_state())
    )


def restore(simulation: Simulation, state: Mapping[str, Any]) -> None:
    """Back to what `of` gave. Raises UserError for the state of another scene or profile."""
    simulation.world.set_state(part("world", state))
    simulation.clock_speed, tick_ns = Fraction(str(state["clock_speed"])), simulation.profile.tick_ns
    simulation.pacer = Pacer(simulation.executor.speed(simulation.clock_speed, tick_ns), tick_ns)
    simulation.pacer.anchor(*(int(number) for number in state["anchor"]))
    simulation.time0_ns, simulation.wall_ns = int(state["time0_ns"]), int(state["wall_ns"])
    simulation.paused, simulation.api_control = bool(state["paused"]), bool(state["api_control"])
    simulation.failure = str(state["failure"]) or None
    simulation.speed = Speed(*(int(number) for number in state["speed"]))
    simulation.frames.set_state(part("frames", state), simulation.world.data)
    running = part("running", state)
    ends = [number_or_none(running[f"period_end_{unit}"]) for unit in ("tick", "wall_ns")]
    simulation.period = None if ends == [None, None] else Continue(DeferredReply(), *ends)
    simulation.lead.set_state(running)
    for pilot in simulation.pilots[1:]:
        kept = part(f"pilots.{pilot.vehicle.name}", state)
        pilot.set_state(kept)
        pilot.log.set_state(part("log", kept))
        pilot.api_control = bool(kept["api_control"])
    simulation.commands.set_state(part("commands", state))
