"""AirSim's calls about vehicles, and where vehicles are put: those of settings.json, added and moved ones.

Sources: AirSim v1.8.1, RpcLibServerBase.cpp, MultirotorPawnSimApi.cpp (setPose, setKinematics), SimModeBase.cpp
(createVehiclePawn, setupVehiclesAndCamera), PawnSimApi.cpp: places are NED metres from the player's start, and each
vehicle's own frame begins where it does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated

from uavaccel.errors import UserError
from uavaccel.kinematics import Quaternion, Vector
from uavaccel.sim.earth import geodetic
from uavaccel.sim.objects import SceneObjects
from uavaccel.sim.poses import APART_M, HERE, Pose, check_name
from uavaccel.sim.simulation import Pilot, Simulation
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Start
from uavaccel.sim.world import START_M
from uavaccel.units import euler_from_quaternion
from uavaccel.wire import types
from uavaccel.wire.calls import Calls, call
from uavaccel.wire.flight_api import rc_data_map
from uavaccel.wire.settings import Settings
from uavaccel.wire.types import AnyPose, FinitePose, VehicleName, place, pose

FASTEST_M_S, FASTEST_RAD_S = 500.0, 100.0  # beyond these a tick's drag or turn is not a small change
KIND = "simpleflight"
TURNS = (-1, -1, 1, 1)  # AirSim's signs of the rotors' torques
MAX_SPEED_RAD_S = 669.857


def motion(value: object, name: str) -> tuple[Pose, Vector, Vector]:
    """The settable parts of a client's KinematicsState: pose, velocity in m/s and body rate in rad/s."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a KinematicsState")
    velocity = _bounded(value.get("linear_velocity"), "linear_velocity", FASTEST_M_S)
    rate = _bounded(value.get("angular_velocity"), "angular_velocity", FASTEST_RAD_S)
    return pose(value, name), velocity, rate


def _bounded(value: object, name: str, most: float) -> Vector:
    vector = place(value, name)
    if math.hypot(*vector) > most:
        raise ValueError(f"{name} must be at most {most:g}, not {math.hypot(*vector):g}")
    return vector


