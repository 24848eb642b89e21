"""An evaluation's lanes on one GPU, with rendering and decisions; the host reads the outcome of each command."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.dqn.policies import DQNPolicy

from uavaccel.envs.cuda_lanes import AT, CudaLanes
from uavaccel.envs.values import Info
from uavaccel.rl.agents import Agent, PolicyAgent, make_agent
from uavaccel.rl.algorithms import action_values
from uavaccel.rl.policy import Policy
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import game_seed
from uavaccel.suites.evaluation.lanes import BLOCK, Blocks, Ended

DEVICE = "cuda"


class LanesOnGpu:
    """Lanes on a GPU, one game each."""

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        self._device, self._inference_s = th.device(DEVICE), config.inference_s
        self._lanes = CudaLanes(config.task, len(lanes), self._device, renews=False)
        self._fly = self._lanes.recorded_flight()
        self._lanes.seed([game_seed(config, lane) for lane in lanes])
        self._lanes.games.draw_one_each([{"lane": lane} for lane in lanes])
        self._lanes.begin()
        self._agent, self._blocks = _moved(make_agent(config.agent, config.task), self._device), Blocks(lanes)
        self._places: list[list[float]] = [[0.0, 0.0, 0.0] for _ in lanes]

    def decide_and_fly(self, going: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[Ended]]:
        self._lanes.charge(self._lanes.going, self._inference_s, "inference")
        actions = self._decide(going)
        self._fly(actions)
        outcome = self._lanes.ended.tolist()  # the host waits for the device here
        self._places = [row[AT.place : AT.place + 3] for row in outcome]
        over = [place for place in going.tolist() if outcome[place][AT.over]]
        ended = [(place, self._lanes.info(place, outcome[place])) for place in over]
        return actions.cpu().numpy()[going], ended

    def _decide(self, going: NDArray[np.int64]) -> th.Tensor:
        """Return the actions (L,) of all lanes, of which those still flying are valid."""
        actions = th.zeros(self._lanes.count, dtype=th.int64, device=self._device)
        seen = self._lanes.observations
        if not isinstance(self._agent, PolicyAgent):
            for place in going.tolist():
                info: Info = {"position_m": self._places[place]}
                actions[place] = self._agent.act(np.zeros(0), info)
            return actions
        for members, rows in self._blocks.of(going):
            there, row = (th.from_numpy(each).to(self._device) for each in (members, rows))
            block = th.zeros((BLOCK, *seen.shape[1:]), dtype=seen.dtype, device=self._device)
            block[row] = seen[there]
            actions[there] = _greedy(self._agent.policy, block)[row]
        return actions

    def close(self) -> None:
        """The device's memory is released with the last reference to it."""


def _greedy(policy: Policy, seen: th.Tensor) -> th.Tensor:
    """Return the best actions (n,) for observations (n, ...) on the device."""
    if not isinstance(policy.network, DQNPolicy):
        return th.from_numpy(policy.act(seen.cpu().numpy())).to(seen.device)
    with th.inference_mode():
        return action_values(policy.network, seen, policy.turned).argmax(dim=1)


def _moved(agent: Agent, device: th.device) -> Agent:
    """Return the agent with a copy of its network on the device; the policy that was loaded stays as it is."""
    if not isinstance(agent, PolicyAgent):
        return agent
    return PolicyAgent(replace(agent.policy, network=deepcopy(agent.policy.network).to(device)))
