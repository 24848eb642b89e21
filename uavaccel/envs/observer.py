"""Observers of an environment's flights: films, further event cameras, counters.

`FlightEnv.add_observer` registers one. It sees each game's beginning and samples and, through the game's session, any
ticks that it asks for (`Session.watch`); none of that is a message, takes wall time or changes a flight.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.camera_client import NO_IMAGE, Sample
from uavaccel.envs.sensors import PICTURE_SIZE
from uavaccel.envs.task import Task
from uavaccel.kinematics import Kinematics, Quaternion, Vector
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.vision.dvs import EventCounter, make_sensor
from uavaccel.vision.noise import ImageNoise
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


def receives_whole(task: Task) -> bool:
    """Return whether an agent receives the gray pictures of whole size that onlookers see."""
    return task.observation == "dvs" and task.picture_size == PICTURE_SIZE


class Observer:
    """Base class of observers; a subclass replaces the methods that it needs."""

    def game_begun(self, game: Game) -> None:
        """Called after `reset` has begun a game, before its first command."""

    def sample_taken(self, sample: Sample, command: int) -> None:
        """Called for each gathered sample, during command number `command`, from 0; with a collision it is the last."""


class Seen(NamedTuple):
    """The front camera's gray image, when and where it was taken, and the command during which it was."""

    time_ns: int
    image: NDArray[np.uint8]
    position_m: Vector
    orientation_wxyz: Quaternion
    command: int


class Onlooker(Observer):
    """Collects the current game's start and samples, the last one at the moment of impact, and what it hit.

    Images that the agent does not receive are rendered without a message, which needs `virtual` or `lockstep`. Without
    `pictures` the images are empty.
    """

    def __init__(self, pictures: bool = True) -> None:
        self.pictures = pictures
        self.samples: list[Seen] = []
        self.hit: tuple[int, str] | None = None

    def game_begun(self, game: Game) -> None:
        self._game, self.hit, start = game, None, game.start
        image = game.picture(start.time_ns) if self.pictures else NO_IMAGE
        self.samples = [Seen(start.time_ns, image, start.position_m, start.orientation_wxyz, 0)]

    def sample_taken(self, sample: Sample, command: int) -> None:
        state, hit = sample.state, sample.collision
        time_ns, place, image = state.time_ns, state.position_m, NO_IMAGE
        if hit:
            time_ns, self.hit = hit["time_ns"], (hit["time_ns"], hit["object"])
            north, east, down = hit["position_m"]
            place = north, east, down
        if self.pictures:
            shown = receives_whole(self._game.task) and not hit
            image = sample.image if shown else self._game.session.picture()
        self.samples.append(Seen(time_ns, image, place, state.orientation_wxyz, command))


class SecondEventCamera(Observer):
    """An event camera beside the agent's own, which receives a frame every few ticks of the game."""

    def __init__(self, task: Task, every_ticks: int) -> None:
        self._every_ticks = every_ticks
        self.events = EventCounter(make_sensor(task.dvs_parameters, (HEIGHT, WIDTH), task.dvs_seed), listed=True)
        self._stop: Callable[[], None] = lambda: None

    def game_begun(self, game: Game) -> None:
        self._stop()
        now_ns, seed = game.start.time_ns, game.task.events_seed(game.noise.seed)
        self.events.start(game.picture(now_ns), now_ns, seed)
        self._stop = game.session.watch(
            self._every_ticks, lambda time_ns: self.events.process_frame(game.picture(time_ns), time_ns)
        )
