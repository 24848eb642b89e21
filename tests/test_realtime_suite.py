"""The experiment on agents that need time to think: its agents, cells, rankings and bytes."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from itertools import permutations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from gymnasium.wrappers import TransformAction

from tests import made_runs as made
from tests.drawing import labelled
from tests.made_runs import thinking_row
from tests.running import configured, fly_into, stopped_at
from uavaccel.errors import UserError
from uavaccel.own_code import trusting
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment
from uavaccel.suites import realtime_agents as agents
from uavaccel.suites import realtime_learner as learner
from uavaccel.suites.realtime import AgentBlock, EnvironmentBlock, Evaluation, Realtime
from uavaccel.suites.realtime_agents import LookAhead, measured, policy_of, timed
from uavaccel.suites.realtime_learner import train, training
from uavaccel.suites.realtime_report import panels_figure

pytestmark = pytest.mark.usefixtures("whole_messages")

PENDULUM = EnvironmentBlock(id="InvertedPendulum-v5", train_steps=512)
CART = EnvironmentBlock(id="CartPole-v1", default_action=1, period_s=0.5)
DRONE = EnvironmentBlock(id="uavaccel/Hover-v0", train_steps=2048)
TINY = (
    "environments={pendulum: {id: InvertedPendulum-v5, train_steps: 512}}",
    "agents={naive: {}, look_ahead: {look_ahead: true}, chunk: {chunk: 2, training_delay_s: [0, 0.1], hidden: [8, 5]}, "
    "slow: {latency_factor: 3}}",
    "latency_s=[0, 0.05]",
    "clock_speed=[1, 4]",
    "episodes=2",
)


@pytest.fixture(scope="module", autouse=True)
def short_rollouts() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for key, value in {"n_steps": 64, "batch_size": 128, "n_epochs": 3}.items():
            patch.setitem(learner.LEARNER, key, value)
        yield


def flown(out: Path, *overrides: str, resume: bool = False) -> RunDirectory:
    return fly_into(out, Realtime(), configured("realtime_smoke", *TINY, *overrides), resume)


@pytest.fixture(scope="module")
def run(short_rollouts: None, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return flown(tmp_path_factory.mktemp("realtime") / "run", "seed=10")


# --- what is flown --------------------------------------------------------------------------------


def test_its_cases_are_each_training_once_and_each_delay() -> None:
    """A drone takes no chunks, and has no model to look ahead with."""
    suite, hover = Realtime(), "environments.hover={id: uavaccel/Hover-v0, train_steps: 2048}"
    config = configured("realtime_smoke", *TINY, "seeds=2", hover)
    some = list(suite.cases(config))
    trainings = [case.id for case in some if not isinstance(case, Evaluation)]
    met = [case for case in some if isinstance(case, Evaluation)]
    agents_of = ("pendulum-naive", "pendulum-chunk", "hover-naive")
    assert trainings == [f"{agent}-s{seed}" for agent in agents_of for seed in (0, 1)]
    assert [suite.stage(case) for case in some] == [0] * 6 + [1] * len(met)  # in parallel, too, trainings come first
    assert [case.id for case in met if case.agent == "look_ahead" and case.seed == 1] == [
        *(f"pendulum-look_ahead-s1-adsc-{latency}-{speed}" for latency in ("0ms", "50ms") for speed in ("1x", "4x")),
        *(f"pendulum-look_ahead-s1-tcsc-50ms-{speed}" for speed in ("1x", "4x")),  # one latency stands for all
    ]
    assert {(case.environment, case.agent, case.trained) for case in met if case.seed == 1} == {
        *(("pendulum", agent, "pendulum-naive-s1") for agent in ("naive", "look_ahead", "slow")),
        ("pendulum", "chunk", "pendulum-chunk-s1"),
        *(("hover", agent, "hover-naive-s1") for agent in ("naive", "slow")),
    }
    assert [suite.games(config, case) for case in (some[0], some[-1])] == [1, 2]
    for order in permutations(config.agents):
        other = config.model_copy(update={"agents": {name: config.agents[name] for name in order}})
        pairs = [(place, agent) for place in other.environments for agent in order if other.flies(place, agent)]
        assert all(other.flies(place, other.trained_as(place, agent)) for place, agent in pairs), order


def test_a_run_that_was_interrupted_ends_with_the_same_bytes(run: RunDirectory, tmp_path: Path) -> None:
    """Stopped after both trainings and four evaluations; the others load the weights from the run's folder."""
    with stopped_at(lambda again, _: len(again.rows()) == 6):
        flown(tmp_path / "again", "seed=10")
    again = flown(tmp_path / "again", "seed=10", resume=True)
    assert (again.path / "rows.jsonl").read_bytes() == (run.path / "rows.jsonl").read_bytes()


