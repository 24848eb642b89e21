"""What continuous actions mean: a velocity, an attitude, body rates, or the motors themselves. 0 hovers in all of them.

All functions take numbers, or arrays and tensors (n,) in their place: the actions of n games.
Source: AirSim v1.8.1, SimpleFlightApi.hpp: commandVelocity, commandRollPitchYawrateThrottle, commandAngleRatesThrottle
and commandMotorPWMs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from uavaccel.envs.arrays import constant
from uavaccel.envs.values import Number
from uavaccel.kinematics import AttitudeGoal, BodyRatesGoal, FlightGoal, MotorsGoal, Vector

ActionKind = Literal["velocity", "attitude", "rates", "motors"]
SIZES: dict[ActionKind, int] = {"velocity": 3, "attitude": 4, "rates": 4, "motors": 4}
"""Numbers of an action."""
HOVER_THROTTLE = 0.5941
"""Throttle that carries AirSim's generic quadrotor (1 kg, four rotors of 4.1794 N) 10 m above its default home."""
RAD = math.pi / 180.0  # as in math.radians


def throttle(share: Number) -> Number:
    """Return the throttle, 0 to 1, of a share from -1 to 1: 0 carries the vehicle's weight."""
    sinking, climbing = HOVER_THROTTLE * (1.0 + share), HOVER_THROTTLE + (1.0 - HOVER_THROTTLE) * share
    return sinking * (share < 0.0) + climbing * (share >= 0.0)


def low_level_goal(kind: ActionKind, shares: Sequence[Number], tilt_deg: Number, rate_deg_s: Number) -> FlightGoal:
    """Return the goal of four shares, -1 to 1, of the largest tilt, turn rate and throttle.

    "attitude": roll, pitch (nose up), yaw rate, throttle; "rates": roll, pitch and yaw rate, throttle, all FRD;
    "motors": front right, rear left, front left, rear right.
    """
    first, second, third, fourth = shares
    tilt, rate = tilt_deg * RAD, rate_deg_s * RAD
    if kind == "attitude":
        return AttitudeGoal(first * tilt, second * tilt, third * rate, throttle(fourth))
    if kind == "rates":
        return BodyRatesGoal(first * rate, second * rate, third * rate, throttle(fourth))
    return MotorsGoal(throttle(first), throttle(second), throttle(third), throttle(fourth))


def chosen(table: Sequence[Vector], action: Number) -> Number:
    """Return the columns of a table's row `action`, or with an array or tensor (n,) of rows: three arrays (n,)."""
    return constant(np.array(table), action)[action].T
