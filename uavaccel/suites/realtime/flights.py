"""Trainings and evaluations of the experiment, and the rows that are kept of them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field

from uavaccel.clock import MonotonicClock
from uavaccel.forms import ArrayForm, Count, NotNegative, Number, Positive
from uavaccel.limits import Seed
from uavaccel.suites.experiment import CommandName, Timing
from uavaccel.suites.realtime.agents import LookAhead, Policy, Weights, train
from uavaccel.suites.realtime.config import EvaluationCase, RealtimeConfig, TrainingCase
from uavaccel.suites.realtime.environments import Env, measured, timed
from uavaccel.suites.rows import GameRow
from uavaccel.units import seconds_to_ns

EVALUATION_SEED = 1_000_000  # episodes of an evaluation begin with others than those of trainings


class TrainingRow(GameRow):
    """The row of a training."""

    kind: Literal["training"]
    environment: str
    agent: str
    seed: Seed
    steps: Count
    last_return: Number
    weights_sha256: str


class EvaluationRow(GameRow):
    """The row of the episodes of one trained agent under one latency, ClockSpeed and command."""

    kind: Literal["evaluation"]
    timing: Timing
    environment: str
    agent: str
    seed: Seed
    latency_s: NotNegative
    clock_speed: Positive
    command: CommandName
    returns: Annotated[list[Number], Field(min_length=1)]
    delays_s: Annotated[list[NotNegative], Field(min_length=1)]
    """Simulated seconds from an observation to its action: the median of each episode."""
    late_s: NotNegative
    """How late the environment was at most, behind the machine's clock; 0 where the clock is simulated."""


RealtimeRow = Annotated[TrainingRow | EvaluationRow, Discriminator("kind")]
WEIGHTS = {"*": ArrayForm("f")}
"""The arrays of a training: what its agent needs."""


def fly_training(config: RealtimeConfig, case: TrainingCase) -> tuple[TrainingRow, Weights]:
    """Train an agent, and return its row and its weights."""
    block, agent = config.environments[case.environment], config.agents[case.agent]
    trained = train(block, agent, config.seed + case.seed)
    row: TrainingRow = {
        "suite": "realtime",
        "case": case.id,
        "kind": "training",
        "environment": case.environment,
        "agent": case.agent,
        "seed": case.seed,
        "steps": trained.steps,
        "last_return": trained.last_return,
        "weights_sha256": _sha256(trained.weights),
    }
    return row, trained.weights


def fly_evaluation(config: RealtimeConfig, case: EvaluationCase, weights: Weights) -> EvaluationRow:
    """Fly the episodes of a trained agent under the latency, ClockSpeed and command of a case, and return their row."""
    block, agent = config.environments[case.environment], config.agents[case.agent]
    delay_s, wall = config.delay_s(case.agent, case.latency_s), case.timing == "wall"
    if wall:
        env: Env = measured(block, agent, case.command, case.clock_speed)
    else:
        env = timed(block, agent, delay_s, case.command, case.clock_speed)
    policy = Policy(env, agent, weights)
    actor: Policy | LookAhead = policy
    if agent.look_ahead and case.command == "adsc":
        actor = LookAhead(policy, env, block, delay_s, case.clock_speed)
    thinks_s, first = delay_s if wall else 0.0, EVALUATION_SEED + config.seed
    try:
        episodes = [_episode(env, actor, seed, thinks_s) for seed in range(first, first + config.episodes)]
    finally:
        env.close()
    returns, delays_s, late_s = (list(each) for each in zip(*episodes, strict=True))
    return {
        "suite": "realtime",
        "case": case.id,
        "kind": "evaluation",
        "timing": case.timing,
        "environment": case.environment,
        "agent": case.agent,
        "seed": case.seed,
        "latency_s": case.latency_s,
        "clock_speed": case.clock_speed,
        "command": case.command,
        "returns": returns,
        "delays_s": delays_s,
        "late_s": max(late_s),
    }


def _episode(env: Env, actor: Policy | LookAhead, seed: int, thinks_s: float) -> tuple[float, float, float]:
    """Fly an episode of decisions that take `thinks_s` of wall time; return its return, median delay and lateness."""
    clock = MonotonicClock()
    observation, _ = env.reset(seed=seed)
    if isinstance(actor, LookAhead):
        actor.begin()
    total, delays_s, late_s, over = 0.0, list[float](), 0.0, False
    while not over:
        since_ns = clock.now_ns()
        action = actor.act(observation)
        if thinks_s:
            clock.sleep_until(since_ns + seconds_to_ns(thinks_s))
        observation, reward, terminated, truncated, info = env.step(action)
        total, over = total + float(reward), terminated or truncated
        delays_s.append(float(info["meanwhile_s"]))
        late_s = max(late_s, float(info.get("late_s", 0.0)))
    return total, float(np.median(delays_s)), late_s


def _sha256(weights: Mapping[str, Any]) -> str:
    digest = hashlib.sha256()
    for name in sorted(weights):
        digest.update(name.encode() + np.ascontiguousarray(weights[name]).tobytes())
    return digest.hexdigest()
