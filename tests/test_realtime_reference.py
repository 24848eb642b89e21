"""Real time against a second simulation of what its pages say, tick by tick, written here, over random options."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import MaxAndSkipObservation, TimeLimit
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.realtime import RealTime

SETS, EPISODES, DECISIONS = 400, 2, 6
TOLD = ("thinking_s", "meanwhile_s", "simulated_s", "wall_s")
Result = tuple[list[float], bool, bool, list[float]]


class Ticking(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """It notes the action of each tick, earns that action in a period, ends at a tick, and spoils what it is given."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    end = 10**9

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.ticks: list[float] = []
        return np.zeros(1, np.float32), {}

    def _made(self) -> int:
        return 1

    def step(self, action: NDArray[np.float32]) -> Any:
        value = float(action[0])
        self.ticks += [value] * self._made()
        action[:] = np.nan
        over = len(self.ticks) >= self.end
        return np.full(1, len(self.ticks), np.float32), np.float32(value), over, False, {}


class Physical(Ticking):
    """Like Gymnasium's MuJoCo's, clocks of unstable ones too; `substeps` are made whatever `frame_skip` says."""

    def __init__(self, frame_skip: Any, timestep_s: float, substeps: int | None = None) -> None:
        self.frame_skip, self.substeps = frame_skip, substeps
        self.model = SimpleNamespace(opt=SimpleNamespace(timestep=timestep_s))
        self.data = SimpleNamespace(time=0.0)

    def do_simulation(self) -> None: ...

    def _made(self) -> int:
        made = self.substeps or int(self.frame_skip)
        falls = not self.substeps and len(self.ticks) % 7 == 6
        self.data.time = 0.0 if falls else self.data.time + made * self.model.opt.timestep
        return made


@dataclass
class Drawn:
    """A set of options, an environment, and what the reference knows of both."""

    env: gymnasium.Env[Any, Any]
    keys: dict[str, Any]
    tick_s: float
    period: int
    limit: int
    latencies_s: list[float]
    refused: str = ""


def drawn(generator: np.random.Generator) -> Drawn:
    """Draw a set of options."""

    def one_of(*choices: Any) -> Any:
        return choices[generator.integers(len(choices))]

    number = one_of(float, np.float32, np.float64)
    latencies = [float(each) for each in generator.choice([0, 0.003, 0.013, 0.02, 0.05, 0.37], 3)]
    chunk = int(one_of(1, 1, 2, 3, 5))
    execute = int(generator.integers(1, chunk + 1))
    starts = one_of({"overlap": False}, {"overlap": True}, {"early": int(generator.integers(0, execute))})
    keys: dict[str, Any] = {
        "latency_s": one_of(number(latencies[0]), latencies, tuple(latencies), np.array(latencies, np.float32)),
        "command": one_of(*["adsc"] * 5, "tcsc"),
        "clock_speed": one_of(1, number(2.5), np.int64(10), number(0.3)),
        "meanwhile": one_of("hold", "default"),
        "default_action": one_of(None, [-0.5], np.full(1, 0.25, np.float64)),
        "chunk": np.int64(chunk),
        "execute": one_of(None, execute) if "overlap" in starts else execute,
        **starts,
        "head_start": one_of(False, False, True),
        "frozen_prefix": chunk > 1 and one_of(False, True),
        "ensemble": one_of(None, None, 0, 0.3) if chunk > 1 else None,
        "observe_age": one_of(False, True),
        "observe_actions": np.int32(one_of(0, 1, 3)),
        "observe_planned": np.int32(one_of(0, 0, 2)),
    }
    tick_s, period, refused = float(one_of(0.02, 0.05, 0.03)), 1, ""
    kind = one_of("dt", "tau", "period_s", *["physical"] * 4, "fixed")
    if kind in ("physical", "fixed"):
        tick_s, period = float(one_of(0.01, 0.002)), int(one_of(1, 3, 4, 5))
        env: Any = Physical(np.int64(period), tick_s, period if kind == "fixed" else None)
    else:
        env = Physical(1, 0.01) if kind == "period_s" and one_of(False, True) else Ticking()
        (keys if kind == "period_s" else vars(env))[kind] = number(tick_s)
    env.end = int(one_of(10**9, generator.integers(1, 120)))
    limits = [int(generator.integers(1, 9)) for _ in range(one_of(0, 1, 2))]
    for limit in limits:
        env = TimeLimit(env, limit)
    if one_of(*[False] * 15, True):
        env, refused = RealTime(env, 0.05, period_s=tick_s), "is in real time already"
    elif one_of(*[False] * 15, True) and kind != "period_s":
        env, refused = MaxAndSkipObservation(env, 2), "has made"
    elif kind == "fixed":
        refused = "has made"
    listed = latencies[:1] if np.ndim(keys["latency_s"]) == 0 else latencies
    if one_of(False, False, True):
        steps = [int(each) for each in generator.integers(0, 7, 3)]
        keys |= {"latency_s": None, "delay_steps": one_of(np.int64(steps[0]), steps, tuple(steps))}
        listed = [each * period * tick_s / float(str(keys["clock_speed"])) for each in steps]
    return Drawn(env, keys, tick_s, period, min([10**9, *limits]), listed, refused)