def test_an_evaluation_flies_the_weights_and_seeds_of_the_run(run: RunDirectory) -> None:
    """Episodes begin with other seeds than any training's; under TCSC neither latency nor ClockSpeed counts."""
    rows = {row["case"]: row for row in run.rows()}
    weights = run.load_arrays(rows["pendulum-naive-s0"])
    again, learned = train(PENDULUM, AgentBlock(), 10)
    assert {name: each.tobytes() for name, each in weights.items()} == {name: again[name].tobytes() for name in again}
    assert learned.items() <= rows["pendulum-naive-s0"].items()
    for agent, latency_s in (("naive", 0.05), ("slow", 0.15)):
        env = timed(PENDULUM, AgentBlock(), latency_s, "adsc", 4.0)
        policy = policy_of(env, AgentBlock(), weights)
        alone = [agents.fly_episode(env, policy, seed, 0.0) for seed in (1_000_010, 1_000_011)]
        row = rows[f"pendulum-{agent}-s0-adsc-50ms-4x"]
        assert (row["returns"], row["delays_s"]) == tuple(list(each) for each in zip(*alone, strict=True))[:2]
    assert rows["pendulum-naive-s0-adsc-50ms-1x"]["delays_s"] == pytest.approx([0.06, 0.06])  # a step is 20 ms
    undelayed = [
        rows[f"pendulum-naive-s0-{under}"]["returns"] for under in ("adsc-0ms-1x", "adsc-0ms-4x", "tcsc-50ms-4x")
    ]
    assert undelayed[0] == undelayed[1] == undelayed[2] != rows["pendulum-naive-s0-adsc-50ms-4x"]["returns"]
    ahead = [rows[f"pendulum-look_ahead-s0-{under}-50ms-4x"]["returns"] for under in ("adsc", "tcsc")]
    assert ahead[0] != rows["pendulum-naive-s0-adsc-50ms-4x"]["returns"]
    assert ahead[1] == undelayed[0]
    shapes = {name: each.shape for name, each in run.load_arrays(rows["pendulum-chunk-s0"]).items()}
    assert [shapes[f"mlp_extractor.policy_net.{layer}.weight"] for layer in (0, 2)] == [(8, 4), (5, 8)]
    assert shapes["action_net.bias"] == (2,)


def test_on_the_machines_clock_an_agent_sleeps_for_its_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    met: list[Any] = []

    def noting(returned: Any) -> Any:
        return lambda *given: (met.append(given[2:]), returned)[1]  # type: ignore[func-returns-value]

    monkeypatch.setattr(agents, "measured", noting(SimpleNamespace(close=lambda: None, unwrapped=None)))
    monkeypatch.setattr(agents, "policy_of", lambda *_: None)
    monkeypatch.setattr(agents, "fly_episode", noting((1.0, 0.0, 0.0)))
    config = configured("realtime_smoke", *TINY, "agents={slow: {latency_factor: 3}}", timing="wall")
    case = next(case for case in Realtime().cases(config) if case.id == "pendulum-slow-s0-adsc-50ms-4x")
    Realtime().fly(config, case, (None, lambda trained: {}))
    asleep_s = pytest.approx(0.15)
    assert met == [("adsc", 4.0), (1_000_000, asleep_s), (1_000_001, asleep_s)]


# --- agents ---------------------------------------------------------------------------------------


def test_a_policy_is_its_weights_on_normalised_observations(run: RunDirectory) -> None:
    weights, seen = run.load_arrays(run.rows()[0]), np.array([0.1, -0.05, 0.3, 0.2])
    hidden = (seen - weights["observation.mean"]) / np.sqrt(weights["observation.var"] + 1e-8)
    for layer in ("0", "2"):
        prefix = f"mlp_extractor.policy_net.{layer}"
        hidden = np.tanh(weights[f"{prefix}.weight"] @ hidden + weights[f"{prefix}.bias"])
    expected = weights["action_net.weight"] @ hidden + weights["action_net.bias"]
    env = timed(PENDULUM, AgentBlock(), 0.0, "adsc", 1.0)
    np.testing.assert_allclose(policy_of(env, AgentBlock(), weights)(seen), np.clip(expected, -3, 3), rtol=1e-5)


