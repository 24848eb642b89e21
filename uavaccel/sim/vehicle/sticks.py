"""The sticks of a remote control, and what they ask of the autopilot.

Source: AirSim v1.8.1, RemoteControl.hpp (updateGoal), SimpleFlightApi.hpp (setRCData). The sticks hold until they are
moved: their age is not looked at.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.vehicle import autopilot
from uavaccel.sim.vehicle import goal as goals
from uavaccel.sim.vehicle.goal import Goal, Yaw

ROLL, PITCH, THROTTLE, YAW, RATE_MODE, VALID = range(6)
STICKS = 6
RATE_SWITCH = 0.3
TILT_LIMIT_RAD = math.pi / 5.5

Sticks = NDArray[np.float64]  # roll, pitch, throttle, yaw, the switch for rates, whether they are valid


def stick_goal(sticks: Sticks) -> Goal:
    """What the sticks ask for while no program has control: angles, or rates where the switch says so."""
    throttle = max(sticks[THROTTLE], autopilot.IDLE_THROTTLE)
    roll, pitch = sticks[ROLL] * TILT_LIMIT_RAD, -sticks[PITCH] * TILT_LIMIT_RAD
    yaw_rate = sticks[YAW] * math.pi
    if sticks[RATE_MODE] >= RATE_SWITCH:
        return goals.body_rates(roll, pitch, yaw_rate, throttle, autopilot.THROTTLE)
    return goals.attitude(roll, pitch, Yaw(yaw_rate), throttle, autopilot.THROTTLE)


IDLE = stick_goal(np.zeros(STICKS))
