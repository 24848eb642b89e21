"""An evaluation's games side by side: in several processes, in the kernels on cores, in the kernels on one GPU.

A game's decisions never depend on its neighbours. In processes, each is made from a single observation, as in a single
environment, by an agent in the environment's own process, and none waits for another. In the kernels, all lanes are one
batch of arrays: each has a fixed row in a block of observations of fixed size, and one thread rates a whole block. A
network's ratings of one observation and of several, or by one thread and by several, differ in their last bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
from typing import Any, cast

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.config import validate
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.flyable import CUDA
from uavaccel.envs.gates import Gates
from uavaccel.envs.hover import Hover
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.values import Action, Info
from uavaccel.machine import usable_cores
from uavaccel.rl.agents import Agent, PolicyAgent, make_agent, reset_options
from uavaccel.rl.config import DOUBLE_DQN, PPO, environment_class
from uavaccel.suites.evaluate import EvaluateConfig, EvaluateRow, Flyable, fly_game, game_seed, row_of
from uavaccel.suites.host_time import timed
from uavaccel.suites.suite import GameResult
from uavaccel.units import NS_PER_S

MOST_LANES = 1024  # in a batch: a lane's event camera takes about 300 KB
BLOCK = 32  # observations that a network rates at once
GPU = "cuda"
TimedRow = tuple[EvaluateRow, dict[str, float]]  # row, host times
Places = NDArray[np.int64]  # of lanes in the batch
Flown = tuple[NDArray[Any], list[tuple[int, Info]]]  # actions; places of games that ended, their last infos


# --- in processes -----------------------------------------------------------------------------------------------


class FliesGames:
    """What makes an environment one with an agent in the same process."""

    def set_agent(self, config: Mapping[str, object]) -> None:
        """Load the agent that an evaluation's configuration, as plain data, names."""
        th.set_num_threads(1)
        self._config = validate(EvaluateConfig, config, "evaluation")
        self._agent: Agent = make_agent(self._config.agent, self._config.task)

    def fly(self, lane: int) -> TimedRow:
        """Fly a game, and return its row and the time that it took on this machine."""
        return timed(lambda: fly_game(self._config, cast(Flyable, self), self._agent, lane))


class AgentObstacleLane(FliesGames, ObstacleLane):
    """The obstacle lane with an agent."""


class AgentHover(FliesGames, Hover):
    """Hover with an agent."""


class AgentGates(FliesGames, Gates):
    """Gates with an agent."""


class AgentNavigate(FliesGames, Navigate):
    """Navigate with an agent."""


AGENTS: dict[type[FlightEnv[Any]], type[FlightEnv[Any]]] = {
    each.__mro__[2]: each for each in (AgentObstacleLane, AgentHover, AgentGates, AgentNavigate)
}


