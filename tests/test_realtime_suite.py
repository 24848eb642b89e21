"""The experiment on agents that need time to think: its agents, cells, rankings and bytes."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.drawing import labelled, points, record_figures
from tests.running import configured
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment
from uavaccel.suites import realtime_agents as agents
from uavaccel.suites.own_code import trusting
from uavaccel.suites.realtime import AgentBlock, EnvironmentBlock, Evaluation, Realtime
from uavaccel.suites.realtime_agents import LookAhead, Policy, measured, timed, train, training
from uavaccel.suites.runner import run_suite, start_run

PENDULUM = EnvironmentBlock(id="InvertedPendulum-v5", train_steps=512)
TINY = (
    "environments={pendulum: {id: InvertedPendulum-v5, train_steps: 512}}",
    "agents={naive: {}, look_ahead: {look_ahead: true}, chunk: {chunk: 2, training_delay_s: [0, 0.1]}}",
    "latency_s=[0, 0.05]",
    "clock_speed=[1, 4]",
    "episodes=2",
)


@pytest.fixture(scope="module", autouse=True)
def short_rollouts() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for key, value in {"n_steps": 64, "batch_size": 128, "n_epochs": 3}.items():
            patch.setitem(agents.LEARNER, key, value)
        yield


def flown(out: Path, *overrides: str, resume: bool = False) -> RunDirectory:
    suite, config = Realtime(), configured("realtime_smoke", *TINY, *overrides)
    run = start_run(suite, config, out, {}, resume)
    run_suite(suite, config, run)
    return run


@pytest.fixture(scope="module")
def run(short_rollouts: None, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return flown(tmp_path_factory.mktemp("realtime") / "run")


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
    assert {(case.agent, case.trained) for case in met if (case.environment, case.seed) == ("pendulum", 1)} == {
        *(("naive", "pendulum-naive-s1"), ("look_ahead", "pendulum-naive-s1"), ("chunk", "pendulum-chunk-s1"))
    }
    assert {(case.environment, case.agent) for case in met if case.environment == "hover"} == {("hover", "naive")}
    assert [suite.games(config, case) for case in (some[0], some[-1])] == [1, 2]


def test_the_same_bytes_every_time_killed_or_not(
    run: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped after both trainings and four evaluations; the others load the weights from the run's folder."""
    append = RunDirectory.append_row

    def interrupted(self: RunDirectory, row: Any, on_disk: bool = True) -> None:
        if len(self.rows()) == 6:
            raise KeyboardInterrupt
        append(self, row, on_disk)

    with monkeypatch.context() as patch:
        patch.setattr(RunDirectory, "append_row", interrupted)
        with pytest.raises(KeyboardInterrupt):
            flown(tmp_path / "again")
    again = flown(tmp_path / "again", resume=True)
    assert (again.path / "rows.jsonl").read_bytes() == (run.path / "rows.jsonl").read_bytes()


