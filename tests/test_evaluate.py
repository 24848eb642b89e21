"""Evaluation: baselines on lanes of known geometry, equal bytes, paired comparison, figure, films, policies."""

from __future__ import annotations

import base64
import json
import re
import shutil
from dataclasses import astuple
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch as th

from tests import made_runs as made
from tests.lanes import free_distance_m
from tests.learning import fly_here, side_by_side, tiny_config, train_into
from tests.made_runs import ended_at
from tests.opengl import needs_opengl
from tests.running import configured, fly_into, run_into
from uavaccel.cli.experiments import evaluate_agent
from uavaccel.config import validate
from uavaccel.envs.observer import SecondEventCamera
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.errors import UserError
from uavaccel.files import file_sha256
from uavaccel.records import RunDirectory
from uavaccel.resources import asset
from uavaccel.rl import agents
from uavaccel.rl.agents import OffsetAgent, origin_of
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.learner import make_learner
from uavaccel.rl.policy import MANIFEST, Policy, export_policy, load_policy, make_policy
from uavaccel.sim.lane import lane_seed, sample_layout
from uavaccel.suites import evaluate_again
from uavaccel.suites.evaluate import EvaluateConfig, Evaluation, against, fly_lane, game_seed, row_of
from uavaccel.suites.evaluate_again import flight_of_agent
from uavaccel.suites.flight import film_game, film_of
from uavaccel.suites.report import Summary
from uavaccel.suites.session import RunRequest
from uavaccel.suites.suite import choose_row

pytestmark = pytest.mark.usefixtures("whole_messages")

LANES = 3
FIGURE = "figures/figure8_survival.png"


def evaluated(agent: str, out: Path, *overrides: str, **options: Any) -> Summary:
    """Evaluate on a few lanes; the summary."""
    config = configured("evaluate", *overrides, **{"agent": agent, "games": LANES, **options})
    return run_into(out, Evaluation(), config)


def request(agent: str, out: Path, *overrides: str, **options: Any) -> RunRequest:
    """What the command line asks for."""
    shell = {key: options.pop(key) for key in ("resume",) if key in options}
    return RunRequest("evaluate", {"agent": agent, "games": LANES, **options}, overrides, out=out, **shell)


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    out = tmp_path_factory.mktemp("evaluate") / "straight"
    evaluate_agent(request("straight", out), None, False)
    return RunDirectory(out)


def free_m(lane: int, y_m: float) -> float:
    return free_distance_m(sample_layout(lane_seed("evaluation", lane)), y_m)


# --- baselines --------------------------------------------------------------------------------------------------


def test_straight_flight_gets_as_far_as_the_lane_is_free(straight: RunDirectory) -> None:
    rows = straight.rows()
    assert [row["lane"] for row in rows] == list(range(LANES))
    for row in rows:
        assert row["path_m"][-1][0] == row["distance_m"]
        assert len(row["path_m"]) == row["commands"]
        assert row["distance_m"] == pytest.approx(free_m(row["lane"], 0.0), abs=0.02)
        assert not row["is_success"]
        assert row["collision"]


def test_an_offset_is_reached_and_kept(tmp_path: Path) -> None:
    config = configured("evaluate", agent="offset:-1.5", games=LANES)
    for row in fly_into(tmp_path / "run", Evaluation(), config).rows():
        near = [free_m(row["lane"], -1.5 + off) for off in np.linspace(-0.35, 0.35, 15)]
        assert min(near) - 0.1 <= row["distance_m"] <= max(near) + 0.1


@pytest.mark.parametrize("headings_deg", [[-60.0, -30.0, 0.0, 60.0], [20.0, 0.0, 50.0, -10.0], [3.0, -80.0]])
def test_an_offset_agent_turns_towards_its_offset(headings_deg: list[float]) -> None:
    """By its outermost headings, and goes on by that nearest to the lane's, in whatever order these are."""
    task = configured("evaluate", f"task.headings_deg={headings_deg}", agent="straight").task
    ahead = min(headings_deg, key=abs)
    for off_m, heading_deg in ((-2.0, max(headings_deg)), (-0.1, ahead), (0.0, ahead), (2.0, min(headings_deg))):
        action = OffsetAgent(-1.5, task).act(np.zeros(0), {"position_m": [7.0, off_m - 1.5, -2.0]})
        assert task.headings_deg[action] == heading_deg


