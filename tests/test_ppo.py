"""PPO: what it learns in a toy, its advantages by their definition, and trainings of it from the command's keys on."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from torch.nn.utils import parameters_to_vector

from tests.golden import assert_numbers_as_recorded
from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from tests.lanes import assert_close
from tests.learning import side_by_side, train_into
from tests.running import configured, fly_into
from uavaccel import make
from uavaccel.config import validate
from uavaccel.envs.hover import Hover
from uavaccel.envs.navigate import NavigateTask
from uavaccel.envs.task import SIZES, Mirror
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.rl.adapters import TensorLoop
from uavaccel.rl.learner import first_seed
from uavaccel.rl.onnx_file import OnnxPolicy, described, example
from uavaccel.rl.policy import load_policy, trained_with
from uavaccel.rl.ppo import PPO, ActorCritic, FirstLayer, PPOOptions, PPOTraining, Turn, blocks
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.evaluate_again import environment_of, fly_again
from uavaccel.suites.runner import run_suite, start_run
from uavaccel.suites.train import TrainConfig, Training

WANTED = np.array([0.5, -0.3])


class Toy:
    """Games of a few steps, in which the action near WANTED is best, times the game's sign.

    The picture is bright on the left if it is 1. Games of the first `cut` environments are truncated.
    """

    def __init__(
        self, count: int = 16, steps: int = 4, observation: Any = None, cut: int = 0, actions: Any = None,
        signs: tuple[float, ...] = (-1.0, 1.0), mirrored: Any = None,
    ) -> None:  # fmt: skip
        self.num_envs, self._steps, self.cut = count, steps, np.arange(count) < cut
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32) if actions is None else actions
        picture = spaces.Box(0, 255, (1, 12, 12), np.uint8)
        both = spaces.Dict({"image": picture, "state": spaces.Box(-np.inf, np.inf, (1,), np.float32)})
        self.single_observation_space: Any = both if observation is None else observation
        self._signs, self.task = signs, type("Symmetric", (), {"mirrored": lambda self: mirrored, "observation": ""})()
        self.flown: list[np.ndarray] = []
        self.rewards: list[np.ndarray] = []

    def reset(self, *, seed: int) -> tuple[Any, dict[str, Any]]:
        self._random, self._count = np.random.default_rng(seed), 0
        return self._show(), {}

    def _show(self) -> Any:
        self._sign = self._random.choice(self._signs, self.num_envs).astype(np.float32)
        return {"image": np.stack(list(map(picture, self._sign))), "state": self._sign[:, None]}

    def step(self, actions: np.ndarray) -> tuple[Any, ...]:
        self.flown.append(actions.copy())
        reward = -((actions - self._sign[:, None] * WANTED) ** 2).sum(1)
        self._count += 1
        over = np.full(self.num_envs, self._count % self._steps == 0)
        infos = {"final_info": {"is_success": reward > -0.05}} if over.any() else {}
        self.rewards.append(reward)
        return self._show(), reward, over & ~self.cut, over & self.cut, infos


def picture(sign: float) -> np.ndarray:
    left_bright = np.repeat(np.array([200, 50], np.uint8), 6) * np.ones((1, 12, 1), np.uint8)
    return left_bright if sign > 0 else left_bright[..., ::-1]


def options(**keys: Any) -> PPOOptions:
    return PPOOptions(
        **{"rollout": 16, "minibatches": 4, "channels": (4,), "hidden": (32,), "learning_rate": 3e-3} | keys
    )


LEFT_ALONE = {"signs": (1.0,), "mirrored": ((-1,), (-1, -2))}


@pytest.mark.parametrize(
    ("keys", "seen"), [({}, {}), ({"precision": "bfloat16", "divergence": 0.02}, LEFT_ALONE)], ids=str
)
def test_it_learns_actions_from_a_picture_beside_a_state(keys: dict[str, Any], seen: dict[str, Any]) -> None:
    """Of a task that says how it is mirrored, what it sees on the left teaches what to do on the right."""
    env = Toy(**seen)
    ppo = PPO(env, options(commands=16 * 16 * 44, **keys))
    rounds = list(ppo.learn())
    assert rounds[-1].commands == ppo.commands == 16 * 16 * 44
    assert rounds[0].games == 16 * 4
    assert rounds[-1].reward > rounds[0].reward / 3
    assert rounds[-1].won > rounds[0].won
    for sign in (1.0, -1.0):
        seen = {"image": picture(sign)[None].copy(), "state": np.full((1, 1), sign, np.float32)}
        np.testing.assert_allclose(ppo.policy.act(seen)[0].numpy(), sign * WANTED, atol=0.15)


def test_each_option_changes_what_is_learned_as_recorded() -> None:
    """After each of three rounds: deviation, reward, games won, learning rate, and sum and spread of the weights."""
    moved: dict[str, Any] = {
        "rollout": 8, "epochs": 3, "minibatches": 2, "learning_rate": 0.02, "gamma": 0.5, "smoothing": 0.5,
        "clip": 0.01, "value_weight": 4.0, "entropy_weight": 0.5, "max_grad_norm": 0.01, "first_deviation": 0.2,
        "final_deviation": 0.1, "divergence": 0.001, "half_contrast": 3.0, "channels": (2, 3), "hidden": (), "seed": 5,
    }  # fmt: skip
    assert set(moved) | {"commands", "precision", "mirror"} == set(PPOOptions.model_fields), "each option has a case"
    told: dict[str, list[float]] = {}
    for label, keys in {"defaults": {}, **{f"{name} {value}": {name: value} for name, value in moved.items()}}.items():
        env: Any = Toy(cut=5)
        env.task = SimpleNamespace(observation="dvs")
        ppo = PPO(env, options(**{"commands": 3 * 16 * keys.get("rollout", 16), **keys}))
        told[label] = []
        for each in ppo.learn():
            weights = parameters_to_vector(ppo.policy.parameters()).detach().double()
            rate = float(ppo.optimizer.param_groups[0]["lr"])
            told[label] += [each.deviation, each.reward, each.won, rate, float(weights.sum()), float(weights.std())]
    assert len(set(map(tuple, told.values()))) == len(told)
    assert_numbers_as_recorded("learned_by_ppo", told)


@pytest.mark.parametrize("shape", [(8, 36, 64), (3, 35, 63), (1, 6, 5)], ids=str)
def test_blocks_are_convolved_to_what_pictures_are(shape: tuple[int, ...]) -> None:
    layer, seen = FirstLayer(shape[0], 4), th.rand(2, *shape)
    turn = Turn(Mirror((), (1,)), {"image": spaces.Box(0, 255, shape, np.uint8)}, th.device("cpu"))
    assert th.equal(turn.seen("image", blocks(seen), True), blocks(turn.seen("image", seen, False)))
    np.testing.assert_allclose(
        layer(blocks(seen).permute(0, 3, 1, 2)).detach(), layer(seen).detach(), atol=1e-5, strict=True
    )


def test_advantages_are_sums_of_discounted_surprises() -> None:
    """A(t) is the sum over k of (gamma lambda)^k times the surprise of step t + k, up to the game's end.

    What a game that is cut short would still have brought is the value of what was seen last, of a lost one nothing.
    """
    ppo = PPO(
        toy := Toy(count=4, steps=3, cut=2), options(commands=64, rollout=8, minibatches=1, gamma=0.9, smoothing=0.8)
    )
    next(ppo.learn())
    rewards, values, going = (part.numpy().astype(float) for part in (ppo._rewards, ppo._values, ppo._going))
    assert going[:, 0].tolist() == [1, 1, 0, 1, 1, 0, 1, 1]
    np.testing.assert_allclose(rewards, toy.rewards[:8] + 0.9 * values * (1.0 - going) * toy.cut, atol=1e-6)
    last = th.tensor(0.0)
    with th.no_grad():  # the value of what is seen after the rollout; the gradient step came later
        ppo._estimate()
        last = ppo.policy(ppo._now)[1]
    after = np.concatenate([values[1:], last.numpy()[None]])
    surprises = rewards + 0.9 * going * after - values
    for step in range(8):
        expected, weight = np.zeros(4), np.ones(4)
        for later in range(step, 8):
            expected += weight * surprises[later]
            weight = weight * 0.72 * going[later]
        np.testing.assert_allclose(ppo._gains[step].numpy(), expected, atol=1e-5)
    np.testing.assert_allclose(ppo._targets.numpy(), ppo._gains.numpy() + values, atol=1e-6)


@pytest.mark.parametrize(
    ("sees", "half", "levels", "expected"),
    [
        ("dvs", 24.0, [128, 152, 104, 255], [0.0, 0.5, -0.5, 127 / 151]),
        ("dvs", 4.0, [128, 132, 124, 255], [0.0, 0.5, -0.5, 127 / 131]),
        ("depth", 24.0, [0, 51, 77, 255], [1.0, 1.0 - 10 / 15, 0.0, 0.0]),  # 50 m are 255; from 15 m on all is as far
        ("colour", 24.0, [0, 51, 255, 102], [-1.0, -0.6, 1.0, -0.2]),
    ],
)
def test_levels_are_seen_as_what_they_show(sees: str, half: float, levels: list[int], expected: list[float]) -> None:
    network = ActorCritic(spaces.Box(0, 255, (1, 12, 12), np.uint8), 2, options(half_contrast=half), sees=sees)
    seen = network._levels(th.tensor([levels], dtype=th.uint8))
    np.testing.assert_allclose(seen[0].numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("action", SIZES)
def test_navigate_flies_as_its_mirror_says(action: Any) -> None:
    """To a goal straight ahead; actions and observations that are turned are flown and seen the other way round."""
    ahead = {"goal_bearing_deg": 0.0, "goal_m": (20.0, 20.0)}
    task = NavigateTask(observation="state", action=action, also_attitude=True, history=2, **ahead)
    turn = Turn(task.mirrored(), {"seen": task.observation_space()}, th.device("cpu"))
    actions = th.as_tensor(np.random.default_rng(3).uniform(-0.3, 0.3, (5, SIZES[action])), dtype=th.float32)
    with make("navigate", **task.model_dump(exclude_defaults=True)) as env:
        env.reset(seed=1, options={"world": 3})
        seen = np.stack([env.step(each.numpy())[0] for each in actions])
        env.reset(seed=1, options={"world": 3})
        turned = np.stack([env.step(each.numpy())[0] for each in turn.action(actions)])
    assert np.ptp(seen, axis=0).min() > 0.0
    np.testing.assert_allclose(turn.seen("seen", th.as_tensor(turned), False), seen, atol=1e-5)


def test_a_task_of_other_functions_is_not_mirrored() -> None:
    class Low(NavigateTask):
        altitude_m: float = 1.0

    class LooksAside(Low):
        def fields(self, state: Any, course: Any) -> Any:
            return [state.position_m[1]]

    class Mixed(type("Aside", (), {"fields": LooksAside.fields}), Low):  # type: ignore[misc]
        pass

    assert Low().mirrored() == NavigateTask().mirrored()
    assert LooksAside().mirrored() is Mixed().mirrored() is None


@pytest.mark.parametrize(
    ("env", "keys", "message"),
    [
        (Toy(), {"minibatches": 7}, "minibatches = 7: must divide the 256 samples"),
        (Toy(), {"minibatches": 256}, "minibatches = 256: must divide the 256 samples, 2 or more in each"),
        *(
            (Toy(observation=space), {}, "observation 'seen': must be a picture")
            for space in (spaces.Discrete(3), spaces.Box(0, 1, ()), spaces.Box(0, 1, (1, 2, 3, 3)))
        ),
        (Toy(mirrored=Mirror((-1, 2), (1, 2))), {}, r"mirrored: fields = \[-1, 2\]: must be all places"),
        (Toy(mirrored=Mirror((-1,), (1, 1))), {}, r"mirrored: action = \[1, 1\]: must be all places"),
        (Toy(mirrored=((-1,), (1.0, 2.0))), {}, r"mirrored: action = \[1.0, 2.0\]: must be all places"),
        (Toy(actions=spaces.Discrete(5)), {}, r"PPO takes continuous actions \(n,\), not Discrete"),
    ],
)
def test_what_it_cannot_learn_from_is_one_line(env: Any, keys: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=f"^{message}"):
        PPO(env, options(**keys))


# --- in `uavaccel train` and `evaluate` ---------------------------------------------------------------------------

HOVER = {
    "env_id": "uavaccel/Hover-v0", "algorithm": "ppo", "games": 6, "environments": 2, "hidden": [8],
    "checkpoint_games": 2, "task": {"max_commands": 6},
    "options": {"rollout": 8, "minibatches": 2, "learning_rate": 0.01, "divergence": 0.005},
}  # fmt: skip


def hover(**keys: Any) -> TrainConfig:
    return validate(TrainConfig, {**HOVER, **keys}, "test")


@pytest.fixture(scope="module")
def trained(trainings_here: None, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    out = tmp_path_factory.mktemp("ppo") / "run"
    train_into(out, hover())
    return RunDirectory(out)


def weights_of(run: RunDirectory) -> str:
    return str(trained_with(run.path)["weights_sha256"])


def test_a_training_repeats_and_goes_on_to_the_same_weights(trained: RunDirectory, tmp_path: Path) -> None:
    def stop(case: Any, row: Any) -> None:
        if row["game"] == 3:
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        run_suite(Training(), hover(), start_run(Training(), hover(), tmp_path / "cut", {}), on_game=stop)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler, "as before"
    train_into(tmp_path / "cut", hover(), resume=True)
    train_into(tmp_path / "again", hover())
    train_into(tmp_path / "other", hover(seed=1))
    for name in ("cut", "again"):
        assert weights_of(RunDirectory(tmp_path / name)) == weights_of(trained), name
        assert (tmp_path / name / "rows.jsonl").read_bytes() == (trained.path / "rows.jsonl").read_bytes(), name
    assert weights_of(RunDirectory(tmp_path / "other")) != weights_of(trained)
    rows = trained.rows()
    assert [(row["game"], row["exploration"]) for row in rows] == [(number, None) for number in range(6)]
    assert not any("lane" in row for row in rows), "which is the obstacle lane's"
    assert all(row["commands"] == 6 or row["is_success"] for row in rows)
    assert "modelled_real_time_s" not in trained.read_json("summary.json")


@pytest.mark.slow
def test_the_kernels_teach_the_same_weights(trained: RunDirectory, tmp_path: Path) -> None:
    keys = [f"{name}={json.dumps(value)}" for name, value in HOVER.items()]
    run = fly_into(tmp_path / "run", Training(), configured("hover_ppo", *keys, "simulator=kernels"))
    assert weights_of(run) == weights_of(trained)
    assert (tmp_path / "run/rows.jsonl").read_bytes() == (trained.path / "rows.jsonl").read_bytes()


@pytest.mark.slow
def test_the_shipped_training_learns_to_hover(tmp_path: Path) -> None:
    """In games that none of its seeds has flown, and with fewer than it ships with."""
    run = fly_into(tmp_path / "run", Training(), configured("hover_ppo", "games=64", "simulator=kernels"))
    keys = ("simulator=kernels", "task.timing=lockstep")
    flown = fly_into(tmp_path / "flown", Evaluation(), configured("evaluate", *keys, agent=str(run.path), games=40))
    assert sum(row["is_success"] for row in flown.rows()) >= 36


@pytest.mark.parametrize("timing", ["lockstep", "virtual"])
def test_an_evaluation_flies_the_policy_and_repeats(timing: str, trained: RunDirectory, tmp_path: Path) -> None:
    config = configured("evaluate", f"task.timing={timing}", agent=str(trained.path), games=2)
    assert config.env_id == "uavaccel/Hover-v0"
    assert (config.task.max_commands, config.task.timing) == (6, timing)
    run = fly_into(tmp_path / "flown", Evaluation(), config)
    for lane, row in enumerate(run.rows()):
        assert (row["game"], np.shape(row["actions"])) == (lane, (row["commands"], 3))
        steps = fly_again(run, config, environment_of(config), row)
        policy = load_policy(trained.path)
        for step in steps:
            np.testing.assert_array_equal(step.action, policy.act(step.given[None])[0])
    report = Evaluation().report(run)
    assert Evaluation().flight(report, run.rows()[0], pictures=False).scene == "blocks"
    assert " of 2 games with " in Evaluation().headline(report)


def test_the_policy_is_exported_with_its_form(trained: RunDirectory) -> None:
    policy = load_policy(trained.path)
    assert (policy.manifest["action"], policy.manifest["action_shape"]) == ("velocity", [3])
    (seen,) = example(policy)
    seen = th.rand(seen.shape)
    (action,) = OnnxPolicy(policy).eval()(seen)
    np.testing.assert_array_equal(action.detach(), policy.act(seen.numpy()))
    assert json.loads(described(policy)["action"]) == "velocity"


def test_lanes_pay_for_decisions_and_learning() -> None:
    """A rollout of eight commands and four gradient steps, of two lanes, whose games are of the training's seed."""
    config = hover(task={"timing": "virtual", "max_commands": 4}, inference_s=0.5, learning_s=0.125, seed=3)
    lanes: Any = side_by_side(config)
    charged: list[Any] = []
    seeds: list[int] = []
    reset = lanes.reset

    def note_and_reset(*, seed: int) -> Any:
        seeds.append(seed)
        return reset(seed=seed)

    lanes.reset = note_and_reset
    lanes.call_each = lambda name, arguments, slots: charged.append((name, *arguments, slots))
    learner = PPOTraining(config, lanes)
    assert learner.at_rest
    games = learner.advance()
    lanes.close()
    assert charged[:8] == [("charge", *[(0.5, "inference")] * 2, [0, 1])] * 8
    assert charged[8:] == [("charge", *[(4 / 2 * 0.125, "learning")] * 2, [0, 1])]
    assert [game.number for game in games] == [0, 1, 2, 3]
    assert (seeds, th.initial_seed()) == ([first_seed(3)], 3)