class GamesInBatch:
    """Flies the games of `lanes` in `config.environments` environments, each of which takes the next game when idle."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        count, environment = min(config.environments, len(lanes)), AGENTS[environment_class(config.env_id)]
        self._batch = EnvironmentBatch(environment, count, **config.task.model_dump(mode="json"))
        self.close = self._batch.close  # ends the processes, and abandons unfinished games
        try:
            self.begin(config, lanes)
        except BaseException:
            self.close()
            raise

    def begin(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        """Start on the games of `lanes`, with the agent of this configuration, once all earlier games are over."""
        self._left, self._flown = deque(lanes), dict[int, TimedRow]()
        self._batch.call("set_agent", config.model_dump(mode="json"))
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


# --- in the kernels ---------------------------------------------------------------------------------------------


class GamesOverArrays:
    """Flies the games of `lanes` in batches of up to MOST_LANES, in the order of `game`'s calls."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        self._config, self._left = config, list(lanes)
        self._batch: LanesOnCores | LanesOnGpu | None = None
        self._rows: dict[int, EvaluateRow] = {}
        self._clock = MonotonicClock()
        self._start_ns: int | None = None

    def game(self, lane: int) -> GameResult:
        """Fly until the game on a lane is over; its host times have `wall_s` since the first game began."""
        while lane not in self._rows:
            if self._batch is None:
                self._lanes, self._left = self._left[:MOST_LANES], self._left[MOST_LANES:]
                self._actions: list[list[Action]] = [[] for _ in self._lanes]
                self._going = np.arange(len(self._lanes))
                self._batch = open_lanes(self._config, self._lanes)
                self._start_ns = self._start_ns or self._clock.now_ns()
            actions, ended = self._batch.decide_and_fly(self._going)
            for place, action in zip(self._going.tolist(), actions.tolist(), strict=True):
                self._actions[place].append(action)
            for place, info in ended:
                flown = self._lanes[place]
                self._rows[flown] = row_of(self._config, flown, info, self._actions[place])
            self._going = self._going[~np.isin(self._going, [place for place, _ in ended])]
            if not len(self._going):
                self.close()
        row, now_ns = self._rows.pop(lane), self._clock.now_ns()
        host = {"wall_s": (now_ns - (self._start_ns or now_ns)) / NS_PER_S}
        return GameResult(row, host=host, next_is_ready=lane + 1 in self._rows)

    def close(self) -> None:
        """Abandon unfinished games."""
        if self._batch is not None:
            self._batch.close()
        self._batch = None


def open_lanes(config: EvaluateConfig, lanes: Sequence[int]) -> LanesOnCores | LanesOnGpu:
    """Return a batch of lanes on the device of the configuration."""
    return LanesOnGpu(config, lanes) if config.device == CUDA else LanesOnCores(config, lanes)


def blocks(lanes: Sequence[int], going: Places) -> Iterator[tuple[Places, Places]]:
    """Yield the places of the flying lanes of each block, and their rows in it, which depend on a lane alone."""
    block, row = np.divmod(np.asarray(lanes), BLOCK)
    for number in np.unique(block[going]):
        members = going[block[going] == number]
        yield members, row[members]


