"""An evaluation's games in the kernels: all lanes as one batch of arrays, with decisions for many lanes at once.

A game's decisions do not depend on its neighbours or on the number of cores: each lane has a fixed row in a block of
observations of fixed size, and one thread rates a whole block. A network's ratings of one observation and of several,
or by one thread and by several, differ in their last bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.envs.flyable import CUDA
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.values import Info
from uavaccel.machine import usable_cores
from uavaccel.rl.agents import Agent, PolicyAgent, make_agent
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import EvaluateRow, game_seed, row_of
from uavaccel.suites.suite import GameResult
from uavaccel.units import NS_PER_S

MOST_LANES = 1024  # in a batch: a lane's event camera takes about 300 KB
BLOCK = 32  # observations that a network rates at once
Ended = tuple[int, Info]  # place in the batch, info of the game's end


class Lanes(Protocol):
    """A batch of an evaluation's lanes, on cores or on a GPU."""

    def decide_and_fly(self, going: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[Ended]]:
        """Fly a command of the lanes in these places, and return their actions and the games that ended."""
        ...

    def close(self) -> None: ...


class GamesOverArrays:
    """Flies the games of `lanes` in batches of up to MOST_LANES, in the order of `game`'s calls."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        self._config, self._left = config, deque(lanes)
        self._batch: Lanes | None = None
        self._rows: dict[int, EvaluateRow] = {}
        self._clock = MonotonicClock()
        self._start_ns: int | None = None

    def game(self, lane: int) -> GameResult:
        """Fly until the game on a lane is over; its host times have `wall_s` since the first game began."""
        while lane not in self._rows:
            if self._batch is None:
                self._begin()
            self._fly()
        row, now_ns = self._rows.pop(lane), self._clock.now_ns()
        host = {"wall_s": (now_ns - (self._start_ns or now_ns)) / NS_PER_S}
        return GameResult(row, host=host, next_is_ready=lane + 1 in self._rows)

    def _begin(self) -> None:
        self._lanes = [self._left.popleft() for _ in range(min(MOST_LANES, len(self._left)))]
        self._actions: list[list[int]] = [[] for _ in self._lanes]
        self._going = np.arange(len(self._lanes))
        self._batch = _open(self._config, self._lanes)
        self._start_ns = self._start_ns or self._clock.now_ns()

    def _fly(self) -> None:
        assert self._batch is not None
        actions, ended = self._batch.decide_and_fly(self._going)
        for place, action in zip(self._going.tolist(), actions.tolist(), strict=True):
            self._actions[place].append(action)
        for place, info in ended:
            lane = self._lanes[place]
            self._rows[lane] = row_of(self._config, lane, info, self._actions[place])
        over = [place for place, _ in ended]
        self._going = self._going[~np.isin(self._going, over)]
        if not len(self._going):
            self.close()

    def close(self) -> None:
        """Abandon unfinished games."""
        if self._batch is not None:
            self._batch.close()
        self._batch = None


def _open(config: EvaluateConfig, lanes: Sequence[int]) -> Lanes:
    if config.device == CUDA:
        from uavaccel.suites.evaluation.cuda import LanesOnGpu

        return LanesOnGpu(config, lanes)
    return LanesOnCores(config, lanes)


class LanesOnCores:
    """Lanes on CPU cores, in threads of this process."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        from uavaccel.envs.kernel_batch import KernelBatch

        task = config.task.model_dump(mode="json")
        self._batch = KernelBatch(ObstacleLane, len(lanes), autoreset_mode="Disabled", **task)
        self._agent: Agent = make_agent(config.agent, config.task)
        self._inference_s = config.inference_s
        self._blocks = Blocks(lanes)
        self._raters = ThreadPoolExecutor(usable_cores(), initializer=th.set_num_threads, initargs=(1,))
        options = [{"lane": lane} for lane in lanes]
        self._infos = self._batch.reset_each([game_seed(config, lane) for lane in lanes], options)
        self._seen = self._batch.observations()

    def decide_and_fly(self, going: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[Ended]]:
        for place in going.tolist():
            self._batch.charge(place, self._inference_s)
        actions = self._decide(going)
        self._batch.step_async(actions, going.tolist())
        seen, _, terminated, truncated, infos = self._batch.step_wait(going.tolist())
        self._seen[going] = seen
        for place, info in zip(going.tolist(), infos, strict=True):
            self._infos[place] = info
        over = going[terminated | truncated].tolist()
        return actions, [(place, self._infos[place]) for place in over]

    def _decide(self, going: NDArray[np.int64]) -> NDArray[np.int64]:
        if not isinstance(self._agent, PolicyAgent):
            return np.array([self._agent.act(self._seen[place], self._infos[place]) for place in going])
        policy, actions = self._agent.policy, np.zeros(len(self._seen), np.int64)

        def rate(block: tuple[NDArray[np.int64], NDArray[np.int64]]) -> None:
            members, rows = block
            seen = np.zeros((BLOCK, *self._seen.shape[1:]), self._seen.dtype)
            seen[rows] = self._seen[members]
            actions[members] = policy.act(seen)[rows]

        list(self._raters.map(rate, self._blocks.of(going)))
        return actions[going]

    def close(self) -> None:
        self._batch.close()
        self._raters.shutdown()


class Blocks:
    """The fixed block of observations, and the row in it, that each lane has; they depend on the lane alone."""

    def __init__(self, lanes: Sequence[int]) -> None:
        self._block, self._row = np.divmod(np.asarray(lanes), BLOCK)

    def of(self, going: NDArray[np.int64]) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """Return the places of the flying lanes of each block, and their rows in it."""
        blocks = self._block[going]
        members = [going[blocks == block] for block in np.unique(blocks)]
        return [(each, self._row[each]) for each in members]
