"""What a vehicle touches: a log as in AirSim's CollisionInfo, and places where it stands or touches nothing.

AirSim locks a vehicle to the ground on which it stands (FastPhysicsEngine.hpp): velocity and accelerations are 0 until
the rotors lift it. MuJoCo's contacts are soft: they carry a vehicle only after some penetration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Quaternion, Vector
from uavaccel.sim.poses import DEEPEST_M, HERE
from uavaccel.sim.scene import physics_state, restore_physics
from uavaccel.sim.vehicle.clearance import PLANE
from uavaccel.units import mujoco_to_ned

if TYPE_CHECKING:
    from uavaccel.sim.vehicle.vehicle import Vehicle


@dataclass(frozen=True)
class Contact:
    """The beginning of a contact with an object; metres, NED.

    `normal` points out of the object; `position_m` is that of the vehicle at `tick`.
    """

    tick: int
    object: str
    position_m: Vector
    impact_point_m: Vector
    normal: Vector
    penetration_m: float


class ContactLog:
    """Counts contacts since the vehicle was last placed, and keeps the first and the latest.

    A contact is counted when it begins; while it lasts, it is not counted again.
    """

    def __init__(self) -> None:
        self.clear()

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData, body: int, name_of: Callable[[int], str]) -> None:
        """Log the contacts of `body` in this model from now on; `name_of` returns the name of what a geom belongs to.

        Geoms of the world keep their ids from one model to the next.
        """
        self._model, self._data, self._body, self._name_of = model, data, body, name_of

    def clear(self) -> None:
        self.count = 0
        self.first: Contact | None = None
        self.latest: Contact | None = None
        self._unread = False
        self.leave()

    def leave(self) -> None:
        """Let all present contacts count as new ones: the vehicle was moved."""
        self._present: frozenset[int] = frozenset()

    def log(self, tick: int, position_m: NDArray[np.float64]) -> None:
        """Log the contacts that have begun at `tick`, in `data.contact`; `position_m` (3,) is NED."""
        contacts = _contacts(self._model, self._data, self._body)
        new = [contact for contact in contacts if contact[0] not in self._present]
        self._present = frozenset(geom for geom, _ in contacts)
        if not new:
            return
        geom, contact = min(new, key=lambda found: found[1].dist)  # the deepest
        outwards = 1.0 if int(contact.geom[0]) == geom else -1.0  # MuJoCo's normal leaves the first geom
        self.latest = Contact(
            tick,
            self._name_of(geom),
            _vector(position_m),
            _vector(mujoco_to_ned(contact.pos)),
            _vector(outwards * mujoco_to_ned(contact.frame[:3])),
            max(-float(contact.dist), 0.0),
        )
        self.first = self.first or self.latest
        self.count += 1
        self._unread = True

    def read(self) -> bool:
        """Return whether a contact began since the last call: AirSim's flag, which reading clears."""
        unread, self._unread = self._unread, False
        return unread


def deepest_contact(model: mujoco.MjModel, data: mujoco.MjData, vehicle: int) -> tuple[float, int]:
    """Return the deepest penetration, m, of a vehicle's body in `data.contact`, and the geom; (0, -1) without any."""
    found = min(_contacts(model, data, vehicle), key=lambda found: found[1].dist, default=None)
    return (0.0, -1) if found is None else (-float(found[1].dist), found[0])


def _contacts(model: mujoco.MjModel, data: mujoco.MjData, vehicle: int) -> list[tuple[int, mujoco.MjContact]]:
    """List the contacts of a vehicle's body, each with the other geom."""
    found = []
    for contact in data.contact[: data.ncon]:
        bodies = [int(model.geom_bodyid[geom]) for geom in contact.geom]
        if vehicle in bodies:
            found.append((int(contact.geom[1 - bodies.index(vehicle)]), contact))
    return found


def _vector(numbers: Iterable[float]) -> Vector:
    x, y, z = (float(number) for number in numbers)
    return x, y, z


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
        return vehicle.rises

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
