"""Real time for any environment: what it flies while its agent thinks, tick by tick, and the same every time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

import uavaccel.envs  # noqa: F401  registers the drones
from tests.counting import Closing, Counting, Failing, OwnError
from tests.processes import left_after, state_of
from uavaccel.clock import VirtualClock
from uavaccel.errors import UserError
from uavaccel.processes import lifetime
from uavaccel.realtime import Measured, RealTime, RealTimeProcess, ThinkingTime, lognormal, samples
from uavaccel.realtime.control_loop import ControlLoop, LoopOptions
from uavaccel.realtime.plant import plant_of
from uavaccel.realtime.process import EnvironmentServer, portable
from uavaccel.realtime.thinking import thinking_time
from uavaccel.wire.latency import read_latency

pytestmark = pytest.mark.usefixtures("whole_messages")

Env = gymnasium.Env[Any, Any]


class Drawing(ThinkingTime):
    """A thinking time of anybody's."""

    def __init__(self, drawn: Any) -> None:
        self._drawn = drawn

    def sample_ns(self, generator: np.random.Generator) -> Any:
        return self._drawn


def one(value: float) -> NDArray[np.float32]:
    return np.full(1, value, np.float32)


def applied(env: RealTime, actions: list[Any]) -> list[float]:
    """What the environment inside was given, period by period."""
    env.reset(seed=0)
    for action in actions:
        env.step(np.asarray(action, np.float32))
    return [round(each, 3) for each in env.unwrapped.applied]  # type: ignore[attr-defined]


def cheetah() -> Env:
    return gymnasium.make("HalfCheetah-v5")


def flight(env: Env, steps: int = 60) -> tuple[NDArray[np.float64], list[float], list[float]]:
    """Observations, rewards and simulated times of drawn actions."""
    generator, observation = np.random.default_rng(1), env.reset(seed=3)[0]
    observations, rewards, times = [observation], [], []
    for _ in range(steps):
        action = generator.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        rewards.append(float(reward))
        times.append(info.get("simulated_s", 0.0))
        if terminated or truncated:
            break
    return np.array(observations), rewards, times


@pytest.mark.parametrize("keys", [{"latency_s": 0.0}, {"command": "tcsc"}, {"command": "tcsc", "clock_speed": 100}])
def test_without_delay_the_flight_is_the_environments_own_to_the_bit(keys: dict[str, Any]) -> None:
    own, timed = flight(cheetah()), flight(RealTime(cheetah(), **keys))
    assert (timed[0].tobytes(), timed[1]) == (own[0].tobytes(), own[1])


def test_delays_are_exact_to_the_physics_step() -> None:
    """Thirteen milliseconds of half cheetah's 10 ms steps are two of its five: the same as by MuJoCo alone."""
    env = RealTime(cheetah(), 0.013)
    inside: Any = env.unwrapped
    env.reset(seed=5)
    start, actions = (inside.data.qpos.copy(), inside.data.qvel.copy()), [np.full(6, 0.3), np.full(6, -0.5)]
    rewards = [env.step(action.astype(np.float32))[1] for action in actions]
    timed = inside.data.qpos.copy()
    twin: Any = cheetah().unwrapped
    twin.reset(seed=5)
    np.testing.assert_array_equal(twin.data.qpos, start[0])
    expected, held = [], np.zeros(6)
    for action in actions:
        total = 0.0
        for control, ticks in ((held, 2), (action, 5)):
            before = twin.data.qpos[0]
            twin.do_simulation(control.astype(np.float32), ticks)
            velocity = (twin.data.qpos[0] - before) / (ticks * 0.01)
            total += ticks / 5 * (velocity - 0.1 * float(np.sum(np.square(control))))
        expected.append(total)
        held = action
    np.testing.assert_array_equal(timed, twin.data.qpos)
    np.testing.assert_allclose(rewards, expected, rtol=1e-6)


def test_the_same_seed_draws_the_same_delays_and_flies_to_the_same_bytes() -> None:
    make = partial(RealTime, latency_s=[0.01, 0.05, 0.2], observe_age=True, observe_actions=2)
    first, second = flight(make(cheetah())), flight(make(cheetah()))
    assert (first[0].tobytes(), first[1:]) == (second[0].tobytes(), second[1:])
    ages = first[0][1:, 17]
    assert set(ages) == {0.01, 0.05, 0.2}
    np.testing.assert_array_equal(first[0][2:, 18:24], first[0][1:-1, 24:])  # the action before the last one
    assert flight(RealTime(cheetah(), 0.05))[2] != flight(RealTime(cheetah(), [0.05, 0.3]))[2]