class LanesOnCores:
    """Lanes on CPU cores, in threads of this process."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        from uavaccel.envs.kernel_batch import KernelBatch

        task = config.task.model_dump(mode="json")
        self._batch = KernelBatch(environment_class(config.env_id), len(lanes), autoreset_mode="Disabled", **task)
        self._agent: Agent = make_agent(config.agent, config.task)
        self._lanes, self._inference_s = lanes, config.inference_s
        self._raters = ThreadPoolExecutor(usable_cores(), initializer=th.set_num_threads, initargs=(1,))
        options = [reset_options(config.env_id, lane) for lane in lanes]
        self._infos = self._batch.reset_each([game_seed(config, lane) for lane in lanes], options)
        self._seen = self._batch.observations()

    def decide_and_fly(self, going: Places) -> Flown:
        """Fly a command of the lanes in these places, and return their actions and the games that ended."""
        for place in going.tolist():
            self._batch.charge(place, self._inference_s)
        actions = self._decide(going)
        self._batch.step_async(actions, going.tolist())
        seen, _, terminated, truncated, infos = self._batch.step_wait(going.tolist())
        self._seen[going] = seen
        for place, info in zip(going.tolist(), infos, strict=True):
            self._infos[place] = info
        return actions, [(place, self._infos[place]) for place in going[terminated | truncated].tolist()]

    def _decide(self, going: Places) -> NDArray[Any]:
        if not isinstance(self._agent, PolicyAgent):
            return np.array([self._agent.act(self._seen[place], self._infos[place]) for place in going])
        policy, space = self._agent.policy, self._batch.single_action_space
        actions = np.zeros((len(self._seen), *(space.shape or ())), space.dtype)

        def rate(block: tuple[Places, Places]) -> None:
            members, rows = block
            seen = np.zeros((BLOCK, *self._seen.shape[1:]), self._seen.dtype)
            seen[rows] = self._seen[members]
            actions[members] = policy.act(seen)[rows]

        list(self._raters.map(rate, blocks(self._lanes, going)))
        return actions[going]

    def close(self) -> None:
        self._batch.close()
        self._raters.shutdown()


class LanesOnGpu:
    """Lanes on a GPU, one game each, with rendering and decisions; the host reads the outcome of each command.

    A round, the network's decisions in it, is recorded as one CUDA graph; other agents decide before it.
    """

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        from uavaccel.envs.cuda_lanes import AT, CudaLanes
        from uavaccel.kernels.recording import recorded

        self._at, device, self._inference_s = AT, th.device(GPU), config.inference_s
        self._lanes = CudaLanes(config.task, len(lanes), device, renews=False)
        self._lanes.seed([game_seed(config, lane) for lane in lanes])
        self._lanes.games.sample_games([reset_options(config.env_id, lane) for lane in lanes])
        self._lanes.begin()
        self._agent: Agent = make_agent(config.agent, config.task)
        self._recorded: Callable[[th.Tensor], th.Tensor] | None = None
        self._asked: Callable[[th.Tensor], th.Tensor] | None = None
        if isinstance(self._agent, PolicyAgent):
            # a copy of its network: the policy that was loaded stays as it is
            network = deepcopy(self._agent.policy.network).to(device)
            policy = replace(self._agent.policy, network=network)
            if policy.config.algorithm == PPO:
                self._recorded = network.act
            elif policy.config.algorithm == DOUBLE_DQN:
                self._recorded = lambda seen: policy.values(seen).argmax(dim=1)
            else:
                self._asked = lambda seen: th.from_numpy(policy.act(seen.cpu().numpy())).to(device)
        # the place in the batch of each row of each block, the first where there is none, and each lane's row in all
        members = list(blocks(lanes, np.arange(len(lanes))))
        places, rows = np.zeros((len(members), BLOCK), np.int64), np.zeros(len(lanes), np.int64)
        for number, (places_of_block, rows_of_block) in enumerate(members):
            places[number, rows_of_block] = places_of_block
            rows[places_of_block] = number * BLOCK + rows_of_block
        self._places, self._rows = th.from_numpy(places).to(device), th.from_numpy(rows).to(device)
        space = config.task.action_space()
        self._actions = th.as_tensor(np.zeros((len(lanes), *(space.shape or ())), space.dtype), device=device)
        self._positions_m: list[list[float]] = [[0.0, 0.0, 0.0] for _ in lanes]
        self._round = recorded(self._fly_round, device)

    def decide_and_fly(self, going: Places) -> Flown:
        """Fly a command of all lanes, and return the actions in these places and the games there that ended."""
        if self._asked:
            self._rate(self._asked)
        elif not self._recorded:
            for place in going.tolist():
                self._actions[place] = self._agent.act(np.zeros(0), {"position_m": self._positions_m[place]})
        self._round()
        outcome = self._lanes.ended.tolist()  # the host waits for the device here
        self._positions_m = [row[self._at.place : self._at.place + 3] for row in outcome]
        over = [place for place in going.tolist() if outcome[place][self._at.over]]
        ended = [(place, self._lanes.info(place, outcome[place])) for place in over]
        return self._actions.cpu().numpy()[going], ended

    def _fly_round(self) -> None:
        self._lanes.charge(self._lanes.going, self._inference_s, "inference")
        if self._recorded:
            with th.inference_mode():
                self._rate(self._recorded)
        self._lanes.fly(self._actions)

    def _rate(self, act: Callable[[th.Tensor], th.Tensor]) -> None:
        """Let all lanes act, block by block, lanes whose games are over too: it is the same work in each round."""
        chosen = [act(self._lanes.observations[block]) for block in self._places]
        self._actions.copy_(th.cat(chosen)[self._rows])

    def close(self) -> None:
        """Release the device's memory: the recorded round refers to these lanes, and they to it."""
        del self._round
