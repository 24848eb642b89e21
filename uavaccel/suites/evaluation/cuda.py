"""An evaluation's lanes on one GPU, with rendering and decisions; the host reads the outcome of each command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.dqn.policies import DQNPolicy

from uavaccel.envs.cuda_lanes import AT, CudaLanes
from uavaccel.envs.values import Info
from uavaccel.kernels import cuda as kernels
from uavaccel.rl.agents import Agent, PolicyAgent, make_agent
from uavaccel.rl.algorithms import action_values
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import game_seed
from uavaccel.suites.evaluation.lanes import BLOCK, Blocks, Ended

DEVICE = "cuda"


class LanesOnGpu:
    """Lanes on a GPU, one game each. A round, the network's decisions in it, is recorded as one CUDA graph."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        self._device, self._inference_s = th.device(DEVICE), config.inference_s
        self._lanes = CudaLanes(config.task, len(lanes), self._device, renews=False)
        self._lanes.seed([game_seed(config, lane) for lane in lanes])
        self._lanes.games.draw_one_each([{"lane": lane} for lane in lanes])
        self._lanes.begin()
        self._agent = _moved(make_agent(config.agent, config.task), self._device)
        self._network = _network_of(self._agent)
        self._blocks, self._rows = (th.from_numpy(each).to(self._device) for each in _all_blocks(lanes))
        self._actions = th.zeros(len(lanes), dtype=th.int64, device=self._device)
        self._places: list[list[float]] = [[0.0, 0.0, 0.0] for _ in lanes]
        self._round = kernels.Recorded(self._decide_and_fly)

    def decide_and_fly(self, going: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[Ended]]:
        if self._network is None:
            self._ask(going)
        self._round()
        outcome = self._lanes.ended.tolist()  # the host waits for the device here
        self._places = [row[AT.place : AT.place + 3] for row in outcome]
        over = [place for place in going.tolist() if outcome[place][AT.over]]
        ended = [(place, self._lanes.info(place, outcome[place])) for place in over]
        return self._actions.cpu().numpy()[going], ended

    def _decide_and_fly(self) -> None:
        self._lanes.charge(self._lanes.going, self._inference_s, "inference")
        if self._network is not None:
            self._decide(self._network)
        self._lanes.fly(self._actions)

    def _decide(self, network: DQNPolicy) -> None:
        turned = self._agent.policy.turned if isinstance(self._agent, PolicyAgent) else None
        with th.inference_mode():
            self._rate(lambda seen: action_values(network, seen, turned).argmax(dim=1))

    def _ask(self, going: NDArray[np.int64]) -> None:
        """Let an agent whose network cannot be recorded, or which has none, decide."""
        if isinstance(self._agent, PolicyAgent):
            policy = self._agent.policy
            self._rate(lambda seen: th.from_numpy(policy.act(seen.cpu().numpy())).to(self._device))
            return
        for place in going.tolist():
            info: Info = {"position_m": self._places[place]}
            self._actions[place] = self._agent.act(np.zeros(0), info)

    def _rate(self, act: Callable[[th.Tensor], th.Tensor]) -> None:
        """Let all lanes act, block by block, lanes whose games are over too: it is the same work in each round."""
        chosen = [act(self._lanes.observations[block]) for block in self._blocks]
        self._actions.copy_(th.cat(chosen)[self._rows])

    def close(self) -> None:
        """Release the device's memory: the recorded round refers to these lanes, and they to it."""
        del self._round


def _moved(agent: Agent, device: th.device) -> Agent:
    """Return the agent with a copy of its network on the device; the policy that was loaded stays as it is."""
    if not isinstance(agent, PolicyAgent):
        return agent
    return PolicyAgent(replace(agent.policy, network=deepcopy(agent.policy.network).to(device)))


def _network_of(agent: Agent) -> DQNPolicy | None:
    """Return the network of an agent that rates actions by one."""
    if isinstance(agent, PolicyAgent) and isinstance(agent.policy.network, DQNPolicy):
        return agent.policy.network
    return None


def _all_blocks(lanes: Sequence[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the place in the batch of each row (blocks, BLOCK), the first where there is none, and each lane's row."""
    of_blocks = Blocks(lanes).of(np.arange(len(lanes)))
    places, rows = np.zeros((len(of_blocks), BLOCK), np.int64), np.zeros(len(lanes), np.int64)
    for number, (members, there) in enumerate(of_blocks):
        places[number, there] = members
        rows[members] = number * BLOCK + there
    return places, rows