def test_weights_are_loaded_once_for_the_evaluations_of_a_training(
    run: RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, rows = iter(range(9)), run.rows()
    monkeypatch.setattr(RunDirectory, "rows", lambda _: rows if next(read) < 9 else [])
    with Realtime().open(configured("realtime_smoke"), "virtual", run) as weights:
        loaded = [weights(f"pendulum-{agent}-s0")["action_net.bias"] for agent in ("naive", "naive", "chunk")]
    assert next(read) == 2  # twice
    assert loaded[0] is loaded[1]
    assert loaded[2].shape == (2,)  # of a chunk


def test_under_tcsc_the_clock_speed_changes_nothing_and_under_adsc_the_delay_counts(run: RunDirectory) -> None:
    rows = [row for row in run.rows() if row["kind"] == "evaluation" and row["agent"] == "naive"]
    naive = {(row["command"], row["latency_s"], row["clock_speed"]): row for row in rows}
    assert naive["adsc", 0, 1]["returns"] == naive["adsc", 0, 4]["returns"] == naive["tcsc", 0.05, 4]["returns"]
    assert naive["adsc", 0.05, 1]["returns"] != naive["adsc", 0.05, 4]["returns"]
    assert naive["adsc", 0.05, 1]["delays_s"] == pytest.approx([0.06, 0.06])  # to the physics step of 20 ms
    assert naive["adsc", 0.05, 4]["delays_s"] == pytest.approx([0.2, 0.2])


def test_its_report_says_who_is_best_and_how_fast_one_may_simulate(run: RunDirectory) -> None:
    report = Realtime().report(run)
    summary = report.write()
    assert report.headline().endswith("under TCSC all returns are the same to the bit at every ClockSpeed")
    assert {ranking["latency_s"] for ranking in summary["rankings"]} == {0.0, 0.05}
    assert len(summary["trainings"]) == 2
    page = (run.path / "report.html").read_text()
    assert "How fast may one simulate before the ranking changes?" in page
    assert (run.path / "figures/returns.png").stat().st_size > 10_000
    assert json.loads((run.path / "summary.json").read_text())["provenance"] == "modelled"


def test_flights_have_the_seeds_the_weights_and_the_latency_of_their_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes of an evaluation begin with other seeds than any training; agents of one seed meet the same ones.

    An agent thinks so many times a cell's latency: on the simulated clock the environment waits for it, on the
    machine's own it sleeps.
    """
    met: list[Any] = []

    def noting(name: str, *at: int, returned: Any = None) -> Any:
        def note(*given: Any) -> Any:
            met.append((name, *(given[place] for place in at)))
            return returned

        return note

    slow = "agents={slow: {latency_factor: 3, look_ahead: true}}"
    keys = slow, "latency_s=[0.05]", "clock_speed=[4]", "seeds=2", "episodes=2"
    config: Any = configured("realtime_smoke", *TINY, *keys, seed=10)
    closed = SimpleNamespace(close=lambda: None)
    monkeypatch.setattr(agents, "train", noting("train", 2, returned=agents.Trained({}, 1.0, 5)))
    monkeypatch.setattr(agents, "timed", noting("timed", 2, 3, 4, returned=closed))
    monkeypatch.setattr(agents, "measured", noting("measured", 2, 3, returned=closed))
    monkeypatch.setattr(agents, "Policy", noting("weights", 2))
    monkeypatch.setattr(agents, "LookAhead", noting("looks ahead", 3, 4))
    monkeypatch.setattr(agents, "fly_episode", noting("episode", 2, 3, returned=(1.0, 0.0, 0.0)))
    suite = Realtime()
    first, _, adsc, tcsc, other, _ = cases = list(suite.cases(config))
    assert [suite.fly(config, case, None).row["seed"] for case in cases[:2]] == [0, 1]
    for case in (adsc, tcsc, replace(tcsc, timing="wall"), other):
        assert suite.fly(config, case, lambda trained: trained).row["latency_s"] == 0.05
    slowly_s, seeds = pytest.approx(0.15), (1_000_010, 1_000_011)
    asleep, awake = ([("episode", seed, s) for seed in seeds] for s in (slowly_s, 0.0))
    weights = ("weights", f"{first.id[:-1]}0")
    assert met == [
        *(("train", 10), ("train", 11)),
        *(("timed", slowly_s, "adsc", 4.0), weights, ("looks ahead", slowly_s, 4.0), *awake),
        *(("timed", slowly_s, "tcsc", 4.0), weights, *awake),
        *(("measured", "tcsc", 4.0), weights, *asleep),
        *(("timed", slowly_s, "adsc", 4.0), ("weights", f"{first.id[:-1]}1"), ("looks ahead", slowly_s, 4.0), *awake),
    ]


# --- agents ---------------------------------------------------------------------------------------


def test_an_agent_is_what_its_weights_are() -> None:
    """Another seed trains other weights; loaded, they decide as the learner's own policy did."""
    first, other = (train(PENDULUM, AgentBlock(), seed) for seed in (0, 1))
    assert first.weights["action_net.weight"].tobytes() != other.weights["action_net.weight"].tobytes()
    env = timed(PENDULUM, AgentBlock(), 0.0, "adsc", 1.0)
    weights, seen = first.weights, np.array([0.1, -0.05, 0.3, 0.2])
    scaled = (seen - weights["observation.mean"]) / np.sqrt(weights["observation.var"] + 1e-8)
    hidden = scaled
    for layer in ("0", "2"):
        prefix = f"mlp_extractor.policy_net.{layer}"
        hidden = np.tanh(weights[f"{prefix}.weight"] @ hidden + weights[f"{prefix}.bias"])
    expected = weights["action_net.weight"] @ hidden + weights["action_net.bias"]
    np.testing.assert_allclose(Policy(env, AgentBlock(), weights).act(seen), np.clip(expected, -3, 3), rtol=1e-5)


def test_a_network_has_the_layers_of_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    for key, value in {"n_steps": 2, "batch_size": 16, "n_epochs": 1}.items():
        monkeypatch.setitem(agents.LEARNER, key, value)
    agent, block = AgentBlock(hidden=(8, 5)), PENDULUM.model_copy(update={"train_steps": 16})
    weights = train(block, agent, seed=0).weights
    assert [weights[f"mlp_extractor.policy_net.{layer}.weight"].shape for layer in (0, 2)] == [(8, 4), (5, 8)]
    env = timed(PENDULUM, agent, 0.0, "adsc", 1.0)
    assert Policy(env, agent, weights).act(np.zeros(4)).shape == (1,)


def test_an_episode_has_its_return_its_median_delay_and_its_worst_lateness() -> None:
    """On a simulated clock nothing is late, and no environment says so."""
    met: list[Any] = []

    class Scripted:
        ends = "lost"

        def reset(self, seed: int) -> Any:
            self.left = list(script)
            return seed, {}

        def step(self, action: Any) -> Any:
            met.append(action)
            reward, info = self.left.pop(0)
            lost, out = (self.ends == each and not self.left for each in ("lost", "out"))
            return action + 1, reward, lost, out, info

    env: Any = Scripted()
    actor: Any = SimpleNamespace(begin=lambda: None, act=lambda observation: 10 * observation)
    rewards, delays_s, late_s = (1.0, 2.0, 4.0, -0.5), (0.1, 0.9, 0.3, 0.2), (0.0, 0.75, 0.25, 0.5)
    script = [
        (reward, {"meanwhile_s": delay, "late_s": late})
        for reward, delay, late in zip(rewards, delays_s, late_s, strict=True)
    ]
    for env.ends in ("lost", "out"):
        assert agents.fly_episode(env, actor, 7, 0.0) == (6.5, 0.25, 0.75)
    assert met == [70, 710, 7110, 71110] * 2  # each acts on what the one before made of the environment
    script = [(1.0, {"meanwhile_s": 0.5})]
    assert agents.fly_episode(env, actor, 0, 0.0) == (1.0, 0.5, 0.0)


class Echo(Policy):
    """Acts by the pole's angle, and keeps what it has been shown."""

    def __init__(self) -> None:
        self.shown: list[Any] = []

    def act(self, observation: Any) -> Any:
        self.shown.append(observation)
        return np.array([10 * observation[1] + 2 * observation[3]], np.float32)


@pytest.mark.parametrize("clock_speed", [1.0, 2.0])
def test_who_looks_ahead_decides_upon_what_will_be_when_the_action_is_applied(clock_speed: float) -> None:
    env = timed(PENDULUM, AgentBlock(), 0.03, "adsc", clock_speed)
    echo = Echo()
    ahead = LookAhead(echo, env, PENDULUM, 0.03, clock_speed)
    inside: Any = env.unwrapped
    applied, do_simulation = [], inside.do_simulation

    def watched(control: Any, ticks: int) -> None:
        applied.append(np.concatenate([inside.data.qpos, inside.data.qvel]))
        do_simulation(control, ticks)

    inside.do_simulation = watched
    for seed in (3, 4):
        observation, _ = env.reset(seed=seed)
        ahead.begin()
        for _ in range(4):
            observation, *_ = env.step(ahead.act(observation))
    del inside.do_simulation
    steps = len(applied) // 8  # of each decision the last one begins where its action is applied
    np.testing.assert_allclose(echo.shown, applied[steps - 1 :: steps], atol=1e-12)
    env.close()


def test_a_trainings_return_is_the_mean_of_its_last_hundred_episodes() -> None:
    """A lane's episodes have two steps, and each brings 1 more than the one before."""
    returns: Any = agents._Returns()
    rewards = np.zeros(agents.LANES)
    lanes = SimpleNamespace(get_original_reward=lambda: rewards)
    returns.model = SimpleNamespace(get_env=lambda: lanes)
    assert np.isnan(returns.last())
    for episode, ends in product(range(150), (False, True)):
        rewards[:] = episode / 2
        returns.locals = {"dones": np.arange(agents.LANES) == (0 if ends else -1)}
        returns._on_step()
    assert returns.last() == pytest.approx(np.mean(np.arange(50, 150)))


def test_a_training_meets_one_delay_an_episode_from_its_range() -> None:
    env = training(PENDULUM, AgentBlock(training_delay_s=(0.02, 0.2)), seed=5)
    delays = []
    for _ in range(8):
        env.reset(seed=0)
        delays.append([round(env.step(env.action_space.sample())[-1]["thinking_s"], 4) for _ in range(2)])
    assert all(first == second for first, second in delays)
    assert len({first for first, _ in delays}) == 8
    assert all(0.02 <= first <= 0.2 for first, _ in delays)


@pytest.mark.parametrize(
    ("agent", "numbers", "planned"),
    [
        (AgentBlock(), 4, (1,)),
        (AgentBlock(observe_age=True), 4 + 1, (1,)),
        (AgentBlock(observe_actions=3), 4 + 3, (1,)),
        (AgentBlock(chunk=3), 4, (3, 1)),
        (AgentBlock(chunk=2, observe_age=True, observe_actions=2), 4 + 1 + 2 * 2, (2, 1)),
    ],
)
def test_an_agent_sees_and_plans_in_its_training_and_its_evaluation_what_its_block_says(
    agent: AgentBlock, numbers: int, planned: tuple[int, ...]
) -> None:
    """Of the actions that it plans one is applied, for 40 ms, before it observes again."""
    for env in (timed(PENDULUM, agent, 0.0, "adsc", 1.0), training(PENDULUM, agent, seed=0)):
        observation, _ = env.reset(seed=0)
        assert (observation.shape, env.action_space.shape) == ((numbers,), planned)
        assert env.step(np.zeros(planned, np.float32))[-1]["simulated_s"] == pytest.approx(0.04)
        env.close()


def test_on_the_machines_clock_an_agent_has_the_same_options(monkeypatch: pytest.MonkeyPatch) -> None:
    met: list[Any] = []
    monkeypatch.setattr(agents, "RealTimeProcess", lambda make, *at, **keys: met.append((at, keys)))
    block = EnvironmentBlock(id="CartPole-v1", default_action=1, period_s=0.5)
    measured(block, AgentBlock(chunk=3, observe_age=True, observe_actions=2), "tcsc", 4.0)
    measured(block, AgentBlock(), "adsc", 2.0)
    of_both = {"period_s": 0.5, "default_action": 1}
    assert met == [
        (("tcsc", 4.0), {"chunk": 3, "execute": 1, "observe_age": True, "observe_actions": 2, **of_both}),
        (("adsc", 2.0), {"observe_age": False, "observe_actions": 0, **of_both}),
    ]


def test_an_environment_has_the_default_action_and_the_period_of_its_block() -> None:
    """The pushes of 40 ms before the first action move the cart; a step of the other cart is said to take 0.5 s."""
    moved_m = []
    for push in ((2.0,), (-2.0,)):
        env = timed(PENDULUM.model_copy(update={"default_action": push}), AgentBlock(), 0.04, "adsc", 1.0)
        env.reset(seed=0)
        moved_m.append(env.step(np.zeros(1, np.float32))[0][0])
    assert moved_m[0] > 0.03 > -0.03 > moved_m[1]
    slow = EnvironmentBlock(id="CartPole-v1", default_action=1, period_s=0.5)
    env = timed(slow, AgentBlock(), 0.5, "adsc", 1.0)
    env.reset(seed=0)
    info = env.step(0)[-1]
    assert (info["meanwhile_s"], info["simulated_s"]) == (0.5, 1.0)


@pytest.mark.parametrize(("command", "clock_speed"), [("adsc", 5.0), ("tcsc", 2.0)])
def test_a_drone_flies_with_the_command_and_the_clock_speed_of_the_case(command: str, clock_speed: float) -> None:
    """In training always with ADSC in real time, whose delays are of simulated time."""
    drone = EnvironmentBlock(id="uavaccel/Hover-v0", train_steps=2048)
    flown = timed(drone, AgentBlock(), 0.0, command, clock_speed), training(drone, AgentBlock(), seed=0)
    tasks: Any = [getattr(env.unwrapped, "task") for env in flown]  # noqa: B009  it has no type
    assert [(task.timing, task.command, task.clock_speed) for task in tasks] == [
        ("virtual", command, clock_speed),
        ("virtual", "adsc", 1.0),
    ]
    for env in flown:
        env.close()


# --- reports ---


def row_of(agent: str, command: str, latency_s: float, clock_speed: float, mean: float, **keys: Any) -> Any:
    """An evaluation of two episodes that return 2 less and 2 more than the mean."""
    case = f"{agent}-{command}-{latency_s:g}-{clock_speed:g}-{keys.get('seed', 0)}"
    row: dict[str, Any] = {
        "suite": "realtime",
        "kind": "evaluation",
        "case": case,
        "timing": "virtual",
        "environment": "pendulum",
    }
    row |= {"agent": agent, "seed": 0, "command": command, "latency_s": latency_s, "clock_speed": clock_speed}
    return row | {"returns": [mean - 2, mean + 2], "delays_s": [latency_s * clock_speed] * 2, "late_s": 0.0} | keys


def made(path: Path, *rows: Any, **options: Any) -> RunDirectory:
    run = RunDirectory.create(path, configured("realtime_smoke", *TINY, **options), {})
    for row in rows:
        run.append_row(row)
    return run


def ranking_of(path: Path, means: dict[tuple[str, float], float]) -> dict[str, Any]:
    """The ranking of agents by their means by agent and ClockSpeed, each within 2 of it."""
    rows = [row_of(agent, "adsc", 0.05, speed, mean) for (agent, speed), mean in means.items()]
    stopped = [row_of("c", "tcsc", 0.05, speed, 99.0) for speed in (1.0, 5.0)]  # rankings are of ADSC
    (ranking,) = Realtime().report(made(path, *rows, *stopped)).summary["rankings"]
    return dict(ranking)


def test_a_ranking_holds_until_two_agents_change_places_for_sure(tmp_path: Path) -> None:
    means = {("a", 1.0): 10.0, ("b", 1.0): 5.0, ("c", 1.0): 0.0, ("a", 5.0): 6.0, ("b", 5.0): 6.5, ("c", 5.0): 0.0}
    held = ranking_of(tmp_path / "held", means)
    assert (held["holds_to"], held["reversals"]) == (5, [])  # b is ahead of a, but their intervals overlap
    assert held["kendall_tau"] == [1.0, pytest.approx(1 / 3)]
    assert held["orders"] == [["a", "b", "c"], ["b", "a", "c"]]
    broken = ranking_of(tmp_path / "broken", means | {("a", 20.0): 1.0, ("b", 20.0): 2.0, ("c", 20.0): 19.0})
    assert broken["holds_to"] == 5
    assert broken["reversals"] == [{"clock_speed": 20, "ahead": "c", "behind": each} for each in ("a", "b")]


@pytest.mark.parametrize(("reversed_at", "holds_to"), [((), 50), ((5, 20), 1), ((20, 50), 5), ((5,), 1), ((5, 50), 1)])
def test_a_ranking_holds_up_to_the_last_clock_speed_before_the_first_change(
    tmp_path: Path, reversed_at: tuple[float, ...], holds_to: float
) -> None:
    pairs = [(agent, speed) for speed in (50.0, 1.0, 20.0, 5.0) for agent in ("a", "b")]
    means = {(agent, speed): 19.0 if (agent == "a") != (speed in reversed_at) else 2.0 for agent, speed in pairs}
    ranking = ranking_of(tmp_path / "run", means)
    assert (ranking["clock_speeds"], ranking["holds_to"]) == ([1, 5, 20, 50], holds_to)
    found = [(change["clock_speed"], change["ahead"], change["behind"]) for change in ranking["reversals"]]
    assert found == [(speed, "b", "a") for speed in reversed_at]


def test_a_cell_is_of_all_trainings_and_tcsc_is_held_against_its_own(tmp_path: Path) -> None:
    rows = [row_of("a", "tcsc", 0.0, 1.0, 2.0, delays_s=[0.0, 0.1]), row_of("a", "tcsc", 0.0, 1.0, 8.0, seed=1)]
    rows[1] |= {"delays_s": [0.5, 0.1], "late_s": 0.3}
    alone = Realtime().report(made(tmp_path / "alone", *rows)).summary
    (cell,) = alone["cells"]
    assert (cell["return_mean"], cell["seeds"], cell["episodes"], cell["late_s"]) == (5.0, 2, 4, 0.3)
    assert 0.0 <= cell["return_low"] < 5.0 < cell["return_high"] <= 10.0
    assert cell["delay_s"] == pytest.approx(0.1)
    rows += [row | {"clock_speed": 5.0, "case": f"{row['case']}-fast"} for row in rows]
    equal = Realtime().report(made(tmp_path / "equal", *rows, row_of("a", "adsc", 0.0, 5.0, 7.0))).summary
    other = Realtime().report(made(tmp_path / "other", *rows, row_of("a", "tcsc", 0.0, 9.0, 2.5))).summary
    said = [each["tcsc_equal_at_every_clock_speed"] for each in (alone, equal, other)]
    assert said == [None, True, False]
    training: dict[str, Any] = {
        "suite": "realtime",
        "kind": "training",
        "case": "pendulum-a-s0",
        "environment": "pendulum",
    }
    training |= {"agent": "a", "seed": 0, "steps": 1, "last_return": 0.0, "weights_sha256": "0" * 64}
    begun = Realtime().report(made(tmp_path / "none", training))
    with pytest.raises(UserError, match="holds no finished evaluation yet"):
        begun.write()


def test_the_page_tells_each_return_and_ranking_in_its_column(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two agents the naive one is ahead in real time, and behind at 4x where latency is 50 ms."""
    drawn = record_figures(monkeypatch)
    run = RunDirectory.create(tmp_path / "run", configured("realtime_smoke", *TINY), {})
    for latency_s in (0.3, 0.0, 0.05):
        for speed in (1.0, 4.0):
            mean = 3 if (latency_s, speed) == (0.05, 4.0) else 20
            run.append_row(row_of("naive", "adsc", latency_s, speed, mean))
            run.append_row(row_of("chunk", "adsc", latency_s, speed, 10, late_s=0.004))
    run.append_row(row_of("naive", "tcsc", 0.3, 1.0, 20, delays_s=[0.0, 0.0]))
    run.append_row(row_of("naive", "tcsc", 0.3, 4.0, 21, delays_s=[0.0, 0.0]))
    report = Realtime().report(run)
    report.write()
    page = (run.path / "report.md").read_text(encoding="utf-8")
    change = "at 4x chunk is ahead of naive, which beats it at 1x"
    assert report.headline() == (
        f"pendulum, 50 ms: the ranking holds up to 1x; {change}; under TCSC all returns DIFFER at every ClockSpeed"
    )
    shown = report.overview()
    assert shown is not None
    ahead, late = ("20", "18 to 22", "-"), ("10", "8 to 12", "0.004")
    assert shown.rows == [
        ("pendulum", "naive", "ADSC", "0", "1x", "0", *ahead),
        ("pendulum", "chunk", "ADSC", "0", "1x", "0", *late),
        ("pendulum", "naive", "ADSC", "50", "1x", "0.05", *ahead),
        ("pendulum", "chunk", "ADSC", "50", "1x", "0.05", *late),
    ]
    lines = [line for line in page.splitlines() if line.startswith("| pendulum | ")]
    trusting = {tuple(each.strip() for each in line.strip("| ").split("|")) for line in lines}
    assert {line for line in trusting if len(line) == 5} == {
        ("pendulum", "0", "4x", "1.00", "none"),
        ("pendulum", "50", "1x", "-1.00", change),
        ("pendulum", "300", "4x", "1.00", "none"),
    }
    assert ("pendulum", "naive", "TCSC", "300", "4x", "0", "21", "19 to 23", "-") in trusting
    lines_of = labelled(drawn["rankings"].axes[0])
    assert {label: points(line) for label, line in lines_of.items()} == {
        "0 ms": [(1.0, 1.0), (4.0, 1.0)],
        "50 ms": [(1.0, 1.0), (4.0, -1.0)],
        "300 ms": [(1.0, 1.0), (4.0, 1.0)],
    }
    naive = labelled(drawn["returns"].axes[0])["naive"]
    assert points(naive) == [(0.0, 20.0), (0.05, 20.0), (0.2, 3.0), (0.3, 20.0), (1.2, 20.0)]


def test_the_machines_clock_is_held_against_the_simulated_one_in_either_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = record_figures(monkeypatch)
    keys = "agents={naive: {}, chunk: {chunk: 2}}"
    runs = [
        RunDirectory.create(tmp_path / timing, configured("realtime_smoke", *TINY, keys, timing=timing), {})
        for timing in ("virtual", "wall")
    ]
    for run, naive, late_s in zip(runs, (10.0, 8.0), (0.0, 0.03), strict=True):
        run.append_row(row_of("naive", "adsc", 0.05, 1.0, naive, late_s=late_s, delays_s=[0.05 + late_s / 0.6] * 2))
        run.append_row(row_of("chunk", "adsc", 0.05, 1.0, 4.0))
    runs[0].append_row(row_of("naive", "adsc", 0.05, 4.0, 99.0))  # which the machine's clock has not
    for given in (runs, runs[::-1]):
        assert Realtime().compare(given) == [tmp_path / "wall/figures/agreement.png"]
        axes: Any = drawn["agreement"].axes[0]
        shown = {label: points(line) for label, line in labelled(axes).items()}
        assert shown == {"naive": [(10.0, 8.0)], "chunk": [(4.0, 4.0)]}
        said = runs[1].read_json("agreement.json")
        assert (said["cells"], said["late_s"]) == (2, 0.03)
        assert said["return_difference_median"] == pytest.approx(0.1)  # of 0.2 and 0
        assert said["delay_difference_median"] == pytest.approx(0.5)  # of 1 and 0
        assert (said["kendall_tau_mean"], said["kendall_tau_least"]) == (1.0, 1.0)


@pytest.mark.wall_clock
@pytest.mark.slow
def test_on_the_machines_clock_it_flies_what_the_simulated_one_models(run: RunDirectory, tmp_path: Path) -> None:
    """Delays cannot be shorter than the agent's thinking; how much longer depends on the machine."""
    keys = "agents={naive: {}}", "latency_s=[0.05]", "clock_speed=[1]", "command=[adsc]", "episodes=1"
    measured = flown(tmp_path / "wall", *keys, "timing=wall")
    row = next(row for row in measured.rows() if row["kind"] == "evaluation")
    assert row["delays_s"][0] >= 0.05
    (picture,) = Realtime().compare([run, measured])
    assert picture.is_file()
    assert json.loads((measured.path / "agreement.json").read_text())["cells"] == 1


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("environments={x: {id: Nowhere-v0}}", "environments.x: Nowhere-v0 cannot be made: Environment `Nowhere`"),
        ("environments={x: {id: 'os:Nowhere-v0'}}", "environments.x.id: no module 'os' in "),
        ("environments={x: {id: CartPole-v1}}", "environments.x, agents.naive: default_action: a Discrete"),
        ("environments={x: {id: CartPole-v1, default_action: 0}}", "agents.look_ahead: look_ahead: looks into"),
        (
            "environments={x: {id: uavaccel/Hover-v0, keys: {timing: wall}}}",
            "environments.x.keys: a drone has timing of each cell",
        ),
        ("agents={a: {training_delay_s: [0.2, 0.1]}}", "training_delay_s must rise"),
        ("agents={a/b: {}}", "'a/b' names files: letters, digits and _ alone"),
        ("latency_s=[0.1, 0.1]", "latency_s has a latency twice"),
        ("timing=wall", "look_ahead needs timing virtual"),
    ],
)
def test_what_does_not_fit_is_one_line(override: str, said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        Realtime().check(configured("realtime_smoke", *TINY, override))
    assert "\n" not in str(caught.value)


def test_a_module_with_environments_is_the_projects_and_runs_when_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    Realtime().check(config)


def test_what_ships_can_be_made() -> None:
    for path in sorted(Path(experiment("dp1.yaml")).parent.glob("realtime*.yaml")):
        Realtime().check(configured(path.stem))