# --- results ----------------------------------------------------------------------------------------------------


def test_the_same_bytes_twice(tmp_path: Path, straight: RunDirectory) -> None:
    evaluate_agent(request("straight", tmp_path / "run"), None, False)
    for name in ("rows.jsonl", "summary.json", "config.yaml", FIGURE):
        assert (tmp_path / "run" / name).read_bytes() == (straight.path / name).read_bytes()


@pytest.mark.slow
def test_without_opengl_the_kernels_fly_and_films_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    keys = "simulator=kernels", "task.timing=lockstep", "task.max_commands=2"
    evaluate_agent(request("default", tmp_path / "run", *keys, games=1), None, True)
    assert "\nwithout films: MUJOCO_GL=off switches images off;" in capsys.readouterr().out
    assert (tmp_path / "run" / "report.html").is_file()
    assert not (tmp_path / "run" / "films").exists()


@needs_opengl
def test_films_of_the_best_and_the_worst(tmp_path: Path) -> None:
    evaluate_agent(request("straight", tmp_path / "run", "task.max_commands=2", games=2), None, True)
    made = sorted(path.name for path in (tmp_path / "run/films").iterdir())
    assert made == ["best.mp4", "best.png", "worst.mp4", "worst.png"]
    html = (tmp_path / "run/report.html").read_text()
    assert len(re.findall(r'<video controls preload="metadata" poster="data:image/jpeg;base64,', html)) == 2
    films = re.findall(r'<video [^>]* src="data:video/mp4;base64,([^"]*)"', html)
    assert [base64.b64decode(film) for film in films] == [
        (tmp_path / f"run/films/{name}.mp4").read_bytes() for name in ("best", "worst")
    ]
    with pytest.raises(UserError, match="--case lane-99: not in"):
        film_game(tmp_path / "run", "lane-99", None, tmp_path / "none.mp4")


def test_a_second_event_camera_has_the_noise_of_its_game() -> None:
    """With its own seed where there is noise, from its start, and at its own pace until the next game."""
    done: list[Any] = []
    camera: Any = SecondEventCamera(LaneTask(), 5)
    camera.events = SimpleNamespace(
        start=lambda *told: done.append(told), process_frame=lambda *told: done.append(told)
    )

    def watch(every: int, refresh: Any) -> Any:
        done.append(every)
        refresh(30)
        return lambda: done.append("stopped")

    for seed, noise_hz in ((77, 1.0), (78, 0.0)):
        start, noise = SimpleNamespace(time_ns=10), SimpleNamespace(seed=seed)
        session, task = SimpleNamespace(watch=watch), LaneTask(dvs_shot_noise_hz=noise_hz)
        camera.game_begun(SimpleNamespace(start=start, task=task, noise=noise, picture=str, session=session))
    assert done == [("10", 10, 77), 5, ("30", 30), "stopped", ("10", 10, 0), 5, ("30", 30)]


@pytest.mark.slow
@needs_opengl
@pytest.mark.parametrize(("agent", "keys"), [("straight", ()), ("default", ("task.max_commands=5",))])
def test_a_film_is_of_the_very_game_up_to_its_impact(agent: str, keys: tuple[str, ...], tmp_path: Path) -> None:
    """ADSC's game depends on every message: what is filmed must not ask for more of them than the agent does."""
    config = configured("evaluate", "first_lane=2", *keys, agent=agent, command="adsc", clock_speed=20.0, games=1)
    suite, run = Evaluation(), fly_into(tmp_path / "run", Evaluation(), config)
    row = run.rows()[0]
    film = film_of(suite.flight(suite.report(run), row))
    assert film.hit == (row["collision"] or "")
    assert (np.diff(film.time_s) > 0).all()
    if agent == "straight":
        assert film.hit
        assert film.position_m[-1, 0] == row["distance_m"]
        assert film.decisions is None
        return
    again = film_of(flight_of_agent(config, 2))
    np.testing.assert_array_equal(again.images, film.images)
    assert (film.decisions is None, again.decisions is None) == (False, False)
    for one, other in zip(astuple(film.decisions), astuple(again.decisions), strict=True):  # type: ignore[arg-type]
        np.testing.assert_array_equal(one, other)
    shown: Any = film.decisions
    assert shown.taken.tolist() == row["actions"]
    assert shown.of_sample.tolist() == [0, *(command for command in range(5) for _ in range(3))]
    assert shown.given.shape == (5, *config.task.observation_space().shape)
    assert len({each.tobytes() for each in shown.given}) == 5
    run.write_json("manifest.json", {"policy_sha256": "another"})
    with pytest.raises(UserError, match="default is another policy than the one that flew this run"):
        suite.flight(suite.report(run), row)


