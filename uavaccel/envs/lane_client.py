"""The mission computer of the obstacle lane: its samples are state, picture and whether something has been hit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.camera_client import CameraClient
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.kinematics import Kinematics
from uavaccel.wire.client import Client

NO_IMAGE = np.zeros((0, 0), np.uint8)


class LaneSample(NamedTuple):
    """One gathered sample; `collision` as Client.collision has it, empty without one."""

    state: Kinematics
    image: NDArray[Any]
    collision: dict[str, Any]


class LaneClient(CameraClient):
    """Gathers lane samples, with pictures of `kind` unless that is None, and tells the stopwatches when it renders."""

    def __init__(self, inner: Client, kind: str | None, stopwatches: Sequence[Stopwatch]) -> None:
        super().__init__(inner, kind or "")
        self._wants_image = kind is not None
        self._stopwatches = stopwatches

    def gather(self, state: Kinematics) -> Any:
        collision = self._latched_collision()
        image = NO_IMAGE
        if self._wants_image and not collision:
            self._switch("rendering")
            image = super().gather(state).image
            self._switch("simulation")
        return LaneSample(state, image, collision)

    def _latched_collision(self) -> dict[str, Any]:
        """As `collision`, but the state stays known: asking moves nothing."""
        call = self.transport.send("uavaccelCollision", (), blocking=True)
        self.transport.wait(call)
        latched: dict[str, Any] = call.result()
        return latched

    def _switch(self, phase: str) -> None:
        for stopwatch in self._stopwatches:
            stopwatch.switch(phase)