@pytest.mark.slow
@pytest.mark.usefixtures("host_kernels")
@pytest.mark.parametrize("clock", [{}, {"timing": "virtual", "command": "adsc", "clock_speed": 20.0}], ids=str)
def test_a_batch_of_tensors_teaches_what_the_host_does(clock: dict[str, Any]) -> None:
    """Flight there is equal to the host's, and so are the games and the weights; its games are read once a round."""
    from uavaccel.envs.cuda_batch import CudaBatch
    from uavaccel.envs.kernel_batch import KernelBatch

    task = {"max_commands": 6, "altitude_m": 0.5, **clock}
    config = hover(games=100, task=task)
    keys: dict[str, Any] = {**task, "autoreset_mode": "SameStep"}
    made: list[Any] = []
    told, weights = [], []
    for kind in (KernelBatch, CudaBatch):  # one after the other: PyTorch's generator is seeded where a learner is made
        made.append(learner := PPOTraining(config, kind(Hover, 2, **keys)))
        rounds = [(learner.advance(), th.nn.utils.parameters_to_vector(learner.policy.parameters())) for _ in range(3)]
        told.append([game for games, _ in rounds for game in games])
        weights.append(th.stack([each for _, each in rounds]))
    th.testing.assert_close(*weights)
    assert len(told[0]) >= 6
    assert {game.info["collision"] for game in told[0]} == {None, "ground"}
    for ours, theirs in zip(*told, strict=True):
        assert (ours.number, ours.lane) == (theirs.number, theirs.lane)
        assert ours.reward == pytest.approx(theirs.reward, abs=1e-4)
        assert ours.info.pop("collision") == theirs.info.pop("collision")
        assert_close({name: told for name, told in theirs.info.items() if name != "host_phase_s"}, ours.info)
    for learner in made:
        learner.lanes.close()


