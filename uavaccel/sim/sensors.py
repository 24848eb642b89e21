"""AirSim's sensors: their settings under AirSim's names, and their readings of a vehicle's true state at a tick.

A reading's noise depends only on that tick and on a seed, not on earlier readings. Sources: AirSim v1.8.1, ImuSimple
(an MPU 6000), BarometerSimple, MagnetometerSimple, GpsSimple, DistanceSimple, LidarSimple, their Params,
UnrealDistanceSensor.cpp, UnrealLidarSensor.cpp.
"""

from __future__ import annotations

import math
import zlib
from typing import Annotated, Literal, NamedTuple, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, field_validator, model_validator
from pydantic.alias_generators import to_pascal

from uavaccel.config import Config
from uavaccel.kinematics import Kinematics, Vector
from uavaccel.sim.earth import (
    GRAVITY_M_S2,
    SEA_LEVEL_PA,
    GeoPoint,
    atmosphere,
    geodetic,
    magnetic_field_gauss,
    pressure_altitude_m,
)
from uavaccel.sim.objects import cast
from uavaccel.sim.poses import HERE, Pose, from_degrees
from uavaccel.units import NS_PER_S


class AirSimKeys(Config):
    """Settings with AirSim's PascalCase keys; unknown keys are kept.

    Every number is 0, or between LEAST and MOST in size: what is computed from it stays finite.
    """

    model_config = ConfigDict(extra="allow", alias_generator=to_pascal)

    @field_validator("*")
    @classmethod
    def _in_range(cls, value: Checked) -> Checked:
        if isinstance(value, int | float) and value and not LEAST <= abs(value) <= MOST:
            raise ValueError(f"must be 0, or between {LEAST:g} and {MOST:g} in size")
        return value


Checked = TypeVar("Checked")
LEAST, MOST = 1e-12, 1e12


class Truth(NamedTuple):
    """Ground truth for a reading: a vehicle's state, physics step, time since the last reset, and NED's origin."""

    kinematics: Kinematics
    tick_s: float
    since_reset_s: float
    home: GeoPoint
    body: str = "quadrotor"  # the vehicle's body in the model, through which rays pass
    origin_m: Vector = HERE  # of its own frame, NED in the world

    @property
    def time_s(self) -> float:
        return self.kinematics.time_ns / NS_PER_S

    @property
    def sample(self) -> int:
        """Number of the tick since the simulation was made."""
        return round(self.time_s / self.tick_s)

    @property
    def pose(self) -> Pose:
        """Pose of the vehicle, NED."""
        return Pose(self.kinematics.position_m, self.kinematics.orientation_wxyz)

    @property
    def place(self) -> GeoPoint:
        """Geographic position of the vehicle."""
        return geodetic(self.kinematics.position_m, self.home, self.origin_m)


UPDATES_PER_S = 50  # of a drift: BarometerSimpleParams' update_frequency


def seeds_of(seed: int, sensor: str) -> np.random.SeedSequence:
    """Return the seed sequence of a sensor, by its name."""
    return np.random.SeedSequence([seed, zlib.crc32(sensor.encode())])


class White:
    """White noise: independent standard normal numbers for each sample."""

    def __init__(self, seed: int, sensor: str, size: int) -> None:
        self._key = seeds_of(seed, sensor).generate_state(2, np.uint64)
        self._size = size

    def at(self, sample: int) -> NDArray[np.float64]:
        """Return the noise (size,) of sample number `sample`, 0 or more."""
        generator = np.random.Generator(np.random.Philox(key=self._key, counter=[0, 0, 0, sample]))
        return generator.standard_normal(self._size)


class Drift:
    """A first-order process that begins at 0; each step multiplies it by `keep` and adds `gain` times a normal number.

    It has UPDATES_PER_S steps, as AirSim's barometer.
    """

    def __init__(self, seed: int, sensor: str, size: int, keep: float, gain: float) -> None:
        self._white, self._size = White(seed, sensor, UPDATES_PER_S * size), size
        self._keep, self._gain = keep, gain
        self._shares = gain * keep ** np.arange(UPDATES_PER_S - 1, -1, -1.0)[:, None]  # at a second's end
        self._begin()

    def _begin(self) -> None:
        self._second, self._first = 0, np.zeros(self._size)
        self._values: list[NDArray[np.float64]] = []  # of this second, once they are asked for

    def at(self, time_s: float) -> NDArray[np.float64]:
        """Return the value (size,) at a time, 0 s or more."""
        second, update = divmod(math.floor(time_s * UPDATES_PER_S + 1e-6), UPDATES_PER_S)
        if second < self._second:  # a reset, or a saved state was gone back to
            self._begin()
        while self._second < second:
            gained = (self._shares * self._drawn()).sum(axis=0)
            self._first = self._keep**UPDATES_PER_S * self._first + gained
            self._second += 1
            self._values = []
        if not self._values:
            self._values = [self._first]
            for drawn in self._drawn():
                self._values.append(self._keep * self._values[-1] + self._gain * drawn)
        return self._values[update].copy()

    def _drawn(self) -> NDArray[np.float64]:
        """Return the normal numbers (UPDATES_PER_S, size) of the present second."""
        return self._white.at(self._second).reshape(UPDATES_PER_S, self._size)


NotNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]


class ImuSettings(AirSimKeys):
    """Noise in AirSim's units, time constants in seconds."""

    sensor_type: Literal[2] = 2
    enabled: bool = True
    angular_random_walk: NotNegative = 0.30
    """Degrees per root hour."""
    gyro_bias_stability_tau: Positive = 500.0
    gyro_bias_stability: NotNegative = 4.6
    """Degrees per hour."""
    velocity_random_walk: NotNegative = 0.24
    """Thousandths of gravity."""
    accel_bias_stability_tau: Positive = 800.0
    accel_bias_stability: NotNegative = 36.0
    """Millionths of gravity."""


class ImuReading(NamedTuple):
    """Body rate in rad/s and specific force in m/s², FRD."""

    angular_velocity_rad_s: Vector
    linear_acceleration_m_s2: Vector


class Imu:
    """Reads rate and force at every tick, with white noise and random-walk biases."""

    def __init__(self, settings: ImuSettings, seed: int, name: str) -> None:
        self._rate_noise = math.radians(settings.angular_random_walk) / math.sqrt(3600)
        self._force_noise = settings.velocity_random_walk * GRAVITY_M_S2 / 1e3
        rate_walk = math.radians(settings.gyro_bias_stability / 3600) / math.sqrt(settings.gyro_bias_stability_tau)
        force_walk = settings.accel_bias_stability * 1e-6 * GRAVITY_M_S2
        force_walk /= math.sqrt(settings.accel_bias_stability_tau)
        self._white = White(seed, name, 6)
        step = 1.0 / math.sqrt(UPDATES_PER_S)  # of a random walk of 1 per root second
        self._rate_bias = Drift(seed, f"{name} rate", 3, 1.0, rate_walk * step)
        self._force_bias = Drift(seed, f"{name} force", 3, 1.0, force_walk * step)

    def read(self, truth: Truth) -> ImuReading:
        kinematics = truth.kinematics
        white = self._white.at(truth.sample) / math.sqrt(truth.tick_s)
        rate = np.array(kinematics.angular_velocity_rad_s) + white[:3] * self._rate_noise
        free_fall = np.array(kinematics.linear_acceleration_m_s2) - (0.0, 0.0, GRAVITY_M_S2)
        force = free_fall @ truth.pose.matrix() + white[3:] * self._force_noise
        rate += self._rate_bias.at(truth.time_s)
        force += self._force_bias.at(truth.time_s)
        return ImuReading(tuple(rate.tolist()), tuple(force.tolist()))


NO_FIX, FIX_2D, FIX_3D = 0, 2, 3


class BarometerSettings(AirSimKeys):
    """Drift as a share of the pressure, its time constant in seconds, noise in pascals."""

    sensor_type: Literal[1] = 1
    enabled: bool = True
    pressure_factor_sigma: NotNegative = 0.0365 / 20
    pressure_factor_tau: Positive = 3600.0
    uncorrelated_noise_sigma: NotNegative = 2.7


class BarometerReading(NamedTuple):
    """Altitude in metres, pressure in pascals, and pressure at sea level in hectopascals."""

    altitude_m: float
    pressure_pa: float
    qnh_hpa: float = SEA_LEVEL_PA / 100


class Barometer:
    """Reads the standard atmosphere's pressure with a drift since the last reset, and white noise.

    The drift is a Gauss-Markov process as in GaussianMarkov.hpp: its increments scale with the step instead of its
    square root, so that it stays far below `pressure_factor_sigma`.
    """

    def __init__(self, settings: BarometerSettings, seed: int, name: str) -> None:
        self._white, self._sigma_pa = White(seed, name, 1), settings.uncorrelated_noise_sigma
        keep = math.exp(-1.0 / UPDATES_PER_S / settings.pressure_factor_tau)
        gain = (1.0 - keep) * settings.pressure_factor_sigma
        self._drift = Drift(seed, f"{name} drift", 1, keep, gain)

    def read(self, truth: Truth) -> BarometerReading:
        pressure = atmosphere(truth.place.altitude).pressure_pa
        pressure *= 1.0 + float(self._drift.at(truth.since_reset_s)[0])
        pressure += float(self._white.at(truth.sample)[0]) * self._sigma_pa
        pressure = max(pressure, 0.0)  # whatever the noise
        return BarometerReading(pressure_altitude_m(pressure), pressure)