@pytest.mark.filterwarnings("default::UserWarning")
def test_gymnasiums_checker_and_vectors_take_it() -> None:
    with pytest.warns(UserWarning, match="different from the unwrapped version|infinity"):
        check_env(RealTime(Counting(), 0.05, observe_age=True, observe_actions=1), skip_render_check=True)
    wrapper = partial(RealTime, latency_s=[0.0, 0.1])
    vector = gymnasium.make_vec("HalfCheetah-v5", 3, vectorization_mode="sync", wrappers=[wrapper])
    observations, _ = vector.reset(seed=4)
    vector.step(vector.action_space.sample())
    single = RealTime(cheetah(), [0.0, 0.1])
    np.testing.assert_array_equal(observations[1], single.reset(seed=5)[0])
    spec = RealTime(cheetah(), 0.05, "tcsc").spec
    assert spec is not None
    kwargs = spec.additional_wrappers[-1].kwargs
    assert kwargs is not None
    assert kwargs["command"] == "tcsc"


def test_the_users_own_default_action_stays_as_it_is() -> None:
    default = np.full(1, -0.5, np.float32)
    env = RealTime(Counting(), 0.05, meanwhile="default", default_action=default)
    default[:] = 1.0
    assert applied(env, [[0.25]]) == [-0.5, -0.5, -0.5, 0.25]


@pytest.mark.parametrize("space", [spaces.MultiBinary(2), spaces.MultiDiscrete([2, 3])])
def test_a_default_action_of_several_parts_is_an_array(space: spaces.MultiBinary | spaces.MultiDiscrete) -> None:
    given = LoopOptions(default_action=[1, 0]).idle_action(space)
    assert isinstance(given, np.ndarray)
    assert (given.dtype, given.tolist()) == (space.dtype, [1, 0])


def test_a_step_that_somebody_has_put_in_stays_there() -> None:
    """As profilers and recorders do, below a wrapper whose steps are counted."""
    env, seen = Counting(), list[Any]()
    own = env.step

    def step(action: Any) -> Any:
        seen.append(action)
        return own(action)

    env.step = step  # type: ignore[method-assign]
    assert applied(RealTime(gymnasium.Wrapper(env), 0.0), [[0.25], [0.5], [0.75]]) == [0.25, 0.5, 0.75]
    assert len(seen) == 3


@pytest.mark.parametrize(
    ("low", "high", "bounds"), [(1.0, 2.0, (0.0, 2.0)), (-3.0, -2.0, (-3.0, 0.0)), (-1.0, 1.0, (-1.0, 1.0))]
)
def test_an_observation_fits_before_any_action_too(low: float, high: float, bounds: tuple[float, float]) -> None:
    """Of the latest actions there are none at first: zeros, which need not be actions."""

    class Biased(Counting):
        action_space = spaces.Box(low, high, (1,), np.float32)

    env = RealTime(Biased(), 0.05, observe_age=True, observe_actions=2)
    space: Any = env.observation_space
    assert space.low.tolist() == [-np.inf, 0.0, bounds[0], bounds[0]]
    assert space.high.tolist() == [np.inf, np.inf, bounds[1], bounds[1]]
    assert space.contains(env.reset(seed=0)[0])
    assert space.contains(env.step(one(high))[0])


@pytest.mark.parametrize(
    ("reward", "said"),
    [(np.array([1.5]), ""), (None, "not None"), (np.ones(2), r"not array\(\[1., 1.\]\)"), ({}, "not {}")],
)
def test_rewards_are_numbers_alone_or_in_an_array(reward: Any, said: str) -> None:
    env = RealTime(Counting(), 0.0)
    env.reset(seed=0)
    env.unwrapped.step = lambda action: (np.ones(1, np.float32), reward, False, False, {})  # type: ignore[method-assign]
    if not said:
        assert env.step(one(0.5))[1] == 1.5
        return
    with pytest.raises(UserError, match=f"^Counting: its reward must be a number, {said}$"):
        env.step(one(0.5))


# --- thinking times -------------------------------------------------------------------------------


def drawn_s(source: ThinkingTime, count: int = 4000) -> NDArray[np.float64]:
    generator = np.random.default_rng(0)
    return np.array([source.sample_ns(generator) for _ in range(count)]) / 1e9


class Half:
    """No source: nobody can tell it of an observation."""

    sample_ns = Drawing.sample_ns