class VehicleApi(Calls, title="Vehicles"):
    @call("enableApiControl")
    def enable_api_control(self, is_enabled: bool, vehicle: VehicleName = "") -> None:
        pilot = self.scenery.flying_pilot(vehicle)
        if not is_enabled:  # the running command would never end
            pilot.end(False, self.wall_ns)
        pilot.api_control = is_enabled

    @call("isApiControlEnabled")
    def is_api_control_enabled(self, vehicle: VehicleName = "") -> bool:
        return self.scenery.flying_pilot(vehicle).api_control

    @call("armDisarm")
    def arm(self, arm: bool, vehicle: VehicleName = "") -> bool:
        return self.scenery.flying_pilot(vehicle).arm(arm)

    @call("listVehicles")
    def names(self) -> list[str]:
        """List all vehicles in alphabetical order, as in AirSim's map."""
        return sorted(vehicle.name for vehicle in self.simulation.world.vehicles)

    @call("simAddVehicle")
    def add(self, vehicle_name: str, vehicle_type: object, pose: FinitePose, pawn_path: object = "") -> bool:
        """Add a SimpleFlight vehicle, level and idle; `pose` is NED from the player's start.

        A pose below the ground is moved onto it, and one at another vehicle beside that, as Unreal does when it spawns.
        """
        if str(vehicle_type).lower() != KIND:
            raise ValueError(f"vehicle type {vehicle_type!r} is not available; there is SimpleFlight")
        there = [vehicle.place_m for vehicle in self.simulation.world.vehicles]
        north, east, down = pose.position_m[0], pose.position_m[1], min(pose.position_m[2], 0.0)
        aside_m = room_m((north, east, down + STANDING_M), there)
        heading_rad = euler_from_quaternion(pose.orientation_wxyz)[2]
        start = standing((north, east + aside_m, down), heading_rad, self.simulation.world.still)
        check_is_no_object(vehicle_name, self.scenery.objects.names())
        self.simulation.add_vehicles([AddedVehicle(vehicle_name, *start)])
        return True

    @call("simGetVehiclePose")
    def pose(self, vehicle: VehicleName = "") -> dict[str, dict[str, float]]:
        return types.pose_map(self.scenery.pilot(vehicle).kinematics())

    @call("simSetVehiclePose")
    def set_pose(self, pose: AnyPose, ignore_collision: object, vehicle: VehicleName = "") -> None:
        """Set the pose; velocity, rotors, goal, and parts of the pose that are NaN stay as they are.

        With `ignore_collision` a place inside an object becomes the nearest one outside; without it, it is refused.
        """
        pilot = self.scenery.pilot(vehicle)
        world = self.simulation.world
        world.teleport(pilot.vehicle, *in_world_frame(pilot, pose), anywhere=bool(ignore_collision))

    @call("simGetGroundTruthKinematics")
    def kinematics(self, vehicle: VehicleName = "") -> dict[str, dict[str, float]]:
        return types.kinematics_map(self.scenery.pilot(vehicle).kinematics())

    @call("simSetKinematics")
    def set_kinematics(
        self, state: Annotated[tuple[Pose, Vector, Vector], motion], ignore_collision: object,
        vehicle: VehicleName = "",
    ) -> None:  # fmt: skip
        """Set pose and velocities; the accelerations follow from them here."""
        pilot, (pose, velocity_m_s, rate_rad_s) = self.scenery.pilot(vehicle), state
        place = in_world_frame(pilot, pose)
        self.simulation.world.teleport(pilot.vehicle, *place, velocity_m_s, rate_rad_s, bool(ignore_collision))

    @call("getMultirotorState")
    def multirotor_state(self, vehicle: VehicleName = "") -> dict[str, object]:
        pilot = self.scenery.flying_pilot(vehicle)
        kinematics, origin_m = pilot.kinematics(), pilot.vehicle.origin_m
        position_m = pilot.vehicle.in_world(kinematics.position_m)
        return {
            "collision": no_collision(),  # AirSim never fills it here
            "kinematics_estimated": types.kinematics_map(kinematics),
            "gps_location": types.geo_map(geodetic(position_m, self.scenery.settings.home, origin_m)),
            "timestamp": types.stamp(kinematics.time_ns),
            "landed_state": 0 if pilot.vehicle.landed else 1,
            "rc_data": rc_data_map(pilot.sticks),
        }

    @call("getRotorStates")
    def rotor_states(self, vehicle: VehicleName = "") -> dict[str, object]:
        """Return the RotorStates: N and N m in air at sea level, and rad/s (RotorActuator.hpp)."""
        pilot = self.scenery.flying_pilot(vehicle)
        parameters, outputs = pilot.vehicle.parameters, pilot.vehicle.state["rotor_output"].tolist()
        rotors = [
            {
                "thrust": float(parameters["max_thrust_n"]) * output,
                "torque_scaler": float(parameters["max_torque_n_m"]) * output * sign,
                "speed": MAX_SPEED_RAD_S * math.sqrt(output),
            }
            for output, sign in zip(outputs, TURNS, strict=True)
        ]
        return {"rotors": rotors, "timestamp": types.stamp(pilot.kinematics().time_ns)}

    @call("simGetCollisionInfo")
    def collision_info(self, vehicle: VehicleName = "") -> dict[str, object]:
        """Return the latest collision; reading it resets has_collided, as in AirSim.

        The penetration is the present one while the contact lasts, then that at its beginning.
        """
        flown = self.scenery.vehicle(vehicle)
        touches = flown.contact_log
        info = no_collision() | {"has_collided": touches.read(), "collision_count": touches.count}
        if touch := touches.latest:
            info |= {"time_stamp": types.stamp(self.simulation.time_of(touch.tick))}
            info |= {"object_name": self.scenery.objects.name_of(touch.object)}
            depth_m, touched = self.simulation.world.penetration(flown)
            depth_m = depth_m if touched == touch.object else touch.penetration_m
            info |= {"penetration_depth": depth_m, "normal": types.vector_map(touch.normal)}
            info |= {"position": types.vector_map(flown.local(touch.position_m))}
            info |= {"impact_point": types.vector_map(flown.local(touch.impact_point_m))}
        return info


