"""AirSim's calls about sensors. Each reads the tick of the call, so that its stamp is that of the state.

Sources: AirSim v1.8.1, RpcLibAdaptorsBase.hpp (fields), VehicleApiBase.hpp (names and error texts).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from uavaccel.sim.poses import Pose
from uavaccel.sim.sensors.field import Barometer, Gps, Magnetometer
from uavaccel.sim.sensors.inertial import Imu
from uavaccel.sim.sensors.ranging import DistanceSensor, Lidar
from uavaccel.sim.sensors.state import Truth
from uavaccel.sim.vehicle.vehicle import BODY
from uavaccel.wire import types
from uavaccel.wire.method import Method
from uavaccel.wire.scenery import Scenery
from uavaccel.wire.sensors import Sensors


class SensorApi:
    """The sensor calls of one simulation."""

    def __init__(self, scenery: Scenery, check_vehicle: Callable[[Any], None]) -> None:
        self._scenery = scenery
        self._simulation = scenery.simulation
        self._check_vehicle = check_vehicle
        self._sensors: dict[int, Sensors] = {}

    def methods(self) -> dict[str, Method]:
        """By wire name."""
        return {
            "getImuData": Method(self.imu, 0, 2),
            "getBarometerData": Method(self.barometer, 0, 2),
            "getMagnetometerData": Method(self.magnetometer, 0, 2),
            "getGpsData": Method(self.gps, 0, 2),
            "getDistanceSensorData": Method(self.distance, 0, 2),
            "getLidarData": Method(self.lidar, 0, 2),
        }

    def _of(self, vehicle: Any) -> Sensors:
        """A vehicle's sensors; their noise is its own."""
        self._check_vehicle(vehicle)
        number, settings = self._scenery.number_of(vehicle), self._scenery.settings
        if number not in self._sensors:
            given = settings.vehicles.get(self._scenery.vehicle(vehicle).name)
            sensors = given.sensors if given else None
            self._sensors[number] = Sensors(sensors, settings.default_sensors, settings.sensor_seed + number)
        return self._sensors[number]

    def _truth(self, vehicle: Any) -> Truth:
        profile, world = self._simulation.profile, self._simulation.world
        return Truth(
            self._scenery.truth(vehicle),
            profile.tick_s,
            world.tick * profile.tick_s,
            self._scenery.settings.home,
            self._scenery.vehicle(vehicle).prefix + BODY,
        )

    def _stamp(self) -> int:
        return types.stamp(self._simulation.time_ns)

    def imu(self, name: Any = "", vehicle: Any = "") -> dict[str, Any]:
        """getImuData."""
        sensors, truth = self._of(vehicle), self._truth(vehicle)
        reading = sensors.named(Imu, "imu", name).read(truth)
        return {
            "time_stamp": self._stamp(),
            "orientation": types.quaternion_map(truth.kinematics.orientation_wxyz),
            "angular_velocity": types.vector_map(reading.angular_velocity_rad_s),
            "linear_acceleration": types.vector_map(reading.linear_acceleration_m_s2),
        }

    def barometer(self, name: Any = "", vehicle: Any = "") -> dict[str, Any]:
        """getBarometerData."""
        reading = self._of(vehicle).named(Barometer, "barometer", name).read(self._truth(vehicle))
        return {
            "time_stamp": self._stamp(),
            "altitude": reading.altitude_m,
            "pressure": reading.pressure_pa,
            "qnh": reading.qnh_hpa,
        }

    def magnetometer(self, name: Any = "", vehicle: Any = "") -> dict[str, Any]:
        """getMagnetometerData; AirSim never fills the covariance."""
        field = self._of(vehicle).named(Magnetometer, "magnetometer", name).read(self._truth(vehicle))
        return {
            "time_stamp": self._stamp(),
            "magnetic_field_body": types.vector_map(field),
            "magnetic_field_covariance": [],
        }

    def gps(self, name: Any = "", vehicle: Any = "") -> dict[str, Any]:
        """getGpsData; time_utc in microseconds."""
        reading = self._of(vehicle).named(Gps, "gps", name).read(self._truth(vehicle))
        gnss = {
            "geo_point": types.geo_map(reading.place),
            "eph": reading.eph_m,
            "epv": reading.epv_m,
            "velocity": types.vector_map(reading.velocity_m_s),
            "fix_type": reading.fix,
            "time_utc": self._stamp() // 1000,
        }
        return {"time_stamp": self._stamp(), "gnss": gnss, "is_valid": True}

    def distance(self, name: Any = "", vehicle: Any = "") -> dict[str, Any]:
        """getDistanceSensorData."""
        sensor = self._of(vehicle).named(DistanceSensor, "distance sensor", name)
        world = self._simulation.world
        return {
            "time_stamp": self._stamp(),
            "distance": sensor.read(self._truth(vehicle), world.model, world.data),
            "min_distance": sensor.settings.min_distance,
            "max_distance": sensor.settings.max_distance,
            "relative_pose": pose_map(sensor.settings.mount),
        }

    def lidar(self, name: Any = "", vehicle: Any = "") -> dict[str, Any]:
        """getLidarData: x, y, z of all points in one list; a single 0 stands for none, as in AirSim."""
        sensor = self._of(vehicle).named(Lidar, "lidar", name)
        world = self._simulation.world
        scan = sensor.read(self._truth(vehicle), world.model, world.data)
        points_m = scan.points_m
        if sensor.settings.data_frame == "VehicleInertialFrame":
            points_m = points_m - np.array(self._scenery.vehicle(vehicle).origin_m)
        return {
            "time_stamp": self._stamp(),
            "point_cloud": points_m.ravel().astype(np.float32) if len(scan.points_m) else [0.0],
            "pose": pose_map(
                scan.pose._replace(position_m=self._scenery.vehicle(vehicle).local(scan.pose.position_m))
            ),
            "segmentation": self._scenery.segmentation.ids(scan.geoms).tolist(),
        }


def pose_map(pose: Pose) -> dict[str, Any]:
    """Pose."""
    return {
        "position": types.vector_map(pose.position_m),
        "orientation": types.quaternion_map(pose.orientation_wxyz),
    }
