"""AirSim's calls about a vehicle as such: where it is, where it is put, what it has touched, and new ones.

Sources: AirSim v1.8.1, RpcLibServerBase.cpp, MultirotorPawnSimApi.cpp (setPose, setKinematics), SimModeBase.cpp.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from uavaccel.kinematics import Quaternion, Vector
from uavaccel.sim.flight.pilot import Pilot
from uavaccel.sim.vehicle.vehicle import Newcomer
from uavaccel.units import euler_from_quaternion
from uavaccel.wire import types
from uavaccel.wire.method import Method
from uavaccel.wire.scenery import Scenery
from uavaccel.wire.vehicles import free_place, standing

FASTEST_M_S, FASTEST_RAD_S = 500.0, 100.0  # beyond them a tick's drag or turn is no small change
KIND = "simpleflight"


class VehicleApi:
    """Calls on the vehicles of a simulation, which `pilot_of` finds by name."""

    def __init__(self, scenery: Scenery, pilot_of: Callable[[Any], Pilot]) -> None:
        self._scenery, self._simulation, self._pilot_of = scenery, scenery.simulation, pilot_of

    def methods(self) -> dict[str, Method]:
        return {
            "listVehicles": Method(self.names, 0),
            "simAddVehicle": Method(self.add, 3, 1),
            "simGetVehiclePose": Method(self.pose, 0, 1),
            "simSetVehiclePose": Method(self.set_pose, 2, 1),
            "simSetKinematics": Method(self.set_kinematics, 2, 1),
            "simGetCollisionInfo": Method(self.collision_info, 0, 1),
        }

    def names(self) -> list[str]:
        """Every vehicle, by the alphabet as AirSim's map has them."""
        return sorted(vehicle.name for vehicle in self._simulation.world.vehicles)

    def add(self, name: Any, kind: Any, pose: Any, pawn_path: Any = "") -> bool:
        """simAddVehicle: one more SimpleFlight, level and idle; `pose` is NED from the player's start.

        Below the ground is on it, and where another vehicle is beside that: Unreal adjusts what it spawns.
        """
        if str(kind).lower() != KIND:
            raise ValueError(f"vehicle type {kind!r} is not available; there is SimpleFlight")
        place, attitude = types.pose(pose)
        if math.isnan(sum(place) + sum(attitude)):
            raise ValueError("pose must be finite")
        if not isinstance(name, str):
            raise ValueError(f"vehicle_name must be a text, not {type(name).__name__}")
        there = [vehicle.place_m for vehicle in self._simulation.world.vehicles]
        start = standing(free_place(place, there), euler_from_quaternion(attitude)[2])
        self._simulation.add_vehicles([Newcomer(name, *start)])
        return True

    def pose(self, vehicle: Any = "") -> dict[str, Any]:
        """simGetVehiclePose; ours is of the same tick as everything else."""
        return types.pose_map(self._pilot_of(vehicle).kinematics())

    def set_pose(self, pose: Any, ignore_collision: Any, vehicle: Any = "") -> None:
        """simSetVehiclePose: velocity, rotors and goal stay as they are; NaN leaves a part of the pose as it is."""
        flown = self._pilot_of(vehicle).vehicle
        self._simulation.world.teleport(flown, *self._place(*types.pose(pose), vehicle))

    def put(self, pose: Any, vehicle: Any) -> None:
        """simSetObjectPose of a vehicle: the pose is the world's."""
        position, attitude = types.pose(pose)
        flown = self._pilot_of(vehicle).vehicle
        self._simulation.world.teleport(flown, *self._place(flown.local(position), attitude, vehicle))

    def _place(self, position: Vector, attitude: Quaternion, vehicle: Any) -> tuple[Vector, Quaternion]:
        """The pose in the world; what is NaN is the vehicle's present one."""
        pilot = self._pilot_of(vehicle)
        now = pilot.kinematics()
        place = now.position_m if math.isnan(sum(position)) else position
        return pilot.vehicle.in_world(place), now.orientation_wxyz if math.isnan(sum(attitude)) else attitude

    def set_kinematics(self, state: Any, ignore_collision: Any, vehicle: Any = "") -> None:
        """simSetKinematics: pose and velocities; the accelerations follow from them here."""
        flown = self._pilot_of(vehicle).vehicle
        if not isinstance(state, Mapping):
            raise ValueError("state must be a KinematicsState")
        velocity = _bounded(state.get("linear_velocity"), "linear_velocity", FASTEST_M_S)
        rate = _bounded(state.get("angular_velocity"), "angular_velocity", FASTEST_RAD_S)
        place = self._place(*types.pose(state), vehicle)
        self._simulation.world.teleport(flown, *place, velocity, rate)

    def collision_info(self, vehicle: Any = "") -> dict[str, Any]:
        """simGetCollisionInfo; reading it sets has_collided back, as in AirSim."""
        flown = self._pilot_of(vehicle).vehicle
        touches = flown.touches
        info = types.no_collision_map() | {"has_collided": touches.read(), "collision_count": touches.count}
        if touch := touches.latest:
            info |= {"time_stamp": types.stamp(self._simulation.time_of(touch.tick))}
            info |= {"object_name": self._scenery.objects.name_of(touch.object)}
            info |= {"penetration_depth": touch.penetration_m, "normal": types.vector_map(touch.normal)}
            info |= {"position": types.vector_map(flown.local(touch.position_m))}
            info |= {"impact_point": types.vector_map(flown.local(touch.impact_point_m))}
        return info


def _bounded(value: Any, name: str, most: float) -> Vector:
    vector = types.place(value, name)
    if math.hypot(*vector) > most:
        raise ValueError(f"{name} must be at most {most:g}, not {math.hypot(*vector):g}")
    return vector
