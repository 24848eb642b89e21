"""Worlds whose trajectory under delayed actions is known in closed form, which every mode is held to.

Each is linear, and at rest at first: where its actions change by `jump` at the time `at`, its state at t has the term
jump * response(t - at). The worlds themselves step from state to state, exactly too: they differ by rounding alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.realtime import RealTime

TICK_S, PERIOD = 0.01, 5  # a control period is five ticks of physics
PERIOD_S = TICK_S * PERIOD
DECAY_S = 0.3
EPISODE_S = 3.0
Signal = Callable[[float], float]  # the action at a time


@dataclass
class Kind:
    """How a linear world answers a unit step, and how its state moves in a time under a constant action."""

    response: Callable[[float], float]
    moved: Callable[[NDArray[np.float64], float, float], NDArray[np.float64]]


def decayed(state: NDArray[np.float64], action: float, time_s: float) -> NDArray[np.float64]:
    return action + (state - action) * math.exp(-time_s / DECAY_S)


def pushed(state: NDArray[np.float64], action: float, time_s: float) -> NDArray[np.float64]:
    place, speed = state
    return np.array([place + speed * time_s + action * time_s**2 / 2, speed + action * time_s])


KINDS = {
    "integrator": Kind(lambda t: t, lambda state, action, time_s: state + action * time_s),
    "first order": Kind(lambda t: 1 - math.exp(-t / DECAY_S), decayed),
    "double integrator": Kind(lambda t: t**2 / 2, pushed),
}


class Linear(gymnasium.Env[NDArray[np.float64], NDArray[np.float64]]):
    """Built as Gymnasium's MuJoCo environments are: a step makes `frame_skip` ticks of physics."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float64)
    action_space = spaces.Box(-np.inf, np.inf, (1,), np.float64)

    def __init__(self, kind: Kind, start: float = 0.0) -> None:
        self.kind, self.start, self.frame_skip = kind, start, PERIOD
        self.model = SimpleNamespace(opt=SimpleNamespace(timestep=TICK_S))
        self.data = SimpleNamespace(time=0.0)

    def do_simulation(self) -> None: ...

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.state, self.data.time = np.array([self.start, 0.0]), 0.0
        return self.state[:1].copy(), {}

    def step(self, action: NDArray[np.float64]) -> Any:
        self.data.time += self.frame_skip * TICK_S
        self.state = self.kind.moved(self.state, float(action[0]), self.frame_skip * TICK_S)
        return self.state[:1].copy(), 0.0, False, False, {}


def planned(decision: int, place: int) -> float:
    """The action that a decision plans for so many periods after its first one."""
    return math.sin(3.0 * decision + 0.7 * place) + 0.1 * decision


def waited_s(latency_s: float) -> float:
    """An action waits for the end of the tick in which it arrives."""
    return math.ceil(round(latency_s / TICK_S, 9)) * TICK_S


def turns(
    first_s: float, cycle_s: float, chunk: int, late_s: float = 0.0, holds: bool = True, ready: bool = False
) -> Signal:
    """The signal of chunks of which the n-th takes over at first_s + n cycle_s, `late_s` after it begins.

    With `ready` the one before the first is there when the episode begins. A chunk that is over by then never counts.
    """
    dropped = round(late_s / PERIOD_S, 9) >= chunk

    def signal(time_s: float) -> float:
        decision = -1 if dropped else max(math.floor((time_s - first_s) / cycle_s), -1)
        place = math.floor((time_s - first_s - decision * cycle_s + late_s) / PERIOD_S)
        if decision < 0:
            return planned(0, min(math.floor(time_s / PERIOD_S), chunk - 1)) if ready else 0.0
        return planned(decision + ready, min(place, chunk - 1)) if place < chunk or holds else 0.0

    return signal


def averaged(chunk: int, weight: float) -> Signal:
    """The signal of chunks that come every period, all of which count."""

    def signal(time_s: float) -> float:
        period = math.floor(time_s / PERIOD_S)
        decisions = range(max(period - chunk + 1, 0), period + 1)  # the oldest first
        weights = [math.exp(-weight * rank) for rank in range(len(decisions))]
        terms = (w * planned(each, period - each) for w, each in zip(weights, decisions, strict=True))
        return sum(terms) / sum(weights)

    return signal


