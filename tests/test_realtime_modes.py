"""How deployed policies take turns with the world, against the papers' loops written here, a control period at a time.

A policy's chunk depends on what it observed and on the actions it is told will be applied meanwhile, so that a turn
that is taken at another time, or with other actions before it, changes all that follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from uavaccel.realtime import RealTime

PERIODS = 40
Chunk = list[float]


class World(gymnasium.Env[NDArray[np.float64], NDArray[np.float64]]):
    """A number that moves by each action, of which it keeps a list."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float64)
    action_space = spaces.Box(-np.inf, np.inf, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.place, self.applied = 0.5, list[float]()
        return np.full(1, self.place), {}

    def step(self, action: NDArray[np.float64]) -> Any:
        self.applied.append(float(action[0]))
        self.place = moved(self.place, self.applied[-1])
        return np.full(1, self.place), 0.0, False, False, {}


def moved(place: float, action: float) -> float:
    return 0.9 * place + 0.1 * action


def policy(length: int, place: float, prefix: Chunk = []) -> Chunk:  # noqa: B006  which it does not change
    """A chunk that begins with the prefix, and is inpainted in its light."""
    return [*prefix, *(math.sin(9 * place + k + sum(prefix)) for k in range(len(prefix), length))]


def flown(keys: dict[str, Any], agent: Callable[[float, Chunk], Chunk], periods: int = PERIODS) -> Chunk:
    """The actions that the world was given while the agent acts on what it observes and what is planned."""
    env = RealTime(World(), **{"period_s": 0.1, **keys})
    observation, info = env.reset()
    while len(applied := env.unwrapped.applied) < periods:  # type: ignore[attr-defined]
        chunk = agent(float(observation[0]), np.ravel(info.get("planned", [])).tolist())
        observation, _, _, _, info = env.step(np.reshape(chunk, env.action_space.shape or ()))
    return list(applied[:periods])


def the_same(actions: Chunk, expected: Iterator[float]) -> None:
    np.testing.assert_allclose(actions, list(islice(expected, len(actions))), rtol=0, atol=1e-12)


# --- real-time chunking: arXiv 2506.07339, whose loop 2605.08168 sweeps over delays --------------------------------


def real_time_chunking(horizon: int, execute: int, delay: int, sees_prefix: bool) -> Iterator[float]:
    """Each chunk is inferred from the observation at which the one before has `horizon - execute` actions left, of
    which `delay` are applied meanwhile; of the new one those up to `execute` follow. The first comes without delay."""

    def inferred(place: float, left: Chunk) -> Chunk:
        return policy(horizon, place, left[:delay] if sees_prefix else [])

    place = 0.5
    chunk = policy(horizon, place)
    while True:
        new = inferred(place, chunk)
        for action in [*chunk[:delay], *new[delay:execute]]:
            yield action
            place = moved(place, action)
        chunk = new[execute:]


@st.composite
def chunked(draw: st.DrawFn) -> tuple[int, int, int]:
    """A horizon, of which so many are executed, and a delay that what is left bridges."""
    delay = draw(st.integers(0, 6))
    execute = draw(st.integers(max(delay, 1), 9))
    return draw(st.integers(max(execute + delay, 2), 20)), execute, delay


def compare(at: tuple[int, int, int], sees_prefix: bool, clock_speed: float = 1.0) -> None:
    horizon, execute, delay = at
    keys = {"delay_steps": delay, "clock_speed": clock_speed, "chunk": horizon, "execute": execute, "overlap": True}

    def agent(place: float, planned: Chunk) -> Chunk:
        before = planned if any(planned) else policy(horizon, place)  # of an episode's first chunk
        return policy(horizon, place, before[:delay] if sees_prefix else [])

    actions = flown({**keys, "frozen_prefix": True, "head_start": True}, agent)
    the_same(actions, real_time_chunking(horizon, execute, delay, sees_prefix))


@given(chunked(), st.booleans(), st.sampled_from([1.0, 3.0, 7.0, 0.3]))
@settings(deadline=None, max_examples=60)
def test_a_frozen_prefix_is_real_time_chunking(at: tuple[int, int, int], sees_prefix: bool, clock_speed: float) -> None:
    """At any ClockSpeed: a delay of steps is one of control periods."""
    compare(at, sees_prefix, clock_speed)


@pytest.mark.parametrize("delay", range(9))
def test_the_delays_of_the_comparison_of_asynchronous_methods(delay: int) -> None:
    """arXiv 2605.08168 on Kinetix: chunks of 16, of which max(d, 1) are executed, naive or with a prefix."""
    compare((16, max(delay, 1), delay), sees_prefix=False)
    compare((16, max(delay, 1), delay), sees_prefix=True)


# --- strands-labs/robots: the next chunk is inferred once the present one is drained to a trigger -------------------


def prefetching(length: int, trigger: int, slices: bool) -> Iterator[float]:
    """The world waits for an inference that starts at the trigger; its chunk follows when the present one has drained,
    and an RTC policy cuts from it the steps that are pending then, a number known beforehand."""
    place, pending = 0.5, length - trigger
    chunk = policy(length + pending, place)[:length]
    while True:
        for step, action in enumerate(chunk):
            if step == trigger:
                fetched = policy(length + pending, place)
            yield action
            place = moved(place, action)
        chunk = fetched[pending:] if slices else fetched[:length]


@given(st.integers(2, 12), st.data(), st.booleans(), st.booleans())
@settings(deadline=None, max_examples=60)
def test_an_early_start_is_a_chunk_fetched_ahead(length: int, data: st.DataObject, slices: bool, waits: bool) -> None:
    """Whether the world waits or goes on for a shorter time than the actions that are left bridge."""
    trigger = data.draw(st.integers(1, length - 1))
    slow = {"command": "tcsc", "latency_s": 3.0}
    quick = {"delay_steps": data.draw(st.integers(0, length - trigger)), "head_start": True}
    keys = {"chunk": 2 * length - trigger, "execute": length, "early": length - trigger, "frozen_prefix": slices}
    actions = flown(keys | (slow if waits else quick), lambda place, _: policy(2 * length - trigger, place))
    the_same(actions, prefetching(length, trigger, slices))


# --- temporal ensembling: arXiv 2304.13705, algorithm 2 -------------------------------------------------------------


def ensembling(length: int, weight: float) -> Iterator[float]:
    """The policy is asked in every step, and all actions that were predicted for it are averaged, the oldest first."""
    place, buffers = 0.5, dict[int, list[float]]()
    for step in range(10**9):
        for k, action in enumerate(policy(length, place)):
            buffers.setdefault(step + k, []).append(action)
        weights = [math.exp(-weight * i) for i in range(len(buffers[step]))]
        action = sum(w * each for w, each in zip(weights, buffers[step], strict=True)) / sum(weights)
        yield action
        place = moved(place, action)


@given(st.integers(2, 12), st.sampled_from([0.0, 0.01, 0.5, 3.0]))
@settings(deadline=None, max_examples=40)
def test_an_ensemble_is_the_papers(length: int, weight: float) -> None:
    keys = {"latency_s": 0.0, "chunk": length, "execute": 1, "ensemble": weight}
    the_same(flown(keys, lambda place, _: policy(length, place)), ensembling(length, weight))


def test_what_is_planned_is_what_is_applied_if_nothing_else_arrives() -> None:
    """An agent that observes the next actions, and is told them, finds in them what its world was given meanwhile."""
    keys: dict[str, Any] = {"delay_steps": [0, 1, 2, 5], "chunk": 4, "execute": 2, "overlap": True}
    env = RealTime(World(), period_s=0.1, frozen_prefix=True, observe_planned=4, **keys)
    observation, info = env.reset(seed=3)
    inside: Any = env.unwrapped
    for _ in range(30):
        done, planned = len(inside.applied), info["planned"].ravel()
        np.testing.assert_array_equal(observation[1:], planned)
        observation, _, _, _, info = env.step(np.reshape(policy(4, float(observation[0])), (4, 1)))
        meanwhile = inside.applied[done : done + min(round(info["meanwhile_s"] / 0.1), 4)]
        assert meanwhile == planned[: len(meanwhile)].tolist()
    space: Any = env.observation_space
    assert space.contains(observation)
    assert space.shape == (5,)
