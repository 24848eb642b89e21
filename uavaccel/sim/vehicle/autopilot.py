"""SimpleFlight's cascade of position, velocity, angle and rate controllers and mixer, run once per tick.

Sources: AirSim v1.8.1, simple_flight/firmware: CascadeController, PositionController, VelocityController,
AngleLevelController, AngleRateController, PidController, OffboardApi (goal timeout), Mixer. All gains are
proportional except for the vertical velocity's leaky integrator, which is reset whenever the mode of z changes.

`goal` holds x, y, z and yaw, as velocities or positions. In the modes TILT and TILT_RATE the first two are roll and
pitch, in THROTTLE the third is a throttle, in MOTORS all four are motor commands.

Two peculiarities of AirSim are kept: velocities are regulated along the *body's* axes, so a tilted drone
climbs; and in `moveByVelocityZ` the height goal takes part in the rotation of the horizontal velocity goal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.parts import part
from uavaccel.sim.vehicle.quadrotor import PID_LEVELS, Record, density_ratio, world_to_body

VELOCITY, POSITION = 0, 1  # modes of x, y and of z
TILT, TILT_RATE, MOTORS = 2, 3, 4  # modes of x, y only: roll and pitch, their rates, motor commands
THROTTLE = 2  # mode of z only
RATE, ANGLE = 0, 1  # modes of yaw
UNSET = -1
POSITION_LEVEL, VELOCITY_LEVEL, ANGLE_LEVEL, RATE_LEVEL = range(PID_LEVELS)
NEW = 100  # added to the mode of a controller that has not been updated yet
IDLE_THROTTLE = 0.1 / 1.5  # of an armed vehicle without a goal (Params.hpp)


@part
def clip(value: float, limit: float) -> float:
    """Limit a value to -limit..limit."""
    return min(max(value, -limit), limit)


@part
def shortest_turn(goal_rad: float, angle_rad: float) -> float:
    """Return the difference of two angles, within half a turn."""
    turn = goal_rad - angle_rad
    return turn - 2 * math.pi * math.floor((turn + math.pi) / (2 * math.pi))


@part
def hold_position(state: Record) -> None:
    """Set the goal to the present position, yaw rate 0 (OffboardApi::update after the goal timeout)."""
    state.goal[0], state.goal[1], state.goal[2] = state.position[0], state.position[1], state.position[2]
    state.goal[3] = 0.0
    state.xy_mode, state.z_mode, state.yaw_mode = POSITION, POSITION, RATE


@part
def renew(state: Record) -> None:
    """Reset controllers whose mode has changed: AirSim makes new ones (CascadeController.hpp)."""
    for group in range(4):
        mode = (state.xy_mode, state.xy_mode, state.z_mode, state.yaw_mode)[group]
        if state.pid_mode[group] == mode + NEW:
            state.pid_mode[group] = mode
        elif state.pid_mode[group] != mode:
            state.pid_mode[group] = mode + NEW
            for slot in range(3 * PID_LEVELS):
                if pid_group(slot) == group:
                    state.pid_integral[slot] = state.pid_error[slot] = 0.0


@part
def pid_group(slot: int) -> int:
    """Return the group whose mode a controller follows: x or roll, y or pitch, z, yaw."""
    return 3 if slot % 3 == 2 and slot >= 3 * ANGLE_LEVEL else slot % 3


@part
def correction(parameters: Record, state: Record, level: int, axis: int, error: float) -> float:
    """Return the integral and derivative terms of a controller (PidController.hpp).

    In a new controller's first update no time has passed. The vertical velocity's integral is computed in `vertical`.
    """
    slot = 3 * level + axis
    if state.pid_mode[pid_group(slot)] >= NEW:
        return 0.0
    gathered = parameters.tick_s * error * parameters.integral_gain[slot]
    state.pid_integral[slot] = clip(state.pid_integral[slot] + gathered, 1.0)
    change = (error - state.pid_error[slot]) / parameters.tick_s
    state.pid_error[slot] = error
    return state.pid_integral[slot] + parameters.derivative_gain[slot] * change


@part
def velocity_goal(parameters: Record, state: Record, axis: int) -> float:
    """Return the output of one axis' position controller, m/s along that world axis."""
    error = state.goal[axis] - state.position[axis]
    output = parameters.position_gain[axis] * error
    if parameters.full_pid != 0:
        output += correction(parameters, state, POSITION_LEVEL, axis, error)
    return clip(output, 1.0) * parameters.velocity_limit_m_s


