"""The vehicle without its surroundings, to step while nothing can be touched: a third of a step less in the lane.

What MuJoCo leaves out are the places of the scene's geoms, which it works out at every step anew. The vehicle's motion
comes from the same operations on the same numbers, to the last bit.
"""

from __future__ import annotations

import ctypes
from typing import Any

import mujoco
from numpy.typing import NDArray

from uavaccel.resources import asset
from uavaccel.sim import hotloop
from uavaccel.sim.vehicle import Vehicle


class OpenAir:
    """A model of a scene with the vehicle alone, for flights of the scene's own `model` and `data`.

    Only for scenes in which nothing but the vehicle moves.
    """

    def __init__(self, scene: str, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        spec = mujoco.MjSpec.from_file(str(asset(f"mjcf/{scene}.xml")))
        for unseen in (*spec.geoms, *spec.lights, *spec.cameras, *spec.materials, *spec.textures):
            spec.delete(unseen)
        self.model = spec.compile()
        self.model.opt.timestep = model.opt.timestep
        self.model.opt.disableflags = model.opt.disableflags | mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data = mujoco.MjData(self.model)
        self._scene = data
        self._handles: Any = None
        self._shared = [(_moving(self.data)[name], values) for name, values in _moving(data).items()]

    def fly(self, vehicle: Vehicle, ticks: int) -> int:
        """The scene's vehicle flies `ticks` ticks here, from where it is, and goes on there."""
        handles = self._handles_of(vehicle)
        self.data.time = self._scene.time
        for here, there in self._shared:
            here[:] = there
        flown = int(hotloop.ENTRY_POINTS.fly.ctypes(handles, ticks))
        self._scene.time = self.data.time
        for here, there in self._shared:
            there[:] = here
        return flown

    def _handles_of(self, vehicle: Vehicle) -> Any:
        if self._handles is None:
            addresses = vehicle.addresses_alone_in(self.model, self.data)
            self._handles = addresses.ctypes.data_as(ctypes.POINTER(ctypes.c_int64))  # which keeps them
        return self._handles


def _moving(data: mujoco.MjData) -> dict[str, NDArray[Any]]:
    """All that a step depends on, or notes for the next, but the time."""
    names = ("qpos", "qvel", "qfrc_applied", "qacc_warmstart")
    return {name: getattr(data, name) for name in names} | {"warnings": data.warning.number}
