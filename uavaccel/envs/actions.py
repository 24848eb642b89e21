"""What continuous actions mean: a velocity, an attitude, body rates, or the motors themselves. 0 hovers in all of them.

Source: AirSim v1.8.1, SimpleFlightApi.hpp: commandVelocity, commandRollPitchYawrateThrottle, commandAngleRatesThrottle
and commandMotorPWMs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from uavaccel.kinematics import AttitudeGoal, BodyRatesGoal, FlightGoal, MotorsGoal

ActionKind = Literal["velocity", "attitude", "rates", "motors"]
SIZES: dict[ActionKind, int] = {"velocity": 3, "attitude": 4, "rates": 4, "motors": 4}
"""Numbers of an action."""
HOVER_THROTTLE = 0.5941
"""Throttle that carries AirSim's generic quadrotor (1 kg, four rotors of 4.1794 N) 10 m above its default home."""


def throttle(share: float) -> float:
    """Return the throttle, 0 to 1, of a share from -1 to 1: 0 carries the vehicle's weight."""
    return HOVER_THROTTLE * (1.0 + share) if share < 0.0 else HOVER_THROTTLE + (1.0 - HOVER_THROTTLE) * share


def low_level_goal(kind: ActionKind, shares: Sequence[float], tilt_deg: float, rate_deg_s: float) -> FlightGoal:
    """Return the goal of four shares, -1 to 1, of the largest tilt, turn rate and throttle.

    "attitude": roll, pitch (nose up), yaw rate, throttle; "rates": roll, pitch and yaw rate, throttle, all FRD;
    "motors": front right, rear left, front left, rear right.
    """
    first, second, third, fourth = (float(share) for share in shares)
    tilt, rate = math.radians(tilt_deg), math.radians(rate_deg_s)
    if kind == "attitude":
        return AttitudeGoal(first * tilt, second * tilt, third * rate, throttle(fourth))
    if kind == "rates":
        return BodyRatesGoal(first * rate, second * rate, third * rate, throttle(fourth))
    return MotorsGoal(throttle(first), throttle(second), throttle(third), throttle(fourth))