def test_a_loop_of_dictionaries_shows_last_and_first_frames() -> None:
    """Of games that go on, that are over, and that are cut short."""
    seen, last = np.array([[1.0], [2.0], [3.0]]), np.array([None, np.array([9.0]), np.array([8.0])], object)
    lost, cut = np.array([False, True, False]), np.array([False, False, True])
    batch = SimpleNamespace(
        reset=lambda seed: (seen + seed - 3, {}),
        step=lambda action: (seen + action, np.array([0.5, 1.5, 2.5]), lost, cut, {"final_obs": last}),
    )
    loop = TensorLoop(batch)
    data, begun = loop.step_and_maybe_reset({**loop.reset(seed=3), "action": th.tensor([[10.0], [20.0], [30.0]])})
    assert data["observation"].tolist() == seen.tolist()
    assert begun["observation"].tolist() == [[11.0], [22.0], [33.0]]
    told = {name: data["next"][name][:, 0].tolist() for name in ("observation", "reward", "terminated", "truncated")}
    assert told == {
        "observation": [11.0, 9.0, 8.0], "reward": [0.5, 1.5, 2.5],
        "terminated": lost.tolist(), "truncated": cut.tolist(),
    }  # fmt: skip
    assert data["next"]["done"][:, 0].tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"env_id": "uavaccel/ObstacleLane-v0"}, "does not learn uavaccel/ObstacleLane-v0, whose actions are discrete"),
        ({"algorithm": "double_dqn"}, "does not learn uavaccel/Hover-v0, whose actions are continuous"),
        ({"task": {"reach": 1.0}}, "unknown key 'task.reach'; did you mean 'task.reach_m'?"),
        ({"task": {"reach_m": -1.0}}, "task.reach_m = -1.0: should be greater than 0"),
        ({"start_from": "default"}, "start_from needs algorithm double_dqn, not ppo"),
        ({"options": {"tempo": 1}}, "options of ppo: unknown key 'tempo'"),
        ({"options": {"minibatches": 5}}, "options of ppo: minibatches = 5: must divide the 64 samples"),
    ],
)
def test_a_training_that_cannot_be_is_one_clear_line(keys: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(UserError) as caught:
        train_into(tmp_path / "run", hover(**keys))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"env_id": "uavaccel/Gates-v0"}, "flies uavaccel/Hover-v0; omit the key"),
        ({"task.t_move_s": 0.4, "task.speed_m_s": 1}, "with other observations or actions: t_move_s = 0.2, not 0.4\n"),
        ({"agent": "straight", "env_id": "uavaccel/Hover-v0"}, "straight flies uavaccel/ObstacleLane-v0; omit the key"),
    ],
)
def test_a_policy_that_does_not_fit_is_one_clear_line(keys: dict[str, Any], said: str, trained: RunDirectory) -> None:
    overrides = {f"{name}={value}" for name, value in keys.items() if name != "agent"}
    with pytest.raises(UserError) as caught:
        Evaluation().check(configured("evaluate", *overrides, agent=keys.get("agent", str(trained.path))))
    assert said in f"{caught.value}\n"
