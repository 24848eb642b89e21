"""What the suite `realtime` flies: environments with delays, and policies in them. It loads nothing that learns."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from numpy.typing import NDArray

import uavaccel.envs  # noqa: F401  registers the drones'
from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.realtime import RealTime, RealTimeProcess
from uavaccel.realtime.control_loop import ControlLoop, LoopOptions
from uavaccel.realtime.plant import MujocoPlant
from uavaccel.realtime.policies import load_policy
from uavaccel.realtime.server import begin
from uavaccel.suites.realtime import DRONES, AgentBlock, EnvironmentBlock
from uavaccel.units import seconds_to_ns

Env = gymnasium.Env[Any, Any]
Act = Callable[[Any], Any]
Weights = dict[str, NDArray[Any]]
TRANSPARENT = (RealTime, TimeLimit, OrderEnforcing, PassiveEnvChecker)
"""Wrappers that change neither observations nor actions, but for RealTime's own."""


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


def policy_of(env: Env, agent: AgentBlock, weights: Mapping[str, NDArray[Any]], given: str | None = None) -> Act:
    """Return the policy of an agent, from the file `given` or with weights, which computes in one thread.

    Raises UserError for a file without a policy that fits the environment.
    """
    if given is None:
        from uavaccel.suites.realtime_learner import trained_policy

        policy = trained_policy(env, agent, weights)
    else:
        policy = load_policy(given, env)
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(1)
    return policy


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