@pytest.mark.parametrize(("clock_speed", "least", "most"), [(1.0, 0.9, 1.0), (50.0, 10.0, 50.0)])
def test_the_speed_is_that_of_the_games_own_clock(
    tmp_path: Path, clock_speed: float, least: float, most: float
) -> None:
    summary = evaluated("straight", tmp_path / "run", clock_speed=clock_speed, games=1)
    speed = summary["sim_time_s"] / summary["wall_s"]
    assert summary["simulated_s_per_wall_s"] == speed
    assert least < speed < most


def test_a_decision_takes_wall_time_and_lost_games_keep_their_path(tmp_path: Path) -> None:
    keys = ("task.observation=state", "task.max_commands=3", "games=1")
    took_s = []
    for inference_s in (0.0, 0.5):
        config = configured("evaluate", *keys, agent="straight")
        config = config.model_copy(update={"inference_s": inference_s})
        [row] = fly_into(tmp_path / f"{inference_s}", Evaluation(), config).rows()
        took_s.append(row["wall_s"])
    assert took_s[1] - took_s[0] == pytest.approx(3 * 0.5)
    ended: dict[str, Any] = {
        "commands": 2,
        "collision": None,
        "phase_s": {},
        "distance_m": 9.0,
        "wall_s": 1.0,
        "path_m": [[1.0, 2.0]],
    }
    rows = [row_of(config, 3, ended | {"is_success": won}, [2, 2]) for won in (True, False)]
    assert ["path_m" in row for row in rows] == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "keys"),
    [
        ({}, {}),
        ({"observation": "state", "history": 2}, {"algorithm": "sb3_dqn", "mirror": False}),
        ({}, {"algorithm": "sb3_ppo", "mirror": False, "options": {}}),
    ],
    ids=["double_dqn", "dqn-state", "sb3_ppo"],
)
def test_an_exported_policy_acts_as_the_model(tmp_path: Path, task: dict[str, Any], keys: dict[str, Any]) -> None:
    headings = [30.0, -60.0, 0.0, 60.0, -30.0]  # the policy's actions, in this order
    config = tiny_config(task | {"headings_deg": headings}, **keys)
    environment = side_by_side(config)
    learner = make_learner(config, environment)
    export_policy(tmp_path, learner.policy, config, {"games": 0})
    policy = load_policy(tmp_path)
    rng = np.random.default_rng(0)
    shape = (50, *(environment.single_observation_space.shape or ()))
    seen = rng.integers(0, 256, shape).astype(environment.single_observation_space.dtype)
    model = Policy(learner.policy.eval(), config, {})
    np.testing.assert_array_equal(policy.act(seen), model.act(seen))
    rated_as, ratings = policy.rate(seen)
    assert ratings.shape == (50, 5)
    np.testing.assert_array_equal(ratings.argmax(axis=1), policy.act(seen))
    chances = rated_as == "probabilities of the actions"
    assert chances == (config.algorithm == "sb3_ppo") == bool(np.allclose(ratings.sum(axis=1), 1.0, atol=1e-5))
    assert policy.config.task == config.task
    assert policy.manifest["actions_heading_deg"] == headings
    environment.close()