def test_distributions_are_those_that_were_named(tmp_path: Path) -> None:
    log = drawn_s(lognormal(0.05, 0.2))
    assert np.median(log) == pytest.approx(0.05, rel=0.05)
    assert np.quantile(log, 0.99) == pytest.approx(0.2, rel=0.15)
    for listed in ([0.1, 0.3, 0.2], (0, 0, 0, 1), np.array([0.1, 0.2], np.float32)):
        few = drawn_s(samples(listed))
        assert set(few) == set(np.round(np.asarray(listed, float), 6)), "of the list, and nothing between"
        assert np.mean(few) == pytest.approx(np.mean(listed), rel=0.1)
    uniform = {"quantiles": [0, 1], "scale": 2, "request_us": {"call": [0, 9e4], "move": [0, 1e4]}}
    (tmp_path / "both.json").write_text(
        json.dumps({"latency": {**uniform, "reply_us": {"call": [0, 9e4], "image": [0, 3e4]}}})
    )
    both = drawn_s(thinking_time(tmp_path / "both.json"))  # a sum of two, each drawn for itself
    assert (np.mean(both), np.std(both)) == pytest.approx((0.04, np.hypot(0.02, 0.06) / 12**0.5), rel=0.05)
    with pytest.raises(UserError, match=r"^latency_s: must be seconds, a list of them, .*, not <.*Half"):
        thinking_time(Half())
    shipped = read_latency(Path("experiments/latency_airsim.yaml"))
    trips = drawn_s(thinking_time("experiments/latency_airsim.yaml"))
    tables = shipped.request_us.get("move", shipped.request_us["call"]), shipped.reply_us["image"]
    middle = [dict(zip(shipped.quantiles, table, strict=True))[0.5] for table in tables]
    assert np.median(trips) == pytest.approx(sum(middle) / 1e6, rel=0.1)


def test_what_was_measured_is_replayed_as_a_distribution(tmp_path: Path) -> None:
    measured: Any = Measured()
    with pytest.raises(UserError, match="no thinking time has been measured yet"):
        measured.save(tmp_path / "thinking.yaml")
    clock = measured._clock = VirtualClock()
    env = RealTime(Counting(), measured)
    with pytest.raises(UserError, match="reset the environment before a step"):
        env.step(0)
    env.reset()
    for thought_s in (0.021, 0.019):
        clock.charge(round(1e9 * thought_s))
        assert env.step(one(0.1))[-1]["thinking_s"] == pytest.approx(thought_s)
    assert measured.taken_ns == [21_000_000, 19_000_000]
    for taken_ns in range(10_000_000, 30_000_000, 100_000):
        measured.taken_ns.append(taken_ns)
    with pytest.raises(UserError, match="No such file or directory"):
        measured.save(tmp_path / "none" / "thinking.yaml")
    kept = measured.save(tmp_path / "thinking.yaml")
    replayed = drawn_s(thinking_time(str(kept)))
    assert np.median(replayed) == pytest.approx(0.02, rel=0.05)
    assert np.quantile(replayed, 0.9) == pytest.approx(0.028, rel=0.05)
    (own := tmp_path / "own.yaml").write_text("latency: {quantiles: [0, 1], request_us: {call: [1e3, 1.0e3]}}")
    assert set(drawn_s(thinking_time(own), 3)) == {0.001}
    kept.write_text(kept.read_text().replace('"latency": {', '"latency": {"scale": 2.0,'))
    np.testing.assert_allclose(drawn_s(thinking_time(kept)), 2 * replayed, atol=2e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *((text, "neither JSON nor YAML: ") for text in ("[1", "latency: 2024-13-45", "[" * 9_999)),
        ("latency: ü", "not UTF-8 text$"),
        *((text, "latency must be a mapping; 'measured' and its save") for text in ("[1, 2]", "lag: 1")),
        ("latency: {request_us: 7}", "request_us must be a mapping"),
        ("latency: {name: none}", "latency.request_us.call: needs microseconds at the quantiles"),
        ("latency: {quantiles: [0, 1], request_us: {call: [1, 9e12]}}", "latency.request_us.call: .* up to 3600 s"),
        (
            "latency: {quantiles: [0, 1], request_us: {call: [1]}}",
            "latency.request_us.call: needs 2 values, one for each",
        ),
        (
            "latency: {quantiles: [0, 1], request_us: {call: [1, 2, 3]}}",
            "latency.request_us.call: needs 2 values, one for",
        ),
        ("latency: {quantiles: [0, 1], reply_us: {image: [2, 1]}}", "latency.reply_us.image: .* must not fall"),
        ("latency: {quantiles: [0, .5, .5, 1], request_us: {call: [1, 2, 3, 4]}}", "latency.quantiles: must rise"),
        (
            "latency: {quantiles: [0, 1], request_us: {move: [-1, 1]}}",
            "latency.request_us.move: quantiles must be 0 or",
        ),
        ("latency: {quantiles: [0, 0.5], request_us: {call: [1, 2]}}", "latency.quantiles: must begin with 0 and end"),
        ('{"latency": {"quantiles": [0, 1], "scale": NaN}}', "latency.scale must be a number of 0 or more, not nan"),
    ],
)
def test_a_calibration_file_that_does_not_fit_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(text, "latin-1")
    with pytest.raises(UserError, match=f"own.yaml: {said}") as caught:
        thinking_time(tmp_path / "own.yaml")
    assert "\n" not in str(caught.value)