class MagnetometerSettings(AirSimKeys):
    """Noise and bias in gauss."""

    sensor_type: Literal[4] = 4
    enabled: bool = True
    noise_sigma: NotNegative = 0.005
    scale_factor: float = 1.0
    noise_bias: NotNegative = 0.0


class Magnetometer:
    """Reads the dipole's field at the vehicle, with a constant bias and white noise."""

    def __init__(self, settings: MagnetometerSettings, seed: int, name: str) -> None:
        self._settings = settings
        self._white = White(seed, name, 3)
        within = settings.noise_bias
        self._bias = np.random.default_rng(seeds_of(seed, f"{name} bias")).uniform(-within, within, 3)

    def read(self, truth: Truth) -> Vector:
        """Return the field in gauss, FRD."""
        field = np.array(magnetic_field_gauss(truth.place)) @ truth.pose.matrix() * self._settings.scale_factor
        field += self._white.at(truth.sample) * self._settings.noise_sigma + self._bias
        x, y, z = field.tolist()
        return x, y, z


class GpsSettings(AirSimKeys):
    """Dilutions in metres, times in seconds."""

    sensor_type: Literal[3] = 3
    enabled: bool = True
    eph_time_constant: Annotated[float, Field(alias="EPH_TimeConstant", gt=0.0)] = 0.9
    epv_time_constant: Annotated[float, Field(alias="EPV_TimeConstant", gt=0.0)] = 0.9
    eph_initial: float = 100.0
    epv_initial: float = 100.0
    eph_final: float = 0.1
    epv_final: float = 0.1
    eph_min3d: float = 3.0
    eph_min2d: float = 4.0
    update_latency: NotNegative = 0.2


class GpsReading(NamedTuple):
    """Position, horizontal and vertical dilution in metres, velocity in m/s NED, and the kind of fix."""

    place: GeoPoint
    eph_m: float
    epv_m: float
    velocity_m_s: Vector
    fix: int


class Gps:
    """Reads a delayed true position without noise, and dilutions that fall after a reset.

    The delayed position is extrapolated back from the present velocity and acceleration.
    """

    def __init__(self, settings: GpsSettings, seed: int, name: str) -> None:
        self._settings = settings

    def read(self, truth: Truth) -> GpsReading:
        own, kinematics = self._settings, truth.kinematics
        ago_s = min(own.update_latency, truth.since_reset_s)
        acceleration = np.array(kinematics.linear_acceleration_m_s2)
        velocity = np.array(kinematics.linear_velocity_m_s)
        position = np.array(kinematics.position_m) - velocity * ago_s + acceleration * ago_s**2 / 2
        eph, epv = (
            final + (initial - final) * math.exp(-truth.since_reset_s / constant_s)
            for final, initial, constant_s in (
                (own.eph_final, own.eph_initial, own.eph_time_constant),
                (own.epv_final, own.epv_initial, own.epv_time_constant),
            )
        )
        fix = FIX_3D if eph <= own.eph_min3d else FIX_2D if eph <= own.eph_min2d else NO_FIX
        place = geodetic(tuple(position.tolist()), truth.home, truth.origin_m)
        return GpsReading(place, eph, epv, tuple((velocity - acceleration * ago_s).tolist()), fix)


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

    All channels have the same azimuths, from `start_deg` on, without those outside the horizontal field of view, which
    is the full circle if its ends are equal (VectorMath::isAngleBetweenAngles). There are none if a channel has less
    than half a point (UnrealLidarSensor::getPointCloud).
    """
    period_s, channels = 1.0 / settings.update_frequency, settings.number_of_channels
    points = min(_half_up(settings.points_per_second * period_s), MOST_POINTS)
    of_one = _half_up(points / channels)
    turn_deg = settings.rotations_per_second * 360.0 * period_s
    azimuths_deg = (start_deg + turn_deg * np.arange(of_one) / max(of_one, 1)) % 360.0
    first, last = settings.horizontal_fov_start % 360.0, settings.horizontal_fov_end % 360.0
    after, before = azimuths_deg >= first, azimuths_deg <= last
    azimuths_deg = azimuths_deg[after & before if first < last else after | before]
    channels_deg = np.linspace(settings.vertical_fov_upper, settings.vertical_fov_lower, channels)
    pitch, yaw = np.radians(np.repeat(channels_deg, len(azimuths_deg))), np.radians(np.tile(azimuths_deg, channels))
    return np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)], axis=1)


def _half_up(count: float) -> int:
    """Round to the nearest integer, halves up: FMath::RoundHalfFromZero for non-negative numbers."""
    return math.floor(count + 0.5)