def cases() -> list[Any]:
    """Options of RealTime, and the signal that they apply, by the mode's name."""
    found: list[tuple[str, dict[str, Any], Signal]] = [
        ("paused", {"latency_s": 1.0, "command": "tcsc"}, turns(0, PERIOD_S, 1)),
        ("ensemble", {"latency_s": 0, "chunk": 6, "execute": 1, "ensemble": 0.2}, averaged(6, 0.2)),
        ("steps", {"delay_steps": 2}, turns(2 * PERIOD_S, 3 * PERIOD_S, 1)),
        ("10 x", {"latency_s": 0.007, "clock_speed": 10}, turns(0.07, 0.07 + PERIOD_S, 1)),
        ("slowest", {"latency_s": 70.0, "clock_speed": 0.001}, turns(0.07, 0.07 + PERIOD_S, 1)),
    ]
    for latency_s in (0.02, 0.034, 0.05, 0.12, 0.31):
        delay_s = waited_s(latency_s)
        keys = {"latency_s": latency_s, "chunk": 6, "execute": 3}
        after_s, overlap_s = delay_s + 3 * PERIOD_S, max(3 * PERIOD_S, delay_s)
        early_s = max(delay_s, PERIOD_S)
        found += [
            ("hold", {"latency_s": latency_s}, turns(delay_s, delay_s + PERIOD_S, 1)),
            ("default", {"latency_s": latency_s, "meanwhile": "default"},
             turns(delay_s, delay_s + PERIOD_S, 1, holds=False)),
            ("chunk", keys, turns(delay_s, after_s, 6)),
            ("runs dry", {**keys, "chunk": 4, "meanwhile": "default"}, turns(delay_s, after_s, 4, holds=False)),
            ("overlap", {**keys, "overlap": True}, turns(delay_s, overlap_s, 6)),
            ("frozen prefix", {**keys, "overlap": True, "frozen_prefix": True}, turns(delay_s, overlap_s, 6, delay_s)),
            ("head start", {**keys, "overlap": True, "head_start": True, "frozen_prefix": True},
             turns(3 * PERIOD_S + delay_s, overlap_s, 6, delay_s, ready=True)),
            ("early", {**keys, "early": 1, "head_start": True}, turns(0, 2 * PERIOD_S + early_s, 6)),
        ]  # fmt: skip
    return [pytest.param(keys, signal, id=f"{name} {keys.get('latency_s', '')}") for name, keys, signal in found]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("keys", "signal"), cases())
def test_a_mode_flies_the_trajectory_in_closed_form(keys: dict[str, Any], signal: Signal, kind: str) -> None:
    env = RealTime(Linear(KINDS[kind]), **keys)
    env.reset()
    chunk, decision, time_s = keys.get("chunk", 1), 0, 0.0
    while time_s < EPISODE_S:
        actions = [planned(decision, place) for place in range(chunk)]
        observation, _, _, _, info = env.step(np.reshape(actions, env.action_space.shape or ()))
        decision, time_s = decision + 1, info["simulated_s"]
        ticks = [signal((tick + 0.5) * TICK_S) for tick in range(round(time_s / TICK_S))]
        jumps = np.diff(ticks, prepend=0.0)
        expected = sum(jumps[at] * KINDS[kind].response(time_s - at * TICK_S) for at in np.flatnonzero(jumps))
        assert observation[0] == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("gain_s", [0.3, 0.8, 0.99, 1.01, 2.0])
@pytest.mark.parametrize("latency_s", [0.05, 0.12, 0.31])
def test_a_delayed_feedback_swings_as_its_characteristic_roots_say(latency_s: float, gain_s: float) -> None:
    """x' = -(gain / w) x(t - w), sampled every w: z^2 - z + gain = 0, which is stable up to a gain of 1 and no more."""
    delay_s = waited_s(latency_s)
    env = RealTime(Linear(KINDS["integrator"], start=1.0), latency_s, overlap=True)
    observation, _ = env.reset()
    modulus, angle = math.sqrt(gain_s), math.acos(1 / (2 * math.sqrt(gain_s)))
    slope = (1 - modulus * math.cos(angle)) / (modulus * math.sin(angle))
    for turn in range(40):
        swung = modulus**turn * (math.cos(turn * angle) + slope * math.sin(turn * angle))
        assert observation[0] == pytest.approx(swung, rel=1e-9, abs=1e-9 * max(modulus, 1.0) ** turn)
        observation, *_ = env.step(-gain_s / delay_s * observation)