HOVER: dict[str, Any] = {"timing": "virtual"}


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"latency_s": -1.0}, "latency_s: must be 0 to 3600 seconds, not -1"),
        ({"latency_s": np.array([0.1, np.nan])}, "latency_s: must be 0 to 3600 seconds, not nan"),
        ({"latency_s": 3601}, "latency_s: must be 0 to 3600 seconds, not 3601"),
        ({"latency_s": "nowhere.yaml"}, "nowhere.yaml: No such file or directory"),
        ({"latency_s": []}, r"latency_s: a sample is a list of seconds, not \[\]"),
        ({"latency_s": ["0.1"]}, r"latency_s: a sample is a list of seconds, not \['0.1'\]"),
        ({"latency_s": b"x"}, "latency_s: must be seconds, .*, not b"),
        ({"latency_s": {}}, "latency_s: must be seconds, a list of them, a calibration file"),
        ({"delay_steps": 1}, "latency_s, delay_steps: each says how long the agent thinks; give one of them"),
        ({"latency_s": None, "delay_steps": 0.5}, "delay_steps: must be a count of control periods, or a list .* 0.5"),
        ({"latency_s": None, "delay_steps": [1, -1]}, r"delay_steps: must be a count .* not \[1, -1\]"),
        ({"latency_s": None, "delay_steps": []}, r"delay_steps: must be a count .* not \[\]"),
        (
            {"latency_s": None, "delay_steps": 1, "period_s": 1e-9, "clock_speed": 3},
            "delay_steps: ticks of 1 ns are shorter than 1 ns at clock_speed 3",
        ),
        ({"latency_s": None, "delay_steps": 10**6}, "delay_steps: 1000000 are 20000 seconds; at most 3600 may pass"),
        ({"chunk": 4, "execute": 2, "early": 2}, "early: must be less than execute = 2, not 2"),
        ({"chunk": 4, "early": 1, "overlap": True}, "early, overlap: each says when the agent observes again"),
        ({"chunk": 4, "ensemble": -1}, "ensemble: must be a number of 0 or more, such as 0.01, not -1"),
        ({"ensemble": 0.01}, "ensemble: needs a chunk of 2 or more actions"),
        ({"frozen_prefix": True}, "frozen_prefix: needs a chunk of 2 or more actions"),
        ({"latency_s": Drawing(-1)}, "Drawing.sample_ns: must be 0 to 3.6e.12 nanosec"),
        ({"latency_s": Drawing(float("nan"))}, "Drawing.sample_ns: .* not nan"),
        ({"command": "stop"}, "command: must be 'adsc' or 'tcsc', not 'stop'"),
        ({"clock_speed": 0}, "clock_speed must be a finite number above 0"),
        ({"clock_speed": "2"}, "clock_speed must be a finite number"),
        ({"clock_speed": 1e300}, "clock_speed must be 0.001 to 100000, not 1e"),
        ({"chunk": 2, "execute": 3}, "execute: must be at most chunk = 2, not 3"),
        ({"chunk": 0}, "chunk: must be 1 to 4,096 actions, not 0"),
        ({"chunk": 10**9}, "chunk: must be 1 to 4,096 actions, not 1"),
        ({"chunk": 3}, r"action: must be a chunk of 3, not of shape \(1,\)"),
        ({"default_action": [3.0]}, "default_action: .* is not in Box"),
        ({"default_action": "up"}, "default_action: 'up' is not in Box"),
        ({"period_s": 0}, "period_s: must be a number of seconds, 1e-9 to 1e6, not 0"),
        ({"observe_actions": 1.5}, "observe_actions: must be 0 to 4,096 actions, not 1.5$"),
    ],
)
def test_a_value_that_does_not_fit_is_one_line(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=f"^{said}") as caught:
        applied(RealTime(Counting(), **{"latency_s": 0.1, **keys}), [[0.1]])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "own", "keys", "said"),
    [
        ("CartPole-v1", {}, {}, "default_action: a Discrete has no neutral action"),
        ("FrozenLake-v1", {}, {}, "period_s: FrozenLakeEnv does not say how long"),
        ("FrozenLake-v1", {}, {"command": "tcsc", "period_s": 1, "observe_age": True},
         r"observe_age, observe_actions, observe_planned: need a Box of observations, not Discrete\(16\)"),
        ("uavaccel/Hover-v0", {}, {}, "Hover: timing = lockstep: make it with timing='virtual' for real time"),
        ("uavaccel/Hover-v0", HOVER, {}, "command: 'adsc' here, but 'tcsc' in Hover; give both the same"),
        ("uavaccel/Hover-v0", HOVER, {"command": "tcsc", "clock_speed": 2.0},
         "clock_speed: 2.0 here, but 1.0 in Hover; give both the same"),
        ("CartPole-v1", {}, {"default_action": 0, "chunk": 2, "ensemble": 0.0}, "ensemble: actions of a Discrete have"),
        *(
            ("uavaccel/Hover-v0", HOVER, {"command": "tcsc", **keys}, f"{next(iter(keys))}: leave it out: Hover's own")
            for keys in (
                {"period_s": 5}, {"meanwhile": "default"}, {"default_action": np.zeros(3)}, {"chunk": 2},
                {"head_start": True}, {"overlap": True}, {"observe_planned": 1},
            )
        ),
    ],
)  # fmt: skip
def test_an_environment_that_does_not_fit_is_one_line(
    name: str, own: dict[str, Any], keys: dict[str, Any], said: str
) -> None:
    with pytest.raises(UserError, match=f"^{said}") as caught:
        RealTime(gymnasium.make(name, **own), 0.1, **keys)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("asked", [{"observe_actions": 1}, {"observe_planned": 1}])