@pytest.mark.parametrize("ends", ["lost", "out"])
def test_an_episode_has_its_return_delay_and_lateness(ends: str) -> None:
    """Each action is decided upon what the one before has made of the environment; only a real clock is late."""
    script = [(1.0, 0.1, {}), (2.0, 0.9, {"late_s": 0.75}), (4.0, 0.3, {"late_s": 0.25}), (-0.5, 0.2, {})]
    left, met = list(script), []

    def step(action: int) -> Any:
        met.append(action)
        reward, delay_s, info = left.pop(0)
        return (
            action + 1,
            reward,
            ends == "lost" and not left,
            ends == "out" and not left,
            {"meanwhile_s": delay_s, **info},
        )

    env: Any = SimpleNamespace(reset=lambda seed: (seed, {}), step=step)
    policy: Any = lambda observation: 10 * observation  # noqa: E731
    policy.reset = lambda seed: met.append(-seed)
    assert agents.fly_episode(env, policy, 7, 0.0) == (6.5, 0.25, 0.75)
    assert met == [-7, 70, 710, 7110, 71110]


@pytest.mark.parametrize("clock_speed", [1.0, 2.0])
def test_who_looks_ahead_decides_upon_what_will_be(clock_speed: float) -> None:
    env, shown = timed(PENDULUM, AgentBlock(), 0.03, "adsc", clock_speed), list[Any]()
    inside: Any = env.unwrapped

    def by_the_angle(observation: Any) -> Any:
        shown.append(observation)
        return np.array([10 * observation[1] + 2 * observation[3]], np.float32)

    ahead = LookAhead(by_the_angle, env, PENDULUM, 0.03, clock_speed)
    applied, do_simulation = [], inside.do_simulation

    def watched(control: Any, ticks: int) -> None:
        applied.append(np.concatenate([inside.data.qpos, inside.data.qvel]))
        do_simulation(control, ticks)

    inside.do_simulation = watched
    for seed in (3, 4):
        observation, _ = env.reset(seed=seed)
        ahead.reset(seed)
        for _ in range(4):
            observation, *_ = env.step(ahead(observation))
    steps = len(applied) // 8  # of each decision the last one begins where its action is applied
    np.testing.assert_allclose(shown, applied[steps - 1 :: steps], atol=1e-12)


def test_a_trainings_return_is_of_its_last_hundred_episodes() -> None:
    """A lane's episodes have two steps, and each brings 1 more than the one before."""
    returns, rewards = learner._Returns(), np.zeros(learner.LANES)
    returns.model = SimpleNamespace(get_env=lambda: SimpleNamespace(get_original_reward=lambda: rewards))  # type: ignore
    assert returns.last() is None
    for step in range(300):
        rewards[:] = step // 2 / 2
        returns.locals = {"dones": np.arange(learner.LANES) == (0 if step % 2 else -1)}
        returns._on_step()
    assert returns.last() == pytest.approx(np.mean(np.arange(50, 150)))


def test_a_training_meets_one_delay_an_episode_from_its_range() -> None:
    env = training(PENDULUM, AgentBlock(training_delay_s=(0.02, 0.2)), seed=5)
    delays = []
    for _ in range(8):
        env.reset(seed=0)
        delays.append([round(env.step(env.action_space.sample())[-1]["thinking_s"], 4) for _ in range(2)])
    assert all(first == second and 0.02 <= first <= 0.2 for first, second in delays)
    assert len({first for first, _ in delays}) == 8


@pytest.mark.parametrize(
    ("agent", "numbers", "planned"),
    [
        (AgentBlock(observe_age=True), 4 + 1, (1,)),
        (AgentBlock(observe_actions=3), 4 + 3, (1,)),
        (AgentBlock(chunk=3), 4, (3, 1)),
        (AgentBlock(chunk=2, observe_age=True, observe_actions=2), 4 + 1 + 2 * 2, (2, 1)),
    ],
)
def test_an_agent_sees_and_plans_what_its_block_says(agent: AgentBlock, numbers: int, planned: tuple[int, ...]) -> None:
    """Of the actions that it plans one is applied, for 40 ms, before it observes again."""
    for env in (timed(PENDULUM, agent, 0.0, "adsc", 1.0), training(PENDULUM, agent, seed=0)):
        observation, _ = env.reset(seed=0)
        assert (observation.shape, env.action_space.shape) == ((numbers,), planned)
        assert env.step(np.zeros(planned, np.float32))[-1]["simulated_s"] == pytest.approx(0.04)


