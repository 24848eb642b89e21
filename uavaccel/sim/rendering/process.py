"""A process that renders for many simulations in one GL context, until the last of them has ended.

    python -m uavaccel.sim.rendering.process '{"scene": "lane", "scenery": "plain", "cameras": 8, "tiles": 8, ...}'

prints one line of JSON when it is ready: its renderer, or an error.
"""

from __future__ import annotations

import contextlib
import copy
import json
import os
import select
import signal
import sys
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict
from typing import NamedTuple

import cv2
import mujoco
import numpy as np

from uavaccel.errors import UserError
from uavaccel.sim.camera.view import AnyImage, View
from uavaccel.sim.rendering.slots import DONE, KINDS, REQUEST_BYTES, map_records, pixels, read_appearance, slot_dtype
from uavaccel.sim.rendering.tiles import BUFFERS, Tiles
from uavaccel.sim.scene.model import load_scene

_READ_BYTES = 1 << 12


class ServedCamera:
    """The renderer's side of a camera: its slot, and a model that looks like its simulation's."""

    def __init__(self, model: mujoco.MjModel, slot: np.void, reply: int) -> None:
        self._model, self._data = copy.copy(model), mujoco.MjData(model)
        self._slot, self._reply = slot, reply
        self._qpos, self._pose = self._data.qpos, slot["pose"]
        self._pictures = {kind: pixels(slot, kind) for kind in KINDS}
        self._revision = 0
        self.view = View(self._model)

    @property
    def kind(self) -> str:
        return KINDS[self._slot["kind"]]

    def scene(self, as_ids: bool) -> mujoco.MjvScene:
        """Return the scene at the pose in the slot."""
        if self._revision != self._slot["revision"]:
            read_appearance(self._slot["looks"], self._model)
            self._revision = int(self._slot["revision"])
        self._qpos[:] = self._pose
        return self.view.update(self._data, as_ids)

    def hand_over(self, kind: str, drawn: AnyImage) -> None:
        """Write a rendered picture into the slot in the form of its kind, and notify the camera."""
        picture = self._pictures[kind]
        if kind == "gray":
            cv2.cvtColor(drawn, cv2.COLOR_RGBA2GRAY, dst=picture)
        elif kind == "colour":
            cv2.cvtColor(drawn, cv2.COLOR_RGBA2RGB, dst=picture)
        elif kind == "depth":
            np.copyto(picture, drawn)
        else:
            self.view.geoms(drawn, picture)
        with contextlib.suppress(BrokenPipeError):  # its simulation has ended
            os.write(self._reply, DONE)


class Batch(NamedTuple):
    """Pictures of one kind that were rendered into a pixel buffer but not yet handed over."""

    buffer: int
    kind: str
    eyes: list[ServedCamera]


def serve(tiles: Tiles, eyes: list[ServedCamera], requests: int) -> None:
    """Render requests, up to `tiles.count` at once, until every simulation has ended.

    A GPU renders while earlier pictures are handed over; in software they are handed over at once.
    """
    waiting = select.poll()
    waiting.register(requests, select.POLLIN)
    drawn: deque[Batch] = deque()
    ahead, number = 0 if tiles.renderer.software else BUFFERS - 1, 0
    while True:
        if drawn and not waiting.poll(0):
            _hand_over(tiles, drawn.popleft())
            continue
        numbers = os.read(requests, _READ_BYTES)
        if not numbers:
            return
        asking = [eyes[each] for each in np.frombuffer(numbers, f"<u{REQUEST_BYTES}").tolist()]
        for kind, some in _batches(asking, tiles.count):
            drawn.append(_render(tiles, Batch(number, kind, some)))
            number = (number + 1) % BUFFERS
            if len(drawn) > ahead:
                _hand_over(tiles, drawn.popleft())


def _batches(asking: list[ServedCamera], most: int) -> Iterator[tuple[str, list[ServedCamera]]]:
    """Group requests by kind of picture, at most `most` in each group."""
    by_kind: dict[str, list[ServedCamera]] = {}
    for eye in asking:
        by_kind.setdefault(eye.kind, []).append(eye)
    for kind, eyes in by_kind.items():
        for start in range(0, len(eyes), most):
            yield kind, eyes[start : start + most]


def _render(tiles: Tiles, batch: Batch) -> Batch:
    depth, as_ids = batch.kind == "depth", batch.kind in ("depth", "segmentation")  # depth needs no lighting
    for place, eye in enumerate(batch.eyes):
        tiles.render(batch.buffer, place, eye.scene(as_ids), depth)
    return batch


def _hand_over(tiles: Tiles, batch: Batch) -> None:
    with tiles.read(batch.buffer, len(batch.eyes), batch.kind == "depth") as pictures:
        for eye, picture in zip(batch.eyes, pictures, strict=True):
            eye.hand_over(batch.kind, picture)


def main() -> None:
    """Render with the options in the first argument, JSON."""
    options = json.loads(sys.argv[1])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    cv2.setNumThreads(0)
    model = load_scene(options["scene"], scenery=options["scenery"])
    try:
        tiles = Tiles(model, options["tiles"])
    except UserError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return
    slots = map_records(options["memory"], slot_dtype(model), options["cameras"])
    eyes = [ServedCamera(model, slot, reply) for slot, reply in zip(slots, options["replies"], strict=True)]
    print(json.dumps(asdict(tiles.renderer)), flush=True)
    serve(tiles, eyes, options["requests"])
    tiles.close()


if __name__ == "__main__":
    main()