def test_actions_of_any_length_are_not_observed(asked: dict[str, Any]) -> None:
    inside: Any = Counting()
    inside.action_space = spaces.Sequence(spaces.Discrete(2))
    said = "observe_actions, observe_planned: actions of a Sequence have no fixed length"
    with pytest.raises(UserError, match=f"^{said}"):
        RealTime(inside, 0.1, default_action=(), **asked)


def test_a_step_lasts_what_the_environment_says_dt_before_tau() -> None:
    inside: Any = Counting()
    inside.tau = 0.5
    for seconds in (0.02, 0.5):
        env = RealTime(inside, 0.0)
        env.reset()
        assert env.step(one(0.1))[-1]["simulated_s"] == seconds
        inside.dt = None


def test_real_time_in_real_time_and_thinking_times_that_fall_are_refused() -> None:
    own = gymnasium.make("uavaccel/Hover-v0", **HOVER)
    with pytest.raises(UserError, match=r"^RealTime is in real time already"):
        RealTime(RealTime(own, 0.1, "tcsc"), 0.1, "tcsc")
    with pytest.raises(UserError, match=r"^Hover keeps its own wall clock: use it as it is"):
        plant_of(own, 0.1)
    with pytest.raises(UserError, match=r"^lognormal: needs 0 < median_s <= p99_s"):
        lognormal(0.2, 0.1)


@pytest.mark.parametrize("space", [spaces.Discrete(2, start=1), spaces.MultiBinary(2)])
def test_actions_that_do_not_stack_are_named(space: spaces.Space[Any]) -> None:
    inside: Any = Counting()
    inside.action_space = space
    said = f"^chunk: actions of a {type(space).__name__} do not stack; use chunk=1$"
    with pytest.raises(UserError, match=said):
        RealTime(inside, 0.1, default_action=space.sample(), chunk=2)


# --- the drone, and the machine's own clock -------------------------------------------------------


@pytest.mark.parametrize("command", ["adsc", "tcsc"])
def test_the_lane_through_the_wrapper_is_the_lane_under_that_command(command: str) -> None:
    keys: dict[str, Any] = {"timing": "virtual", "command": command, "clock_speed": 5.0, "observation": "state"}
    own, inside = (gymnasium.make("uavaccel/ObstacleLane-v0", **keys) for _ in range(2))
    wrapped = RealTime(inside, 0.2, command, 5.0, observe_age=True, observe_actions=1)  # type: ignore[arg-type]
    age_s = 1.0 if command == "adsc" else 0.0  # of 0.2 s of wall time, at five times real time or at none
    first, _ = own.reset(seed=1)
    np.testing.assert_array_equal([*first.ravel(), *[0] * 6], wrapped.reset(seed=1)[0])
    for action in (2, 1, 3, 2):
        own.unwrapped.charge(0.2)  # type: ignore[attr-defined]
        expected, got = own.step(action), wrapped.step(action)
        latest = np.arange(5) == action
        np.testing.assert_allclose([*expected[0].ravel(), age_s, *latest], got[0], rtol=1e-6)
        assert expected[1:4] == got[1:4]
        assert expected[4]["wall_s"] == got[4]["wall_s"]
        assert (got[4]["thinking_s"], got[4]["meanwhile_s"]) == (0.2, age_s)
    own.close()
    wrapped.close()


