"""The inertial measurement unit. Source: AirSim v1.8.1, ImuSimple.hpp and ImuSimpleParams.hpp (an MPU 6000)."""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from uavaccel.kinematics import Vector
from uavaccel.sim.sensors.base import AirSimKeys, Truth, sensor
from uavaccel.sim.sensors.earth import GRAVITY_M_S2
from uavaccel.sim.sensors.noise import UPDATES_PER_S, Drift, White

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


@sensor(ImuSettings)
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