@pytest.mark.parametrize(
    ("observation", "shape", "said"),
    [
        ("dvs", (4, 36, 64), "a frame every T_sample of a command"),
        ("colour", (12, 36, 64), "colour"),
        ("depth", (4, 36, 64), "depth"),
        ("state", (4, 13), "state"),
    ],
)
def test_a_manifest_describes_what_is_observed_and_done(
    observation: str, shape: tuple[int, ...], said: str, tmp_path: Path
) -> None:
    """Two frames of a command, of the last two commands; the file has the online network alone."""
    flight = {"t_move_s": 1.0, "t_sample_s": 0.5, "history": 2, "headings_deg": [20.0, 0.0, -20.0]}
    config = tiny_config({"observation": observation, **flight}, mirror=False)
    network = make_policy(config)
    export_policy(tmp_path, network, config, {"games": 7})
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    assert manifest["preprocessing"].startswith(said)
    assert (manifest["observation_shape"], manifest["actions_heading_deg"]) == ([*shape], [20.0, 0.0, -20.0])
    assert (manifest["weights"], manifest["trained"]) == ("policy.pt", {"games": 7})
    assert manifest["weights_file_sha256"] == file_sha256(tmp_path / "policy.pt")
    assert "latency" not in manifest["config"]["task"]
    kept = th.load(tmp_path / "policy.pt", weights_only=True)
    online = {name: each for name, each in network.state_dict().items() if name.startswith("q_net.")}
    assert kept.keys() == online.keys()
    assert all(th.equal(kept[name], each) for name, each in online.items())


@needs_opengl
def test_the_policy_that_ships_flies_a_lane(tmp_path: Path) -> None:
    manifest = json.loads((asset("policies/default") / MANIFEST).read_text())
    assert manifest["preprocessing"]
    summary = evaluated("default", tmp_path / "run", games=1)
    assert summary["games"] == 1
    assert summary["distance_m_median"] > 50.0


@pytest.mark.slow
@needs_opengl
def test_a_trainings_run_directory_is_an_agent_and_is_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fly_here(monkeypatch.setattr)
    training = tmp_path / "training"
    train_into(training, tiny_config({"max_commands": 4}, games=1))
    summary = evaluated(str(training), tmp_path / "run", "task.max_commands=3", games=1)
    assert summary["games"] == 1
    film = tmp_path / "films/mine/lane.mp4"
    assert film_game(training, "lane-000004", None, film) == (film, film.with_suffix(".png"))
    with pytest.raises(UserError, match="--case 4: must be an evaluation lane, as lane-000007"):
        film_game(training, "4", None, tmp_path / "lane.mp4")


# --- keys of the task -------------------------------------------------------------------------------------------


def test_an_agent_flies_with_what_it_was_trained_with(tmp_path: Path) -> None:
    trained = load_policy(asset("policies/default")).config.task
    task = configured("evaluate", "task.dvs_preset=noisy", "task.speed_m_s=1.5").task
    assert (task.dvs_preset, task.speed_m_s) == ("noisy", 1.5)
    kept = ("observation", "history", "dvs_seed", "t_move_s", "t_sample_s", "headings_deg", "altitude_m")
    assert {key: getattr(task, key) for key in kept} == {key: getattr(trained, key) for key in kept}
    for more, timing in (("", "virtual"), ("task: {timing: lockstep}", "lockstep")):  # whatever it was trained under
        (tmp_path / "own.yaml").write_text(f"suite: evaluate\n{more}\n")
        assert configured(str(tmp_path / "own.yaml")).task.timing == timing
    shutil.copytree(asset("policies/default"), tmp_path / "mine")
    (tmp_path / "own.yaml").write_text("suite: evaluate\nagent: mine\n")
    (tmp_path / "more.yaml").write_text("suite: train\nstart_from: mine\nhidden: [8]\n")
    assert configured(str(tmp_path / "own.yaml")).agent == str(tmp_path / "mine"), "a path is one beside the file, too"
    with pytest.raises(UserError, match=f"start_from = '{re.escape(str(tmp_path))}/mine': another network"):
        configured(str(tmp_path / "more.yaml"))


