"""AirSim's calls about vehicles: control, poses and kinematics, states, collisions, and adding vehicles.

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
from uavaccel.wire.vehicles import free_place, in_world_frame, standing

FASTEST_M_S, FASTEST_RAD_S = 500.0, 100.0  # beyond these a tick's drag or turn is not a small change
KIND = "simpleflight"
TURNS = (-1, -1, 1, 1)  # AirSim's signs of the rotors' torques
MAX_SPEED_RAD_S = 669.857


class SettableKinematics(NamedTuple):
    """The parts of a KinematicsState that can be set."""

    pose: Pose
    velocity_m_s: Vector
    rate_rad_s: Vector


def motion(value: object, name: str) -> SettableKinematics:
    """The settable parts of a client's KinematicsState."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a KinematicsState")
    velocity = _bounded(value.get("linear_velocity"), "linear_velocity", FASTEST_M_S)
    rate = _bounded(value.get("angular_velocity"), "angular_velocity", FASTEST_RAD_S)
    return SettableKinematics(pose(value, name), velocity, rate)


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
        yaw_rad = euler_from_quaternion(pose.orientation_wxyz)[2]
        start = standing(free_place(pose.position_m, there), yaw_rad)
        self.simulation.add_vehicles([AddedVehicle(vehicle_name, *start)])
        return True

    @call("simGetVehiclePose")
    def pose(self, vehicle: VehicleName = "") -> dict[str, dict[str, float]]:
        """Return the vehicle's pose at the present tick."""
        return types.pose_map(self.scenery.pilot(vehicle).kinematics())

    @call("simSetVehiclePose")
    def set_pose(self, pose: AnyPose, ignore_collision: object, vehicle: VehicleName = "") -> None:
        """Set the pose; velocity, rotors, goal, and parts of the pose that are NaN stay as they are.

        With `ignore_collision` a place inside an object becomes the nearest one outside; without it, it is refused.
        """
        pilot = self.scenery.pilot(vehicle)
        place = in_world_frame(pilot, pose)
        self.simulation.world.teleport(pilot.vehicle, *place, anywhere=bool(ignore_collision))

    @call("simGetGroundTruthKinematics")
    def kinematics(self, vehicle: VehicleName = "") -> dict[str, dict[str, float]]:
        return types.kinematics_map(self.scenery.pilot(vehicle).kinematics())

    @call("simSetKinematics")
    def set_kinematics(
        self, state: Annotated[SettableKinematics, motion], ignore_collision: object, vehicle: VehicleName = ""
    ) -> None:
        """Set pose and velocities; the accelerations follow from them here."""
        pilot = self.scenery.pilot(vehicle)
        motion, anywhere = (state.velocity_m_s, state.rate_rad_s), bool(ignore_collision)
        place = in_world_frame(pilot, state.pose)
        self.simulation.world.teleport(pilot.vehicle, *place, *motion, anywhere)

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
        info = types.no_collision_map() | {"has_collided": touches.read(), "collision_count": touches.count}
        if touch := touches.latest:
            info |= {"time_stamp": types.stamp(self.simulation.time_of(touch.tick))}
            info |= {"object_name": self.scenery.objects.name_of(touch.object)}
            depth_m, touched = self.simulation.world.penetration(flown)
            depth_m = depth_m if touched == touch.object else touch.penetration_m
            info |= {"penetration_depth": depth_m, "normal": types.vector_map(touch.normal)}
            info |= {"position": types.vector_map(flown.local(touch.position_m))}
            info |= {"impact_point": types.vector_map(flown.local(touch.impact_point_m))}
        return info
