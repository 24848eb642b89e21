"""A simulation's state, taken out and put back: what Simulation.get_state and set_state do."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from uavaccel.clock import Pacer
from uavaccel.sim.saved import State, part, under
from uavaccel.sim.tally import Speed

if TYPE_CHECKING:
    from uavaccel.sim.simulation import Simulation


def of(simulation: Simulation) -> State:
    """All that its flight from here on depends on."""
    state: State = {"clock_speed": str(simulation.clock_speed), "anchor": list(simulation.pacer.anchored)}
    state |= {"time0_ns": simulation.time0_ns, "wall_ns": simulation.wall_ns}
    state |= {"paused": simulation.paused, "api_control": simulation.api_control}
    state |= {"failure": simulation.failure or "", "speed": list(vars(simulation.speed).values())}
    state |= under("running", simulation.running.get_state()) | under(
        "commands", simulation.commands.get_state()
    )
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
    simulation.running.set_state(part("running", state))
    simulation.commands.set_state(part("commands", state))
