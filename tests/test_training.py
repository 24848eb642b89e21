"""Training: equal weights in every timing and after a kill, schedules on games, the Double DQN target, algorithms."""

from __future__ import annotations

import hashlib
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch as th

from tests.learning import side_by_side, tiny_config, train_into
from tests.opengl import needs_opengl
from tests.running import configured
from uavaccel.config import to_yaml
from uavaccel.envs.batch import LanesHere
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError
from uavaccel.files import append_lines, to_json
from uavaccel.records import RunDirectory
from uavaccel.resources import asset
from uavaccel.rl import lanes
from uavaccel.rl.agents import make_agent
from uavaccel.rl.double_dqn import HostDQN
from uavaccel.rl.lanes import make_lanes, start_exact_lanes
from uavaccel.rl.learner import LearnerState, find_checkpoint, games_of, load_checkpoint, make_learner, save_checkpoint
from uavaccel.rl.policy import load_policy, trained_with, weights_sha256
from uavaccel.suites import trainer
from uavaccel.suites.evaluate import EvaluateConfig, fly_game
from uavaccel.suites.runner import run_suite, start_run
from uavaccel.suites.suite import GameResult
from uavaccel.suites.train import CHECKPOINTS, EVALUATIONS, Training, evaluations
from uavaccel.suites.trainer import Evaluations, evaluation_of
from uavaccel.units import NS_PER_S

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("trainings_here")]

STATE = {"observation": "state"}  # needs no pictures, hence no OpenGL
EVALUATED = {"evaluate_every_games": 3, "evaluation_games": 2}
PPO = {"algorithm": "sb3_ppo", "options": {"n_steps": 8, "batch_size": 8}}


@pytest.fixture(scope="module")
def lockstep(trainings_here: None, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """A training in `lockstep`."""
    out = tmp_path_factory.mktemp("training") / "run"
    train_into(out, tiny_config())
    return RunDirectory(out)


# --- equal weights ----------------------------------------------------------------------------------------------


@needs_opengl
def test_tcsc_learns_the_same_weights_at_any_clock_speed(tmp_path: Path, lockstep: RunDirectory) -> None:
    task = {"timing": "virtual", "clock_speed": 100.0}
    train_into(tmp_path / "fast", tiny_config(task))
    train_into(tmp_path / "other", tiny_config(seed=1))
    runs = [lockstep, *(RunDirectory(tmp_path / name) for name in ("fast", "other"))]
    slow, fast, other = (run.read_json("summary.json")["weights_sha256"] for run in runs)
    assert slow == fast != other
    flown, again, others = ([(row["lane"], row["distance_m"], row["commands"]) for row in run.rows()] for run in runs)
    assert flown == again
    assert not {lane for lane, *_ in flown} & {lane for lane, *_ in others}


def test_adsc_does_not(tmp_path: Path) -> None:
    task = {**STATE, "command": "adsc", "timing": "virtual"}
    slow, fast = (
        train_into(tmp_path / f"{clock:g}", tiny_config(task | {"clock_speed": clock}, mirror=False))
        for clock in (1.0, 100.0)
    )
    assert slow["weights_sha256"] != fast["weights_sha256"]


@needs_opengl
@pytest.mark.parametrize("seen", [{}, {"observation": "depth", "also_state": True}], ids=["events", "depth, state"])
def test_a_training_cut_short_ends_with_the_same_weights(tmp_path: Path, seen: dict[str, Any]) -> None:
    config = tiny_config({"timing": "virtual", "max_commands": 6, **seen}, games=6, mirror=not seen)
    cut = start_run(Training(), config, tmp_path / "cut", {})
    with pytest.raises(RuntimeError, match="stopped"):
        run_suite(Training(), config, cut, on_game=stop_after(5))
    assert (len(cut.rows()), checkpointed(cut.path)) == (5, 4)
    assert train_into(cut.path, config, resume=True) == train_into(tmp_path / "whole", config)
    assert (cut.path / "rows.jsonl").read_bytes() == (tmp_path / "whole/rows.jsonl").read_bytes()


def checkpointed(run: Path) -> int:
    """The games after which the last checkpoint of a run was taken."""
    checkpoint = find_checkpoint(run / CHECKPOINTS)
    assert checkpoint is not None
    return int(checkpoint.name)


def test_a_batch_systems_end_leaves_a_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: Callable[[str], str]
) -> None:
    config = tiny_config(STATE, mirror=False, games=100_000, checkpoint_games=100_000)
    (tmp_path / "train.yaml").write_text(to_yaml(config))
    append, run = RunDirectory.append_row, tmp_path / "run"

    def end_after(self: RunDirectory, row: Any, on_disk: bool = True) -> None:
        append(self, row, on_disk)
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(RunDirectory, "append_row", end_after)
    told = said(f"train {tmp_path / 'train.yaml'} --out {run}")
    assert told == f"uavaccel: interrupted; go on with: uavaccel train --resume --out {run}"
    assert checkpointed(run) == len(RunDirectory(run).rows()) > 0


