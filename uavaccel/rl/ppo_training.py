"""PPO as the learner of a training: it counts games, and goes on from its state."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
import torch as th

from uavaccel.clock import MonotonicClock
from uavaccel.envs.batch import TurnBatch
from uavaccel.envs.stopwatch import PHASES, Stopwatch
from uavaccel.rl.config import LearnerConfig, PPOSettings
from uavaccel.rl.learner import (
    Game,
    LearnerState,
    charge,
    compute_the_same_each_time,
    falling,
    finished_games,
    first_seed,
)
from uavaccel.rl.ppo import PPO, ActorCritic, PPOOptions
from uavaccel.units import NS_PER_S


def options_of(config: LearnerConfig) -> PPOOptions:
    """Return PPO's options. Raises UserError for an unknown key or a value that does not fit."""
    settings = PPOSettings.of(config).model_dump()
    return PPOOptions(**settings, channels=config.channels, hidden=config.hidden, seed=config.seed)


def actor_of(config: LearnerConfig) -> ActorCritic:
    """Make the untrained policy of a configuration."""
    (actions,) = config.task.action_space().shape or (0,)
    return ActorCritic(config.task.observation_space(), actions, options_of(config), config.task.observation)


class PPOTraining:
    """PPO on a batch of the host, or on a CudaBatch, which flies the next round while the last one's games are told.

    A checkpoint can be taken between any two rounds, when none is in flight.
    """

    def __init__(self, config: LearnerConfig, lanes: Any) -> None:
        if config.device.startswith("cuda"):
            compute_the_same_each_time()
        self.config, self.lanes, self.options = config, lanes, options_of(config)
        self.stopwatch = Stopwatch(MonotonicClock())
        self.games, self.returns = 0, [0.0] * lanes.num_envs
        self.exploration_rate = None
        self.holding, self.at_rest = False, True
        self._on_host = isinstance(lanes, TurnBatch)
        self._games: HostGames | DeviceGames = HostGames(self, lanes) if self._on_host else DeviceGames(self, lanes)
        self._ppo = PPO(self._games, self.options)
        self._begun = False
        self.seconds_of_learning = self.options.epochs * self.options.minibatches / lanes.num_envs * config.learning_s
        """What a round's gradient steps cost each lane."""
        self.policy = self._ppo.policy if self._on_host else deepcopy(self._ppo.policy)
        """The network after the last round whose games were told."""

    def begin(self) -> None:
        """See `Learner`."""
        if not self._begun:
            self._ppo.look(self.lanes.reset(seed=first_seed(self.config.seed))[0])
        self._begun = True

    def advance(self) -> list[Game]:
        """Fly a rollout and learn from it; returns the games that ended in it."""
        self.begin()
        with self.stopwatch.phase("learning"):
            if self.at_rest:
                self._launch()
            self._ppo.finish()
            games = self._games.pop()
            if not self._on_host:
                self.policy.load_state_dict(self._ppo.policy.state_dict())
                self.at_rest = self.holding or self.games == self.config.games
            if not self.at_rest:
                self._launch()
        return games

    def _launch(self) -> None:
        left = 1.0 - self.games / self.config.games
        self._ppo.launch(left, falling(1.0, self.config.final_learning_rate_share, left))

    def get_state(self) -> LearnerState:
        """Return network, optimizer, counters and generator."""
        tensors = {
            "policy": self.policy.state_dict(),
            "optimizer": self._ppo.optimizer.state_dict(),
            "torch": th.get_rng_state(),
        }
        return LearnerState(tensors, {}, {"games": self.games, "returns": self.returns, "commands": self._ppo.commands})

    def set_state(self, state: LearnerState, observations: Any) -> None:
        """Restore what `get_state` returned; `observations` (lanes, ...) are the lanes' present ones."""
        for network in (self.policy, self._ppo.policy):
            network.load_state_dict(state.tensors["policy"])
        self._ppo.optimizer.load_state_dict(state.tensors["optimizer"])
        self.games, self.returns, self._ppo.commands = (state.counters[n] for n in ("games", "returns", "commands"))
        th.set_rng_state(state.tensors["torch"].cpu())
        self._ppo.look(observations)
        self._begun = True


