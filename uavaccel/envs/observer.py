"""Observers of an environment's flights: films, further event cameras, counters.

`FlightEnv.add_observer` registers one. It sees each game's beginning and samples and, through the game's session, any
ticks that it asks for (`Session.watch`); none of that is a message, takes wall time or changes a flight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.camera_client import FlightSample
from uavaccel.envs.task import Task
from uavaccel.kinematics import Kinematics
from uavaccel.vision.image_noise import ImageNoise
from uavaccel.wire.session import Session


class Game(NamedTuple):
    """A running game."""

    task: Task
    """The task under the game's conditions."""
    session: Session
    noise: ImageNoise
    start: Kinematics

    def picture(self, time_ns: int) -> NDArray[np.uint8]:
        """Return the front camera's gray picture of the present tick, at simulated `time_ns`, with the game's noise."""
        return self.noise.add(self.session.picture(), time_ns)


class Observer:
    """Base class of observers; a subclass replaces the methods that it needs."""

    def game_begun(self, game: Game) -> None:
        """Called after `reset` has begun a game, before its first command."""

    def sample_taken(self, sample: FlightSample, command: int) -> None:
        """Called for each gathered sample, during command number `command`, from 0; with a collision it is the last."""
