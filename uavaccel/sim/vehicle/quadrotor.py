"""AirSim's generic quad-X: its parameters, its flight state, and the forces on it, in NED and FRD.

Mass and inertia come from the MJCF model. Sources: AirSim v1.8.1 MultiRotorParams.hpp (setupFrameGenericQuad),
RotorParams.hpp, RotorActuator.hpp, MultiRotorPhysicsBody.hpp (drag faces), FastPhysicsEngine.hpp, EarthUtils.hpp
(atmosphere), SimpleFlight's Params.hpp (gains and limits).
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.parts import njit, part

Record: TypeAlias = Any  # one element of a structured array, which numba knows field by field

ROTORS = 4
HOVERS = (0.33, 0.89)  # shares of full thrust; the autopilot's is at least .3, so that a lighter one never descends
NEVER = np.iinfo(np.int64).max

PID_LEVELS = 4  # position, velocity, angle, rate: each with three axes

KINEMATICS = 3 + 4 + 3 + 3 + 3 + 3

PARAMETERS_DTYPE = np.dtype(
    [
        ("tick_s", "f8"),
        ("mass_kg", "f8"),
        ("inertia_kg_m2", "f8", 3),
        ("gravity_m_s2", "f8"),
        ("max_thrust_n", "f8"),
        ("max_torque_n_m", "f8"),
        ("rotor_arm_m", "f8"),
        ("rotor_keep", "f8"),  # what the rotors' first-order lag keeps over one tick
        ("drag_factor_m2", "f8", 3),
        ("drag_min_velocity_m_s", "f8"),
        ("ground_altitude_m", "f8"),  # of NED's origin over the sea: the air's density depends on it
        ("position_gain", "f8", 3),
        ("velocity_limit_m_s", "f8"),
        ("velocity_gain", "f8", 3),
        ("z_integral_gain", "f8"),
        ("z_integral_keep", "f8"),  # AirSim leaks 1e-4 each 3 ms
        ("tilt_limit_rad", "f8"),
        ("yaw_limit_rad", "f8"),
        ("angle_gain", "f8", 3),
        ("rate_limit_rad_s", "f8"),
        ("rate_gain", "f8", 3),
        ("min_throttle", "f8"),
        ("min_mixed_throttle", "f8"),
        ("hover_after_ticks", "i8"),
        # integral and derivative gains of the levels of the cascade, which AirSim leaves at 0 but for z_integral_gain
        ("full_pid", "i8"),  # whether any of them is not
        ("integral_gain", "f8", 3 * PID_LEVELS),
        ("derivative_gain", "f8", 3 * PID_LEVELS),
        ("sea_density_kg_m3", "f8"),  # the air's at sea level, which thrust and torque are given for
        ("contacts_act", "i8"),  # whether what is touched pushes back; else the first touch ends the flight
    ]
)

FLIGHT_DTYPE = np.dtype(
    [
        ("tick", "i8"),
        # the kinematics at this tick, from here to angular_acceleration: KINEMATICS numbers
        ("position", "f8", 3),
        ("quaternion", "f8", 4),
        ("velocity", "f8", 3),
        ("rate", "f8", 3),
        ("acceleration", "f8", 3),
        ("angular_acceleration", "f8", 3),
        ("wind", "f8", 3),
        # the goal: x, y (m or m/s), z (m or m/s), yaw (rad or rad/s), and what each is
        ("goal", "f8", 4),
        ("xy_mode", "i8"),
        ("z_mode", "i8"),
        ("yaw_mode", "i8"),
        ("hover_tick", "i8"),  # position hold sets in at this tick
        ("armed", "i8"),
        # the vertical integrator, created anew whenever the mode of z changes
        ("z_integral", "f8"),
        ("z_integral_mode", "i8"),
        # rotor command -> lag -> output -> wrench of the next tick
        ("rotor_input", "f8", ROTORS),
        ("rotor_lagged", "f8", ROTORS),
        ("rotor_output", "f8", ROTORS),
        ("collision_tick", "i8"),  # of the first touch
        # how many contacts there were at the last step's beginning, and when and where that last changed
        ("contacts", "f8"),
        ("contacts_changed", "i8"),
        ("contact_tick", "i8"),
        ("contact_position", "f8", 3),
        # of the integral and derivative gains: what was gathered, the last errors, and the modes that they belong to
        ("pid_integral", "f8", 3 * PID_LEVELS),
        ("pid_error", "f8", 3 * PID_LEVELS),
        ("pid_mode", "i8", 4),
    ]
)


def parameters(
    tick_s: float, hover_after_ticks: int, mass_kg: float, inertia: NDArray[np.float64], contacts_act: bool = True
) -> NDArray[np.void]:
    """Make a record (1,) of PARAMETERS_DTYPE for a physics step of `tick_s` seconds."""
    record = np.zeros(1, PARAMETERS_DTYPE)
    record["tick_s"] = tick_s
    record["hover_after_ticks"] = hover_after_ticks
    record["contacts_act"] = contacts_act
    record["mass_kg"] = mass_kg
    record["inertia_kg_m2"][:] = inertia
    record["gravity_m_s2"] = 9.80665
    record["max_thrust_n"] = 4.1794453
    record["max_torque_n_m"] = 0.055562172
    record["rotor_arm_m"] = 0.16086679  # 0.2275 m at 45 degrees
    record["rotor_keep"] = math.exp(-tick_s / 0.005)
    record["drag_factor_m2"] = (0.0053830924, 0.005838092, 0.10993009)
    record["drag_min_velocity_m_s"] = 0.1
    record["ground_altitude_m"] = 122.0
    record["position_gain"] = 0.25
    record["velocity_limit_m_s"] = 6.0
    record["velocity_gain"] = (0.2, 0.2, 2.0)
    record["z_integral_gain"] = 2.0
    record["z_integral_keep"] = 0.9999 ** (tick_s / 0.003)
    record["tilt_limit_rad"] = math.pi / 5.5
    record["yaw_limit_rad"] = math.pi
    record["angle_gain"] = 2.5
    record["rate_limit_rad_s"] = 2.5
    record["rate_gain"] = 0.25
    record["min_throttle"] = 0.3
    record["min_mixed_throttle"] = 0.05
    record["sea_density_kg_m3"] = air_density(0.0)
    return record


@njit(cache=True)
def air_density(altitude_m: float) -> float:
    """Return the air density, kg/m³, in the standard atmosphere's two lowest layers (EarthUtils.hpp).

    The isothermal upper layer, from 11 to 20 km, is extrapolated above, so that the density is never 0.
    """
    height_km = 6378.137 * (altitude_m / 1000.0) / (6378.137 + altitude_m / 1000.0)
    if height_km > 11.0:
        return 22632.06 * math.exp(-0.1577 * (height_km - 11.0)) / 287.053 / 216.65
    temperature = 288.15 - 6.5 * height_km
    return 101325.0 * (temperature / 288.15) ** 5.255877 / 287.053 / temperature


@part
def density_ratio(parameters: Record, z_m: float) -> float:
    """Return the air density at NED `z_m` relative to sea level, to which thrust and torque are proportional."""
    return air_density(parameters.ground_altitude_m - z_m) / parameters.sea_density_kg_m3


@part
def body_to_world(q: NDArray[np.float64], vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """Rotate by the wxyz quaternion `q`."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    a, b, c = vector
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx


