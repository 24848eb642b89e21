"""The vehicle without its surroundings, to step while nothing can be touched: a third of a step less in the lane.

What MuJoCo leaves out are the places of the scene's geoms, which it works out at every step anew. The vehicle's motion
comes from the same operations on the same numbers, to the last bit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
from numpy.typing import NDArray


class OpenAir:
    """A model of the scene in `path` with the vehicle alone, for flights of the scene's own `model` and `data`.

    Only for scenes in which nothing but the vehicle moves.
    """

    def __init__(self, path: Path, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        spec = mujoco.MjSpec.from_file(str(path))
        for unseen in (*spec.geoms, *spec.lights, *spec.cameras, *spec.materials, *spec.textures):
            spec.delete(unseen)
        self.model = spec.compile()
        self.model.opt.timestep = model.opt.timestep
        self.model.opt.disableflags = model.opt.disableflags | mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data = mujoco.MjData(self.model)
        self._scene = data
        self._shared = [(_moving(self.data)[name], values) for name, values in _moving(data).items()]

    def take_over(self) -> None:
        """Go on from where the scene's vehicle is."""
        self.data.time = self._scene.time
        for here, there in self._shared:
            here[:] = there

    def hand_back(self) -> None:
        """Let the scene's vehicle go on from here."""
        self._scene.time = self.data.time
        for here, there in self._shared:
            there[:] = here


def _moving(data: mujoco.MjData) -> dict[str, NDArray[Any]]:
    """All that a step depends on, or notes for the next, but the time."""
    names = ("qpos", "qvel", "qfrc_applied", "qacc_warmstart")
    return {name: getattr(data, name) for name in names} | {"warnings": data.warning.number}
