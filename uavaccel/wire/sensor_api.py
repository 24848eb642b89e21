"""AirSim's calls about sensors. Each reads the state of the call's tick, so that their time stamps agree.

Sources: AirSim v1.8.1, RpcLibAdaptorsBase.hpp (fields), VehicleApiBase.hpp (names and error texts).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from uavaccel.sim import sensors
from uavaccel.wire import types
from uavaccel.wire.calls import Calls, Scenery, call
from uavaccel.wire.settings import SensorSettings
from uavaccel.wire.types import VehicleName

Kind = TypeVar("Kind")
SENSORS: dict[type[sensors.AirSimKeys], Callable[[Any, int, str], object]] = {
    sensors.ImuSettings: sensors.Imu,
    sensors.BarometerSettings: sensors.Barometer,
    sensors.MagnetometerSettings: sensors.Magnetometer,
    sensors.GpsSettings: sensors.Gps,
    sensors.DistanceSettings: sensors.DistanceSensor,
    sensors.LidarSettings: sensors.Lidar,
}
"""The class of sensors for each kind of settings; it takes these, a noise seed and a name."""
DEFAULTS: dict[str, SensorSettings] = {
    "imu": sensors.ImuSettings(),
    "magnetometer": sensors.MagnetometerSettings(),
    "gps": sensors.GpsSettings(),
    "barometer": sensors.BarometerSettings(),
}


class SensorApi(Calls, title="Sensors"):
    """Calls about sensors; an empty name selects the first sensor of its kind by name.

    A vehicle has the sensors of its settings and, of other kinds, their defaults or else AirSim's four
    (AirSimSettings.hpp, loadSensorSettings and createDefaultSensorSettings).
    """

    def __init__(self, scenery: Scenery) -> None:
        super().__init__(scenery)
        self._sensors: dict[int, dict[str, object]] = {}

    def _named(self, kind: type[Kind], word: str, name: object, vehicle: str) -> Kind:
        """Return the vehicle's sensor of a kind by its name. Raises ValueError without any."""
        number, settings = self.scenery.number_of(vehicle), self.scenery.settings
        if number not in self._sensors:
            given = settings.vehicles.get(self.scenery.vehicle(vehicle).name)
            chosen = (given.sensors if given else None) or {}
            defaults, kinds = settings.default_sensors, {type(each) for each in chosen.values()}
            others = DEFAULTS if defaults is None else defaults
            chosen = chosen | {own: each for own, each in others.items() if type(each) not in kinds}
            seed = settings.sensor_seed + number  # the noise of vehicles is independent
            enabled = {own: sensor for own, sensor in sorted(chosen.items()) if sensor.enabled}
            self._sensors[number] = {own: SENSORS[type(each)](each, seed, own) for own, each in enabled.items()}
        if not isinstance(name, str):
            raise ValueError(f"a sensor's name must be a text, not {type(name).__name__}")
        known = {own: sensor for own, sensor in self._sensors[number].items() if isinstance(sensor, kind)}
        found = next(iter(known.values()), None) if name == "" else known.get(name)
        if found is None:
            there = f"there is {', '.join(known)}" if known else "the settings' Sensors give none"
            raise ValueError(f"No {word} with name {name} exist on vehicle; {there}")
        return found

    def _truth(self, vehicle: str) -> sensors.Truth:
        profile, world = self.simulation.profile, self.simulation.world
        return sensors.Truth(
            self.scenery.truth(vehicle),
            profile.tick_s,
            world.tick * profile.tick_s,
            self.scenery.settings.home,
            (own := self.scenery.vehicle(vehicle)).body,
            own.origin_m,
        )

    def _stamp(self) -> int:
        return types.stamp(self.simulation.time_ns)

    @call("getImuData")
    def imu(self, name: object = "", vehicle: VehicleName = "") -> dict[str, object]:
        truth = self._truth(vehicle)
        reading = self._named(sensors.Imu, "imu", name, vehicle).read(truth)
        return {
            "time_stamp": self._stamp(),
            "orientation": types.quaternion_map(truth.kinematics.orientation_wxyz),
            "angular_velocity": types.vector_map(reading.angular_velocity_rad_s),
            "linear_acceleration": types.vector_map(reading.linear_acceleration_m_s2),
        }

    @call("getBarometerData")
    def barometer(self, name: object = "", vehicle: VehicleName = "") -> dict[str, object]:
        reading = self._named(sensors.Barometer, "barometer", name, vehicle).read(self._truth(vehicle))
        return {
            "time_stamp": self._stamp(),
            "altitude": reading.altitude_m,
            "pressure": reading.pressure_pa,
            "qnh": reading.qnh_hpa,
        }

    @call("getMagnetometerData")
    def magnetometer(self, name: object = "", vehicle: VehicleName = "") -> dict[str, object]:
        """Return the field in the body's frame; AirSim never fills the covariance."""
        field = self._named(sensors.Magnetometer, "magnetometer", name, vehicle).read(self._truth(vehicle))
        return {
            "time_stamp": self._stamp(),
            "magnetic_field_body": types.vector_map(field),
            "magnetic_field_covariance": [],
        }

    @call("getGpsData")
    def gps(self, name: object = "", vehicle: VehicleName = "") -> dict[str, object]:
        """Return the position fix; `time_utc` is in microseconds."""
        reading = self._named(sensors.Gps, "gps", name, vehicle).read(self._truth(vehicle))
        gnss = {
            "geo_point": types.geo_map(reading.place),
            "eph": reading.eph_m,
            "epv": reading.epv_m,
            "velocity": types.vector_map(reading.velocity_m_s),
            "fix_type": reading.fix,
            "time_utc": self._stamp() // 1000,
        }
        return {"time_stamp": self._stamp(), "gnss": gnss, "is_valid": True}

    @call("getDistanceSensorData")
    def distance(self, name: object = "", vehicle: VehicleName = "") -> dict[str, object]:
        sensor = self._named(sensors.DistanceSensor, "distance sensor", name, vehicle)
        world = self.simulation.world
        return {
            "time_stamp": self._stamp(),
            "distance": sensor.read(self._truth(vehicle), world.model, world.data),
            "min_distance": sensor.settings.min_distance,
            "max_distance": sensor.settings.max_distance,
            "relative_pose": types.pose_map(sensor.settings.mount),
        }

    @call("getLidarData")
    def lidar(self, name: object = "", vehicle: VehicleName = "") -> dict[str, object]:
        """Return x, y, z of all points in one list; a single 0 stands for no points, as in AirSim."""
        sensor = self._named(sensors.Lidar, "lidar", name, vehicle)
        world = self.simulation.world
        scan = sensor.read(self._truth(vehicle), world.model, world.data)
        points_m, carrier = scan.points_m, self.scenery.vehicle(vehicle)
        local = scan.pose._replace(position_m=carrier.local(scan.pose.position_m))
        if sensor.settings.data_frame == "VehicleInertialFrame":
            points_m = points_m - np.array(carrier.origin_m)
        return {
            "time_stamp": self._stamp(),
            "point_cloud": points_m.ravel().astype(np.float32) if len(scan.points_m) else [0.0],
            "pose": types.pose_map(local),
            "segmentation": self.scenery.segmentation.ids(scan.geoms).tolist(),
        }