def test_on_the_machines_clock_an_agent_has_the_same_options(monkeypatch: pytest.MonkeyPatch) -> None:
    met: list[Any] = []
    monkeypatch.setattr(agents, "RealTimeProcess", lambda make, *at, **keys: met.append((at, keys)))
    measured(CART, AgentBlock(chunk=3, observe_age=True, observe_actions=2), "tcsc", 4.0)
    of_agent = {"chunk": 3, "execute": 1, "observe_age": True, "observe_actions": 2}
    of_agent |= {"frozen_prefix": False, "observe_planned": 0}
    assert met == [(("tcsc", 4.0), {**of_agent, "period_s": 0.5, "default_action": 1})]


def test_an_environment_has_the_keys_of_its_block() -> None:
    """The pushes of 40 ms before the first action move the cart; a step of the other cart is said to take 0.5 s."""
    for push in (2.0, -2.0):
        env = timed(PENDULUM.model_copy(update={"default_action": (push,)}), AgentBlock(), 0.04, "adsc", 1.0)
        env.reset(seed=0)
        assert np.sign(push) * env.step(np.zeros(1, np.float32))[0][0] > 0.03
    env = timed(CART, AgentBlock(), 0.5, "adsc", 1.0)
    env.reset(seed=0)
    info = env.step(0)[-1]
    assert (info["meanwhile_s"], info["simulated_s"]) == (0.5, 1.0)


def test_a_drone_flies_with_the_command_of_the_case() -> None:
    """In training always with ADSC in real time, whose delays are of simulated time."""
    drones = timed(DRONE, AgentBlock(), 0.0, "tcsc", 2.0), training(DRONE, AgentBlock(), seed=0)
    tasks: Any = [getattr(env.unwrapped, "task") for env in drones]  # noqa: B009  it has no type
    under = [(task.timing, task.command, task.clock_speed) for task in tasks]
    assert under == [("virtual", "tcsc", 2.0), ("virtual", "adsc", 1.0)]


# --- reports --------------------------------------------------------------------------------------


def summary_of(path: Path, *rows: Any) -> Any:
    return made.realtime(path, *rows).summary


def ranking_of(path: Path, means: dict[tuple[str, float], float]) -> Any:
    """The ranking of agents by their means by agent and ClockSpeed, each within 2 of it."""
    rows = [thinking_row(agent, "adsc", 0.05, speed, mean) for (agent, speed), mean in means.items()]
    stopped = [thinking_row("c", "tcsc", 0.05, speed, 99.0) for speed in (1.0, 5.0)]  # rankings are of ADSC
    (ranking,) = summary_of(path, *rows, *stopped)["rankings"]
    return ranking


def test_tcsc_is_held_against_its_own_at_every_clock_speed(tmp_path: Path) -> None:
    rows = [thinking_row("a", "tcsc", 0.0, 1.0, 2.0), thinking_row("a", "tcsc", 0.0, 1.0, 8.0, seed=1)]
    fast = [*rows, *(row | {"clock_speed": 5.0, "case": f"{row['case']}-fast"} for row in rows)]
    equal = summary_of(tmp_path / "equal", *fast, thinking_row("a", "adsc", 0.0, 5.0, 7.0))
    other = summary_of(tmp_path / "other", *fast, thinking_row("a", "tcsc", 0.0, 9.0, 2.5))
    found = [each["tcsc_equal_at_every_clock_speed"] for each in (summary_of(tmp_path / "one", *rows), equal, other)]
    assert found == [None, True, False]


def test_a_ranking_holds_until_two_agents_change_places_for_sure(tmp_path: Path) -> None:
    means = {("a", 1.0): 10.0, ("b", 1.0): 5.0, ("c", 1.0): 0.0, ("a", 5.0): 6.0, ("b", 5.0): 6.5, ("c", 5.0): 0.0}
    held = ranking_of(tmp_path / "held", means)
    assert (held["holds_to"], held["reversals"]) == (5, [])  # b is ahead of a, but their intervals overlap
    assert held["kendall_tau"] == [1.0, pytest.approx(1 / 3)]
    assert held["orders"] == [["a", "b", "c"], ["b", "a", "c"]]
    unsure = ranking_of(tmp_path / "unsure", {("a", 1.0): 6.5, ("b", 1.0): 6.0, ("a", 5.0): 0.0, ("b", 5.0): 9.0})
    assert (unsure["holds_to"], unsure["reversals"]) == (5, [])  # nobody was ahead for sure to begin with
    broken = ranking_of(tmp_path / "broken", means | {("a", 20.0): 1.0, ("b", 20.0): 2.0, ("c", 20.0): 19.0})
    assert broken["holds_to"] == 5
    assert broken["reversals"] == [{"clock_speed": 20, "ahead": "c", "behind": each} for each in ("a", "b")]


