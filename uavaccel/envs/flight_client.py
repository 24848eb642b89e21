"""The client of an environment: its samples are state, picture and collision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uavaccel.envs.camera_client import GuardedClient
from uavaccel.envs.sensors import from_arrays
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.kinematics import Kinematics
from uavaccel.sim.camera.view import AnyImage
from uavaccel.sim.saved import SavedState, State
from uavaccel.vision.guard import GuardState
from uavaccel.vision.image_noise import ImageNoise
from uavaccel.wire.client import Client
from uavaccel.wire.game_api import Collision

NO_IMAGE = np.zeros((0, 0), np.uint8)


class FlightSample(NamedTuple):
    """A gathered sample; `collision` is that of Client.collision."""

    state: Kinematics
    image: AnyImage
    collision: Collision | None


class FlightClient(GuardedClient):
    """Gathers flight samples, with pictures of `kind` unless that is None; `stopwatches` measure the rendering.

    Noise is added after the guard, which sees pictures as they were rendered.
    """

    def __init__(self, client: Client, kind: str | None, stopwatches: Sequence[Stopwatch]) -> None:
        super().__init__(client, kind or "")
        self.noise = ImageNoise()
        self._wants_image = kind is not None
        self._stopwatches = stopwatches

    def gather(self, state: Kinematics) -> FlightSample:
        collision = self.client.collision()
        image = NO_IMAGE
        if self._wants_image and not collision:
            self._switch("rendering")
            image = self.noise.add(self.take(state).image, state.time_ns)
            self._switch("simulation")
        return FlightSample(state, image, collision)

    def _switch(self, phase: str) -> None:
        for stopwatch in self._stopwatches:
            stopwatch.switch(phase)

    def get_state(self) -> State:
        """Return the guard's state, for np.savez."""
        state = self._guard_state._asdict()
        return {name: value for name, value in state.items() if value is not None}

    def set_state(self, state: SavedState) -> None:
        """Restore what `get_state` returned."""
        self._guard_state = GuardState(**from_arrays(state))
