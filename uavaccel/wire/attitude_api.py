"""AirSim's commands below velocities: attitudes, body rates, throttle, motors, the remote control, and the gains.

Sources: AirSim v1.8.1, MultirotorRpcLibServer.cpp, SimpleFlightApi.hpp. Angles are in radians, FRD, throttle and motors
from 0 to 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from uavaccel.sim.flight.pilot import Pilot
from uavaccel.sim.vehicle import goal as goals
from uavaccel.sim.vehicle.autopilot import POSITION, THROTTLE
from uavaccel.sim.vehicle.goal import Goal, Yaw
from uavaccel.sim.vehicle.sticks import RATE_MODE, STICKS, VALID, Sticks
from uavaccel.wire import types
from uavaccel.wire.flight_api import Answer, fly_for
from uavaccel.wire.method import Method

TURNS = (-1, -1, 1, 1)  # of the rotors: AirSim's sign of their torque
MAX_SPEED_RAD_S = 669.857
LARGEST_GAIN = 1e3  # thousands of times SimpleFlight's own
STICK_NAMES = ("roll", "pitch", "throttle", "yaw")  # in the order of manual.Sticks


class AttitudeApi:
    """The low-level calls of the vehicles that `pilot_of` finds by name; `wall_ns` is when a call is handled."""

    def __init__(self, pilot_of: Callable[[Any], Pilot], wall_ns: Callable[[], int]) -> None:
        self._pilot_of, self._wall_ns = pilot_of, wall_ns

    def methods(self) -> dict[str, Method]:
        """The calls, AirSim's names; the last argument of each is the vehicle's name."""
        return {
            "moveByRollPitchYawZ": self._tilt(False, POSITION),
            "moveByRollPitchYawThrottle": self._tilt(False, THROTTLE),
            "moveByRollPitchYawrateZ": self._tilt(True, POSITION),
            "moveByRollPitchYawrateThrottle": self._tilt(True, THROTTLE),
            "moveByAngleRatesZ": self._rates(POSITION),
            "moveByAngleRatesThrottle": self._rates(THROTTLE),
            "moveByMotorPWMs": Method(self.move_by_motor_pwms, 5, 1),
            "moveByRC": Method(self.move_by_rc, 1, 1),
            "getRotorStates": Method(self.rotor_states, 0, 1),
            "setAngleRateControllerGains": self._gains("rate"),
            "setAngleLevelControllerGains": self._gains("angle"),
            "setVelocityControllerGains": self._gains("velocity"),
            "setPositionControllerGains": self._gains("position"),
        }

    def _tilt(self, yaw_is_rate: bool, z_mode: int) -> Method:
        def move(roll: Any, pitch: Any, yaw: Any, z: Any, duration: Any, vehicle: Any = "") -> Answer:
            r, p, y, height = _four(roll=roll, pitch=pitch, yaw=yaw, z=z)
            return self._fly(goals.attitude(r, p, Yaw(y, yaw_is_rate), height, z_mode), duration, vehicle)

        return Method(move, 5, 1)

    def _rates(self, z_mode: int) -> Method:
        def move(roll: Any, pitch: Any, yaw: Any, z: Any, duration: Any, vehicle: Any = "") -> Answer:
            numbers = _four(roll_rate=roll, pitch_rate=pitch, yaw_rate=yaw, z=z)
            return self._fly(goals.body_rates(*numbers, z_mode), duration, vehicle)

        return Method(move, 5, 1)

    def move_by_motor_pwms(
        self, right: Any, rear_left: Any, left: Any, rear_right: Any, duration: Any, vehicle: Any = ""
    ) -> Answer:
        """Front right, rear left, front left, rear right."""
        numbers = _four(
            front_right_pwm=right, rear_left_pwm=rear_left, front_left_pwm=left, rear_right_pwm=rear_right
        )
        return self._fly(goals.motors(*numbers), duration, vehicle)

    def _fly(self, goal: Goal, duration: Any, vehicle: Any) -> Answer:
        return fly_for(self._pilot_of(vehicle), goal, duration, self._wall_ns())

    def move_by_rc(self, data: Any, vehicle: Any = "") -> None:
        """The sticks of a remote control: they fly the vehicle while no program has control, and moveByManual."""
        if not isinstance(data, Mapping):
            raise ValueError(f"rcdata must be a map, not {type(data).__name__}")
        sticks = np.zeros(STICKS)
        for index, name in enumerate(STICK_NAMES):
            sticks[index] = types.number(data.get(name, 0.0), name)
        sticks[RATE_MODE] = int(types.number(data.get("switches", 0), "switches")) & 1
        sticks[VALID] = types.flag(data.get("is_valid", False), "is_valid")
        self._pilot_of(vehicle).move_sticks(sticks)

    def rotor_states(self, vehicle: Any = "") -> dict[str, Any]:
        """RotorStates: N and N m at sea level's air, rad/s (RotorActuator.hpp)."""
        pilot = self._pilot_of(vehicle)
        parameters, outputs = pilot.vehicle.parameters, pilot.vehicle.state["rotor_output"].tolist()
        rotors = [
            {
                "thrust": float(parameters["max_thrust_n"]) * output,
                "torque_scaler": float(parameters["max_torque_n_m"]) * output * sign,
                "speed": MAX_SPEED_RAD_S * math.sqrt(output),
            }
            for output, sign in zip(outputs, TURNS, strict=True)
        ]
        return {"rotors": rotors, "timestamp": types.stamp(pilot.kinematics().time_ns)}

    def _gains(self, level: str) -> Method:
        def set_gains(kp: Any, ki: Any, kd: Any, vehicle: Any = "") -> None:
            gains = [_three(numbers, name) for numbers, name in ((kp, "kp"), (ki, "ki"), (kd, "kd"))]
            self._pilot_of(vehicle).vehicle.set_gains(level, *gains)

        return Method(set_gains, 3, 1)


def stick_map(sticks: Sticks) -> dict[str, Any]:
    """What of RCData the sticks are."""
    valid = bool(sticks[VALID])
    names = zip(STICK_NAMES, sticks[: len(STICK_NAMES)].tolist(), strict=True)
    return {**dict(names), "switches": int(sticks[RATE_MODE]), "is_initialized": valid, "is_valid": valid}


def _four(**numbers: Any) -> tuple[float, float, float, float]:
    a, b, c, d = (types.number(value, name) for name, value in numbers.items())
    return a, b, c, d


def _three(numbers: Any, name: str) -> tuple[float, float, float]:
    if not isinstance(numbers, list) or len(numbers) != 3:
        raise ValueError(f"{name} must be a list of three gains")
    a, b, c = (types.number(number, name) for number in numbers)
    if max(abs(a), abs(b), abs(c)) > LARGEST_GAIN:
        raise ValueError(f"{name} must be within {LARGEST_GAIN:g}, not {numbers}")
    return a, b, c
