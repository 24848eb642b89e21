"""An evaluation's games side by side: in several processes, in the kernels on cores, in the kernels on one GPU.

A game's decisions never depend on its neighbours. In processes, each is made from a single observation, as in a single
environment, by an agent in the environment's own process, and none waits for another. In the kernels, all lanes are one
batch of arrays: each has a fixed row in a block of observations of fixed size, and one thread rates a whole block. A
network's ratings of one observation and of several, or by one thread and by several, differ in their last bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.config import validate
from uavaccel.envs.arrays import select
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.simulators import CUDA, KERNELS
from uavaccel.envs.values import Action, Info, Observation
from uavaccel.machine import usable_cores
from uavaccel.own_code import folder_of, trusted_folder, trusting
from uavaccel.rl.agents import Agent, BatchAgent, PolicyAgent, reset_options
from uavaccel.rl.config import DOUBLE_DQN, PPO
from uavaccel.suites.evaluate import AnyRow, EvaluateConfig, agent_of, fly_game, game_seed, row_of
from uavaccel.suites.experiment import number_of, timed
from uavaccel.suites.suite import GameResult
from uavaccel.units import NS_PER_S

MOST_LANES = 1024  # in a batch: a lane's event camera takes about 300 KB
BLOCK = 32  # observations that a network rates at once
GPU = "cuda"
TimedRow = tuple[AnyRow, dict[str, float]]  # row, host times
Games = Generator[Sequence[TimedRow], None, None]  # that have ended since the last ones
Places = NDArray[np.int64]  # of lanes in the batch
Flown = tuple[NDArray[Any], list[tuple[int, Info]]]  # actions; places of games that ended, their last infos


class GamesInBatch:
    """The games of several lanes, flown side by side; `game` hands each one over, whichever ends first."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        self._processes: EnvironmentBatch | None = None
        if config.simulator != KERNELS:
            count, task = min(config.environments, len(lanes)), config.task.model_dump(mode="json")
            self._processes = EnvironmentBatch(config.environment_class, count, **task)
        try:
            self.begin(config, lanes)
        except BaseException:
            self.close()
            raise

    def begin(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        """Start on the games of `lanes`, with the agent of this configuration, once all earlier games are over."""
        self._ended: dict[int, TimedRow] = {}
        batch = self._processes
        self._flown = over_arrays(config, lanes) if batch is None else in_processes(batch, config, lanes)
        next(self._flown)
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()

    def game(self, lane: int) -> GameResult:
        """Wait for a lane's game, and return it with `wall_s` since the first one began. Raises BatchError."""
        while lane not in self._ended:
            self._ended |= {number_of(row): (row, host) for row, host in next(self._flown)}
        row, host = self._ended.pop(lane)
        host |= {"wall_s": (self._clock.now_ns() - self._start_ns) / NS_PER_S}
        return GameResult(row, host=host, next_is_ready=lane + 1 in self._ended)

    def close(self) -> None:
        """End the processes, and abandon unfinished games."""
        self._flown.close()
        if self._processes is not None:
            self._processes.close()


# --- in processes -----------------------------------------------------------------------------------------------


_evaluates: WeakKeyDictionary[FlightEnv[Any], tuple[EvaluateConfig, Agent]] = WeakKeyDictionary()


def set_agent(environment: FlightEnv[Any], config: Mapping[str, object], folder: str | None) -> None:
    """Load, in the environment's process, the agent of an evaluation; its own code runs, also that in `folder`."""
    th.set_num_threads(1)
    with trusting(beside=None if folder is None else Path(folder)):
        checked = validate(EvaluateConfig, config, "evaluation")
        _evaluates[environment] = checked, agent_of(checked)


def fly(environment: FlightEnv[Any], lane: int) -> TimedRow:
    """Fly a game with the agent that was set, and return its row and the time that it took on this machine."""
    config, agent = _evaluates[environment]
    return timed(lambda: fly_game(config, environment, agent, lane))


def in_processes(batch: EnvironmentBatch, config: EvaluateConfig, lanes: Sequence[int]) -> Games:
    """Fly each game in the first idle environment; yield nothing once they have the agent, then each ended game."""
    folder = folder_of(config.environment_class) or trusted_folder()
    batch.call(f"{__name__}:set_agent", config.model_dump(mode="json"), folder and str(folder))
    yield []
    left = deque(lanes)
    for environment in range(min(batch.num_envs, len(lanes))):
        batch.call_async(environment, f"{__name__}:fly", left.popleft())
    for _ in lanes:
        environment, game = batch.call_wait()
        if left:
            batch.call_async(environment, f"{__name__}:fly", left.popleft())
        yield [game]


# --- in the kernels ---------------------------------------------------------------------------------------------


def over_arrays(config: EvaluateConfig, lanes: Sequence[int]) -> Games:
    """Fly the games in batches of up to MOST_LANES; yield nothing once a batch is open, then what ended in a round."""
    for first in range(0, len(lanes), MOST_LANES):
        numbers = lanes[first : first + MOST_LANES]
        with closing(open_lanes(config, numbers)) as batch:
            yield []
            taken: list[list[Action]] = [[] for _ in numbers]
            going = np.arange(len(numbers))
            while len(going):
                actions, ended = batch.decide_and_fly(going)
                for place, action in zip(going.tolist(), actions.tolist(), strict=True):
                    taken[place].append(action)
                going = going[~np.isin(going, [place for place, _ in ended])]
                yield [(row_of(config, numbers[place], info, taken[place]), {}) for place, info in ended]


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
        self._batch = KernelBatch(config.environment_class, len(lanes), autoreset_mode="Disabled", **task)
        self._agent = agent_of(config)
        self._lanes, self._inference_s = lanes, config.inference_s
        self._raters = ThreadPoolExecutor(usable_cores(), initializer=th.set_num_threads, initargs=(1,))
        options = [reset_options(config.env_id, lane) for lane in lanes]
        self._infos = self._batch.reset_each([game_seed(config, lane) for lane in lanes], options)
        self._seen = self._batch.observations()
        self._returns = np.zeros(len(lanes))

    def decide_and_fly(self, going: Places) -> Flown:
        """Fly a command of the lanes in these places, and return their actions and the games that ended."""
        for place in going.tolist():
            self._batch.charge(place, self._inference_s)
        actions = self._decide(going)
        self._batch.step_async(actions, going.tolist())
        _, rewards, terminated, truncated, infos = self._batch.step_wait(going.tolist())
        self._returns[going] += rewards
        self._seen = self._batch.observations()
        for place, info in zip(going.tolist(), infos, strict=True):
            self._infos[place] = info
        over = going[terminated | truncated].tolist()
        return actions, [(place, self._infos[place] | {"return": float(self._returns[place])}) for place in over]

    def _decide(self, going: Places) -> NDArray[Any]:
        agent, space = self._agent, self._batch.single_action_space
        if not isinstance(agent, BatchAgent):
            return np.array([agent.act(select(self._seen, place), self._infos[place]) for place in going])
        actions = np.zeros((len(self._lanes), *(space.shape or ())), space.dtype)

        def rate(block: tuple[Places, Places]) -> None:
            members, rows = block
            whole = np.full(BLOCK, members[0])  # the same work whatever lanes still fly
            whole[rows] = members
            actions[members] = agent.act_on(select(self._seen, whole))[rows]

        list(self._raters.map(rate, blocks(self._lanes, going)))
        return actions[going]

    def close(self) -> None:
        self._batch.close()
        self._raters.shutdown()


class LanesOnGpu:
    """Lanes on a GPU; the host reads the outcome of each command, whose round is recorded as one CUDA graph."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        from uavaccel.envs.cuda_lanes import AT, CudaLanes
        from uavaccel.kernels.recording import recorded

        self._at, device, self._inference_s = AT, th.device(GPU), config.inference_s
        self._lanes = CudaLanes(config.task, len(lanes), device, renews=False)
        self._lanes.games.seed([game_seed(config, lane) for lane in lanes])
        self._lanes.games.sample_games([reset_options(config.env_id, lane) for lane in lanes])
        self._lanes.begin()
        self._agent = agent_of(config)
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
        elif isinstance(agent := self._agent, BatchAgent):
            self._asked = lambda seen: th.from_numpy(agent.act_on(_on_host(seen))).to(device)
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
        ended = [
            (place, self._lanes.info(place, outcome[place]) | {"return": outcome[place][self._at.reward]})
            for place in over
        ]
        return self._actions.cpu().numpy()[going], ended

    def _fly_round(self) -> None:
        self._lanes.charge(self._lanes.going, self._inference_s, "inference")
        if self._recorded:
            with th.inference_mode():
                self._rate(self._recorded)
        self._lanes.fly(self._actions)

    def _rate(self, act: Callable[[th.Tensor], th.Tensor]) -> None:
        """Let all lanes act, block by block, lanes whose games are over too: it is the same work in each round."""
        chosen = [act(select(self._lanes.observations, block)) for block in self._places]
        self._actions.copy_(th.cat(chosen)[self._rows])

    def close(self) -> None:
        """Release the device's memory: the recorded round refers to these lanes, and they to it."""
        del self._round


def _on_host(seen: Any) -> Observation:
    """Return a device's observations as arrays."""
    if isinstance(seen, Mapping):
        return {name: part.cpu().numpy() for name, part in seen.items()}
    return seen.cpu().numpy()