LANE = partial(gymnasium.make, "uavaccel/ObstacleLane-v0", timing="virtual", observation="state")


@pytest.mark.parametrize("make", [Counting, LANE])
def test_an_agent_thinks_from_each_observation_to_its_action(make: Callable[[], Env]) -> None:
    said: list[str] = []

    class Told(ThinkingTime):
        def observed(self) -> None:
            said.append("observed")

        def sample_ns(self, generator: np.random.Generator) -> int:
            said.append("acts")
            return 10_000_000

    env = RealTime(make(), Told(), "tcsc")
    env.reset(seed=1)
    for _ in range(2):
        env.step(env.action_space.sample())
    env.close()
    assert said == ["observed", "acts", "observed", "acts", "observed"]


class Messages:
    """An agent's end of a connection: each message comes at its time, in ms, on a simulated clock."""

    def __init__(self, clock: VirtualClock, *messages: tuple[float, Any]) -> None:
        self._clock, self._left = clock, list(messages)

    def poll(self, timeout_s: float) -> bool:
        until_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        here = self._left[0][0] * MS <= until_ns
        self._clock.sleep_until(round(self._left[0][0] * MS) if here else until_ns)
        return here

    def recv(self) -> Any:
        time_ms, message = self._left.pop(0)
        self._clock.sleep_until(round(time_ms * MS))
        return message


class Working(Counting):
    """Each of its steps takes the machine so many ms."""

    def __init__(self, clock: VirtualClock, works_ms: int) -> None:
        self._clock, self._works_ms = clock, works_ms

    def step(self, action: Any) -> Any:
        assert len(self.applied) < 50, "no step follows the end of an episode"
        self._clock.charge(self._works_ms * MS)
        return super().step(action)


RESET = ("reset", 0, None)
MS = 1_000_000


def chosen(values: float | list[float]) -> NDArray[np.float32]:
    """One action, or a chunk of them."""
    return np.array([[value] for value in values], np.float32) if isinstance(values, list) else one(values)


