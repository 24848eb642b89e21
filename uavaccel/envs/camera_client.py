"""A client whose samples are images: gathered, checked by the guard, and turned into DVS events while the clock stands.

This is the paper's mission computer (sections II-A, III-B and III-C1): state of the UAV "in a broad sense".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.sim.camera.view import AnyImage
from uavaccel.vision.exposure import AutoExposure
from uavaccel.vision.guard import GuardSettings, GuardState, acquire
from uavaccel.vision.perturb import PerturbationSettings, perturb_share
from uavaccel.wire.client import Client
from uavaccel.wire.transport import PendingCall


class Sample(NamedTuple):
    """One gathered sample: the state, the picture of that moment, and how often it was asked for again."""

    state: Kinematics
    image: NDArray[np.uint8]
    retries: int


class GuardedClient:
    """A client around `client` that takes pictures of `kind` through the guard; a subclass says what a sample is.

    `perturbation` spoils a share of the pictures on their way, `exposure` changes their brightness; both are off by
    default.
    """

    def __init__(
        self,
        client: Client,
        kind: str = "gray",
        guard: GuardSettings | None = None,
        perturbation: PerturbationSettings | None = None,
        exposure: AutoExposure | None = None,
    ) -> None:
        self.client = client
        self._kind = kind
        self._guard, self._guard_state = guard or GuardSettings(), GuardState()
        self._perturbation, self._exposure = perturbation, exposure
        self._ran_ns = 0  # wall time for which the simulation ran
        self._received = 0

    def take(self, state: Kinematics) -> Sample:
        """The picture of this moment, as a `Sample`. The simulation has to stand still."""
        self._ran_ns = round(state.time_ns / self.clock_speed)
        acquisition = acquire(self._guard_state, self._receive, self._guard)
        self._guard_state = acquisition.state
        return Sample(state, acquisition.image, acquisition.retries)

    def _receive(self) -> AnyImage:
        image = self.client.image(self._kind)
        self._received += 1
        if self._exposure is not None:
            image = self._exposure.expose(image, self._ran_ns)
        if self._perturbation is None:
            return image
        return perturb_share(image, self._perturbation, self._received)[0]

    # --- the client's own -------------------------------------------------------------------------

    @property
    def clock_speed(self) -> float:
        return self.client.clock_speed

    def now_ns(self) -> int:
        return self.client.now_ns()

    def move_async(self, goal: VelocityGoal, t_move_s: float) -> PendingCall:
        return self.client.move_async(goal, t_move_s)

    def join(self, future: PendingCall, deadline_ns: int | None = None) -> bool:
        return self.client.join(future, deadline_ns)

    def pause(self) -> None:
        self.client.pause()

    def run(self) -> None:
        self.client.run()

    def continue_for(self, duration_ns: int) -> Kinematics:
        return self.client.continue_for(duration_ns)

    def kinematics(self) -> Kinematics:
        return self.client.kinematics()


class CameraClient(GuardedClient):
    """A `MissionClient` whose samples are states and pictures."""

    def gather(self, state: Kinematics) -> Sample:
        return self.take(state)