def test_a_single_episode_changes_no_places(tmp_path: Path) -> None:
    rows = [
        thinking_row(agent, "adsc", 0.05, speed, 0.0, returns=[mean])
        for speed, means in ((1.0, {"naive": 1.0, "chunk": 2.0}), (5.0, {"naive": 2.0, "chunk": 1.0}))
        for agent, mean in means.items()
    ]
    report = made.realtime(tmp_path / "run", *rows)
    (ranking,) = report.summary["rankings"]
    assert (ranking["holds_to"], ranking["kendall_tau"]) == (5, [1.0, -1.0])
    assert {cell["return_low"] for cell in report.summary["cells"]} == {None}
    (at_one_clock := made.realtime(tmp_path / "one", *rows[:2])).write()
    report.write()
    page, other = ((each.run.path / "report.md").read_text() for each in (report, at_one_clock))
    assert "| 2 | - | - |" in page
    assert ["How fast may one simulate" in text for text in (page, other)] == [True, False]


def test_equal_agents_are_told_to_be_equal(tmp_path: Path) -> None:
    rows = [thinking_row(agent, "adsc", 0.05, 1.0, mean) for agent, mean in (("a", 1.0), ("b", 2.0), ("c", 2.0))]
    assert made.realtime(tmp_path / "run", *rows).headline() == "With 50 ms to think, in pendulum b = c > a"


@pytest.mark.parametrize(("reversed_at", "holds_to"), [((), 50), ((5, 20), 1), ((20, 50), 5), ((5,), 1)])
def test_a_ranking_holds_up_to_its_first_change(
    tmp_path: Path, reversed_at: tuple[float, ...], holds_to: float
) -> None:
    pairs = [(agent, speed) for speed in (50.0, 1.0, 20.0, 5.0) for agent in ("a", "b")]
    means = {(agent, speed): 19.0 if (agent == "a") != (speed in reversed_at) else 2.0 for agent, speed in pairs}
    ranking = ranking_of(tmp_path / "run", means)
    assert (ranking["clock_speeds"], ranking["holds_to"]) == ([1, 5, 20, 50], holds_to)
    found = [(change["clock_speed"], change["ahead"], change["behind"]) for change in ranking["reversals"]]
    assert found == [(speed, "b", "a") for speed in reversed_at]


def test_a_run_without_an_evaluation_has_no_report_yet(run: RunDirectory, tmp_path: Path) -> None:
    begun = made.realtime(
        tmp_path / "begun", {key: value for key, value in run.rows()[0].items() if "arrays" not in key}
    )
    with pytest.raises(UserError, match="holds no finished evaluation yet"):
        begun.write()


@pytest.mark.wall_clock
@pytest.mark.slow
def test_what_is_flown_is_what_the_simulated_clock_models(run: RunDirectory, tmp_path: Path) -> None:
    """Delays cannot be shorter than the agent's thinking; how much longer depends on the machine."""
    keys = "agents={naive: {}}", "latency_s=[0.05]", "clock_speed=[1]", "command=[adsc]", "episodes=1"
    measured = flown(tmp_path / "wall", *keys, "timing=wall")
    row = next(row for row in measured.rows() if row["kind"] == "evaluation")
    assert row["delays_s"][0] >= 0.05
    (picture,) = Realtime().compare([run, measured])
    assert picture.is_file()


