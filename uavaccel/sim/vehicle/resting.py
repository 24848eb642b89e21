"""Placing a vehicle on the ground or an object, at the height where contact forces carry it and it stays at rest.

AirSim locks a vehicle to the ground on which it stands (FastPhysicsEngine.hpp): velocity and accelerations are 0 until
the rotors lift it. MuJoCo's contacts are soft: they carry a vehicle only after some penetration.
"""

from __future__ import annotations

import mujoco

from uavaccel.kinematics import Quaternion, Vector
from uavaccel.sim.poses import DEEPEST_M, HERE
from uavaccel.sim.scene import physics_state, restore_physics
from uavaccel.sim.vehicle.clearance import PLANE
from uavaccel.sim.vehicle.contacts import deepest_contact
from uavaccel.sim.vehicle.vehicle import Vehicle

GIVE_M = 1e-3  # more than contacts give under a vehicle, and less than a noticeable fall
HALVINGS = 60
STEP_M, FARTHEST_STEPS = 0.25, 400  # in which a place outside an object is looked for


def stand(vehicle: Vehicle) -> None:
    """Place a level, idle vehicle on what it touches, if anything; other vehicles stay as they are.

    If the vehicle has its own frame, its origin moves with it.
    """
    (x, y, z), attitude = vehicle.place_m, vehicle.start.orientation_wxyz

    def borne(height: float) -> bool:
        vehicle.set_pose((x, y, height), attitude)
        mujoco.mj_forward(vehicle.model, vehicle.data)
        return bool(vehicle.gained[2] >= 0.0)

    before, low, high = physics_state(vehicle.model, vehicle.data), z + GIVE_M, z - DEEPEST_M
    stands = borne(low) and not borne(high)
    for _ in range(HALVINGS if stands else 0):
        middle = (low + high) / 2
        low, high = (middle, high) if borne(middle) else (low, middle)
    if stands:
        borne(low)  # leaves the contact forces of that height
    restore_physics(vehicle.model, vehicle.data, before)
    if stands:
        vehicle.set_pose((x, y, low), attitude)
        if vehicle.origin_m is not HERE:
            vehicle.origin_m = (x, y, low)
        vehicle.stand()


def on_the_ground(vehicle: Vehicle, position_m: Vector, attitude: Quaternion) -> Vector:
    """Return the position or, if it is in the ground, the one on it, to which AirSim's collisions push a vehicle."""
    x, y, z = position_m
    highest_m = min(z, 0.0)
    depth_m, geom = depth(vehicle, (x, y, highest_m), attitude)
    if depth_m > GIVE_M and vehicle.model.geom_type[geom] == PLANE:
        highest_m -= depth_m
    return x, y, highest_m


def beside_objects(vehicle: Vehicle, position_m: Vector, attitude: Quaternion) -> Vector:
    """Return the position or, if it is inside an object, the nearest one outside: above, or to a side."""
    x, y, z = position_m
    for step in range(FARTHEST_STEPS):
        for north, east, up in ((0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)):
            near = (x + north * step * STEP_M, y + east * step * STEP_M, z - up * step * STEP_M)
            if depth(vehicle, near, attitude)[0] <= GIVE_M:
                return near
    return position_m


def depth(vehicle: Vehicle, position_m: Vector, attitude: Quaternion) -> tuple[float, int]:
    """Return the penetration, m, that a vehicle would have at a pose, and the geom; (0, -1) without any."""
    before = physics_state(vehicle.model, vehicle.data)
    vehicle.set_pose(position_m, attitude)
    mujoco.mj_kinematics(vehicle.model, vehicle.data)
    mujoco.mj_collision(vehicle.model, vehicle.data)
    found = deepest_contact(vehicle.model, vehicle.data, vehicle.body_id)
    restore_physics(vehicle.model, vehicle.data, before)
    return found
