"""Agents of the experiment: PPO of stable-baselines3, its weights as plain arrays, and one that looks ahead."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from uavaccel.realtime.control_loop import ControlLoop, LoopOptions
from uavaccel.realtime.plant import MujocoPlant
from uavaccel.suites.realtime.config import AgentBlock, EnvironmentBlock
from uavaccel.suites.realtime.environments import Env, training

Weights = dict[str, NDArray[Any]]
LANES, STEPS = 8, 256  # of a rollout
LEARNER: dict[str, Any] = {"n_steps": STEPS, "batch_size": 256, "n_epochs": 10}
CLIPPED = 10.0  # an observation's normalised numbers
EPSILON = 1e-8
LAST_EPISODES = 100


class Trained(NamedTuple):
    """A trained agent's weights, and its return over the last episodes of its training."""

    weights: Weights
    last_return: float
    steps: int


def train(block: EnvironmentBlock, agent: AgentBlock, seed: int) -> Trained:
    """Train an agent; observations and rewards are normalised by their running mean and variance."""
    th.set_num_threads(1)
    set_random_seed(seed)
    lanes = DummyVecEnv([partial(training, block, agent, 1000 * seed + lane) for lane in range(LANES)])
    normalised = VecNormalize(lanes, clip_obs=CLIPPED, gamma=0.99)
    normalised.seed(1000 * seed)
    policy = {"net_arch": list(agent.hidden)}
    learner = PPO("MlpPolicy", normalised, seed=seed, device="cpu", policy_kwargs=policy, **LEARNER)
    learner.set_logger(Logger(None, []))  # its own makes a folder among the temporary files
    returns = _Returns()
    learner.learn(block.train_steps, returns)
    weights = {name: value.numpy().copy() for name, value in learner.policy.state_dict().items()}
    scale: Any = normalised.obs_rms
    weights |= {"observation.mean": scale.mean, "observation.var": scale.var}
    normalised.close()
    return Trained(weights, returns.last(), int(learner.num_timesteps))


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

    def last(self) -> float:
        """Return the mean return of the last episodes; NaN where none was finished."""
        return float(np.mean(self._finished[-LAST_EPISODES:])) if self._finished else float("nan")


class Policy:
    """A trained agent, which takes the mean of its distribution of actions, or the most likely one."""

    def __init__(self, env: Env, agent: AgentBlock, weights: Mapping[str, NDArray[Any]]) -> None:
        th.set_num_threads(1)
        self._mean, self._var = weights["observation.mean"], weights["observation.var"]
        space = env.observation_space
        kind = PPO.policy_aliases["MlpPolicy"]
        policy = kind(space, env.action_space, lambda _: 0.0, net_arch=list(agent.hidden))
        policy.load_state_dict({name: th.as_tensor(weights[name]) for name in policy.state_dict()})
        self._policy = policy.eval()

    def act(self, observation: NDArray[Any]) -> Any:
        """Return the action for an observation."""
        normalised = (np.asarray(observation, float) - self._mean) / np.sqrt(self._var + EPSILON)
        seen = np.clip(normalised, -CLIPPED, CLIPPED).astype(np.float32)
        return self._policy.predict(seen, deterministic=True)[0]


class LookAhead:
    """An agent that acts on the observation predicted for the moment at which its action will be applied.

    The model is the simulator itself, from the present state on: an upper bound of what any model brings. `env` is a
    timed one of Gymnasium's MuJoCo environments.
    """

    def __init__(
        self, policy: Policy, env: Env, block: EnvironmentBlock, delay_s: float, clock_speed: float
    ) -> None:
        self._policy, self._real = policy, env.unwrapped
        self._model: Any = gymnasium.make(block.id, **block.keys).unwrapped
        self._model.reset(seed=0)
        options = LoopOptions("adsc", clock_speed, default_action=block.default_action)
        self._loop = ControlLoop(MujocoPlant(self._model), options, self._model.action_space)
        self._idle: Any = options.idle_action(self._model.action_space)
        self._ticks = self._loop.ticks_within(round(delay_s * 1e9))
        self._held = self._idle

    def begin(self) -> None:
        self._held = self._idle

    def act(self, observation: NDArray[Any]) -> Any:
        """Return the action for the predicted observation."""
        if self._ticks:
            real: Any = self._real
            self._model.set_state(real.data.qpos.copy(), real.data.qvel.copy())
            self._model.data.qacc_warmstart[:] = real.data.qacc_warmstart
            observation = self._loop.plant.advance(self._held, self._ticks).observation
        self._held = self._policy.act(observation)
        return self._held
