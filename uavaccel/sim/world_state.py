"""A world's state, taken out and put back: what World.get_state and set_state do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from uavaccel.errors import UserError
from uavaccel.sim.saved import State, layout_of, part, under

if TYPE_CHECKING:
    from uavaccel.sim.world import World


def of(world: World) -> State:
    """All that its flights from here on depend on."""
    state: State = {"scene": world.scene, "profile": world.profile.name, "failed": world.failed}
    state |= {"physics": world.physics(), "warnings": world.warnings.copy()}
    state |= world.lead.get_state() | under("samples", world.recorder.get_state())
    state |= under("contacts", world.clearance.get_state())
    for vehicle in world.vehicles[1:]:
        state |= under(f"vehicles.{vehicle.name}", vehicle.get_state())
    return state | (under("lane", vars(world.lane)) if world.lane else {})


def restore(world: World, state: Mapping[str, Any]) -> None:
    """Back to what `of` gave. Raises UserError for the state of another scene, profile or vehicles."""
    saved = sorted({key.split(".")[1] for key in state if key.startswith("vehicles.")})
    for name, found, own in (
        ("scene", str(state["scene"]), world.scene),
        ("profile", str(state["profile"]), world.profile.name),
        ("vehicles", saved, sorted(vehicle.name for vehicle in world.vehicles[1:])),
    ):
        if found != own:
            raise UserError(f"the saved state's {name} is {found}, not {own}")
    world.failed = bool(state["failed"])
    if lane := part("lane", state):
        world.set_lane(layout_of(lane))
    world.set_physics(state["physics"])
    world.warnings[:] = state["warnings"]
    world.lead.set_state(state)
    for vehicle in world.vehicles[1:]:
        vehicle.set_state(part(f"vehicles.{vehicle.name}", state))
    world.recorder.set_state(part("samples", state))
    world.clearance.set_state(part("contacts", state))
