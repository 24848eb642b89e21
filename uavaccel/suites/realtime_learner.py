"""How the suite `realtime` trains: PPO of stable-baselines3, its weights plain arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from uavaccel.own_code import errors_named, file_of
from uavaccel.realtime import RealTime, samples
from uavaccel.realtime.control_loop import Command
from uavaccel.suites.realtime import AgentBlock, EnvironmentBlock
from uavaccel.suites.realtime_agents import Act, Env, Weights, check_numbers, make, options

COMMAND: Command = "adsc"  # of trainings: their delays are of simulated time
LANES, STEPS = 8, 256  # of a rollout
LEARNER: dict[str, Any] = {"n_steps": STEPS, "batch_size": 256, "n_epochs": 10}
CLIPPED = 10.0  # an observation's normalised numbers
EPSILON = 1e-8
LAST_EPISODES = 100


class DelayPerEpisode(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A wrapper that draws the delay of each episode of a training from a range of simulated seconds."""

    def __init__(self, env: RealTime, delay_s: tuple[float, float], seed: int) -> None:
        super().__init__(env)
        self._timed, self._delay_s, self._generator = env, delay_s, np.random.default_rng(seed)

    def reset(self, **keys: Any) -> tuple[Any, dict[str, Any]]:
        self._timed.thinking = samples([self._generator.uniform(*self._delay_s)])
        observation, info = super().reset(**keys)
        check_numbers(self, observation)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, *rest = super().step(action)
        check_numbers(self, observation, reward)
        return observation, reward, *rest


def training(block: EnvironmentBlock, agent: AgentBlock, seed: int) -> Env:
    """Return one of the environments of a training."""
    env = RealTime(make(block, COMMAND, 1.0), 0.0, COMMAND, **options(block, agent))
    return DelayPerEpisode(env, agent.training_delay_s, seed)


def train(block: EnvironmentBlock, agent: AgentBlock, seed: int) -> tuple[Weights, dict[str, Any]]:
    """Train an agent; return its weights, and what its row says of them.

    Observations and rewards are normalised by their running mean and variance.
    """
    th.set_num_threads(1)
    set_random_seed(seed)
    lanes = DummyVecEnv([partial(training, block, agent, 1000 * seed + lane) for lane in range(LANES)])
    normalised = VecNormalize(lanes, clip_obs=CLIPPED, gamma=0.99)
    normalised.seed(1000 * seed)
    policy = {"net_arch": list(agent.hidden)}
    learner = PPO("MlpPolicy", normalised, seed=seed, device="cpu", policy_kwargs=policy, **LEARNER)
    learner.set_logger(Logger(None, []))  # its own makes a folder among the temporary files
    returns = _Returns()
    with errors_named(file_of(type(lanes.envs[0].unwrapped))):
        learner.learn(block.train_steps, returns)
    weights = {name: value.numpy().copy() for name, value in learner.policy.state_dict().items()}
    scale: Any = normalised.obs_rms
    weights |= {"observation.mean": scale.mean, "observation.var": scale.var}
    normalised.close()
    digest = hashlib.sha256()
    for name in sorted(weights):
        digest.update(name.encode() + np.ascontiguousarray(weights[name]).tobytes())
    learned = {"steps": int(learner.num_timesteps), "last_return": returns.last(), "agent_sha256": digest.hexdigest()}
    return weights, learned


class _Returns(BaseCallback):
    """Returns of finished episodes, not normalised."""

    def __init__(self) -> None:
        super().__init__()
        self._finished: list[float] = []
        self._running = np.zeros(LANES)

    def _on_step(self) -> bool:
        normalised: Any = self.training_env
        self._running += normalised.get_original_reward()
        for lane in np.flatnonzero(self.locals["dones"]):
            self._finished.append(float(self._running[lane]))
            self._running[lane] = 0.0
        return True

    def last(self) -> float | None:
        """Return the mean return of the last episodes; None where none was finished."""
        return float(np.mean(self._finished[-LAST_EPISODES:])) if self._finished else None


def trained_policy(env: Env, agent: AgentBlock, weights: Mapping[str, NDArray[Any]]) -> Act:
    """Return the policy with weights: the mean of its distribution of actions, or the most likely one."""
    kind, space = PPO.policy_aliases["MlpPolicy"], env.observation_space
    policy = kind(space, env.action_space, lambda _: 0.0, net_arch=list(agent.hidden))
    policy.load_state_dict({name: th.as_tensor(weights[name]) for name in policy.state_dict()})
    mean, scale = weights["observation.mean"], np.sqrt(weights["observation.var"] + EPSILON)

    def act(observation: NDArray[Any]) -> Any:
        normalised = (np.asarray(observation, float) - mean) / scale
        seen = np.clip(normalised, -CLIPPED, CLIPPED).astype(np.float32)
        return policy.predict(seen, deterministic=True)[0]

    return act