@pytest.mark.parametrize(
    ("keys", "works_ms", "messages", "applied", "answers", "until_ms"),
    [
        # 50 ms are two and a half periods, and 5 ms a part of one, to whose end an action waits
        ({}, 0, [(50, 0.1), (85, 0.2)], [0, 0, 0, 0.1, 0.1, 0.2], [(4, 50, 3, 0), (2, 5, 1, 0)], 120),
        ({"meanwhile": "default", "clock_speed": 2.0}, 0, [(50, 0.1), (65, 0.2)], [0, 0, 0, 0, 0, 0.1, 0, 0.2],
         [(6, 50, 5, 0), (2, 5, 1, 0)], 80),
        ({"command": "tcsc", "clock_speed": 4.0}, 0, [(50, 0.1), (85, 0.2)], [0.1, 0.2],
         [(1, 50, 0, 0), (1, 30, 0, 0)], 90),
        # the second of a chunk goes on while the agent thinks, but not in the next episode
        ({"chunk": 2, "execute": 1}, 0, [(20, [0.1, 0.2]), (60, [0.3, 0.4])], [0, 0.1, 0.2, 0.3],
         [(2, 20, 1, 0), (2, 20, 1, 0)], 80),
        ({"chunk": 2, "execute": 1}, 0, [(20, [0.1, 0.2]), (60, RESET), (80, [0.3, 0.4])], [0, 0.3],
         [(2, 20, 1, 0), (2, 20, 1, 0)], 100),
        ({"chunk": 3, "execute": 2, "overlap": True}, 0, [(20, [0.1, 0.2, 0.3]), (60, [0.4, 0.5, 0.6])],
         [0, 0.1, 0.2, 0.4], [(2, 20, 1, 0), (2, 20, 1, 0)], 80),
        # a frozen prefix: the chunk's action for the period in which it was thought of is dropped
        ({"chunk": 3, "execute": 2, "overlap": True, "frozen_prefix": True}, 0,
         [(20, [0.1, 0.2, 0.3]), (60, [0.4, 0.5, 0.6])], [0, 0.2, 0.3, 0.5], [(2, 20, 1, 0), (2, 20, 1, 0)], 80),
        # no time passes before the first actions; the next ones wait for those that are left, or these for them
        ({"chunk": 3, "execute": 2, "early": 1, "head_start": True}, 0, [(50, [0.1, 0.2, 0.3]), (75, [0.4, 0.5, 0.6])],
         [0.1, 0.2, 0.4], [(1, 50, 0, 0), (2, 5, 1, 0)], 110),
        ({"chunk": 3, "execute": 2, "early": 1, "head_start": True}, 0, [(50, [0.1, 0.2, 0.3]), (115, [0.4, 0.5, 0.6])],
         [0.1, 0.2, 0.3, 0.3, 0.4], [(1, 50, 0, 0), (4, 45, 3, 0)], 150),
        # steps of 30 ms are 10 ms late each; the agent thinks from when it has its observation
        ({"command": "tcsc"}, 30, [(0, 0.1), (35, 0.2)], [0.1, 0.2], [(1, 0, 0, 10), (1, 5, 0, 10)], 65),
        ({}, 30, [(0, 0.1), (30, 0.2)], [0.1, 0.2], [(1, 0, 0, 10), (1, 0, 0, 10)], 60),
        # an episode of 50 periods ends with an action, or before it comes, and it is applied no more
        ({}, 0, [(980, 0.1), (1200, RESET), (1220, 0.3)], [0, 0.3], [(50, 980, 49, 0), (2, 20, 1, 0)], 1240),
        ({}, 0, [(1100, 0.1), (1200, RESET), (1220, 0.3)], [0, 0.3], [(50, 1100, 50, 100), (2, 20, 1, 0)], 1240),
    ],
)  # fmt: skip
def test_the_environments_process_steps_when_its_clock_says_so(
    keys: dict[str, Any],
    works_ms: int,
    messages: list[tuple[float, Any]],
    applied: list[float],
    answers: list[tuple[int, int, int, int]],
    until_ms: float,
) -> None:
    """An answer has the periods that passed, the thinking time in ms and periods, and the lateness in ms."""
    clock = VirtualClock()
    env = Working(clock, works_ms)
    sent = [(time_ms, each if each is RESET else ("step", chosen(each))) for time_ms, each in messages]
    connection: Any = Messages(clock, (0, RESET), *sent)
    loop = ControlLoop(plant_of(env, None), LoopOptions(**keys), env.action_space)
    server = EnvironmentServer(connection, loop, env, clock)
    told = []
    for _ in range(len(messages) + 1):
        name, *arguments = server.wait()
        answer = getattr(server, name)(*arguments)
        if name == "step":
            passed, thinking_ns, thought, late_ns = answer
            told.append((passed.ticks, thinking_ns / MS, thought, late_ns / MS))
            assert passed.observation == len(env.applied)
    assert told == answers
    assert [round(each, 3) for each in env.applied] == applied
    assert clock.now_ns() == until_ms * MS


def test_an_episode_begins_without_the_actions_of_the_one_before() -> None:
    """As the agent observes them, on a simulated clock and in a process."""
    clock, timed = VirtualClock(), RealTime(Counting(), 0.02, observe_actions=2)
    env, latest = Working(clock, 0), [timed.reset()[0], timed.step(one(0.5))[0], timed.reset()[0]]
    loop = ControlLoop(plant_of(env, None), LoopOptions(observe_actions=2), env.action_space)
    messages: Any = Messages(clock, (0, RESET), (20, ("step", one(0.5))), (60, RESET))
    server = EnvironmentServer(messages, loop, env, clock)
    for _ in range(3):
        name, *arguments = server.wait()
        told = getattr(server, name)(*arguments)[0]
        latest.append(told.observation if name == "step" else told)
    assert [each[1:].tolist() for each in latest] == [[0.0, 0.0], [0.0, 0.5], [0.0, 0.0]] * 2