def no_collision() -> dict[str, object]:
    """Return the CollisionInfo of a vehicle that has not collided."""
    places = {name: types.vector_map((0.0, 0.0, 0.0)) for name in ("normal", "impact_point", "position")}
    what = {"object_name": "", "object_id": -1}
    return {"has_collided": False, "penetration_depth": 0.0, "time_stamp": 0, **places, **what}


STANDING_M = -0.045  # NED z of a vehicle that stands on the ground, where the player starts


def populate(simulation: Simulation, settings: Settings) -> None:
    """Name and place the first vehicle, and add the others. Raises UserError that names the vehicle.

    A vehicle without X, Y and Z hovers at 10 m, ready to be flown; one with them starts there, idle, as in AirSim. One
    that would start at another one starts beside it, as Unreal spawns it.
    """
    world = simulation.world
    _check_names(settings, SceneObjects(world).names())
    world.lead.name, world.still = settings.vehicle, settings.flightless
    there = [vehicle.name for vehicle in world.vehicles]
    added, key, taken_m = [], "", list[Vector]()
    try:
        for name, vehicle in settings.created():
            key = f".{name}"
            start, origin_m = Start(START_M), HERE
            if vehicle.placed:
                place = (vehicle.x or 0.0, vehicle.y or 0.0, vehicle.z or 0.0)
                start, origin_m = standing(place, math.radians(vehicle.yaw or 0.0), world.still)
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


def _check_names(settings: Settings, objects: Sequence[str]) -> None:
    """Raise UserError, naming the key, for the invalid name of a vehicle or a camera."""
    named = [("Vehicles", "a vehicle", name) for name in settings.vehicles]
    for vehicle, given in settings.vehicles.items():
        named += [(f"Vehicles.{vehicle}.Cameras", "a camera", name) for name in given.cameras if name]
    named += [("ExternalCameras", "a camera", name) for name in settings.external_cameras]
    for key, kind, name in named:
        try:
            check_name(name, kind=kind)
            check_is_no_object(name, objects if key == "Vehicles" else ())
        except UserError as error:
            raise UserError(f"{key}: {error}") from None


def check_is_no_object(name: str, objects: Sequence[str]) -> None:
    """Raise UserError for a vehicle with the name of an object: in Unreal, too, actors' names differ."""
    if name in objects:
        raise UserError(f"a vehicle cannot be called {name!r}: an object of the scene is")


def room_m(position_m: Vector, taken_m: Sequence[Vector]) -> float:
    """Return how far to the east of a position in the world, in m, the next one is that is free of vehicles."""
    aside_m = 0.0
    while any(math.dist(east_of(position_m, aside_m), other) < APART_M for other in taken_m):
        aside_m += APART_M
    return aside_m


def east_of(position_m: Vector, metres: float) -> Vector:
    return position_m[0], position_m[1] + metres, position_m[2]


def in_world_frame(pilot: Pilot, pose: Pose) -> tuple[Vector, Quaternion]:
    """Convert a pose in the vehicle's frame to place and attitude in the world; NaN stands for the present part."""
    now = pilot.kinematics()
    place_m = now.position_m if math.isnan(sum(pose.position_m)) else pose.position_m
    attitude = now.orientation_wxyz if math.isnan(sum(pose.orientation_wxyz)) else pose.orientation_wxyz
    return pilot.vehicle.in_world(place_m), attitude


def standing(place_m: Vector, yaw_rad: float, still: bool) -> tuple[Start, Vector]:
    """Return a level, idle start at a place NED from the player's start, and the frame's origin, which is there.

    A vehicle that is only a camera, in a world that is `still`, does not stand on anything.
    """
    origin = (place_m[0], place_m[1], place_m[2] + (0.0 if still else STANDING_M))
    heading: Quaternion = (math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2))
    return Start(origin, heading, idle=True), origin
