"""The environments: in training with a random delay in each episode, in an evaluation with one latency."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import gymnasium
import mujoco
import numpy as np

from uavaccel.realtime import RealTime, RealTimeProcess, samples
from uavaccel.realtime.control_loop import Command
from uavaccel.suites.realtime.config import DRONES, AgentBlock, EnvironmentBlock

Env = gymnasium.Env[Any, Any]
COMMAND: Command = "adsc"  # of trainings: their delays are of simulated time


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
    chosen = {"chunk": agent.chunk, "execute": 1} if agent.chunk > 1 else {}
    chosen |= {"observe_age": agent.observe_age, "observe_actions": agent.observe_actions}
    return {**chosen, "period_s": block.period_s, "default_action": block.default_action}


def timed(
    block: EnvironmentBlock, agent: AgentBlock, latency_s: float, command: str, clock_speed: float
) -> Env:
    """Return the environment of an evaluation on the simulated wall clock."""
    env = make(block, command, clock_speed)
    return RealTime(env, latency_s, command, clock_speed, **options(block, agent))  # type: ignore[arg-type]


def measured(block: EnvironmentBlock, agent: AgentBlock, command: str, clock_speed: float) -> RealTimeProcess:
    """Return the environment of an evaluation on the machine's own clock, in a process of its own."""
    made = partial(make, block, command, clock_speed)
    return RealTimeProcess(made, command, clock_speed, **options(block, agent))  # type: ignore[arg-type]


class DelayPerEpisode(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A wrapper that draws the delay of each episode of a training from a range of simulated seconds."""

    def __init__(self, env: RealTime, delay_s: tuple[float, float], seed: int) -> None:
        super().__init__(env)
        self._timed, self._delay_s, self._generator = env, delay_s, np.random.default_rng(seed)

    def reset(self, **keys: Any) -> tuple[Any, dict[str, Any]]:
        self._timed.thinking = samples([self._generator.uniform(*self._delay_s)])
        return super().reset(**keys)


def training(block: EnvironmentBlock, agent: AgentBlock, seed: int) -> Env:
    """Return one of the environments of a training."""
    env = RealTime(make(block, COMMAND, 1.0), 0.0, COMMAND, **options(block, agent))
    return DelayPerEpisode(env, agent.training_delay_s, seed)
