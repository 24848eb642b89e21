"""The events of an evaluation's game, by an event camera beside the agent's own, at whatever rate."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.task import rate_ticks
from uavaccel.errors import UserError
from uavaccel.rl.agents import make_agent
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import fly_lane
from uavaccel.vision.dvs import make_sensor
from uavaccel.vision.event_counter import EventCounter
from uavaccel.wire.image_api import HEIGHT, WIDTH
from uavaccel.wire.session import Session, VirtualSession


class WatchedLane(ObstacleLane):
    """An `ObstacleLane` with a second event camera, which sees `rate_hz` frames per simulated second."""

    def __init__(self, rate_hz: float, **task: Any) -> None:
        super().__init__(**task)
        self._every_ticks = rate_ticks(rate_hz, self.task.profile, "--events-rate-hz")
        sensor = make_sensor(self.task.dvs_parameters, (HEIGHT, WIDTH), self.task.dvs_seed)
        self.events = EventCounter(sensor, listed=True)

    def _opened(self) -> Session:
        opened = self._session is not None
        session = super()._opened()
        if not opened and isinstance(session, VirtualSession):
            session.watch(self._every_ticks, self._look_too)
        return session

    def _start_game(self, course: Any, latencies: np.random.SeedSequence) -> None:
        super()._start_game(course, latencies)
        assert isinstance(self._session, VirtualSession)
        now_ns = self._now.state.time_ns
        seed = self.flown.events_seed(self._noise.seed)
        self.events.start(self._noise.add(self._session.picture(), now_ns), now_ns, seed)

    def _look_too(self, time_ns: int) -> None:
        assert isinstance(self._session, VirtualSession)
        self.events.look(self._noise.add(self._session.picture(), time_ns), time_ns)


def lane_events(config: EvaluateConfig, lane: int, rate_hz: float) -> NDArray[np.float32]:
    """Events (n, 4) of the game on that lane: rows t in s, x, y, p = 1 or -1. Raises UserError for the rate."""
    keys = config.task.model_dump(mode="json")
    try:
        environment = WatchedLane(rate_hz, **keys)
    except ValueError as error:
        raise UserError(str(error)) from None
    try:
        for _ in fly_lane(config, environment, make_agent(config.agent, config.task), lane):
            pass
        return environment.events.take_events()
    finally:
        environment.close()
