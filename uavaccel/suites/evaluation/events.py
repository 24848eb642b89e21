"""The events of an evaluation's game, by an event camera beside the agent's own, at whatever rate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.observer import Game, Observer
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.task import rate_ticks
from uavaccel.errors import UserError
from uavaccel.rl.agents import make_agent
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import fly_lane
from uavaccel.vision.dvs import make_sensor
from uavaccel.vision.event_counter import EventCounter


class SecondEventCamera(Observer):
    """An event camera beside the agent's own, which sees a frame at every so many ticks of the game."""

    def __init__(self, task: LaneTask, every_ticks: int) -> None:
        self._every_ticks = every_ticks
        self.events = EventCounter(
            make_sensor(task.dvs_parameters, (HEIGHT, WIDTH), task.dvs_seed), listed=True
        )
        self._stop: Callable[[], None] = lambda: None

    def game_begun(self, game: Game) -> None:
        self._stop()
        now_ns, seed = game.start.time_ns, game.task.events_seed(game.noise.seed)
        self.events.start(game.picture(now_ns), now_ns, seed)
        self._stop = game.session.watch(
            self._every_ticks, lambda time_ns: self.events.look(game.picture(time_ns), time_ns)
        )


def lane_events(config: EvaluateConfig, lane: int, rate_hz: float) -> NDArray[np.float32]:
    """Events (n, 4) of the game on that lane: rows t in s, x, y, p = 1 or -1. Raises UserError for the rate."""
    task = config.task
    try:
        camera = SecondEventCamera(task, rate_ticks(rate_hz, task.profile, "--events-rate-hz"))
    except ValueError as error:
        raise UserError(str(error)) from None
    environment = ObstacleLane(**task.model_dump(mode="json"))
    environment.add_observer(camera)
    try:
        for _ in fly_lane(config, environment, make_agent(config.agent, task), lane):
            pass
        return camera.events.take_events()
    finally:
        environment.close()
