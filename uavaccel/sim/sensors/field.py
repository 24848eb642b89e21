"""Inertial measurement unit, barometer, magnetometer and satellite receiver.

Sources: AirSim v1.8.1, ImuSimple (an MPU 6000), BarometerSimple, MagnetometerSimple, GpsSimple and their Params.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from uavaccel.kinematics import Vector
from uavaccel.sim.sensors.base import UPDATES_PER_S, AirSimKeys, Drift, Truth, White, seeds_of
from uavaccel.sim.sensors.earth import (
    GRAVITY_M_S2,
    SEA_LEVEL_PA,
    GeoPoint,
    atmosphere,
    geographic,
    magnetic_field_gauss,
    pressure_altitude_m,
)

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
        place = geographic(tuple(position.tolist()), truth.home)
        return GpsReading(place, eph, epv, tuple((velocity - acceleration * ago_s).tolist()), fix)
