"""A log of a vehicle's contacts by object, with the contents of AirSim's CollisionInfo."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Vector
from uavaccel.units import mujoco_to_ned


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