@pytest.mark.wall_clock
@pytest.mark.slow
def test_a_process_of_its_own_goes_on_by_the_machines_clock(tmp_path: Path) -> None:
    """However long anything took: what passed inside is what the thinking times that were measured say."""
    keys: dict[str, Any] = {"period_s": 0.05, "observe_age": True}
    process = RealTimeProcess(Counting, **keys)
    assert process.reset(seed=7, options={"a": 1})[1] == Counting().reset(seed=7, options={"a": 1})[1]
    assert process.observation_space == RealTime(Counting(), **keys).observation_space
    expected = 0
    for thinking_ticks in range(5):
        observation, _, over, _, info = process.step(one(0.1))
        thought = -(-round(info["thinking_s"] * 1e9) // 50_000_000)
        expected += thought + 1
        if over:
            break
        assert observation.tolist() == [expected, np.float32(info["meanwhile_s"])]
        assert info["meanwhile_s"] == pytest.approx(0.05 * thought)
        assert len(process.thinking.taken_ns) == thinking_ticks + 1
    process.close()
    with pytest.raises(UserError, match=r"the process of the environment (was ended by SIGKILL|ended with status 0)"):
        process.step(one(0.1))
    stopped = RealTimeProcess(partial(Closing, tmp_path / "closed"), "tcsc", clock_speed=100, chunk=3, execute=2)
    stopped.reset(seed=0)
    assert [int(stopped.step(np.zeros((3, 1)))[0][0]) for _ in range(3)] == [2, 4, 6]
    assert stopped.action_space.shape == (3, 1)
    stopped.close()
    assert (tmp_path / "closed").exists()
    with pytest.raises(UserError, match=r"^period_s: FrozenLakeEnv does not say how long a step is"):
        RealTimeProcess(partial(gymnasium.make, "FrozenLake-v1"))


@pytest.mark.wall_clock
@pytest.mark.slow
def test_in_a_process_of_its_own_an_environments_exception_arrives_whole() -> None:
    """Whether it comes in a step, while the agent thinks, or as the environment is made; then the process is over."""
    process = RealTimeProcess(partial(Failing, ValueError("too low")), "tcsc")
    process.reset(seed=0)
    with pytest.raises(ValueError, match="too low") as caught:
        process.step(one(0.1))
    assert "in step" in caught.value.__notes__[0]
    with pytest.raises(UserError, match=r"the process of the environment (was ended by SIGKILL|ended with status 0)"):
        process.step(one(0.1))
    process = RealTimeProcess(partial(Failing, ZeroDivisionError("while it thinks")))
    process.reset(seed=0)
    process._process.join()
    with pytest.raises(ZeroDivisionError, match="while it thinks"):
        process.step(one(0.1))
    with pytest.raises(TypeError, match="argument"):
        RealTimeProcess(partial(Counting, 1))  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("error", "sent"),
    [
        (ValueError("low"), "ValueError('low')"),
        (UserError("one line"), "UserError('one line')"),
        (OwnError(1, 2), "RuntimeError('OwnError: 1 and 2')"),
        (ValueError(lambda: 0), "RuntimeError('ValueError: <function"),
    ],
)
def test_an_exception_that_cannot_be_sent_is_told(error: Exception, sent: str) -> None:
    assert repr(portable(error)).startswith(sent)


@pytest.mark.wall_clock
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_process_that_was_stopped_is_noticed_and_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the agent that waits for it, or by `close`."""
    monkeypatch.setattr(lifetime, "STOPPED_S", 0.0)
    for closed in (False, True):
        env = RealTimeProcess(Counting, "tcsc")
        env.reset(seed=0)
        pid = env._process.pid
        assert pid is not None
        os.kill(pid, signal.SIGSTOP)
        while state_of(pid) != "T":
            pass
        if closed:
            env.close()
        with pytest.raises(UserError, match=rf"was {'ended by SIGKILL' if closed else 'stopped'}$"):
            env.step(one(0.1))
        assert not left_after([pid], 0.0)


@pytest.mark.wall_clock
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_an_interrupted_program_ends_though_its_environment_was_stopped() -> None:
    """An interruption while it waits, and nobody closes what it made."""
    program = (
        "import os, signal; from uavaccel.realtime import RealTimeProcess; from tests.counting import Counting;"
        "env = RealTimeProcess(Counting, 'tcsc'); env.reset(); os.kill(env._process.pid, signal.SIGSTOP);"
        "print(env._process.pid, flush=True); env.step([0.1])"
    )
    asked = [sys.executable, "-c", program]
    with subprocess.Popen(asked, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert said.splitlines()[-1] == "KeyboardInterrupt"
    assert not left_after([pid], 0.0)


def test_it_loads_neither_pytorch_nor_opengl() -> None:
    heavy = ("torch", "OpenGL", "numba", "scipy.stats")
    asked = f"import sys, uavaccel.realtime; print([name for name in {heavy} if name in sys.modules])"
    # with a backend named MuJoCo, which Gymnasium's environments bring, loads it at once
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run([sys.executable, "-c", asked], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
