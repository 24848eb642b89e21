"""Batches in real time: environment i is to the byte the single one with seed + i, in whatever autoreset mode."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import partial
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

import uavaccel
from tests.host_kernels import a_gpu, host_kernels  # noqa: F401 - fixtures
from uavaccel.envs.hover import Hover
from uavaccel.errors import UserError
from uavaccel.realtime import RealTime, RealTimeVector, ThinkingTime, lognormal, samples
from uavaccel.realtime.thinking import thinking_generator

COUNT, STEPS, SEED = 3, 25, 40
LATENCIES = [0.0, 0.01, 0.03, 0.12]
Env = gymnasium.Env[Any, Any]


class Ending(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A sum of actions with noise of its own, whose episodes end soon."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    dt = 0.02

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.state, self.left = np.zeros(2, np.float32), int(self.np_random.integers(5, 30))
        return self.state.copy(), {}

    def step(self, action: NDArray[np.float32]) -> Any:
        self.state += np.array([action[0], self.np_random.normal()], np.float32)
        self.left -= 1
        return self.state.copy(), float(action[0]), self.left == 0, False, {}


class Alternating(ThinkingTime):
    """A source with a state, which no other environment may move."""

    def __init__(self) -> None:
        self.drawn = 0

    def sample_ns(self, generator: np.random.Generator) -> int:
        self.drawn += 1
        return self.drawn % 3 * 10_000_000


def actions_of(space: Any) -> list[Any]:
    generator = np.random.default_rng(7)
    if isinstance(space, spaces.MultiDiscrete):
        return list(generator.integers(space.nvec, size=(STEPS, *space.shape)))
    return list(generator.uniform(-1, 1, (STEPS, *space.shape)).astype(space.dtype))


def singly(make: Callable[[], Env], keys: dict[str, Any], mode: AutoresetMode, actions: list[Any]) -> list[list[Any]]:
    """What single environments do, and begin anew as the mode says: observation, reward, ends and thinking time."""
    found = []
    for place in range(COUNT):
        env, over, told = RealTime(make(), **deepcopy(keys)), False, []
        observation, _ = env.reset(seed=SEED + place)
        for action in actions:
            if over and mode != AutoresetMode.SAME_STEP:
                observation, _ = env.reset()
                over = False
                if mode == AutoresetMode.NEXT_STEP:
                    told.append((observation.tobytes(), 0.0, False, False, None))
                    continue
            observation, reward, terminated, truncated, info = env.step(action[place])
            over = terminated or truncated
            if over and mode == AutoresetMode.SAME_STEP:
                observation, _ = env.reset()
            thought = None if over and mode == AutoresetMode.SAME_STEP else info["thinking_s"]
            told.append((observation.tobytes(), reward, terminated, truncated, thought))
        env.close()
        found.append(told)
    return found


def together(vector: RealTimeVector, actions: list[Any]) -> list[list[Any]]:
    """The same of the environments of a vector."""
    mode, over = vector.metadata["autoreset_mode"], np.zeros(COUNT, bool)
    vector.reset(seed=SEED)
    found: list[list[Any]] = [[] for _ in range(COUNT)]
    for action in actions:
        if mode == AutoresetMode.DISABLED and over.any():
            vector.reset(options={"reset_mask": over})
        observations, rewards, terminated, truncated, infos = vector.step(action)
        over = terminated | truncated
        for place, told in enumerate(found):
            known = infos.get("_thinking_s", np.zeros(COUNT, bool))[place]
            thought = float(infos["thinking_s"][place]) if known else None
            ends = bool(terminated[place]), bool(truncated[place])
            told.append((observations[place].tobytes(), float(rewards[place]), *ends, thought))
    vector.close()
    return found


MODES = list(AutoresetMode)
KEYS: list[dict[str, Any]] = [
    {"latency_s": LATENCIES, "observe_age": True},
    {"latency_s": lognormal(0.02, 0.1), "overlap": True, "clock_speed": 2.5},
    {"delay_steps": [0, 1, 4], "chunk": 3, "execute": 2, "frozen_prefix": True, "observe_planned": 2},
    {"latency_s": Alternating()},
]


@pytest.mark.parametrize("mode", MODES, ids=str)
@pytest.mark.parametrize("keys", KEYS, ids=lambda keys: next(iter(keys)))
def test_an_environment_of_a_vector_is_a_single_one(keys: dict[str, Any], mode: AutoresetMode) -> None:
    vector = RealTimeVector(SyncVectorEnv([Ending] * COUNT, autoreset_mode=mode), **keys)
    actions = actions_of(vector.action_space)
    assert together(vector, actions) == singly(Ending, keys, mode, actions)


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES, ids=str)
def test_so_is_one_in_a_process_of_its_own(mode: AutoresetMode) -> None:
    given = AsyncVectorEnv([Ending] * COUNT, autoreset_mode=mode)
    vector = RealTimeVector(given, **KEYS[0])
    assert given.closed  # or twice as many processes would run
    actions = actions_of(vector.action_space)
    assert together(vector, actions) == singly(Ending, KEYS[0], mode, actions)


def test_a_physics_step_is_a_tick_there_too_and_gymnasium_makes_the_same() -> None:
    cheetah = partial(gymnasium.make, "HalfCheetah-v5")
    vector = RealTimeVector(SyncVectorEnv([cheetah] * COUNT), latency_s=LATENCIES)
    actions = actions_of(vector.action_space)
    expected = singly(cheetah, {"latency_s": LATENCIES}, AutoresetMode.NEXT_STEP, actions)
    assert together(vector, actions) == expected
    wrapped = gymnasium.make_vec("HalfCheetah-v5", COUNT, wrappers=[partial(RealTime, latency_s=LATENCIES)])
    assert together(wrapped, actions) == expected  # type: ignore[arg-type]


# Messages take no time, as each simulator draws the time of its own ones.
OWN: dict[str, Any] = {"timing": "virtual", "command": "adsc", "clock_speed": 3.0, "max_commands": 3}
OWN |= {"latency": {"scale": 0.0}}


def test_episodes_of_an_own_batch_begin_anew_by_a_mask() -> None:
    keys: dict[str, Any] = {"latency_s": LATENCIES, "clock_speed": 3.0}
    mode = AutoresetMode.DISABLED
    batch = uavaccel.make_vec("hover", COUNT, simulator="kernels", autoreset_mode=mode, **OWN)
    vector = RealTimeVector(batch, **keys)
    actions = actions_of(vector.action_space)
    assert together(vector, actions) == singly(partial(uavaccel.make, "hover", **OWN), keys, mode, actions)


def batch_of(simulator: str) -> Any:
    if simulator == "device":
        return import_module("uavaccel.envs.cuda_batch").CudaBatch(Hover, 2, **OWN)  # which the fixture has exchanged
    return uavaccel.make_vec("hover", 2, simulator=simulator, **OWN)


@pytest.mark.slow
@pytest.mark.usefixtures("a_gpu")
@pytest.mark.parametrize("simulator", ["mujoco", "kernels", "device"])
def test_a_batch_with_clocks_of_its_own_is_charged_as_one_is(simulator: str) -> None:
    """Each environment's thinking times on its own clock, from a source or a list; a device's tensors stay there."""
    for source in (Alternating(),) if simulator == "mujoco" else (LATENCIES, Alternating()):
        keys: dict[str, Any] = {"latency_s": source, "clock_speed": 3.0}
        vector = RealTimeVector(batch_of(simulator), **keys)
        singles = [RealTime(uavaccel.make("hover", **OWN), **deepcopy(keys)) for _ in range(2)]
        vector.reset(seed=SEED)
        for place, single in enumerate(singles):
            single.reset(seed=SEED + place)
        generator, over = np.random.default_rng(0), np.zeros(2, bool)
        same_step = vector.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        for _ in range(7):
            action = generator.uniform(-1, 1, vector.action_space.shape or ()).astype(np.float32)
            observations, _, terminated, truncated, infos = vector.step(action)
            assert isinstance(observations, th.Tensor) == (simulator == "device")
            for place, single in enumerate(singles):
                waits, over[place] = over[place], False  # for the next episode, which begins in this step
                assert infos["_thinking_s"][place] == (not waits)
                if not waits:
                    observation, _, *ends, info = single.step(action[place])
                    assert [bool(terminated[place]), bool(truncated[place])] == ends
                    for key in ("thinking_s", "meanwhile_s"):
                        assert float(infos[key][place]) == pytest.approx(info[key], abs=1e-12)
                    over[place] = any(ends) and not same_step
                if waits or (any(ends) and same_step):
                    observation, _ = single.reset()
                seen = th.as_tensor(observations[place]).cpu().numpy()
                np.testing.assert_allclose(seen, observation, rtol=0, atol=1e-6)
        vector.close()


class Clocks(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """A batch with clocks of its own, of which the first environment ends in every second step."""

    num_envs = 2
    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012
    task = SimpleNamespace(timing="virtual", command="adsc", clock_speed=1.0)

    def __init__(self) -> None:
        self.charged_ns: list[list[int]] = []

    def charge_each(self, durations_ns: NDArray[np.int64]) -> None:
        self.charged_ns.append(durations_ns.tolist())

    def reset(self, **_: Any) -> Any:
        return np.zeros((2, 1)), {}

    def step(self, actions: Any) -> Any:
        ends = np.array([len(self.charged_ns) % 2 == 0, False])
        return np.zeros((2, 1)), np.zeros(2), ends, np.zeros(2, bool), {}


class Chance(ThinkingTime):
    def sample_ns(self, generator: np.random.Generator) -> int:
        return int(generator.integers(1, 10**9))


@pytest.mark.parametrize("source", [Chance(), samples(LATENCIES)])
def test_every_reset_begins_with_thoughts_drawn_by_the_seeds_of_each(source: ThinkingTime) -> None:
    """Also where an episode has ended in the step before, and would have begun in the next."""
    batch = Clocks()
    vector = RealTimeVector(batch, source)
    for _ in range(2):
        vector.reset(seed=SEED)
        for _ in range(2):
            vector.step(None)
    generators = [thinking_generator(SEED + place) for place in range(2)]
    thoughts_ns = [[source.sample_ns(generator) for generator in generators] for _ in range(2)]
    assert batch.charged_ns == 2 * thoughts_ns
    vector.reset(seed=SEED, options={"reset_mask": np.array([False, True])})  # of the one that has not ended
    for _ in range(2):
        vector.step(None)
    (_, first_ns), (_, second_ns) = thoughts_ns
    assert batch.charged_ns[4:] == [[0, first_ns], [source.sample_ns(generators[0]), second_ns]]


@pytest.mark.parametrize(
    ("make", "keys", "said"),
    [
        (lambda: SyncVectorEnv([Ending]), {"latency_s": "measured"}, "latency_s: a batch's agent thinks about all env"),
        (lambda: SyncVectorEnv([Ending]), {"latency_s": -1}, "latency_s: must be 0 to 3600 seconds, not -1"),
        (lambda: SyncVectorEnv([partial(RealTime, Ending())]), {}, "RealTime is in real time already"),
        (lambda: gymnasium.wrappers.vector.RecordEpisodeStatistics(RealTimeVector(SyncVectorEnv([Ending]))), {},
         "RealTimeVector is in real time already"),
        (lambda: gymnasium.make_vec("CartPole-v1", 2, vectorization_mode="vector_entry_point"), {},
         "RealTimeVector: needs a SyncVectorEnv, an AsyncVectorEnv or a batch of uavaccel's; other .* not CartPoleV"),
        (lambda: gymnasium.wrappers.vector.RecordEpisodeStatistics(SyncVectorEnv([Ending])), {},
         "RealTimeVector: needs .* other wrappers go outside, not RecordEpisodeStatistics"),
        (lambda: uavaccel.make_vec("hover", 2, simulator="kernels"), {}, "KernelBatch: timing = lockstep: make"),
        (lambda: uavaccel.make_vec("hover", 2, simulator="kernels", **OWN), {"clock_speed": 3.0, "observe_age": True},
         "observe_age: leave it out: observations of KernelBatch stay as they are"),
        (lambda: uavaccel.make_vec("hover", 2, simulator="kernels", **OWN), {"clock_speed": 3.0, "observe_actions": 2},
         "observe_actions: leave it out: observations of KernelBatch stay as they are"),
        (lambda: uavaccel.make_vec("hover", 2, simulator="kernels", **OWN), {"clock_speed": 3.0, "delay_steps": 1},
         "delay_steps: KernelBatch's own task says how long a step is; give latency_s"),
    ],
)  # fmt: skip
def test_a_vector_that_does_not_fit_is_one_line(make: Callable[[], Any], keys: dict[str, Any], said: str) -> None:
    vector = make()
    with pytest.raises(UserError, match=f"^{said}") as caught:
        RealTimeVector(vector, **keys)
    assert "\n" not in str(caught.value)
    vector.close()