@part
def body_velocity_goal(parameters: Record, state: Record) -> tuple[float, float, float]:
    """Return the velocity goals along the body's axes, in m/s.

    In velocity mode the whole goal is rotated; a position controller rotates only its own axis.
    """
    goal = state.goal
    gx, gy, gz = world_to_body(state.quaternion, (goal[0], goal[1], goal[2]))
    if state.xy_mode == POSITION:
        gx = world_to_body(state.quaternion, (velocity_goal(parameters, state, 0), 0.0, 0.0))[0]
        gy = world_to_body(state.quaternion, (0.0, velocity_goal(parameters, state, 1), 0.0))[1]
    if state.z_mode == POSITION:
        gz = world_to_body(state.quaternion, (0.0, 0.0, velocity_goal(parameters, state, 2)))[2]
    return gx, gy, gz


@part
def vertical(parameters: Record, state: Record, error_m_s: float) -> float:
    """Return the throttle for a vertical velocity error: proportional and leaky integral terms, clipped to 1."""
    if state.z_integral_mode != state.z_mode:  # a new controller, in whose first update no time has passed
        state.z_integral_mode = state.z_mode
        state.z_integral = 0.0
    else:
        gathered = parameters.tick_s * error_m_s * parameters.z_integral_gain
        state.z_integral = clip(state.z_integral * parameters.z_integral_keep + gathered, 1.0)
    output = parameters.velocity_gain[2] * error_m_s + state.z_integral
    if parameters.full_pid != 0:
        output += correction(parameters, state, VELOCITY_LEVEL, 2, error_m_s)
    return max((1.0 - clip(output, 1.0)) / 2, parameters.min_throttle)


@part
def tilt_goal(parameters: Record, state: Record, axis: int, error_m_s: float) -> float:
    """Return the velocity controller's tilt, rad, for a velocity error along body axis 0 or 1."""
    output = parameters.velocity_gain[axis] * error_m_s
    if parameters.full_pid != 0:
        output += correction(parameters, state, VELOCITY_LEVEL, axis, error_m_s)
    return clip(output, 1.0) * parameters.tilt_limit_rad


@part
def rate_goal(parameters: Record, state: Record, axis: int, error_rad: float) -> float:
    """Return the angle controller's rate, rad/s, for an angle error."""
    output = parameters.angle_gain[axis] * error_rad
    if parameters.full_pid != 0:
        output += correction(parameters, state, ANGLE_LEVEL, axis, error_rad)
    return clip(output, 1.0) * parameters.rate_limit_rad_s


@part
def turn(parameters: Record, state: Record, axis: int, goal_rad_s: float) -> float:
    """Return the rate controller's output for the mixer, -1 to 1, for a rate about one body axis."""
    error = goal_rad_s - state.rate[axis]
    output = parameters.rate_gain[axis] * error
    if parameters.full_pid != 0:
        output += correction(parameters, state, RATE_LEVEL, axis, error)
    return clip(output, 1.0)


@part
def mix(parameters: Record, state: Record, throttle: float, roll: float, pitch: float, yaw: float) -> None:
    """Mix for a quad-X: shift commands up if one is below 0, scale them down if one is above 1 (Mixer.hpp)."""
    if throttle < parameters.min_mixed_throttle:
        state.rotor_input[:] = max(throttle, 0.0)
        return
    m0 = throttle - roll + pitch + yaw  # front right
    m1 = throttle + roll - pitch + yaw  # rear left
    m2 = throttle + roll + pitch - yaw  # front left
    m3 = throttle - roll - pitch - yaw  # rear right
    shift = max(-min(m0, m1, m2, m3), 0.0)
    scale = max(max(m0, m1, m2, m3) + shift, 1.0)
    state.rotor_input[0] = min(max((m0 + shift) / scale, 0.0), 1.0)
    state.rotor_input[1] = min(max((m1 + shift) / scale, 0.0), 1.0)
    state.rotor_input[2] = min(max((m2 + shift) / scale, 0.0), 1.0)
    state.rotor_input[3] = min(max((m3 + shift) / scale, 0.0), 1.0)


