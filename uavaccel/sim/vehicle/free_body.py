"""MuJoCo's Euler step of a single free body without contacts, bit for bit, in a twentieth of `mj_step`'s time.

The operations are those of MuJoCo 4.0, in its order, as its wheels for x86-64 are built: with AVX, which adds four
products in pairs, and without fused multiply-adds. On other platforms the last bits differ from `mj_step`'s. Sources:
engine_core_smooth.c (kinematics, comPos, comVel, rne), engine_forward.c (fwdAcceleration, advance),
engine_util_spatial.c (quat2Mat, inertCom, mulInertVec, crossMotion, crossForce, quatIntegrate).

Everything is in MuJoCo's frames: metres and m/s of the world, rad/s and the torque of the body.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.parts import part
from uavaccel.sim.vehicle.quadrotor import Record

Triple: TypeAlias = tuple[float, float, float]
Quad: TypeAlias = tuple[float, float, float, float]
Array: TypeAlias = NDArray[np.float64]

LEAST = 1e-15  # mjMINVAL: a norm this close to 0 or to 1 counts as equal
HUGE = 1e10  # mjMAXVAL: MuJoCo warns of numbers beyond


@part
def cross(a: Triple, b: Triple) -> Triple:
    """Return the cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@part
def weighted(a: Triple, b: Triple, c: Triple, by: Triple) -> Triple:
    """Return a by[0] + b by[1] + c by[2]."""
    return (
        a[0] * by[0] + b[0] * by[1] + c[0] * by[2],
        a[1] * by[0] + b[1] * by[1] + c[1] * by[2],
        a[2] * by[0] + b[2] * by[1] + c[2] * by[2],
    )


@part
def normalised(w: float, x: float, y: float, z: float) -> Quad:
    """Return the normalised quaternion."""
    norm = math.sqrt((w * w + x * x) + (y * y + z * z))
    if norm < LEAST:
        return 1.0, 0.0, 0.0, 0.0
    if abs(norm - 1.0) > LEAST:
        inverse = 1.0 / norm
        return w * inverse, x * inverse, y * inverse, z * inverse
    return w, x, y, z


@part
def body_axes(q: Quad) -> tuple[Triple, Triple, Triple]:
    """Return the body's axes in the world, the columns of its rotation matrix."""
    w, x, y, z = q
    a, b = w * w - y * y, x * x - z * z
    return (
        (a + b, 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), (w * w + y * y) - (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), a - b),
    )


@part
def momentum(
    axes: tuple[Triple, Triple, Triple], inertia: Array, arm: Triple, mass: float, spin: Triple, velocity: Triple
) -> tuple[Triple, Triple]:
    """Return spatial inertia, about a point `arm` from the centre of mass, times a motion."""
    ax, ay, az = axes
    rx = (ax[0] * inertia[0], ax[1] * inertia[0], ax[2] * inertia[0])
    ry = (ay[0] * inertia[1], ay[1] * inertia[1], ay[2] * inertia[1])
    rz = (az[0] * inertia[2], az[1] * inertia[2], az[2] * inertia[2])
    dx, dy, dz = arm
    xx = (ax[0] * rx[0] + ay[0] * ry[0] + az[0] * rz[0]) + mass * (dy * dy + dz * dz)
    yy = (ax[1] * rx[1] + ay[1] * ry[1] + az[1] * rz[1]) + mass * (dx * dx + dz * dz)
    zz = (ax[2] * rx[2] + ay[2] * ry[2] + az[2] * rz[2]) + mass * (dx * dx + dy * dy)
    xy = (ax[0] * rx[1] + ay[0] * ry[1] + az[0] * rz[1]) - mass * dx * dy
    xz = (ax[0] * rx[2] + ay[0] * ry[2] + az[0] * rz[2]) - mass * dx * dz
    yz = (ax[1] * rx[2] + ay[1] * ry[2] + az[1] * rz[2]) - mass * dy * dz
    mx, my, mz = mass * dx, mass * dy, mass * dz
    p, q, r = spin
    u, v, w = velocity
    return (
        xx * p + xy * q + xz * r - mz * v + my * w,
        xy * p + yy * q + yz * r + mz * u - mx * w,
        xz * p + yz * q + zz * r - my * u + mx * v,
    ), (mz * q - my * r + mass * u, mx * r - mz * p + mass * v, my * p - mx * q + mass * w)


@part
def moment(axis: Triple, lever: Triple, torque: Triple, force: Triple) -> float:
    """Return the moment of torque and force about a body axis, in mju_dot's order."""
    return ((axis[0] * torque[0] + axis[2] * torque[2]) + (axis[1] * torque[1] + lever[0] * force[0])) + (
        lever[1] * force[1] + lever[2] * force[2]
    )


