"""What the suite `realtime` flies: PPO of stable-baselines3, its weights plain arrays, in environments with delays."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import uavaccel.envs  # noqa: F401  registers the drones'
from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.own_code import errors_named, file_of
from uavaccel.realtime import RealTime, RealTimeProcess, samples
from uavaccel.realtime.control_loop import Command, ControlLoop, LoopOptions
from uavaccel.realtime.plant import MujocoPlant
from uavaccel.realtime.policies import load_policy
from uavaccel.realtime.server import begin
from uavaccel.suites.realtime import DRONES, AgentBlock, EnvironmentBlock
from uavaccel.units import seconds_to_ns

Env = gymnasium.Env[Any, Any]
Act = Callable[[Any], Any]
Weights = dict[str, NDArray[Any]]
COMMAND: Command = "adsc"  # of trainings: their delays are of simulated time
LANES, STEPS = 8, 256  # of a rollout
LEARNER: dict[str, Any] = {"n_steps": STEPS, "batch_size": 256, "n_epochs": 10}
CLIPPED = 10.0  # an observation's normalised numbers
EPSILON = 1e-8
LAST_EPISODES = 100


def make(block: EnvironmentBlock, command: str, clock_speed: float) -> Env:
    """Return the environment without delays; a drone's flies with the command at the ClockSpeed."""
    mujoco.set_mju_user_warning(_warned)
    keys = dict(block.keys)
    if block.id.startswith(DRONES):
        keys |= {"timing": "virtual", "command": command, "clock_speed": clock_speed}
    return gymnasium.make(block.id, **keys)


def _warned(text: str) -> None:
    """Print MuJoCo's warnings, but for one about how Gymnasium's own models are written."""
    if "settotalmass" not in text:
        print(f"MuJoCo: {text}", file=sys.stderr)


def options(block: EnvironmentBlock, agent: AgentBlock) -> dict[str, Any]:
    """Return the agent's options of the control loop; it applies one action of a chunk before it observes again."""
    chosen: dict[str, Any] = {"chunk": agent.chunk, "execute": 1} if agent.chunk > 1 else {}
    chosen |= agent.model_dump(include={"frozen_prefix", "observe_age", "observe_actions", "observe_planned"})
    return {**chosen, "period_s": block.period_s, "default_action": block.default_action}


def timed(block: EnvironmentBlock, agent: AgentBlock, latency_s: float, command: str, clock_speed: float) -> Env:
    """Return the environment of an evaluation on the simulated wall clock."""
    env = make(block, command, clock_speed)
    return RealTime(env, latency_s, command, clock_speed, **options(block, agent))  # type: ignore[arg-type]


def measured(block: EnvironmentBlock, agent: AgentBlock, command: str, clock_speed: float) -> RealTimeProcess:
    """Return the environment of an evaluation on the machine's own clock, in a process of its own."""
    made = partial(make, block, command, clock_speed)
    return RealTimeProcess(made, command, clock_speed, **options(block, agent))  # type: ignore[arg-type]


def check_learnable(env: Env) -> None:
    """Raise UserError for spaces that PPO takes none of, or takes for others."""
    seen, actions = env.observation_space, env.action_space
    if not isinstance(seen, spaces.Box):
        raise UserError(f"PPO learns from a Box of observations, not from {seen}: put a wrapper around it")
    if isinstance(actions, spaces.Discrete) and actions.start:
        raise UserError(f"PPO counts actions from 0, not as {actions}: put a wrapper around it")


def check_numbers(env: Env, *given: Any) -> None:
    """Raise UserError for rewards or observations of an environment that are NaN or infinite."""
    if not all(np.isfinite(each).all() for each in given):
        name = type(env.unwrapped).__name__ if env.spec is None else env.spec.id
        raise UserError(f"{name}: a reward or an observation is NaN or infinite")


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


def policy_of(env: Env, agent: AgentBlock, weights: Mapping[str, NDArray[Any]], given: str | None = None) -> Act:
    """Return the policy of an agent: of the file `given`, or with weights the mean of its distribution of actions, or
    the most likely one. Raises UserError for a file without a policy that fits the environment.
    """
    th.set_num_threads(1)
    if given is not None:
        return load_policy(given, env)
    kind, space = PPO.policy_aliases["MlpPolicy"], env.observation_space
    policy = kind(space, env.action_space, lambda _: 0.0, net_arch=list(agent.hidden))
    policy.load_state_dict({name: th.as_tensor(weights[name]) for name in policy.state_dict()})
    policy.eval()
    mean, scale = weights["observation.mean"], np.sqrt(weights["observation.var"] + EPSILON)

    def act(observation: NDArray[Any]) -> Any:
        normalised = (np.asarray(observation, float) - mean) / scale
        seen = np.clip(normalised, -CLIPPED, CLIPPED).astype(np.float32)
        return policy.predict(seen, deterministic=True)[0]

    return act


class LookAhead:
    """A policy that acts on the observation predicted for the moment at which its action will be applied.

    The model is the simulator itself, from the present state on: an upper bound of what any model brings. `env` is a
    timed one of Gymnasium's MuJoCo environments.
    """

    def __init__(self, policy: Act, env: Env, block: EnvironmentBlock, delay_s: float, clock_speed: float) -> None:
        self._policy, self._real = policy, env.unwrapped
        self._model: Any = gymnasium.make(block.id, **block.keys).unwrapped
        self._model.reset(seed=0)
        options = LoopOptions("adsc", clock_speed, default_action=block.default_action)
        self._loop = ControlLoop(MujocoPlant(self._model), options, self._model.action_space)
        self._idle: Any = options.idle_action(self._model.action_space)
        self._ticks = self._loop.ticks_within(round(delay_s * 1e9))
        self._held = self._idle

    def reset(self, seed: int) -> None:
        """Begin an episode, in which the idle action is held at first."""
        begin(self._policy, seed)
        self._held = self._idle

    def __call__(self, observation: NDArray[Any]) -> Any:
        """Return the action for the predicted observation."""
        if self._ticks:
            real: Any = self._real
            self._model.set_state(real.data.qpos.copy(), real.data.qvel.copy())
            self._model.data.qacc_warmstart[:] = real.data.qacc_warmstart
            observation = self._loop.plant.advance(self._held, self._ticks).observation
        self._held = self._policy(observation)
        return self._held


def fly_episode(env: Env, policy: Act, seed: int, thinks_s: float) -> tuple[float, float, float]:
    """Fly an episode of decisions that take `thinks_s` of wall time; return its return, median delay and lateness."""
    clock = MonotonicClock()
    observation, _ = env.reset(seed=seed)
    begin(policy, seed)
    total, delays_s, late_s, over = 0.0, list[float](), 0.0, False
    while not over:
        since_ns = clock.now_ns()
        action = policy(observation)
        if thinks_s:
            clock.sleep_until(since_ns + seconds_to_ns(thinks_s))
        observation, reward, terminated, truncated, info = env.step(action)
        total, over = total + float(reward), terminated or truncated
        delays_s.append(float(info["meanwhile_s"]))
        late_s = max(late_s, float(info.get("late_s", 0.0)))
    check_numbers(env, total)
    return total, float(np.median(delays_s)), late_s