class HostGames:
    """A batch of the host as PPO's environments; it notes the games that end."""

    def __init__(self, learner: PPOTraining, lanes: TurnBatch) -> None:
        self._learner, self._lanes = learner, lanes
        self.num_envs, self.task = lanes.num_envs, learner.config.task
        self.single_observation_space = lanes.single_observation_space
        self.single_action_space = lanes.single_action_space
        self.device = th.device(learner.config.device)
        self._ended: list[Game] = []

    def step(self, actions: Any) -> tuple[Any, ...]:
        """Fly one command in every environment."""
        learner = self._learner
        learner.stopwatch.switch(None)
        self._lanes.step_async(th.as_tensor(actions).cpu().numpy())
        seen, rewards, terminated, truncated, infos = self._lanes.step_wait()
        learner.stopwatch.switch("learning")
        over = terminated | truncated
        self._ended += finished_games(learner, rewards.tolist(), over.tolist(), infos, range(self.num_envs))
        charge(self._lanes, learner.config, learner.config.inference_s, "inference")
        won = np.array([info.get("final_info", info)["is_success"] for info in infos])
        return seen, rewards, terminated, truncated, {"final_info": {"is_success": won}}

    def pop(self) -> list[Game]:
        """Return the games that ended since the last call, and charge the lanes for what was learned since."""
        charge(self._lanes, self._learner.config, self._learner.seconds_of_learning, "learning")
        ended, self._ended = self._ended, []
        return ended


class DeviceGames:
    """A CudaBatch as PPO's environments; the games that end are read once a round."""

    def __init__(self, learner: PPOTraining, lanes: Any) -> None:
        self._learner, self._lanes, self.num_envs = learner, lanes, lanes.num_envs
        self.task, self.device = lanes.task, lanes.device
        self.single_observation_space = lanes.single_observation_space
        self.single_action_space = lanes.single_action_space
        self._returns: th.Tensor | None = None
        self._unread: list[tuple[th.Tensor, th.Tensor, dict[str, Any]]] = []

    def step(self, actions: th.Tensor) -> tuple[Any, ...]:
        """Fly one command in every environment."""
        stepped: tuple[Any, ...] = self._lanes.step(actions)
        _, rewards, terminated, truncated, infos = stepped
        if self._returns is None:
            self._returns = th.tensor(self._learner.returns, dtype=th.float64, device=self.device)
        over, returns = terminated | truncated, self._returns + rewards
        self._unread.append((over, returns, infos["final_info"]))
        self._charge(self._learner.config.inference_s, "inference")
        self._returns = th.where(over, 0.0, returns)
        return stepped

    def _charge(self, duration_s: float, phase: str) -> None:
        self._lanes.charge_each(np.full(self.num_envs, round(duration_s * NS_PER_S)), phase)

    def pop(self) -> list[Game]:
        """Return the games that ended since the last call, up to the configured number, and charge as `HostGames`."""
        learner, games = self._learner, []
        self._charge(learner.seconds_of_learning, "learning")
        ends = th.stack([over for over, _, _ in self._unread]).cpu().numpy()
        for (_, returns, infos), over in zip(self._unread, ends, strict=True):
            told = _on_host(infos) if over.any() else {}
            for lane in np.flatnonzero(over).tolist():
                if learner.games < learner.config.games:
                    info = _of_lane(told, lane) | {"host_phase_s": dict.fromkeys(PHASES, 0.0)}
                    hit = info["collision"]
                    info["collision"] = self._lanes.object_names[hit] if hit >= 0 else None
                    games.append(Game(learner.games, lane, info, float(returns[lane]), None))
                    learner.games += 1
        self._unread.clear()
        assert self._returns is not None
        learner.returns = self._returns.tolist()
        return games


def _on_host(info: dict[str, Any]) -> dict[str, Any]:
    """Return the tensors of an info as arrays, without their masks."""
    parts = {name: value for name, value in info.items() if not name.startswith("_")}
    return {name: _on_host(part) if isinstance(part, dict) else part.cpu().numpy() for name, part in parts.items()}


def _of_lane(info: dict[str, Any], lane: int) -> dict[str, Any]:
    """Return the info of one lane, as plain values."""
    return {
        name: _of_lane(part, lane) if isinstance(part, dict) else part[lane].tolist() for name, part in info.items()
    }
