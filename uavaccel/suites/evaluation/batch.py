"""An evaluation's games flown side by side: each lane of a batch flies whole games, its agent in the same process.

So nothing is waited for between commands, and each decision is of one observation, as in a single environment: of
several at once a network's ratings differ in their last bits.
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

FlownOnLane = tuple[EvaluateRow, dict[str, float]]  # row, host times


class AgentLane(ObstacleLane):
    """An `ObstacleLane` with its agent on board."""

    def take_agent(self, config: Mapping[str, object]) -> None:
        """The agent that a configuration of the evaluation, as plain data, names."""
        th.set_num_threads(1)
        self._config = validate(EvaluateConfig, config, "evaluation")
        self._agent: Agent = make_agent(self._config.agent, self._config.task)

    def fly(self, lane: int) -> FlownOnLane:
        """A game's row, and what it took on this machine."""
        return timed(lambda: fly_game(self._config, self, self._agent, lane))


class GamesInBatch:
    """Flies the games of `lanes` over `config.environments` environments; one that is done takes the next game."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        count = min(config.environments, len(lanes))
        self._batch = EnvironmentBatch(AgentLane, count, **config.task.model_dump(mode="json"))
        try:
            self.begin(config, lanes)
        except BaseException:
            self.close()
            raise

    def begin(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        """Once all games so far are over: fly those of `lanes`, with the agent that this configuration names."""
        self._left, self._flown = deque(lanes), dict[int, FlownOnLane]()
        self._batch.call("take_agent", config.model_dump(mode="json"))
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()
        for environment in range(self._batch.num_envs):
            self._send_off(environment)

    def game(self, lane: int) -> GameResult:
        """The game on that lane, once it is over. Host times have `wall_s`, since the first game began.

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
        """End the processes; games that are still flown are given up."""
        self._batch.close()
