"""Distance sensor and LiDAR, by ray casting.

Sources: AirSim v1.8.1, DistanceSimple, LidarSimple, their Params, UnrealDistanceSensor.cpp, UnrealLidarSensor.cpp.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from uavaccel.sim.poses import Pose, from_degrees
from uavaccel.sim.scene.objects import cast
from uavaccel.sim.sensors.base import AirSimKeys, Truth, White
from uavaccel.sim.sensors.field import NotNegative, Positive

MOST_POINTS = 100_000  # of one scan, as in AirSim
NOISE_M = 0.2  # of a distance, DistanceSimpleParams's uncorrelated_noise_sigma
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]


class _Mounted(AirSimKeys):
    """A sensor's mounting on the vehicle: metres and degrees, FRD."""

    enabled: bool = True
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0

    @property
    def mount(self) -> Pose:
        """Pose relative to the vehicle, FRD."""
        return Pose((self.x, self.y, self.z), from_degrees(self.roll, self.pitch, self.yaw))


class DistanceSettings(_Mounted):
    """Range and standard deviation of the noise in metres."""

    sensor_type: Literal[5] = 5
    min_distance: NotNegative = 0.2
    max_distance: Positive = 40.0
    uncorrelated_noise_sigma: NotNegative = NOISE_M

    @model_validator(mode="after")
    def _distances_rise(self) -> DistanceSettings:
        if self.min_distance > self.max_distance:
            raise ValueError(
                f"MinDistance must be at most MaxDistance: {self.min_distance:g} and {self.max_distance:g}"
            )
        return self


class DistanceSensor:
    """Reads the distance to the first object ahead, at most the largest distance."""

    def __init__(self, settings: DistanceSettings, seed: int, name: str) -> None:
        self.settings = settings
        self._white = White(seed, name, 1)

    def read(self, truth: Truth, model: mujoco.MjModel, data: mujoco.MjData) -> float:
        """Return the distance in metres, with AirSim's noise."""
        eye, longest_m = truth.pose.of(self.settings.mount), self.settings.max_distance
        hits = cast(model, data, eye.position_m, eye.matrix()[:, :1].T, longest_m, exclude=truth.body)
        true_m = min(float(hits.distance_m[0]), longest_m)
        return true_m + float(self._white.at(truth.sample)[0]) * self.settings.uncorrelated_noise_sigma


class LidarSettings(_Mounted):
    """Channels, rates per second, range in metres and field of view in degrees."""

    sensor_type: Literal[6] = 6
    number_of_channels: Annotated[int, Field(ge=1, le=1024)] = 16
    range: Positive = 100.0
    points_per_second: Annotated[int, Field(ge=1)] = 100_000
    rotations_per_second: Annotated[int, Field(ge=0)] = 10
    horizontal_fov_start: Annotated[Degrees, Field(alias="HorizontalFOVStart")] = 0.0
    horizontal_fov_end: Annotated[Degrees, Field(alias="HorizontalFOVEnd")] = 359.0
    vertical_fov_upper: Annotated[Degrees, Field(alias="VerticalFOVUpper")] = -15.0
    vertical_fov_lower: Annotated[Degrees, Field(alias="VerticalFOVLower")] = -45.0
    data_frame: Literal["VehicleInertialFrame", "SensorLocalFrame"] = "VehicleInertialFrame"
    update_frequency: Positive = 10.0


class Scan(NamedTuple):
    """Points (n, 3) in metres, the geoms that were hit (n,), and the sensor's pose, NED."""

    points_m: NDArray[np.float64]
    geoms: NDArray[np.int32]
    pose: Pose


class Lidar:
    """Reads the points of one period, all from the vehicle's present pose."""

    def __init__(self, settings: LidarSettings, seed: int, name: str) -> None:
        self.settings = settings

    def read(self, truth: Truth, model: mujoco.MjModel, data: mujoco.MjData) -> Scan:
        own, eye = self.settings, truth.pose.of(self.settings.mount)
        scan = int(truth.time_s * own.update_frequency)
        seen = directions(own, scan * 360.0 * own.rotations_per_second / own.update_frequency)
        hits = cast(model, data, eye.position_m, seen @ eye.matrix().T, own.range, exclude=truth.body)
        met = hits.geoms >= 0
        points_m = seen[met] * hits.distance_m[met, None]
        if own.data_frame == "VehicleInertialFrame":
            points_m = points_m @ eye.matrix().T + np.array(eye.position_m)
        return Scan(points_m, hits.geoms[met], eye)


def directions(settings: LidarSettings, start_deg: float) -> NDArray[np.float64]:
    """Return unit vectors (n, 3) of a scan's rays in the sensor's frame, by channel from the top, clockwise.

    All channels have the same azimuths, from `start_deg` on, without those outside the horizontal field of view. There
    are none if a channel has less than half a point (UnrealLidarSensor::getPointCloud).
    """
    azimuths_deg = azimuths(settings, start_deg)
    channels_deg = np.linspace(settings.vertical_fov_upper, settings.vertical_fov_lower, settings.number_of_channels)
    pitch = np.radians(np.repeat(channels_deg, len(azimuths_deg)))
    yaw = np.radians(np.tile(azimuths_deg, settings.number_of_channels))
    return np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)], axis=1)


def azimuths(settings: LidarSettings, start_deg: float) -> NDArray[np.float64]:
    """Return the azimuths (m,), 0 to 360 degrees, of each channel's rays within the horizontal field of view.

    A field of view with equal ends is the full circle (VectorMath::isAngleBetweenAngles).
    """
    period_s = 1.0 / settings.update_frequency
    points = min(_half_up(settings.points_per_second * period_s), MOST_POINTS)
    of_one = _half_up(points / settings.number_of_channels)
    turn_deg = settings.rotations_per_second * 360.0 * period_s
    ray_deg = (start_deg + turn_deg * np.arange(of_one) / max(of_one, 1)) % 360.0
    first, last = settings.horizontal_fov_start % 360.0, settings.horizontal_fov_end % 360.0
    after, before = ray_deg >= first, ray_deg <= last
    return ray_deg[after & before if first < last else after | before]


def _half_up(count: float) -> int:
    """Round to the nearest integer, halves up: FMath::RoundHalfFromZero for non-negative numbers."""
    return math.floor(count + 0.5)
