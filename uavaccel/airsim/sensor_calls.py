"""The calls of AirSim's clients that read sensors. An empty name is the first sensor of its kind."""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import logging
from typing import Any

from uavaccel.airsim.calls import Calls
from uavaccel.airsim.types import (
    BarometerData,
    DistanceSensorData,
    GpsData,
    ImuData,
    LidarData,
    MagnetometerData,
)


class SensorCalls(Calls):
    def getImuData(self, imu_name: str = "", vehicle_name: str = "") -> ImuData:
        return ImuData.from_msgpack(self.client.call("getImuData", imu_name, vehicle_name))

    def getBarometerData(self, barometer_name: str = "", vehicle_name: str = "") -> BarometerData:
        return BarometerData.from_msgpack(self.client.call("getBarometerData", barometer_name, vehicle_name))

    def getMagnetometerData(self, magnetometer_name: str = "", vehicle_name: str = "") -> MagnetometerData:
        return MagnetometerData.from_msgpack(
            self.client.call("getMagnetometerData", magnetometer_name, vehicle_name)
        )

    def getGpsData(self, gps_name: str = "", vehicle_name: str = "") -> GpsData:
        return GpsData.from_msgpack(self.client.call("getGpsData", gps_name, vehicle_name))

    def getDistanceSensorData(
        self, distance_sensor_name: str = "", vehicle_name: str = ""
    ) -> DistanceSensorData:
        return DistanceSensorData.from_msgpack(
            self.client.call("getDistanceSensorData", distance_sensor_name, vehicle_name)
        )

    def getLidarData(self, lidar_name: str = "", vehicle_name: str = "") -> LidarData:
        return LidarData.from_msgpack(self.client.call("getLidarData", lidar_name, vehicle_name))

    def simGetLidarSegmentation(self, lidar_name: str = "", vehicle_name: str = "") -> Any:
        logging.warning("simGetLidarSegmentation API is deprecated, use getLidarData() API instead")
        return self.getLidarData(lidar_name, vehicle_name).segmentation
