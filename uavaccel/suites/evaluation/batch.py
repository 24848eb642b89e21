"""An evaluation's games in several processes: each environment of a batch flies whole games with an agent of its own.

No process waits for another between commands, and each decision is made from a single observation, as in a single
environment: a network's ratings of several observations at once differ in their last bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import torch as th

from uavaccel.clock import MonotonicClock
from uavaccel.config import validate
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.rl.agents import Agent, make_agent
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import EvaluateRow, fly_game
from uavaccel.suites.host_time import timed
from uavaccel.suites.suite import GameResult
from uavaccel.units import NS_PER_S

TimedRow = tuple[EvaluateRow, dict[str, float]]  # row, host times


class AgentLane(ObstacleLane):
    """An `ObstacleLane` with an agent in the same process."""

    def take_agent(self, config: Mapping[str, object]) -> None:
        """Load the agent that an evaluation's configuration, as plain data, names."""
        th.set_num_threads(1)
        self._config = validate(EvaluateConfig, config, "evaluation")
        self._agent: Agent = make_agent(self._config.agent, self._config.task)

    def fly(self, lane: int) -> TimedRow:
        """Fly a game, and return its row and the time that it took on this machine."""
        return timed(lambda: fly_game(self._config, self, self._agent, lane))


class GamesInBatch:
    """Flies the games of `lanes` in `config.environments` environments, each of which takes the next game when idle."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        count = min(config.environments, len(lanes))
        self._batch = EnvironmentBatch(AgentLane, count, **config.task.model_dump(mode="json"))
        try:
            self.begin(config, lanes)
        except BaseException:
            self.close()
            raise

    def begin(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        """Start on the games of `lanes`, with the agent of this configuration, once all earlier games are over."""
        self._left, self._flown = deque(lanes), dict[int, TimedRow]()
        self._batch.call("take_agent", config.model_dump(mode="json"))
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()
        for environment in range(self._batch.num_envs):
            self._send_off(environment)

    def game(self, lane: int) -> GameResult:
        """Wait for the game on a lane, and return it; its host times have `wall_s` since the first game began.

        Raises BatchError where a process has ended.
        """
        while lane not in self._flown:
            environment, (row, host) = self._batch.call_wait()
            self._send_off(environment)
            self._flown[row["lane"]] = row, host
        row, host = self._flown.pop(lane)
        return GameResult(row, host={**host, "wall_s": (self._clock.now_ns() - self._start_ns) / NS_PER_S})

    def _send_off(self, environment: int) -> None:
        if self._left:
            self._batch.call_async(environment, "fly", self._left.popleft())

    def close(self) -> None:
        """End the processes and abandon unfinished games."""
        self._batch.close()