def stop_after(games: int) -> Any:
    def stop(case: Any, row: Any) -> None:
        if row["game"] + 1 == games:
            raise RuntimeError("stopped")

    return stop


def test_a_training_names_the_weights_that_it_starts_from() -> None:
    config = tiny_config(torch_threads=3)
    assert Training().provenance(config) == {"torch_threads": 3}
    weights = (asset("policies/default") / "policy.pt").read_bytes()
    assert Training().provenance(config.model_copy(update={"start_from": "default"})) == {
        "torch_threads": 3,
        "start_from_sha256": hashlib.sha256(weights).hexdigest(),
    }


def test_a_training_that_is_over_goes_on_for_more_games(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It computes in its own number of threads, and Ctrl-C is the program's again."""
    run, short = tmp_path / "run", tiny_config(STATE, mirror=False, torch_threads=3)
    threads, ctrl_c = list[int](), signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(th, "set_num_threads", threads.append)
    over = train_into(run, short)
    assert (threads[0], signal.getsignal(signal.SIGINT)) == (3, ctrl_c)
    (run / "policy.json").unlink()  # killed after the last row, before the policy was written
    for _ in range(2):
        assert train_into(run, short, resume=True) == over
    with pytest.raises(UserError, match="games = 3: 4 were asked for before, and a run that goes on can only have"):
        train_into(run, short.model_copy(update={"games": 3}), resume=True)
    before, kept = (run / "rows.jsonl").read_bytes().splitlines(), checkpointed(run)
    assert train_into(run, short.model_copy(update={"games": 7}), resume=True)["games"] == 7
    assert (run / "rows.jsonl").read_bytes().splitlines()[:kept] == before[:kept]
    assert RunDirectory(run).config()["games"] == 7
    assert len(list((run / CHECKPOINTS).iterdir())) == 1, "older ones make room"
    unsaved = tiny_config(STATE, mirror=False, games=2, checkpoint_games=9)
    train_into(tmp_path / "unsaved", unsaved)
    with pytest.raises(UserError, match=r"games = 4: 2 were asked for before, and there is no checkpoint in .*points;"):
        train_into(tmp_path / "unsaved", unsaved.model_copy(update={"games": 4}), resume=True)
    assert len(RunDirectory(tmp_path / "unsaved").rows()) == 2


def test_a_checkpoint_gives_each_lane_its_own_state_back(tmp_path: Path) -> None:
    """Also of more than ten, of other shapes and without some; the newest that is whole is the only one."""
    states: list[Any] = [
        {"at.x": np.array([lane, 0.5]), "over": np.array(lane > 4), "text": "n" * lane, "own": np.zeros(lane)}
        for lane in range(12)
    ]
    del states[3]["text"]
    put: list[Any] = []

    def set_states(given: Any) -> Any:
        put.extend({name: each.tolist() for name, each in state.items()} for state in given)
        return np.arange(12)

    lanes = SimpleNamespace(num_envs=12, get_states=lambda: states, set_states=set_states)
    kept = LearnerState({"weights": th.ones(2)}, {"rewards": np.arange(3.0)}, {"returns": [0.25, 1.5]})
    back: list[Any] = []
    learner: Any = SimpleNamespace(lanes=lanes, get_state=lambda: kept, set_state=lambda *given: back.extend(given))
    for learner.games in (5, 12):
        save_checkpoint(tmp_path, learner)
    newest = tmp_path / "0000012"
    assert ([*tmp_path.iterdir()], find_checkpoint(tmp_path / "elsewhere")) == ([newest], None)
    load_checkpoint(newest, learner)
    assert games_of(newest) == 12
    assert put == [{name: np.asarray(each).tolist() for name, each in state.items()} for state in states]
    assert back[1].tolist() == list(range(12))
    assert (back[0].counters, back[0].arrays["rewards"].tolist()) == (kept.counters, [0, 1, 2])
    assert th.equal(back[0].tensors["weights"], th.ones(2))
    for name in ("0000003", "0000007", "0000020"):
        (tmp_path / name).mkdir()
        (tmp_path / name / ("learner.pt" if name == "0000020" else "state.json")).touch()
    assert find_checkpoint(tmp_path) == newest
    lanes.num_envs = 11
    with pytest.raises(UserError, match=r"^the checkpoint has 12 environments; go on with as many$"):
        load_checkpoint(newest, learner)
    (newest / "games.npz").unlink()
    with pytest.raises(UserError, match=r"0000012: a damaged .* delete it and --resume to go on from 0000007$"):
        load_checkpoint(newest, learner)


def test_evaluations_leave_the_training_as_it_is(tmp_path: Path) -> None:
    config, without = (tiny_config(STATE, mirror=False, **keys) for keys in (EVALUATED, {}))
    summary = train_into(tmp_path / "evaluated", config)
    run, plain = RunDirectory(tmp_path / "evaluated"), start_run(Training(), without, tmp_path / "plain", {})
    run_suite(Training(), without, plain)
    assert trained_with(plain.path) == trained_with(run.path)
    assert (plain.path / "rows.jsonl").read_bytes() == (run.path / "rows.jsonl").read_bytes()
    first, last = evaluations(run)
    kept = [trained_with(run.path / f"policies/{games:07d}") for games in (3, 4)]
    assert [each["weights_sha256"] for each in kept] == [first["weights_sha256"], last["weights_sha256"]]
    assert [first["games"], last["games"]] == [each["games"] for each in summary["evaluations"]] == [3, 4]
    assert last["weights_sha256"] == summary["weights_sha256"] != first["weights_sha256"]
    flown = evaluation_of(config, run.path)  # whose policy is that of the last evaluation
    environment, agent = ObstacleLane(**flown.task.model_dump(mode="json")), make_agent(flown.agent, flown.task)
    rows = [fly_game(flown, environment, agent, lane) for lane in last["lanes"]]
    environment.close()
    assert (last["is_success"], last["distance_m"]) == tuple(
        [row[key] for row in rows] for key in ("is_success", "distance_m")
    )
    assert min(last["lanes"]) >= 500_000
    with pytest.raises(UserError, match="evaluate_every_games must be 0 with timing wall"):
        tiny_config({**STATE, "timing": "wall"}, mirror=False, **EVALUATED)


def test_an_evaluation_flies_lanes_that_no_training_has(tmp_path: Path) -> None:
    """In the exact simulator; a decision takes the simulated time that it takes in the training."""
    task = {**STATE, "timing": "virtual", "command": "adsc", "clock_speed": 7.0, "altitude_m": 3.0}
    keys = {"seed": 6, "environments": 3, "inference_s": 0.125, "simulator": "kernels"}
    config = tiny_config(task, mirror=False, **keys, evaluation_games=2)
    flown = evaluation_of(config, tmp_path)
    assert flown.task == config.task.model_copy(update={"split": "evaluation"})
    assert {name: getattr(flown, name) for name in flown.model_fields_set - {"task"}} == {
        "agent": str(tmp_path), "seed": 6, "games": 2, "first_lane": 500_000, "environments": 2, "inference_s": 0.125,
        "env_id": "uavaccel/ObstacleLane-v0",
    }  # fmt: skip
    assert flown.simulator == "mujoco"


def test_evaluations_are_due_after_every_so_many_games(tmp_path: Path) -> None:
    """By the games of the latest one, of which a resumed training reads; several games may end at once."""
    due = {
        (0, 0): [], (0, 6): [], (3, 0): [3, 4, 5, 6, 7, 8], (3, 3): [6, 7, 8], (3, 4): [6, 7, 8], (3, 6): [8],
        (3, 7): [8], (3, 8): [], (5, 0): [5, 6, 7, 8], (5, 5): [8], (5, 6): [8],
    }  # fmt: skip
    line = {"weights_sha256": "0" * 64, "successes": 1, "lanes": [0], "is_success": [True], "distance_m": [150.0]}
    for (every, done), games in due.items():
        run: Any = SimpleNamespace(path=tmp_path / f"{every}-{done}")
        for earlier in sorted({1, done}) if done else []:
            run.path.mkdir(exist_ok=True)
            append_lines(run.path / EVALUATIONS, [to_json(line | {"games": earlier})])
        waiting = Evaluations(tiny_config(STATE, mirror=False, games=8, evaluate_every_games=every), run)
        assert [each for each in range(9) if waiting.due(each)] == games, (every, done)


class GamesHere:
    """As GamesInBatch, but in this process, on whose clock a game takes an hour and each reading a second."""

    now_s = 0

    @classmethod
    def now_ns(cls) -> int:
        cls.now_s += 1
        return cls.now_s * NS_PER_S

    def __init__(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        self._environment = ObstacleLane(**config.task.model_dump(mode="json"))
        self.begin(config, lanes)

    def begin(self, config: EvaluateConfig, lanes: Sequence[int]) -> None:
        self._config, self._agent = config, make_agent(config.agent, config.task)

    def game(self, lane: int) -> GameResult:
        GamesHere.now_s += 3600
        return GameResult(fly_game(self._config, self._environment, self._agent, lane))

    def close(self) -> None:
        self._environment.close()


def test_evaluations_after_a_checkpoint_are_flown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wall time of a training leaves them out."""
    monkeypatch.setattr(trainer, "GamesInBatch", GamesHere)
    monkeypatch.setattr(trainer, "MonotonicClock", lambda: GamesHere)
    config = tiny_config(STATE, mirror=False, games=7, checkpoint_games=3, **EVALUATED)
    whole, cut = (start_run(Training(), config, tmp_path / name, {}) for name in ("whole", "cut"))
    run_suite(Training(), config, whole)
    with pytest.raises(RuntimeError, match="stopped"):
        run_suite(Training(), config, cut, on_game=stop_after(6))
    assert [line["games"] for line in evaluations(cut)] == [3, 6]
    (cut.path / EVALUATIONS).write_bytes((cut.path / EVALUATIONS).read_bytes()[:-9])  # died while it wrote
    Training().prepare(config, cut)
    assert [line["games"] for line in evaluations(cut)] == [3]  # what the checkpoint of 3 games knows
    run_suite(Training(), config, cut)
    assert [line["games"] for line in evaluations(cut)] == [3, 6, 7]
    assert whole.timings()[-1]["wall_s"] < 3600
    for file in (EVALUATIONS, "rows.jsonl", "policies/0000006/policy.json"):
        assert (cut.path / file).read_bytes() == (whole.path / file).read_bytes()


def test_processes_learn_what_one_would(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of them, and two that fly in turns, stopped and resumed in this one."""
    config = tiny_config(STATE, mirror=False, environments=2)
    keys: dict[str, Any] = {"turns": 2, "games": 8, "checkpoint_games": 3, "inference_s": 0.05}
    turns = tiny_config({**STATE, "timing": "virtual"}, mirror=False, environments=2, **keys)
    one, whole = train_into(tmp_path / "one", config), train_into(tmp_path / "whole", turns)
    assert {row["environment"] for row in RunDirectory(tmp_path / "one").rows()} == {0, 1}
    with monkeypatch.context() as patch:
        patch.setattr(trainer, "make_lanes", make_lanes)
        patch.setattr(lanes, "start_exact_lanes", start_exact_lanes)
        assert train_into(tmp_path / "processes", config) == one
        with pytest.raises(RuntimeError, match="stopped"):
            run_suite(Training(), turns, start_run(Training(), turns, tmp_path / "cut", {}), on_game=stop_after(7))
    assert train_into(tmp_path / "cut", turns, resume=True) == whole


def test_on_the_machines_clock_nothing_learns_while_it_flies() -> None:
    """Both are in this process."""
    config = tiny_config({**STATE, "timing": "wall"}, mirror=False, environments=1)
    with closing(make_lanes(config)) as flown:
        assert isinstance(flown, LanesHere)


# --- schedules and records --------------------------------------------------------------------------------------


@needs_opengl
def test_a_training_leaves_rows_times_summary_and_curves(tmp_path: Path, lockstep: RunDirectory) -> None:
    """Exploration falls with games, however long they are: from 1 to 0.01 over the first 0.3, as before each's end."""
    train_into(tmp_path / "run", tiny_config({"max_commands": 6}, games=4))
    for run in (lockstep, RunDirectory(tmp_path / "run")):
        explored = [row["exploration"] for row in run.rows()]
        assert explored == pytest.approx([1.0, 1.0 - 0.99 * 0.25 / 0.3, 0.01, 0.01])
    rows, times, summary = lockstep.rows(), lockstep.timings(), lockstep.read_json("summary.json")
    assert [row["game"] for row in rows] == [0, 1, 2, 3]
    assert summary["commands"] == sum(row["commands"] for row in rows) == summary["sim_time_s"]
    cut_short = len(rows)  # commands, at most: the last of each game
    assert summary["commands"] - cut_short <= summary["phase_s"]["simulation"] <= summary["commands"]
    spent_s = times[-1]["learner_s"], times[-1]["host_phase_s"]
    kinds = ("inference", "learning"), ("simulation", "rendering", "image_processing")
    assert all(spent[phase] > 0 for spent, phases in zip(spent_s, kinds, strict=True) for phase in phases)
    assert len(times) == len([*(lockstep.path / "tensorboard").iterdir()]) + 3


def test_virtual_charges_each_gradient_step_to_the_games(tmp_path: Path) -> None:
    config = tiny_config({**STATE, "timing": "virtual"}, mirror=False, learning_s=0.25, inference_s=0.125)
    phases = train_into(tmp_path / "run", config)["phase_s"]
    commands = sum(row["commands"] for row in RunDirectory(tmp_path / "run").rows())
    assert phases["learning"] == pytest.approx(0.25 * ((commands - 8) // 4), abs=0.25)
    assert phases["inference"] == pytest.approx(0.125 * commands, abs=0.5)


# --- policies -------------------------------------------------------------------------------------------------


def test_the_first_weights_come_from_the_seed() -> None:
    environment = side_by_side(tiny_config({"max_commands": 2}))
    hashes = [weights_sha256(make_learner(tiny_config(seed=seed), environment).policy) for seed in (0, 0, 1)]
    assert hashes[0] == hashes[1] != hashes[2]
    environment.close()


def test_a_training_goes_on_from_another_ones_weights(lockstep: RunDirectory) -> None:
    environment = side_by_side(tiny_config({"max_commands": 2}))
    first, started = (
        cast(HostDQN, make_learner(tiny_config(seed=9, start_from=each), environment))
        for each in (None, str(lockstep.path))
    )
    weights = started.policy.q_net.state_dict()
    trained = load_policy(lockstep.path).network.state_dict()
    for name, each in trained.items():
        assert "target" in name or th.equal(weights[name.removeprefix("q_net.")], each)
    assert all(th.equal(weights[name], each) for name, each in started.policy.q_net_target.state_dict().items())
    assert not all(th.equal(weights[name], each) for name, each in first.policy.q_net.state_dict().items())
    shape = environment.single_observation_space.shape or ()
    seen: Any = np.random.default_rng(0).integers(0, 256, (64, *shape), dtype=np.uint8)
    first.observations = started.observations = seen
    at_first = {learner: learner._decide(np.arange(64)) for learner in (first, started)}
    greedy = {each: each.policy.values(th.from_numpy(seen)).argmax(1).numpy() for each in (first, started)}
    assert np.array_equal(at_first[started], greedy[started]), "it flies before it learns"
    assert not np.array_equal(at_first[first], greedy[first]), "at random"
    environment.close()


@pytest.mark.parametrize(
    "keys", [{"algorithm": "sb3_dqn"}, PPO, {"algorithm": "sb3_a2c", "options": {}}], ids=lambda keys: keys["algorithm"]
)
def test_other_algorithms_train_by_name(tmp_path: Path, keys: dict[str, Any]) -> None:
    config = tiny_config(STATE, games=2, mirror=False, **keys)
    summary = train_into(tmp_path / "run", config)
    assert summary["games"] == 2
    learner = make_learner(config, environment := side_by_side(config))
    assert summary["weights_sha256"] != weights_sha256(learner.policy)
    environment.close()


WANDB = """
import os
from types import SimpleNamespace

calls = []


class Error(Exception):
    pass


def init(**how):
    if how["project"] == "refused":
        raise Error("api_key not configured\\nlog in")
    calls.append(("init", how["project"], how["name"], how["dir"], how["config"]["games"], os.environ["WANDB_MODE"]))
    return SimpleNamespace(
        log=lambda values, step: calls.append((step, values)), finish=lambda: calls.append(("finish",))
    )
"""


def test_curves_go_to_weights_and_biases_where_a_key_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Through its own package, whose settings are its user's; rows and policy are those of a training without it."""
    (tmp_path / "wandb.py").write_text(WANDB)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.delitem(sys.modules, "wandb", raising=False)
    for name, keys in (("plain", {}), ("logged", {"wandb": "drones"})):
        train_into(tmp_path / name, tiny_config(STATE, mirror=False, **keys))
        if name == "plain":
            assert "wandb" not in sys.modules
    first, *games, last = sys.modules.pop("wandb").calls
    run = str(tmp_path / "logged")
    assert (first, last) == (("init", "drones", run, run, 4, "offline"), ("finish",))
    rows = RunDirectory(tmp_path / "logged").rows()
    assert [(step, values["games/return"]) for step, values in games] == [
        (row["game"] + 1, row["return"]) for row in rows
    ]
    for file in ("rows.jsonl", "policy.pt", "policy.json", "summary.json"):
        assert (tmp_path / "logged" / file).read_bytes() == (tmp_path / "plain" / file).read_bytes()
    kept = tmp_path / "logged/rows.jsonl"
    kept.write_bytes(kept.read_bytes().replace(b'"is_success": false', b'"is_success": true'))  # before it goes on
    train_into(kept.parent, tiny_config(STATE, mirror=False, wandb="drones", games=6), resume=True)
    won, calls = [row["is_success"] for row in RunDirectory(kept.parent).rows()], sys.modules.pop("wandb").calls[1:-1]
    assert [values["games/success_recent"] for _, values in calls] == [sum(won[:step]) / step for step, _ in calls]
    assert won[0] > won[-1]
    with pytest.raises(UserError, match=r"^wandb = 'refused': api_key not configured$"):
        train_into(tmp_path / "refused", tiny_config(STATE, mirror=False, wandb="refused"))


def test_weights_and_biases_needs_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaccel.resources.find_spec", lambda name: None if name == "wandb" else name)
    with pytest.raises(UserError, match=r"wandb = 'drones': needs wandb: pip install .*\[wandb\]'$"):
        configured("train", "wandb=drones")


# --- mistakes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"algorithm": "alphazero"}, "algorithm = 'alphazero' is unknown"),
        ({"algorithm": "sb3_sac"}, "algorithm = 'sb3_sac' is unknown; there are double_dqn, ppo, sb3_dqn"),
        ({"options": {"learning_tempo": 1}}, "options of double_dqn: unknown key 'learning_tempo'"),
        ({"start_from": "runs/none"}, "^start_from: runs/none: holds no policy"),
        ({"start_from": "default", "hidden": [8]}, "start_from = 'default': another network"),
    ],
)
def test_an_algorithm_that_cannot_be_is_one_clear_line(tmp_path: Path, keys: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        train_into(tmp_path / "run", tiny_config(**keys))
    assert "\n" not in str(caught.value)