@part
def world_to_body(q: NDArray[np.float64], vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """Rotate by the inverse of the wxyz quaternion `q`."""
    w, x, y, z = q[0], -q[1], -q[2], -q[3]
    a, b, c = vector
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx


@part
def face_drag(factor_m2: float, density: float, speed: float, min_speed: float) -> float:
    """Return the drag, N, along one body axis on the face that meets the air.

    A face's centre lies on its axis, so that rotation adds no velocity along its normal, and its drag no torque.
    """
    if abs(speed) > min_speed:
        return -factor_m2 * density * speed * abs(speed)
    return 0.0


@part(inline=False)
def accelerate(
    parameters: Record, state: Record, velocity: tuple[float, float, float], rate: tuple[float, float, float]
) -> None:
    """Set the accelerations due to rotors, drag and gravity at the state's pose.

    `velocity` (world) and `rate` (body) are those half a tick later: AirSim evaluates drag and the gyroscopic
    term at the step's mean velocity (FastPhysicsEngine.hpp, getNextKinematicsNoCollision).
    """
    density = air_density(parameters.ground_altitude_m - state.position[2])
    ratio = density / parameters.sea_density_kg_m3
    output = state.rotor_output
    u0, u1, u2, u3 = output[0], output[1], output[2], output[3]
    thrust, arm = parameters.max_thrust_n * ratio, parameters.rotor_arm_m

    # rotors: 0 front right, 1 rear left (both counter-clockwise), 2 front left, 3 rear right
    force_z = -thrust * (u0 + u1 + u2 + u3)
    torque_x = thrust * arm * (-u0 + u1 + u2 - u3)
    torque_y = thrust * arm * (u0 - u1 + u2 - u3)
    torque_z = parameters.max_torque_n_m * ratio * (u0 + u1 - u2 - u3)

    wind = state.wind
    relative = (velocity[0] - wind[0], velocity[1] - wind[1], velocity[2] - wind[2])
    vx, vy, vz = world_to_body(state.quaternion, relative)
    p, q, r = rate
    factor, least = parameters.drag_factor_m2, parameters.drag_min_velocity_m_s
    force_x = face_drag(factor[0], density, vx, least)
    force_y = face_drag(factor[1], density, vy, least)
    force_z += face_drag(factor[2], density, vz, least)

    fx, fy, fz = body_to_world(state.quaternion, (force_x, force_y, force_z))
    state.acceleration[0] = fx / parameters.mass_kg
    state.acceleration[1] = fy / parameters.mass_kg
    state.acceleration[2] = fz / parameters.mass_kg + parameters.gravity_m_s2

    ix, iy, iz = parameters.inertia_kg_m2[0], parameters.inertia_kg_m2[1], parameters.inertia_kg_m2[2]
    state.angular_acceleration[0] = (torque_x - (iz - iy) * q * r) / ix
    state.angular_acceleration[1] = (torque_y - (ix - iz) * r * p) / iy
    state.angular_acceleration[2] = (torque_z - (iy - ix) * p * q) / iz


@part(inline=False)
def turn_rotors(parameters: Record, state: Record) -> None:
    """Advance the rotors' lag by a tick: the output follows the lagged command a tick later (RotorActuator.hpp)."""
    keep = parameters.rotor_keep
    for rotor in range(ROTORS):
        state.rotor_output[rotor] = state.rotor_lagged[rotor]
        state.rotor_lagged[rotor] = keep * state.rotor_lagged[rotor] + (1.0 - keep) * state.rotor_input[rotor]
