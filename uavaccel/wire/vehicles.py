"""Puts the vehicles of settings.json into a simulation, and places vehicles that are added or moved.

Source: AirSim v1.8.1, SimModeBase.cpp (createVehiclePawn, setupVehiclesAndCamera), PawnSimApi.cpp: places are NED
metres from the player's start, and each vehicle's own frame begins where it does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from uavaccel.errors import UserError
from uavaccel.kinematics import Quaternion, Vector
from uavaccel.sim.flight.pilot import Pilot
from uavaccel.sim.poses import APART_M, Pose, check_name
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.vehicle import HERE, AddedVehicle, Start
from uavaccel.sim.world import START_M
from uavaccel.wire.settings import Settings, VehicleSettings

STANDING_M = -0.045  # NED z of a vehicle that stands on the ground, where the player starts


def populate(simulation: Simulation, settings: Settings) -> None:
    """Name and place the first vehicle, and add the others. Raises UserError that names the vehicle.

    A vehicle without X, Y and Z hovers at 10 m, ready to be flown; one with them starts there, idle, as in AirSim. One
    that would start at another one starts beside it, as Unreal spawns it.
    """
    world = simulation.world
    _check_names(settings)
    world.lead.name, world.still = settings.vehicle, settings.flightless
    there = [vehicle.name for vehicle in world.vehicles]
    added, key, taken_m = [], "", list[Vector]()
    try:
        for name, vehicle in settings.created():
            key = f".{name}"
            start, origin_m = starting(vehicle)
            if aside_m := room_m(start.position_m, taken_m):
                start = replace(start, position_m=east_of(start.position_m, aside_m))
                origin_m = east_of(origin_m, aside_m)
            taken_m.append(start.position_m)
            world.check_place(start.position_m, start.orientation_wxyz)
            if name == settings.vehicle and vehicle.placed:
                world.lead.start, world.lead.origin_m = start, origin_m
                simulation.reset(simulation.wall_ns)
            elif name not in there:
                added.append(AddedVehicle(name, start, origin_m))
        key = ""
        if added:
            simulation.add_vehicles(added)
    except UserError as error:
        raise UserError(f"Vehicles{key}: {error}") from None


def _check_names(settings: Settings) -> None:
    """Raise UserError, naming the key, for the invalid name of a vehicle or a camera."""
    named = [("Vehicles", "a vehicle", name) for name in settings.vehicles]
    for vehicle, given in settings.vehicles.items():
        named += [(f"Vehicles.{vehicle}.Cameras", "a camera", name) for name in given.cameras if name]
    named += [("ExternalCameras", "a camera", name) for name in settings.external_cameras]
    for key, kind, name in named:
        try:
            check_name(name, kind=kind)
        except UserError as error:
            raise UserError(f"{key}: {error}") from None


def starting(vehicle: VehicleSettings) -> tuple[Start, Vector]:
    """Return the start of a vehicle in the world, and the origin of its frame."""
    if not vehicle.placed:
        return Start(START_M), HERE
    place = (vehicle.x or 0.0, vehicle.y or 0.0, vehicle.z or 0.0)
    return standing(place, math.radians(vehicle.yaw or 0.0))


def free_place(place_m: Vector, taken_m: Sequence[Vector]) -> Vector:
    """Return the given place, or the ground above it, or the next place to the east that is free of vehicles.

    NED from the player's start; `taken_m` are the vehicles' places in the world.
    """
    north, east, down = place_m[0], place_m[1], min(place_m[2], 0.0)
    return north, east + room_m((north, east, down + STANDING_M), taken_m), down


def room_m(position_m: Vector, taken_m: Sequence[Vector]) -> float:
    """Return how far to the east of a position in the world, in m, the next one is that is free of vehicles."""
    aside_m = 0.0
    while any(math.dist(east_of(position_m, aside_m), other) < APART_M for other in taken_m):
        aside_m += APART_M
    return aside_m


def east_of(position_m: Vector, metres: float) -> Vector:
    """Return the position so many metres to the east."""
    return position_m[0], position_m[1] + metres, position_m[2]


def in_world_frame(pilot: Pilot, pose: Pose) -> tuple[Vector, Quaternion]:
    """Convert a pose in the vehicle's frame to place and attitude in the world; NaN stands for the present part."""
    now = pilot.kinematics()
    place_m = now.position_m if math.isnan(sum(pose.position_m)) else pose.position_m
    attitude = now.orientation_wxyz if math.isnan(sum(pose.orientation_wxyz)) else pose.orientation_wxyz
    return pilot.vehicle.in_world(place_m), attitude


def standing(place_m: Vector, yaw_rad: float) -> tuple[Start, Vector]:
    """Return a level, idle start at a place NED from the player's start, and the frame's origin, which is there."""
    origin = (place_m[0], place_m[1], place_m[2] + STANDING_M)
    heading: Quaternion = (math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2))
    return Start(origin, heading, idle=True), origin
