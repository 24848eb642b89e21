"""Those who look on while an environment flies: films, event cameras beside the agent's own, counters.

`FlightEnv.add_observer` registers one. It sees each game's beginning and its samples, and through the game's session
whatever ticks it likes (`Session.watch`); none of that is a message, takes wall time or changes a flight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.flight_client import FlightSample
from uavaccel.envs.task import Task
from uavaccel.kinematics import Kinematics
from uavaccel.vision.image_noise import ImageNoise
from uavaccel.wire.session import Session


class Game(NamedTuple):
    """A game that is flown."""

    task: Task
    """Under the game's conditions."""
    session: Session
    noise: ImageNoise
    start: Kinematics

    def picture(self, time_ns: int) -> NDArray[np.uint8]:
        """The front camera's gray picture of this tick, which is at that simulated time, with the game's noise."""
        return self.noise.add(self.session.picture(), time_ns)


class Observer:
    """Looks on; a subclass replaces what it wants to see."""

    def game_begun(self, game: Game) -> None:
        """`reset` has begun a game, and its first command can be flown."""

    def sample_taken(self, sample: FlightSample, command: int) -> None:
        """A sample was gathered, during which of the game's commands, from 0; one with a collision is its last."""
