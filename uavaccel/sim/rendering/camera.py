"""A camera whose pictures another process renders, with the interface of one that renders itself."""

from __future__ import annotations

import os
import select

import mujoco
import numpy as np

from uavaccel.sim.camera.camera import FrontCamera
from uavaccel.sim.camera.view import FOV_DEG, HEIGHT, WIDTH, AnyImage, DepthImage, GeomImage, Image, to_metres
from uavaccel.sim.rendering.slots import KINDS, REQUEST_BYTES, map_records, pixels, slot_dtype, write_appearance

PATIENCE_S = 60.0  # for one picture: a driver that hangs must not hang everything


class RendererGoneError(RuntimeError):
    """The rendering process has ended, or does not answer."""


class RemoteCamera(FrontCamera):
    """Camera `number` of the `count` cameras of one renderer, with AirSim's size of 256 x 144.

    `memory`, `requests` and `replies` are file descriptors of the shared slots and of the two pipes. Calls raise
    RendererGoneError if no picture comes.
    """

    def __init__(
        self, model: mujoco.MjModel, number: int, count: int, memory: int, requests: int, replies: int
    ) -> None:
        super().__init__(model, WIDTH, HEIGHT, float(np.tan(np.radians(FOV_DEG) / 2)))
        slots = map_records(memory, slot_dtype(model), count)
        self._slot = slots[number]
        self._pose, self._pictures = self._slot["pose"], {kind: pixels(self._slot, kind) for kind in KINDS}
        self._number = number.to_bytes(REQUEST_BYTES, "little")
        self._requests, self._replies = requests, replies
        self._answered = select.poll()
        self._answered.register(replies, select.POLLIN)
        self.scene_changed()

    def scene_changed(self) -> None:
        """Publish in the shared slot what the model looks like now."""
        write_appearance(self.model, self._slot["looks"])
        self._slot["revision"] += 1

    def gray(self, data: mujoco.MjData) -> Image:
        return self._picture("gray", data)

    def colour(self, data: mujoco.MjData) -> Image:
        return self._picture("colour", data)

    def depth(self, data: mujoco.MjData) -> DepthImage:
        return to_metres(self.model, self._picture("depth", data))

    def segmentation(self, data: mujoco.MjData) -> GeomImage:
        return self._picture("segmentation", data)

    def render_again(self, out: Image) -> None:
        self._draw("colour")
        np.copyto(out, self._pictures["colour"])

    def _picture(self, kind: str, data: mujoco.MjData) -> AnyImage:
        self._pose[:] = data.qpos
        self._draw(kind)
        return self._pictures[kind][::-1].copy()

    def _draw(self, kind: str) -> None:
        self._slot["kind"] = KINDS.index(kind)
        try:
            os.write(self._requests, self._number)
            answered = bool(self._answered.poll(PATIENCE_S * 1e3)) and bool(os.read(self._replies, 1))
        except BrokenPipeError:
            answered = False
        if not answered:
            raise RendererGoneError("the renderer has ended or hangs: no picture comes any more")

    def close(self) -> None:
        """See FrontCamera; pipes and memory belong to the renderer's service."""