@part
def bias(parameters: Record, qpos: Array, qvel: Array, axes: tuple[Triple, Triple, Triple]) -> tuple[Triple, Triple]:
    """Return the bias force and torque of gravity and motion: mj_rne.

    MuJoCo computes the centre of mass as a weighted mean, which may differ from the position in the last bit.
    """
    mass = parameters.mass_kg
    inverse = 1.0 / mass
    x, y, z = qpos[0], qpos[1], qpos[2]
    cx, cy, cz = (x * mass) * inverse, (y * mass) * inverse, (z * mass) * inverse
    arm, lever = (x - cx, y - cy, z - cz), (cx - x, cy - y, cz - z)
    ax, ay, az = axes
    lx, ly, lz = cross(ax, lever), cross(ay, lever), cross(az, lever)
    velocity, rate = (qvel[0], qvel[1], qvel[2]), (qvel[3], qvel[4], qvel[5])

    spin = weighted(ax, ay, az, rate)
    turned = weighted(lx, ly, lz, rate)
    moved = (velocity[0] + turned[0], velocity[1] + turned[1], velocity[2] + turned[2])
    gained = weighted(cross(velocity, ax), cross(velocity, ay), cross(velocity, az), rate)
    fall = (gained[0], gained[1], gained[2] + parameters.gravity_m_s2)

    m = (mass * arm[0], mass * arm[1], mass * arm[2])
    angular, linear = momentum(axes, parameters.inertia_kg_m2, arm, mass, spin, moved)
    tumble, drift, carried = cross(spin, angular), cross(moved, linear), cross(spin, linear)
    twist = cross(m, fall)
    torque = (twist[0] + (tumble[0] + drift[0]), twist[1] + (tumble[1] + drift[1]), twist[2] + (tumble[2] + drift[2]))
    force = (mass * fall[0] + carried[0], mass * fall[1] + carried[1], mass * fall[2] + carried[2])
    about = (moment(ax, lx, torque, force), moment(ay, ly, torque, force), moment(az, lz, torque, force))
    return force, about


@part
def turn(q: Quad, tick_s: float, x: float, y: float, z: float) -> Quad:
    """Return the quaternion after a tick at a body rate, by the exponential map."""
    rate = math.sqrt(x * x + y * y + z * z)
    angle = tick_s * rate
    if angle == 0.0:
        cosine, ex, ey, ez = 1.0, 0.0, 0.0, 0.0
    else:
        inverse = 1.0 / rate
        axis = (1.0, 0.0, 0.0) if rate < LEAST else (x * inverse, y * inverse, z * inverse)
        sine, cosine = math.sin(angle * 0.5), math.cos(angle * 0.5)
        ex, ey, ez = axis[0] * sine, axis[1] * sine, axis[2] * sine
    w, a, b, c = q
    return (
        (w * cosine - a * ex) + (-b * ey - c * ez),
        (w * ex + a * cosine) + (b * ez - c * ey),
        (w * ey - a * ez) + (b * cosine + c * ex),
        (w * ez + a * ey) + (-b * ex + c * cosine),
    )


@part(inline=False)
def free_step(parameters: Record, qpos: Array, qvel: Array, force: Array, acceleration: Array) -> bool:
    """Step pose `qpos` (7,) and velocity `qvel` (6,) in place under `force` (6,) and the gravity of `parameters`.

    `acceleration` (6,) receives MuJoCo's qacc. Returns False, without a step, for numbers of which MuJoCo would warn;
    they are left to `mj_step`.
    """
    q = normalised(qpos[3], qpos[4], qpos[5], qpos[6])
    pull, twist = bias(parameters, qpos, qvel, body_axes(q))
    inertia, tick_s = parameters.inertia_kg_m2, parameters.tick_s
    total = 0.0
    for axis in range(3):
        linear = ((0.0 - pull[axis]) + force[axis]) + 0.0  # MuJoCo's zeros decide the sign of a 0
        angular = ((0.0 - twist[axis]) + force[3 + axis]) + 0.0
        acceleration[axis] = linear * (1.0 / parameters.mass_kg)
        acceleration[3 + axis] = angular * (1.0 / inertia[axis])
        total += abs(qpos[axis]) + abs(qvel[axis]) + abs(qvel[3 + axis])
        total += abs(acceleration[axis]) + abs(acceleration[3 + axis])
    if not total < HUGE:
        return False

    move(qpos, qvel, acceleration, q, tick_s)
    return True


@part(error_model="numpy")
def move(qpos: Array, qvel: Array, acceleration: Array, q: Quad, tick_s: float) -> None:
    """Integrate velocity (6,) and pose (7,) over a tick; `q` is the normalised attitude."""
    for axis in range(6):
        qvel[axis] += acceleration[axis] * tick_s
    for axis in range(3):
        qpos[axis] += tick_s * qvel[axis]
    qpos[3], qpos[4], qpos[5], qpos[6] = turn(q, tick_s, qvel[3], qvel[4], qvel[5])