@part(inline=False)
def control(parameters: Record, state: Record) -> None:
    """Update the firmware at the state's tick, which sets the rotor commands."""
    if state.tick == state.hover_tick:
        hold_position(state)
    if state.armed == 0:
        state.rotor_input[:] = 0.0
        return

    if state.xy_mode == MOTORS:  # whatever flies next has new controllers
        state.z_integral_mode = THROTTLE
        state.pid_mode[:] = UNSET
        for rotor in range(4):
            state.rotor_input[rotor] = min(max(state.goal[rotor], 0.0), 1.0)
        return

    if parameters.full_pid != 0:
        renew(state)
    velocity = (state.velocity[0], state.velocity[1], state.velocity[2])
    vx, vy, vz = world_to_body(state.quaternion, velocity)
    gx, gy, gz = body_velocity_goal(parameters, state)
    w, x, y, z = state.quaternion[0], state.quaternion[1], state.quaternion[2], state.quaternion[3]

    if state.z_mode == THROTTLE:
        throttle = state.goal[2]
        state.z_integral_mode = THROTTLE  # the next vertical controller is a new one
    else:
        throttle = vertical(parameters, state, gz - vz)

    if state.xy_mode == TILT:
        roll_goal, pitch_goal = state.goal[0], state.goal[1]
    else:
        pitch_goal = -tilt_goal(parameters, state, 0, gx - vx)
        roll_goal = tilt_goal(parameters, state, 1, gy - vy)
    pitch = math.asin(clip(2 * (w * y - z * x), 1.0))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))

    if state.xy_mode == TILT_RATE:
        p_goal, q_goal = state.goal[0], state.goal[1]
    else:
        p_goal = rate_goal(parameters, state, 0, shortest_turn(roll_goal, roll))
        q_goal = rate_goal(parameters, state, 1, shortest_turn(pitch_goal, pitch))
    r_goal = state.goal[3]
    if state.yaw_mode == ANGLE:
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        r_goal = rate_goal(parameters, state, 2, shortest_turn(state.goal[3], yaw))

    roll_out, pitch_out = turn(parameters, state, 0, p_goal), turn(parameters, state, 1, q_goal)
    mix(parameters, state, throttle, roll_out, pitch_out, turn(parameters, state, 2, r_goal))


def settle(parameters_of: NDArray[np.void], flight: NDArray[np.void]) -> None:
    """Set rotors, integrator and height goal to the steady state of a position hold at the state's pose.

    Both arguments are arrays of one record (1,).
    """
    state, gains = flight[0], parameters_of[0]
    weight = gains["mass_kg"] * gains["gravity_m_s2"]
    # the Python function has equal results, and no compilation in every process that begins
    density = density_ratio.py_func(parameters_of.view(np.recarray)[0], state["position"][2])
    thrust = gains["max_thrust_n"] * density
    hover = weight / (4 * thrust)
    for name in ("rotor_input", "rotor_lagged", "rotor_output"):
        state[name] = hover
    hold_position.py_func(flight.view(np.recarray)[0])
    gathered = gains["tick_s"] * gains["z_integral_gain"] / (1.0 - gains["z_integral_keep"])
    stiffness = gains["velocity_gain"][2] + gathered
    error_m_s = (1.0 - 2.0 * hover) / stiffness if stiffness else 0.0  # a client's gains may be none
    reach_m_s = gains["position_gain"][2] * gains["velocity_limit_m_s"]
    state["z_integral"] = gathered * error_m_s
    state["z_integral_mode"] = POSITION
    state["goal"][2] += error_m_s / reach_m_s if reach_m_s else 0.0


class Yaw(NamedTuple):
    """A heading in rad or, if `is_rate`, a yaw rate in rad/s (AirSim's YawMode)."""

    value: float = 0.0
    is_rate: bool = True

    @property
    def mode(self) -> int:
        """The autopilot's mode of yaw."""
        return RATE if self.is_rate else ANGLE


STRAIGHT_ON = Yaw()


@dataclass(frozen=True, slots=True)
class Goal:
    """A goal: `values` are x, y, z and yaw, with meanings by the modes; positions are NED in m."""

    values: tuple[float, float, float, float]
    xy_mode: int
    z_mode: int
    yaw_mode: int


IDLE = Goal((0.0, -0.0, IDLE_THROTTLE, 0.0), TILT, THROTTLE, RATE)
