"""DP2's client with an event camera on board, which receives more frames than there are samples."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.camera_client import CameraClient, Sample
from uavaccel.envs.task import rate_ticks
from uavaccel.kinematics import Kinematics
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.suites.dp2.config import Dp2Config
from uavaccel.vision.dvs import PRESETS, make_sensor
from uavaccel.vision.event_counter import EventCounter
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.perturb import AutoExposure, PerturbationSettings
from uavaccel.wire.client import Client
from uavaccel.wire.session import Session

Arrays = dict[str, NDArray[np.generic]]


class EventClient(CameraClient):
    """A camera client that counts events between samples, inside the simulation, without messages or wall time."""

    def __init__(
        self,
        client: Client,
        kind: str,
        guard: GuardSettings,
        perturbation: PerturbationSettings | None,
        exposure: AutoExposure | None,
        *,
        config: Dp2Config,
        session: Session,
    ) -> None:
        super().__init__(client, kind, guard, perturbation, exposure)
        assert config.dvs_rate_hz is not None
        sensor = make_sensor(PRESETS[config.dvs_preset], (HEIGHT, WIDTH), config.sensor_seed)
        self._session, self._noise_seed = session, config.sensor_seed
        self._counter = EventCounter(sensor)
        self._counts: list[tuple[NDArray[np.int32], NDArray[np.int32]]] = []
        self._stop = session.watch(rate_ticks(config.dvs_rate_hz, config.profile), self._look)

    def _look(self, time_ns: int) -> None:
        self._counter.look(self._session.picture(), time_ns)

    def gather(self, state: Kinematics) -> Sample:
        """Return the sample, and count the events since the last one; the first sample begins the game."""
        if not self._counts:
            self._counter.start(self._session.picture(), state.time_ns, self._noise_seed)
        elif not self._counter.has_seen(state.time_ns):
            self._look(state.time_ns)
        self._counts.append(self._counter.take())
        return super().gather(state)

    def arrays(self, samples: int) -> Arrays:
        """Return `dvs_on` and `dvs_off` (n, 144, 256) of the first n samples: uint8, or uint16 beyond 255 events."""
        both = np.array(self._counts[:samples])
        both = both.astype(np.uint8 if both.max() < 256 else np.uint16)
        return {"dvs_on": both[:, 0], "dvs_off": both[:, 1]}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
