"""Clients whose samples include pictures, which the guard checks while the simulation is paused.

This is the paper's mission computer (sections II-A, III-B and III-C1), for which an image is part of the UAV's state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.sensors import PICTURE_SIZE
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.kinematics import Kinematics
from uavaccel.sim.camera.view import AnyImage
from uavaccel.vision.guard import GuardSettings, GuardState, acquire
from uavaccel.vision.noise import ImageNoise
from uavaccel.vision.perturb import AutoExposure, PerturbationSettings, perturb_share
from uavaccel.wire.game_api import Collision
from uavaccel.wire.session import Client

if TYPE_CHECKING:  # they load what is compiled, and the simulation
    from uavaccel.vision.dvs import Counts, DvsSensor, EventCounter
    from uavaccel.wire.session import Session


NO_IMAGE = np.zeros((0, 0), np.uint8)


class Sample(NamedTuple):
    """A gathered sample: the state, its picture, how often that was requested again, and `Client.collision`."""

    state: Kinematics
    image: AnyImage
    retries: int = 0
    collision: Collision | None = None


class CameraClient:
    """A `MissionClient` around `client` whose samples are states with pictures of `kind`, taken through the guard.

    Depths have no brightness and are not guarded. `perturbation` corrupts a share of the received pictures, `exposure`
    changes their brightness; by default both are off.
    """

    def __init__(
        self,
        client: Client,
        kind: str = "gray",
        guard: GuardSettings | None = None,
        perturbation: PerturbationSettings | None = None,
        exposure: AutoExposure | None = None,
        size: tuple[int, int] = PICTURE_SIZE,
    ) -> None:
        self.client = client
        self.now_ns, self.kinematics, self.pause, self.run = client.now_ns, client.kinematics, client.pause, client.run
        self.move_async, self.join, self.continue_for = client.move_async, client.join, client.continue_for
        self._kind, self._size = kind, size
        self._guard, self._guard_state = guard or GuardSettings(), GuardState()
        self._perturbation, self._exposure = perturbation, exposure
        self._ran_ns = 0  # wall time for which the simulation ran
        self._received = 0

    @property
    def clock_speed(self) -> float:
        return self.client.clock_speed

    def read_sample(self, state: Kinematics) -> Sample:
        """Take a picture of the present state; the simulation has to be paused."""
        self._ran_ns = round(state.time_ns / self.clock_speed)
        if self._kind == "depth":
            return Sample(state, self._receive())
        acquisition = acquire(self._guard_state, self._receive, self._guard)
        self._guard_state = acquisition.state
        return Sample(state, acquisition.image, acquisition.retries)

    def _receive(self) -> AnyImage:
        image = self.client.image(self._kind, self._size)
        self._received += 1
        if self._exposure is not None:
            image = self._exposure.expose(image, self._ran_ns)
        if self._perturbation is None:
            return image
        return perturb_share(image, self._perturbation, self._received)[0]


class EventClient(CameraClient):
    """A camera client that may count events between samples, inside the simulation, without messages or wall time."""

    def __init__(self, session: Session, *settings: Any) -> None:
        """`settings` are the arguments of CameraClient, whose client is of the session."""
        super().__init__(*settings)
        self._session, self._noise_seed = session, 0
        self._counter: EventCounter | None = None
        self._counts: list[tuple[Counts, Counts]] = []
        self.close: Callable[[], None] = lambda: None

    def count(self, sensor: DvsSensor, every_ticks: int, noise_seed: int) -> None:
        """Count the sensor's events from the first sample on, of frames at each sample and every so many ticks."""
        from uavaccel.vision.dvs import EventCounter

        self._counter, self._noise_seed = EventCounter(sensor), noise_seed
        self.close = self._session.watch(every_ticks, self._see)

    def _see(self, time_ns: int) -> None:
        assert self._counter
        self._counter.process_frame(self._session.picture(), time_ns)

    def read_sample(self, state: Kinematics) -> Sample:
        """Return the sample, and count the events since the last one; the first sample begins the game."""
        if self._counter:
            if not self._counts:
                self._counter.start(self._session.picture(), state.time_ns, self._noise_seed)
            elif not self._counter.has_frame_of(state.time_ns):
                self._see(state.time_ns)
            self._counts.append(self._counter.take())
        return super().read_sample(state)

    def counts(self, samples: int) -> NDArray[Any]:
        """Return the ON and OFF counts (2, n, H, W) of the first n samples, uint8 or, beyond 255, uint16; else (0,)."""
        both = np.array(self._counts[:samples])
        return both.astype(np.uint8 if both.max() < 256 else np.uint16).swapaxes(0, 1) if both.size else both


class FlightClient(CameraClient):
    """Gathers samples with pictures of `kind`, unless that is None, before a collision; `stopwatches` measure them.

    Noise is added after the guard, which sees pictures as they were rendered.
    """

    def __init__(
        self, client: Client, kind: str | None, stopwatches: Sequence[Stopwatch], size: tuple[int, int] = PICTURE_SIZE
    ) -> None:
        super().__init__(client, kind or "", size=size)
        self.noise, self._stopwatches = ImageNoise(), stopwatches

    def read_sample(self, state: Kinematics) -> Sample:
        collision = self.client.collision()
        if collision or not self._kind:
            return Sample(state, NO_IMAGE, collision=collision)
        for stopwatch in self._stopwatches:
            stopwatch.switch("rendering")
        image = self.noise.add(super().read_sample(state).image, state.time_ns)
        for stopwatch in self._stopwatches:
            stopwatch.switch("simulation")
        return Sample(state, image, collision=collision)