def test_senses_and_flight_alone_are_those_of_the_training(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of them another than where nothing is said; what a policy is tried under stays the evaluation's."""
    like_trained: dict[str, Any] = {
        "observation": "dvs", "history": 2, "knows": ["frame_age"], "blank_images": True, "dvs_preset": "noisy",
        "dvs_seed": 5, "dvs_threshold_ratio": 1.5, "dvs_spread_ratio": 2.0, "dvs_shot_noise_hz": 3.0,
        "dvs_leak_hz": 0.5, "dvs_hot_pixels": 0.01, "image_noise": 4.0, "dvs_rate_hz": 100.0, "t_move_s": 0.8,
        "t_sample_s": 0.2, "speed_m_s": 1.5, "headings_deg": [-20.0, 20.0], "altitude_m": 3.0,
        "also_state": True, "picture_size": [256, 144],
    }  # fmt: skip
    others = {"timing": "virtual", "command": "adsc", "clock_speed": 5.0, "max_commands": 9, "goal_reward": 2.0}
    task = LaneTask(**{**like_trained, **others, "observation": "dvs"})
    monkeypatch.setattr(agents, "read_manifest", lambda folder: ({}, LearnerConfig(task=task, mirror=False)))
    assert origin_of("a/policy").keys() == like_trained
    assert origin_of("straight").keys() == {"observation": "state", "history": 1}
    hover = {"speed_m_s": 3.0, "hold_s": 1.0, **others, "latency": {}, "profile": "airsim", "report_host_times": True}
    kept = {"speed_m_s": 3.0, "hold_s": 1.0, "max_commands": 9, "goal_reward": 2.0}
    assert agents.kept_keys("uavaccel/Hover-v0", hover) == kept, "elsewhere all but the clock"


@needs_opengl
def test_a_noisy_sensor_is_what_flies(tmp_path: Path) -> None:
    """What is recorded as flown was flown: another sensor leads to other actions."""
    runs = []
    for preset in ("clean", "noisy"):
        keys = f"task.dvs_preset={preset}", "task.max_commands=12", "first_lane=4", "games=1"
        runs.append(fly_into(tmp_path / preset, Evaluation(), configured("evaluate", *keys, agent="default")))
    assert runs[1].config()["task"]["dvs_preset"] == "noisy"
    assert runs[0].rows()[0]["actions"] != runs[1].rows()[0]["actions"]


@pytest.mark.parametrize(
    ("agent", "overrides", "said"),
    [
        ("nowhere", (), "nowhere: holds no policy.*"),
        ("default", ("task.knows=[]", "task.picture_size=[64, 36]"),
         re.escape("task.picture_size = (64, 36): default was trained with (256, 144)")),
        *(
            (f"offset:{wrong}", (), f"offset:{wrong}: must be offset:METRES, .* within the lane of 10 m.*")
            for wrong in ("left", "", "nan", "-10.1", "10.1", "-inf")
        ),
        *(
            ("default", (override,), re.escape(said))
            for override, said in (
                ("task.history=1", "task.history = 1: default was trained with 2"),
                ("task.also_state=true", "task.also_state = True: default was trained with False"),
                ("task.knows=[frame_age]", "task.knows = ('frame_age',): default was trained with ('last_action',)"),
                ("task.observation=depth", "task.observation = 'depth': default was trained with 'dvs'"),
                ("task.t_sample_s=0.5",
                 "task.t_sample_s = 0.5: 4 frames per observation, but default was trained with 6"),
                ("task.headings_deg=[-30, 0, 30]", "task.headings_deg: 3 actions, but default was trained with 5"),
            )
        ),
    ],
)  # fmt: skip
def test_an_agent_that_cannot_fly_is_refused_at_once(
    agent: str, overrides: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    with pytest.raises(UserError) as caught:
        evaluate_agent(request(agent, tmp_path / "run", *overrides, games=1), None, False)
    assert re.fullmatch(said, str(caught.value)), "one line"
    assert not (tmp_path / "run").exists()


def test_measured_flights_are_filmed_by_the_events_of_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which a baseline may be given; what else it would see is no film where it was measured."""
    made: list[str] = []

    def make(**task: Any) -> Any:
        made.append(task["observation"])
        return SimpleNamespace(close=lambda: None)

    monkeypatch.setattr(evaluate_again, "environment_class", lambda env_id: make)
    monkeypatch.setattr(evaluate_again, "_flight", lambda *_: None)
    config = configured("evaluate", agent="straight", timing="wall")
    for pictures in (True, False):
        flight_of_agent(config, 0, pictures)
    assert made == ["dvs", "state"]
    monkeypatch.setattr(evaluate_again, "origin_of", lambda agent: None)  # no baseline
    with pytest.raises(UserError, match="timing = 'wall': of state there is no film; take virtual or lockstep"):
        flight_of_agent(config, 0)
    flight_of_agent(configured("evaluate", agent="straight", timing="virtual"), 0)
    assert made[2:] == ["state"], "a simulated clock waits for its own pictures"


# --- reports: tests/test_reports.py has their numbers -----------------------------------------------------------


def test_a_game_has_a_seed_of_its_lane_and_the_run() -> None:
    configs = [validate(EvaluateConfig, {"agent": "straight", "seed": seed}, "test") for seed in (0, 1)]
    assert len({game_seed(config, lane) for config in configs for lane in range(50)}) == 100
    seed = game_seed(configs[1], 3)
    assert game_seed(configs[0], 3) == np.random.SeedSequence([0, 3]).generate_state(1)[0] != seed
    told: list[Any] = []

    def reset(**given: Any) -> tuple[None, dict[str, Any]]:
        told.append(given)
        return None, {}

    agent: Any = SimpleNamespace(act=lambda *seen: 2, reset=told.append)
    environment: Any = SimpleNamespace(reset=reset, charge=told.append, step=lambda _: (None, 0.0, True, False, {}))
    assert [step.action for step in fly_lane(configs[1], environment, agent, 3)] == [2]
    assert told == [{"seed": seed, "options": {"lane": 3}}, seed, configs[1].inference_s], (
        "both begin with the game's own seed"
    )


def test_the_paired_comparison_is_mcnemars_on_common_lanes(tmp_path: Path) -> None:
    run = made.evaluated(tmp_path / "run", *ended_at(150.0, 150.0, 150.0, 20.0, 150.0))
    other = made.evaluated(tmp_path / "other", *({"lane": lane, "is_success": lane == 3} for lane in (4, 3, 1, 2, 9)))
    # Of lanes 1 to 4 three were won by the first alone, one by the other alone: 2 * (1 + 4) / 2**4.
    assert against(run.run, other.run) == (
        f"against {other.run.path} on the same 4 lanes: 3 v 1 successes, +50.0 [-39.9, +90.9] points, "
        "exact McNemar p = 0.625"
    )
    with pytest.raises(UserError, match="elsewhere: is no evaluation of the same lanes"):
        against(run.run, made.evaluated(tmp_path / "elsewhere", {"lane": 77}).run)
    test = made.evaluated(tmp_path / "test", *ended_at(150.0, 20.0), task={"split": "test"})
    assert test.headline().startswith("The agent straight wins 1 of 2 test lanes with TCSC at 1x")
    with pytest.raises(UserError, match="test: is no evaluation of the same lanes"):
        against(run.run, test.run)  # whose numbers are the same


def test_the_best_game_is_shown_unless_one_is_named(tmp_path: Path) -> None:
    """From the success in the fewest commands to the failure with the least distance."""
    order = [(True, 20, 150.0), (True, 30, 150.0), (False, 9, 90.0), (False, 3, 1.0)]
    rows = [{"is_success": won, "commands": n, "distance_m": m} for won, n, m in order[::-1]]
    suite, report = Evaluation(), made.evaluated(tmp_path / "run", *rows)
    assert choose_row(suite, report)["commands"] == 20
    assert [row["lane"] for row in sorted(report.rows, key=suite.interest)] == [3, 2, 1, 0]
    assert choose_row(suite, report, "lane-000001")["lane"] == choose_row(suite, report, number=1)["lane"] == 1
    with pytest.raises(UserError, match=r"--case lane-99: not in"):
        choose_row(suite, report, "lane-99")
    for number in (-1, 4):
        with pytest.raises(UserError, match=rf"--game {number}: .* has 4 games, from 0 to 3"):
            choose_row(suite, report, number=number)