class Reference:
    """The documented semantics, a tick at a time."""

    def __init__(self, given: Drawn) -> None:
        self.given, self.keys = given, given.keys
        default = given.keys["default_action"]
        self.default = 0.0 if default is None else float(default[0])
        self.ticks: list[float] = []
        self.chunks: list[tuple[int, list[float]]] = []  # the tick at which each begins, and its actions
        self.latest = [0.0] * int(given.keys["observe_actions"] * given.keys["chunk"])
        self.terminated = self.truncated = self.has_acted = False
        self.paused_s = 0.0

    def at(self, tick: int) -> tuple[float, int]:
        """Return the action of a tick as planned now, and the ticks for which it stays, at most a period."""
        period, holds = self.given.period, self.keys["meanwhile"] == "hold"
        there = [(tick - begin, chunk) for begin, chunk in self.chunks if tick - begin < len(chunk) * period]
        if there:
            actions = [chunk[since // period] for since, chunk in there]
            weights = [math.exp(-(self.keys["ensemble"] or 0.0) * place) for place in range(len(actions))]
            mean = sum(weight * action for weight, action in zip(weights, actions, strict=True)) / sum(weights)
            return mean, min(period - since % period for since, _ in there)
        last = self.ticks[-1] if self.ticks else self.default
        if self.chunks and len(self.ticks) - self.chunks[-1][0] < len(self.chunks[-1][1]) * period:
            last = self.chunks[-1][1][-1]
        return (last if holds else self.default), period

    def pass_on(self, ticks: int) -> int:
        """Let ticks pass until the episode ends, in calls of the environment; return how many have."""
        before = len(self.ticks)
        while ticks > 0 and not (self.terminated or self.truncated):
            action, stays = self.at(len(self.ticks))
            piece = min(stays, ticks)
            self.ticks += [action] * piece
            ticks -= piece
            self.terminated = len(self.ticks) >= self.given.env.unwrapped.end  # type: ignore[attr-defined]
            self.truncated = len(self.ticks) // self.given.period >= self.given.limit
        return len(self.ticks) - before

    def planned(self, periods: int) -> list[float]:
        return [self.at(len(self.ticks) + place * self.given.period)[0] for place in range(periods)]

    def step(self, chunk: list[float], latency_s: float) -> Result:
        """Return the observation, the two ends, and reward, thinking, meanwhile, simulated and wall seconds."""
        given, keys, start = self.given, self.keys, len(self.ticks)
        speed, early = float(str(keys["clock_speed"])), keys.get("early", 0)
        paused = keys["command"] == "tcsc" or (keys["head_start"] and not self.has_acted)
        due = 0 if paused else math.ceil(round(latency_s * speed / given.tick_s, 9))
        waited = self.pass_on(due)
        waited += self.pass_on((early * given.period if self.has_acted else 0) - waited)
        if not (self.terminated or self.truncated):
            begin = len(self.ticks) - (waited if keys["frozen_prefix"] else 0)
            self.chunks = [*(self.chunks if keys["ensemble"] is not None else []), (begin, chunk)]
            acts = ((keys["execute"] or len(chunk)) - early) * given.period
            self.pass_on(max(acts - waited, 0) if keys.get("overlap") else acts)
            self.has_acted = True
        observation = [float(len(self.ticks))]
        if keys["observe_age"]:
            observation.append(waited * given.tick_s)
        self.latest = [*self.latest, *chunk][len(chunk) :] if self.latest else []
        reward = sum(self.ticks[start:]) / given.period
        simulated_s = len(self.ticks) * given.tick_s
        self.paused_s += latency_s * paused
        told = [reward, latency_s, waited * given.tick_s, simulated_s, simulated_s / speed + self.paused_s]
        seen = [*observation, *self.latest, *self.planned(int(keys["observe_planned"]))]
        return seen, self.terminated, self.truncated, told


def differences(seed: int) -> str:
    """Fly a drawn set of options beside the reference, from one buffer of actions; return what differs."""
    generator = np.random.default_rng(seed)
    given = drawn(generator)
    try:
        env = RealTime(given.env, **given.keys)
        for _ in range(EPISODES):
            if what := episode_differs(env, given, generator):
                return what
    except UserError as error:
        return "" if given.refused and given.refused in str(error) and "\n" not in str(error) else str(error)
    return ""


def episode_differs(env: Any, given: Drawn, generator: np.random.Generator) -> str:
    """Fly an episode, which knows nothing of the one before; return the first difference."""
    observation, _ = env.reset(seed=1)
    reference, inside = Reference(given), env.unwrapped
    buffer = np.zeros(env.action_space.shape, np.float32)
    for _ in range(DECISIONS):
        values = (generator.integers(-8, 9, int(given.keys["chunk"])) / 8).tolist()
        buffer[:] = np.reshape(values, buffer.shape)
        assert env.action_space.contains(buffer)
        assert env.observation_space.contains(observation)
        observation, reward, terminated, truncated, info = env.step(buffer)
        buffer[:] = 0.875
        if not np.isclose(given.latencies_s, info["thinking_s"], rtol=0, atol=2e-9).any():
            return f"{info['thinking_s']} is not in {given.latencies_s}"
        expected = reference.step(values, info["thinking_s"])
        told = [*observation.ravel().tolist(), reward, *(info[key] for key in TOLD)]
        same = np.allclose(told, [*expected[0], *expected[3]], rtol=1e-6, atol=1e-8)
        same = same and len(inside.ticks) == len(reference.ticks) and np.allclose(inside.ticks, reference.ticks)
        if given.keys["frozen_prefix"]:
            same = same and np.allclose(info["planned"].ravel(), reference.planned(int(given.keys["chunk"])))
        if not same or (terminated, truncated) != expected[1:3]:
            return f"{told} {terminated} {truncated} {inside.ticks}, expected {expected} {reference.ticks}"
        if terminated or truncated:
            break
    return ""


def test_hundreds_of_sets_of_options_fly_what_a_second_simulation_does_or_are_refused() -> None:
    found = {seed: what for seed in range(SETS) if (what := differences(seed))}
    assert not found, f"{len(found)} differ, the first {next(iter(found.items()))}"


@pytest.mark.parametrize(
    ("env", "said"),
    [
        (RealTime(Ticking(), 0.0, period_s=0.02), "RealTime is in real time already"),
        (Physical(0, 0.01), "Physical.frame_skip: must be 1 to 1,000,000,000 physics steps, not 0"),
        (Physical(5, float("nan")), r"Physical.model.opt.timestep: must be a number of seconds, .* not nan"),
        *(  # with a part of what MuJoCo's have
            (type("Partly", (Ticking,), dict.fromkeys(pair))(), "period_s: Partly does not say how long a step is")
            for pair in combinations(["frame_skip", "model", "do_simulation"], 2)
        ),
    ],
)
def test_an_environment_without_a_time_of_its_own_is_refused(env: Any, said: str) -> None:
    with pytest.raises(UserError, match=f"^{said}"):
        RealTime(env, 0.05)


def test_steps_of_another_length_than_was_asked_for_are_refused_where_they_happen() -> None:
    env = RealTime(Physical(5, 0.01, substeps=5), 0.05)
    env.reset(seed=0)
    assert env.step(np.zeros(1, np.float32))[-1]["simulated_s"] == pytest.approx(0.1)  # a whole period, twice
    env = RealTime(Physical(5, 0.01, substeps=5), 0.02)
    env.reset(seed=0)
    with pytest.raises(UserError, match="has made 5 physics steps where 2 had been asked for; give the simulated"):
        env.step(np.zeros(1, np.float32))
