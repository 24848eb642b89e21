"""AirSim's calls about a vehicle as such: who controls it, where it is and is put, what it has touched, and new ones.

Sources: AirSim v1.8.1, RpcLibServerBase.cpp, MultirotorPawnSimApi.cpp (setPose, setKinematics), SimModeBase.cpp.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, NamedTuple

from uavaccel.kinematics import Vector
from uavaccel.sim.poses import Pose
from uavaccel.sim.sensors.earth import geographic
from uavaccel.sim.vehicle.vehicle import AddedVehicle
from uavaccel.units import euler_from_quaternion
from uavaccel.wire import types
from uavaccel.wire.arguments import AnyPose, FinitePose, VehicleName, place, pose
from uavaccel.wire.calls import Calls, call
from uavaccel.wire.flight_api import stick_map
from uavaccel.wire.vehicles import free_place, put_at, standing

FASTEST_M_S, FASTEST_RAD_S = 500.0, 100.0  # beyond them a tick's drag or turn is no small change
KIND = "simpleflight"
TURNS = (-1, -1, 1, 1)  # of the rotors: AirSim's sign of their torque
MAX_SPEED_RAD_S = 669.857


class Motion(NamedTuple):
    """What of a KinematicsState can be set."""

    pose: Pose
    velocity_m_s: Vector
    rate_rad_s: Vector


def motion(value: object, name: str) -> Motion:
    """A KinematicsState."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a KinematicsState")
    velocity = _bounded(value.get("linear_velocity"), "linear_velocity", FASTEST_M_S)
    rate = _bounded(value.get("angular_velocity"), "angular_velocity", FASTEST_RAD_S)
    return Motion(pose(value, name), velocity, rate)


def _bounded(value: object, name: str, most: float) -> Vector:
    vector = place(value, name)
    if math.hypot(*vector) > most:
        raise ValueError(f"{name} must be at most {most:g}, not {math.hypot(*vector):g}")
    return vector


class VehicleApi(Calls, title="Vehicles"):
    @call("enableApiControl")
    def enable_api_control(self, is_enabled: bool, vehicle: VehicleName = "") -> None:
        pilot = self.scenery.flying_pilot(vehicle)
        if not is_enabled:  # a command that runs on would have no end
            pilot.cancel(self.wall_ns)
        pilot.api_control = is_enabled

    @call("isApiControlEnabled")
    def is_api_control_enabled(self, vehicle: VehicleName = "") -> bool:
        return self.scenery.flying_pilot(vehicle).api_control

    @call("armDisarm")
    def arm(self, arm: bool, vehicle: VehicleName = "") -> bool:
        return self.scenery.flying_pilot(vehicle).arm(arm)

    @call("listVehicles")
    def names(self) -> list[str]:
        """Every vehicle, by the alphabet as AirSim's map has them."""
        return sorted(vehicle.name for vehicle in self.simulation.world.vehicles)

    @call("simAddVehicle")
    def add(self, vehicle_name: str, vehicle_type: object, pose: FinitePose, pawn_path: object = "") -> bool:
        """One more SimpleFlight, level and idle; `pose` is NED from the player's start.

        Below the ground is on it, and where another vehicle is beside that: Unreal adjusts what it spawns.
        """
        if str(vehicle_type).lower() != KIND:
            raise ValueError(f"vehicle type {vehicle_type!r} is not available; there is SimpleFlight")
        there = [vehicle.place_m for vehicle in self.simulation.world.vehicles]
        yaw_rad = euler_from_quaternion(pose.orientation_wxyz)[2]
        start = standing(free_place(pose.position_m, there), yaw_rad)
        self.simulation.add_vehicles([AddedVehicle(vehicle_name, *start)])
        return True

    @call("simGetVehiclePose")
    def pose(self, vehicle: VehicleName = "") -> dict[str, dict[str, float]]:
        """Of the same tick as everything else."""
        return types.pose_map(self.scenery.pilot(vehicle).kinematics())

    @call("simSetVehiclePose")
    def set_pose(self, pose: AnyPose, ignore_collision: object, vehicle: VehicleName = "") -> None:
        """Velocity, rotors and goal stay as they are; NaN leaves a part of the pose as it is."""
        pilot = self.scenery.pilot(vehicle)
        self.simulation.world.teleport(pilot.vehicle, *put_at(pilot, pose))

    @call("simGetGroundTruthKinematics")
    def kinematics(self, vehicle: VehicleName = "") -> dict[str, dict[str, float]]:
        return types.kinematics_map(self.scenery.pilot(vehicle).kinematics())

    @call("simSetKinematics")
    def set_kinematics(
        self,
        state: Annotated[Motion, motion],
        ignore_collision: object,
        vehicle: VehicleName = "",
    ) -> None:
        """Pose and velocities; the accelerations follow from them here."""
        pilot = self.scenery.pilot(vehicle)
        place = put_at(pilot, state.pose)
        self.simulation.world.teleport(pilot.vehicle, *place, state.velocity_m_s, state.rate_rad_s)

    @call("getMultirotorState")
    def multirotor_state(self, vehicle: VehicleName = "") -> dict[str, object]:
        pilot = self.scenery.flying_pilot(vehicle)
        kinematics = pilot.kinematics()
        position_m = pilot.vehicle.in_world(kinematics.position_m)
        return {
            "collision": types.no_collision_map(),  # AirSim never fills it here
            "kinematics_estimated": types.kinematics_map(kinematics),
            "gps_location": types.geo_map(geographic(position_m, self.scenery.settings.home)),
            "timestamp": types.stamp(kinematics.time_ns),
            "landed_state": 0 if pilot.vehicle.landed else 1,
            "rc_data": types.rc_data_map() | stick_map(pilot.sticks),
        }

    @call("getRotorStates")
    def rotor_states(self, vehicle: VehicleName = "") -> dict[str, object]:
        """RotorStates: N and N m at sea level's air, rad/s (RotorActuator.hpp)."""
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
        """Reading it sets has_collided back, as in AirSim."""
        flown = self.scenery.vehicle(vehicle)
        touches = flown.touches
        info = types.no_collision_map() | {"has_collided": touches.read(), "collision_count": touches.count}
        if touch := touches.latest:
            info |= {"time_stamp": types.stamp(self.simulation.time_of(touch.tick))}
            info |= {"object_name": self.scenery.objects.name_of(touch.object)}
            info |= {"penetration_depth": touch.penetration_m, "normal": types.vector_map(touch.normal)}
            info |= {"position": types.vector_map(flown.local(touch.position_m))}
            info |= {"impact_point": types.vector_map(flown.local(touch.impact_point_m))}
        return info