# --- mistakes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("environments={x: {id: Nowhere-v0}}", "environments.x: Nowhere-v0 cannot be made: Environment `Nowhere`"),
        ("environments={x: {id: 'os:Nowhere-v0'}}", "environments.x.id: no module 'os' in "),
        ("environments={x: {id: CartPole-v1}}", "environments.x, agents.naive: default_action: a Discrete"),
        ("environments={x: {id: CartPole-v1, default_action: 0}}", "agents.look_ahead: look_ahead: looks into"),
        *(
            (
                f"environments={{x: {{id: uavaccel/Hover-v0, keys: {{{key}: 1}}}}}}",
                f"environments.x.keys: a drone has {key} of",
            )
            for key in ("timing", "command", "clock_speed")
        ),
        (
            "environments={x: {id: FrozenLake-v1, default_action: 0, period_s: 1}}",
            r"environments.x, agents.naive: PPO learns from a Box of observations, not from Discrete\(16\)",
        ),
        ("agents={a: {training_delay_s: [0.2, 0.1]}}", "training_delay_s must rise"),
        ("agents={a/b: {}}", "'a/b' names files: letters, digits and _ alone"),
        ("latency_s=[0.1, 0.1]", "latency_s = .*: has 0.1 twice"),
        ("agents={a: {look_ahead: true, chunk: 2}}", "look_ahead predicts .*, for a single action: leave out chunk"),
        ("agents={a: {look_ahead: true, observe_age: true}}", "look_ahead predicts .*: leave out observe_age"),
        ("timing=wall", "look_ahead needs timing virtual"),
    ],
)
def test_what_does_not_fit_is_one_line(override: str, said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        Realtime().check(configured("realtime_smoke", *TINY, override))
    assert "\n" not in str(caught.value)


def test_nobody_looks_ahead_past_a_wrapper() -> None:
    def turned(**keys: Any) -> Any:
        return TransformAction(gymnasium.make("InvertedPendulum-v5"), np.negative, None)

    gymnasium.register("Turned-v0", turned)
    with pytest.raises(UserError, match=r"^environments\.x, agents\.look_ahead: .*past the wrapper TransformAction: "):
        Realtime().check(configured("realtime_smoke", *TINY, "environments={x: {id: Turned-v0}}"))


@pytest.mark.parametrize(
    ("name", "step", "said"),
    [
        ("Blurred", "return np.zeros(4), np.nan, False, False, {}", "Blurred-v0: a reward or an observation is NaN"),
        ("Frayed", "return np.array([0, np.nan, 0, 0]), 1, False, False, {}", "Frayed-v0: a reward or an obs"),
        ("Broken", "raise KeyError('no motor')", "broken_cart.py:7: Cart.step: KeyError: 'no motor'"),
    ],
)
def test_a_mistake_of_ones_own_environment_is_one_line(
    name: str, step: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_cart.py").write_text(
        "import gymnasium\nimport numpy as np\nfrom gymnasium.envs.classic_control import CartPoleEnv\n\n"
        f"class Cart(CartPoleEnv):\n    def step(self, action):\n        {step}\n\n"
        f"gymnasium.register('{name}-v0', Cart, max_episode_steps=3, disable_env_checker=True)\n"
        "def act(seen):\n    return 1\n"
    )
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    environment = f"environments={{x: {{id: 'broken_cart:{name}-v0', default_action: 0, train_steps: 8}}}}"
    own = "{policies: {x: 'broken_cart.py:act'}}"  # which may be given what it likes
    for agent in ("{}", own)[: 1 + (name != "Frayed")]:
        with trusting(), pytest.raises(UserError, match=said):
            flown(tmp_path / "run", environment, f"agents={{a: {agent}}}")
        shutil.rmtree(tmp_path / "run")


def test_a_module_with_environments_runs_when_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = "import gymnasium\ngymnasium.register('Own-v0', 'gymnasium.envs.classic_control:CartPoleEnv')\n"
    (tmp_path / "own_environments.py").write_text(own)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    environments = {"x": EnvironmentBlock(id="own_environments:Own-v0", default_action=0)}
    config = configured("realtime_smoke", *TINY, "agents={a: {}}").model_copy(update={"environments": environments})
    with pytest.raises(UserError, match=r"environments.x.id: .*own_environments.py is code that nobody has trusted"):
        Realtime().check(config)
    with trusting():
        Realtime().check(config)


def test_what_ships_can_be_made() -> None:
    for path in sorted(Path(experiment("dp1.yaml")).parent.glob("realtime*.yaml")):
        Realtime().check(configured(path.stem))


def test_an_agent_looks_alike_in_every_panel() -> None:
    """Also where it is the only one that was flown."""
    rows = [("cart", "naive", 1.0), ("cart", "chunk", 2.0), ("pendulum", "chunk", 3.0), ("cart", "naive", 4.0)]
    cells = pd.DataFrame(rows, columns=["environment", "agent", "x"]).assign(y=1.0)
    figure, panels = panels_figure(cells, "x", "y", "agent", "A title")
    both, alone = ({name: line[0].get_color() for name, line in labelled(axes).items()} for axes in panels)
    assert both["chunk"] == alone["chunk"] != both["naive"]
    plt.close(figure)
