"""The calls of AirSim's clients that read sensors. An empty name is the first sensor of its kind."""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import logging

from uavaccel.airsim.calls import Calls, remote
from uavaccel.airsim.types import (
    BarometerData,
    DistanceSensorData,
    GpsData,
    ImuData,
    LidarData,
    MagnetometerData,
)


class SensorCalls(Calls):
    @remote
    def getImuData(self, imu_name: str = "", vehicle_name: str = "") -> ImuData: ...

    @remote
    def getBarometerData(self, barometer_name: str = "", vehicle_name: str = "") -> BarometerData: ...

    @remote
    def getMagnetometerData(
        self, magnetometer_name: str = "", vehicle_name: str = ""
    ) -> MagnetometerData: ...

    @remote
    def getGpsData(self, gps_name: str = "", vehicle_name: str = "") -> GpsData: ...

    @remote
    def getDistanceSensorData(
        self, distance_sensor_name: str = "", vehicle_name: str = ""
    ) -> DistanceSensorData: ...

    @remote
    def getLidarData(self, lidar_name: str = "", vehicle_name: str = "") -> LidarData: ...

    def simGetLidarSegmentation(self, lidar_name: str = "", vehicle_name: str = "") -> object:
        logging.warning("simGetLidarSegmentation API is deprecated, use getLidarData() API instead")
        return self.getLidarData(lidar_name, vehicle_name).segmentation
