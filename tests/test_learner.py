"""Double DQN by hand: a game learned to its exact values, gradients, targets, schedules, and who pays for learning."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from copy import deepcopy
from functools import partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch as th
from gymnasium import spaces

from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from tests.learning import tiny_config
from uavaccel.config import validate
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.rl.agents import first_policy
from uavaccel.rl.config import DqnOptions, LearnerConfig, check_algorithm
from uavaccel.rl.double_dqn import DeviceDQN, HostDQN, Prepared
from uavaccel.rl.learner import Game, StepStatistics, first_seed, learning_rhythm
from uavaccel.rl.network import Adam, contrast
from uavaccel.rl.policy import weights_sha256
from uavaccel.rl.replay import Windows
from uavaccel.suites.train import TrainConfig

TASK = {"observation": "state", "headings_deg": [-30.0, 30.0]}
SHAPE = (3, 13)  # of its observations
OPTIONS = {"learning_rate": 0.05, "gamma": 0.5, "n_steps": 1, "learning_starts": 8, "batch_size": 16}
LAST = 3  # commands of a game that does not end before


class Flown(NamedTuple):
    """A command of a lane as the buffer is to have it."""

    state: float
    action: int
    reward: float
    after: float
    over: bool
    truncated: bool


class TwoStates:
    """Lanes of a game whose ratings are known; observations have a one where the state's number says.

    From state 0 action 0 leads to state 1, action 1 ends the game and brings 0.3; from state 1 action 0 ends it and
    brings 1, action 1 leads back. A third command is cut short. What a game ends with is a state that is never left.
    """

    ratings = ((0.5, 0.3), (1.0, 0.25))  # 0 + 0.5 * 1 and 0.3; 1 and 0 + 0.5 * 0.5

    def __init__(self, lanes: int) -> None:
        self.num_envs = lanes
        self.single_observation_space = spaces.Box(-np.inf, np.inf, SHAPE, np.float32)
        self.single_action_space = spaces.Discrete(2)
        self.log: list[list[Any]] = [[] for _ in range(lanes)]
        self.seeds: list[int] = []
        self._states, self._commands = [lane % 2 for lane in range(lanes)], [0] * lanes
        self._actions: dict[int, int] = {}

    def reset(self, *, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
        self.seeds.append(seed)
        return self._seen(range(self.num_envs)), {}

    def step_async(self, actions: np.ndarray, lanes: Sequence[int]) -> None:
        assert not set(lanes) & set(self._actions), "a lane that flies cannot be told to"
        self._actions |= dict(zip(lanes, actions.tolist(), strict=True))

    def step_wait(self, lanes: Sequence[int]) -> tuple[Any, ...]:
        rewards, terminated, truncated, infos = zip(*(self._fly(lane) for lane in lanes), strict=True)
        return self._seen(lanes), np.array(rewards), np.array(terminated), np.array(truncated), list(infos)

    def call_each(self, name: str, arguments: Sequence[tuple[float, str]], lanes: Sequence[int]) -> None:
        assert name == "charge"
        for lane, (seconds, phase) in zip(lanes, arguments, strict=True):
            self.log[lane].append((phase, seconds))

    def flown(self, lane: int) -> list[Flown]:
        return [each for each in self.log[lane] if isinstance(each, Flown)]

    def _fly(self, lane: int) -> tuple[float, bool, bool, dict[str, Any]]:
        state, action = self._states[lane], self._actions.pop(lane)
        self._commands[lane] += 1
        over = state != action
        truncated = self._commands[lane] == LAST  # which may be both
        reward = (0.3 if state == 0 else 1.0) if over else 0.0
        after = 2 if over else 1 - state
        self.log[lane].append(Flown(state, action, reward, after, over, truncated and not over))
        info: dict[str, Any] = {"of": "the next game"}
        if over or truncated:
            info |= {"final_obs": seen_of(after), "final_info": {"of": lane}}
            after, self._commands[lane] = lane % 2, 0
        self._states[lane] = after
        return reward, over, truncated, info

    def _seen(self, lanes: Any) -> np.ndarray:
        return np.stack([seen_of(self._states[lane]) for lane in lanes])


def seen_of(state: int) -> np.ndarray:
    """Of state 2, where a game that is over stays, too large for its rating to be taken for nothing."""
    seen = np.zeros(SHAPE, np.float32)
    seen[0, state] = 10.0 if state == 2 else 1.0
    return seen


def config_of(lanes: int, options: dict[str, Any] | None = None, **keys: Any) -> TrainConfig:
    """A linear network, which rates a one-hot state by a number of its own."""
    task = {**TASK, **keys.pop("task", {})}
    keys = {"hidden": [], "mirror": False, "environments": lanes, "games": 400, **keys}
    return tiny_config(task, options={**OPTIONS, **(options or {})}, **keys)


def learning(lanes: int, options: dict[str, Any] | None = None, **keys: Any) -> tuple[Any, TwoStates]:
    flown = TwoStates(lanes)
    return HostDQN(config_of(lanes, options, **keys), flown), flown  # type: ignore[arg-type]


def train(learner: Any) -> list[Game]:
    games: list[Game] = []
    while learner.games < learner.config.games:
        games += learner.advance()
    return games


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """More threads wait for each other longer than such networks take."""
    before = th.get_num_threads()
    th.set_num_threads(1)
    yield
    th.set_num_threads(before)


# --- a whole training -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("lanes", "turns"), [(1, 1), (3, 2)])
def test_a_game_of_two_states_is_learned_to_its_exact_ratings(lanes: int, turns: int) -> None:
    """Wrong at once if the loss rises, an end leads on, a cut-off does not, or the discount is another."""
    options = {"target_update_interval": 20, "exploration_fraction": 0.8, "exploration_final_eps": 0.5}
    learner, flown = learning(lanes, options, turns=turns, games=300, commands_per_gradient_step=1)
    train(learner)
    with th.no_grad():
        rated = learner.policy.q_net(th.from_numpy(np.stack([seen_of(0), seen_of(1)])))
    np.testing.assert_allclose(rated.numpy(), TwoStates.ratings, atol=0.01)
    assert flown.seeds == [first_seed(learner.config.seed)]


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_what_lanes_flew_is_what_can_be_learned_from(turns: int) -> None:
    learner, lanes = learning(3, turns=turns, games=60)
    games = train(learner)
    while len(learner._flying):  # down with them
        learner.holding = True
        learner.advance()
    kept, rows = learner.replay.get_state(), int(learner.replay.filled)
    names = ("observations", "actions", "rewards", "next_observations", "over", "cut")
    for lane in range(3):
        flown = lanes.flown(lane)[:rows]
        for name, column in zip(names, zip(*flown, strict=True), strict=True):
            stored = kept[name][:, lane]
            if name.endswith("observations"):
                stored = stored[:, 0].argmax(axis=-1)
            np.testing.assert_allclose(stored, column, err_msg=name)
    assert [game.number for game in games] == list(range(60))
    assert all(game.info == {"of": game.lane} for game in games)
    if turns == 1:
        assert rows == learner.steps == len(lanes.flown(0)) - 1, "nothing of the last one is kept"
    for lane in range(3):
        sums, total = [], 0.0
        for each in lanes.flown(lane):
            total += each.reward
            if each.over or each.truncated:
                sums.append(total)
                total = 0.0
        ended = [game.reward for game in games if game.lane == lane]
        assert ended == pytest.approx(sums[: len(ended)])
        assert len(ended) > 5


@pytest.mark.parametrize("turns", [1, 3])
def test_each_lane_pays_its_own_share_of_learning_and_each_decision(turns: int) -> None:
    """Three gradient steps after every second command of three lanes: one for each lane, before its next command."""
    keys = {"commands_per_gradient_step": 2, "learning_s": 0.25, "inference_s": 0.125, "turns": turns}
    learner, lanes = learning(3, {"learning_starts": 8}, task={"timing": "virtual"}, games=30, **keys)
    train(learner)
    for lane, log in enumerate(lanes.log):
        commands, paid = 0, 0
        flies_already = turns > 1 and lane < 2  # while the last lane lands, and a row is whole
        for before, each in pairwise([None, *log]):
            commands += isinstance(each, Flown)
            if isinstance(before, Flown):
                assert each == ("inference", 0.125)
            pays = commands - flies_already
            due = isinstance(each, Flown) and pays > 4 and pays % 2 == 1  # from more than eight commands on
            assert (before == ("learning", 0.25)) == due
            paid += due
        assert commands > 10
        assert 3 * (paid - 1) <= learner.updates <= 3 * (paid + 1)
    learner, lanes = learning(2, games=20)
    train(learner)
    assert all(isinstance(each, Flown) for log in lanes.log for each in log), "no clock, nobody pays"
    assert learner.updates > 0


def test_learning_goes_on_while_the_lanes_fly() -> None:
    """It learns after more than eight commands, and then after every fourth; a gradient step has two parts."""
    learner, lanes = learning(1, games=1_000)
    said: list[str] = []
    for owner, name, word in (
        *((learner, part, "learns") for part in ("_prepare_batch", "_step")),
        *((lanes, "step_async", "flies"), (lanes, "step_wait", "waited for")),
    ):
        setattr(owner, name, partial(say_and, said, word, getattr(owner, name)))
    for _ in range(12):
        learner.advance()
    assert (learner.owed, learner.updates) == (1, 0)
    for _ in range(4):
        learner.advance()
    assert (learner.owed, learner.updates) == (1, 1)
    alone, beside = ["flies", "waited for"], ["flies", "learns", "waited for"]
    assert said == [*alone * 12, *beside * 2, *alone * 2]


def say_and(said: list[Any], word: Any, work: Callable[..., Any], *told: Any) -> Any:
    said.append(word)
    return work(*told)


# --- a gradient step, on lanes of the host and of a device ---------------------------------------------------------


class Plain:
    """A sight of numbers: a mirrored row is turned round."""

    def look(self, ring: th.Tensor, row: th.Tensor, lane: th.Tensor, mirrored: th.Tensor) -> th.Tensor:
        return th.where(mirrored[:, None], ring[row, lane].flip(-1), ring[row, lane])

    def rate(self, network: Any, seen: th.Tensor) -> Any:
        return network(seen)


def weights_of(net: Any) -> np.ndarray:
    weights, bias = (parameter.detach().numpy() for parameter in net.parameters())
    return np.concatenate([weights, bias[:, None]], axis=1).copy()


@pytest.mark.parametrize("limit", [10.0, 0.05])
def test_a_step_moves_the_weights_down_the_gradient_worked_out_by_hand(limit: float) -> None:
    """Two networks, of which one rates highest what the other rates lowest; each second window is seen in a mirror."""
    learner, random, weights = learning(1, {"max_grad_norm": limit})[0], np.random.default_rng(0), [1.0, 0.0, 1.0, 1.0]
    th.manual_seed(0)
    online, target = th.nn.Linear(2, 2), th.nn.Linear(2, 2)
    with th.no_grad():
        target.weight.copy_(-online.weight / 2)
        target.bias.copy_(-online.bias / 2)
    seen, after = random.normal(size=(2, 6, 4, 2)).astype(np.float32)
    learner.replay = SimpleNamespace(observations=th.from_numpy(seen), next_observations=th.from_numpy(after))
    learner.sight, learner._turned = Plain(), th.tensor([1, 0])
    learner.policy = SimpleNamespace(q_net=online, q_net_target=target)
    learner.policy.optimizer = th.optim.SGD(online.parameters(), lr=0.1)
    rewards, discounts = [3.0, -2.0, 0.1, 0.2], [0.5, 0.25, 0.0, 0.125]
    lanes, actions, mirrored = [0, 1, 2, 3], [0, 1, 0, 1], [True, False, True, False]
    rows = [th.tensor(each) for each in ([0, 1, 2, 3], [2, 3, 4, 5], lanes, actions)]
    numbers = [th.tensor(each) for each in (rewards, discounts, weights)]
    batch = Windows._make([*rows, *numbers, th.tensor(mirrored)])
    before, rated = weights_of(online), weights_of(target)
    learner._descend(learner._prepared(batch))
    total, losses, chosen = np.zeros((2, 3)), [], []
    for at in range(4):
        turn = -1 if mirrored[at] else 1
        here, there = np.append(seen[at, at][::turn], 1.0), np.append(after[at + 2, at][::turn], 1.0)
        action = actions[at] if turn == 1 else 1 - actions[at]
        goal = rewards[at] + discounts[at] * (rated @ there)[int((before @ there).argmax())]
        error = (before @ here)[action] - goal
        total[action] += weights[at] * np.clip(error, -1.0, 1.0) * here / 4
        losses.append(weights[at] * (error**2 / 2 if abs(error) < 1.0 else abs(error) - 0.5))
        chosen.append((before @ here)[action])
    share = min(1.0, limit / float(np.linalg.norm(total)))
    assert (share < 1.0) == (limit == 0.05)
    np.testing.assert_allclose(weights_of(online), before - 0.1 * total * share, atol=1e-6)
    np.testing.assert_array_equal(weights_of(target), rated)
    learner.statistics.read(learner.statistics.sums)
    assert learner.statistics.loss == pytest.approx(np.mean(losses), abs=1e-6)
    assert learner.statistics.mean_q == pytest.approx(np.mean(chosen), abs=1e-6)


def test_steps_at_once_are_steps_of_a_batch_each() -> None:
    """On a GPU, where batches are drawn together and a step is recorded once; half of each is mirrored."""
    one, other = (learning(1)[0] for _ in range(2))
    for learner in (one, other):
        for _ in range(30):
            learner.advance()
        learner.updates = 0
        learner.config = learner.config.model_copy(update={"mirror": True})
    drawn, state = one._sample(3), one.random.get_state()
    one.random.set_state(state)
    assert drawn.mirrored.tolist() == ([True] * 8 + [False] * 8) * 3
    one._sample = lambda batches: drawn
    one._steps_at_once(3)
    for batch in drawn.split(16):
        other._batch = other._prepared(batch)
        other._step()
    assert (one.updates, other.updates) == (3, 3)
    assert weights_sha256(one.policy) == weights_sha256(other.policy)
    one._steps_at_once(0)
    assert one.updates == 3
    one.device = SimpleNamespace(type="cuda")
    assert [part.args[0] for part in one._parts_of(5, 3)] == [2, 1, 2]


def test_what_is_learned_from_is_looked_at_when_it_is_drawn() -> None:
    """Between the two parts of a step the ring may be written over."""
    learner, _ = learning(1)
    for _ in range(30):
        learner.advance()
    learner._prepare_batch()
    held = [each.clone() for each in learner._batch]
    learner.replay.observations.fill_(7.0)
    assert isinstance(learner._batch, Prepared)
    assert all(th.equal(*each) for each in zip(held, learner._batch, strict=True))


# --- exploration and schedules ----------------------------------------------------------------------------------


def test_it_explores_as_often_as_it_is_to() -> None:
    """Its greedy action is 1 everywhere; of those at random every second one is too."""
    learner, _ = learning(1, {"learning_starts": 100})
    with th.no_grad():
        learner.policy.q_net.q_net[0].bias.copy_(th.tensor([-100.0, 100.0]))

    def share(commands: int, exploration: float, count: int = 2_000) -> float:
        learner.commands, learner.exploration_rate = commands, exploration
        return float(np.mean([learner._decide(seen_of(0)[None])[0] for _ in range(count)]))

    assert share(99, 0.0) == pytest.approx(0.5, abs=0.05)  # before it learns it knows nothing
    learner.config = learner.config.model_copy(update={"start_from": "default"})
    assert share(99, 0.0) == 1.0  # unless it began with what another training had learned
    assert share(100, 0.0) == 1.0
    assert share(100, 0.4) == pytest.approx(0.8, abs=0.05)
    assert share(100, 1.0) == pytest.approx(0.5, abs=0.05)


def test_a_hash_is_of_every_weights_name_shape_and_bytes() -> None:
    weights = {name: th.arange(6.0).reshape(2, 3) + number for number, name in enumerate("cab")}

    def hash_of(changed: dict[str, th.Tensor], without: str = "") -> str:
        now = {name: each for name, each in {**weights, **changed}.items() if name != without}
        policy: Any = SimpleNamespace(state_dict=lambda: now)
        return weights_sha256(policy)

    assert hash_of({}) == hash_of(dict(reversed(weights.items())))
    others = [hash_of({}, without="c"), hash_of({"d": weights["c"]}, without="c")]
    for name, weight in weights.items():
        nudged = weight.clone()
        nudged[1, 2] += 1e-5
        others += [hash_of({name: other}) for other in (nudged, weight.reshape(3, 2), weight.double(), weight.T)]
    assert len({hash_of({}), *others}) == 1 + len(others)


def test_its_seed_draws_the_weights_the_actions_and_the_batches() -> None:
    def drawn(seed: int) -> tuple[Any, ...]:
        learner, lanes = learning(1, games=20, seed=seed)
        first = weights_of(learner.policy.q_net).tolist()
        coin = learner.random.rand()
        train(learner)
        return first, coin, [each.action for each in lanes.flown(0)], lanes.seeds

    once, again, other = drawn(5), drawn(5), drawn(6)
    assert once == again
    assert all(ours != theirs for ours, theirs in zip(once, other, strict=True))


def test_options_that_are_left_out_are_those_of_the_shipped_policy() -> None:
    assert DqnOptions().model_dump() == {
        "learning_rate": 3e-4, "buffer_size": 150_000, "learning_starts": 2_000, "batch_size": 32, "gamma": 0.95,
        "n_steps": 3, "target_update_interval": 2_000, "exploration_initial_eps": 1.0, "exploration_fraction": 0.3,
        "exploration_final_eps": 0.01, "max_grad_norm": 10.0,
    }  # fmt: skip
    assert LearnerConfig().model_dump(exclude={"task"}) == {
        "seed": 0, "games": 5000, "simulator": "mujoco", "environments": 1, "turns": 1, "algorithm": "double_dqn",
        "env_id": "uavaccel/ObstacleLane-v0",
        "options": {}, "final_learning_rate_share": 0.02, "commands_per_gradient_step": 4, "mirror": True,
        "mirrored_decisions": False, "start_from": None, "channels": (16, 32), "hidden": (256,), "device": "cpu",
        "torch_threads": 1, "checkpoint_games": 250, "inference_s": 0.0005, "learning_s": 0.01,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("algorithm", "fits", "too_large"),
    [
        ("double_dqn", {"buffer_size": 100}, {"buffer_size": 101}),
        ("ppo", {"rollout": 50, "minibatches": 5}, {"rollout": 51, "minibatches": 2}),  # of each of two lanes
    ],
)
def test_what_takes_more_memory_than_there_is_is_refused_beforehand(
    algorithm: str, fits: dict[str, int], too_large: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaccel.rl.config.memory_bytes", lambda: 100 * math.prod(SHAPE) * 4)  # of float32
    config = config_of(2, {}).model_copy(update={"algorithm": algorithm, "options": fits})
    check_algorithm(config)
    check_algorithm(config.model_copy(update={"options": too_large, "device": "cuda"}))  # whose memory is another
    name = next(iter(fits))
    with pytest.raises(UserError, match=rf"^options of {algorithm}: {name}: 10[12] observations take 1\.5\d+e-05 GB"):
        check_algorithm(config.model_copy(update={"options": too_large}))


def test_trainings_of_neighbouring_seeds_fly_lanes_far_apart() -> None:
    """Lane n of a training has its seed plus n, so these have to be farther apart than there are lanes."""
    seeds = [first_seed(seed) for seed in range(20)]
    assert min(after - before for before, after in pairwise(sorted(seeds))) > 10_000
    assert all(0 <= seed < 2**31 for seed in seeds)


def test_the_target_network_follows_now_and_then() -> None:
    """Every 16 commands, whatever the number of lanes; in between it stays as it is."""
    learner, _ = learning(2, {"target_update_interval": 16})
    online, target = learner.policy.q_net, learner.policy.q_net_target
    for steps in range(1, 17):
        with th.no_grad():
            for parameter in online.parameters():
                parameter.add_(1.0)
        learner._schedule()
        alike = [np.array_equal(weights_of(online)[:, part], weights_of(target)[:, part]) for part in (0, -1)]
        assert alike == [steps in (8, 16)] * 2


@pytest.mark.parametrize(
    ("commands", "environments", "rhythm"), [(4, 1, (4, 1)), (4, 5, (4, 5)), (4, 8, (1, 2)), (1, 3, (1, 3))]
)
def test_the_ratio_of_learning_is_exact(commands: int, environments: int, rhythm: tuple[int, int]) -> None:
    assert learning_rhythm(commands, environments) == rhythm
    assert rhythm[1] * commands == rhythm[0] * environments


def test_a_learner_goes_on_from_its_state() -> None:
    """Two that were one learn the same weights from then on; every counter and generator is put back."""
    keys: dict[str, Any] = {"games": 60, "task": {"timing": "virtual"}, "learning_s": 0.25}
    first, _ = learning(2, **keys)
    while not (first.games > 20 and first.at_rest and first.owed):
        first.advance()
    second, lanes = learning(2, **keys, seed=5)
    state = deepcopy(first.get_state())
    json.dumps(state.counters)
    second.set_state(state, first.observations)
    for name in HostDQN.counters:
        assert getattr(second, name) == getattr(first, name), name
    for each in (first, second):
        th.manual_seed(1)
        for _ in range(4):
            each._prepare_batch()
            each._step()
    assert weights_sha256(first.policy) == weights_sha256(second.policy)
    assert second.random.rand() == first.random.rand()
    assert [second.space.sample() for _ in range(20)] == [first.space.sample() for _ in range(20)]
    share_s = second.owed / 2 * 0.25
    second.advance()
    assert [log[0] for log in lanes.log] == [("learning", share_s)] * 2, "what was due is still paid for"


# --- the learner beside lanes on a GPU, on tensors of the CPU -----------------------------------------------------


@pytest.fixture
def on_a_device(host_kernels: None) -> Any:  # noqa: F811
    """A learner without lanes or graphs: options, ring and networks of four lanes over pictures of 1 x 1 x 2."""
    from uavaccel.envs.cuda_lanes import AT

    learner: Any = DeviceDQN.__new__(DeviceDQN)
    learner.config = validate(
        TrainConfig, {"games": 8, "commands_per_gradient_step": 8, "final_learning_rate_share": 0.02}, "test"
    )
    learner.options = DqnOptions(learning_starts=8, n_steps=2, target_update_interval=24, exploration_final_eps=0.2)
    learner._at, learner.device = AT, th.device("cpu")
    learner.lanes = SimpleNamespace(count=4, ended=th.zeros((4, AT.columns), dtype=th.float64))
    learner._turned = th.tensor([1, 0])
    learner.statistics = StepStatistics(th.device("cpu"))
    return learner


def test_statistics_are_means_over_the_gradient_steps_between_two_reads() -> None:
    statistics = StepStatistics(th.device("cpu"))
    statistics.read(statistics.sums)
    assert (statistics.loss, statistics.mean_q) == (None, None)
    for loss, chosen in ((1.0, [2.0, 4.0]), (2.0, [5.0, 7.0])):
        statistics.add(th.tensor(loss), th.tensor(chosen))
    for _ in range(2):  # without steps in between the means stay
        statistics.read(statistics.sums)
        assert (statistics.loss, statistics.mean_q) == (1.5, 4.5)
    statistics.add(th.tensor(8.0), th.tensor([1.0]))
    resumed = StepStatistics(th.device("cpu"))
    resumed.set_state(json.loads(json.dumps(statistics.get_state())))
    assert (resumed.loss, resumed.mean_q) == (1.5, 4.5)
    resumed.read(resumed.sums)
    assert (resumed.loss, resumed.mean_q) == (8.0, 1.0)
    resumed.add(th.tensor(float("inf")), th.tensor([3.0]))
    resumed.read(resumed.sums)
    assert (resumed.loss, resumed.mean_q) == (None, 3.0)


def test_on_a_device_rounds_are_of_their_kind(on_a_device: Any) -> None:
    """Of four lanes: learning after more than eight commands, every second round; the target follows every sixth."""
    kinds = {}
    for rounds in range(13):
        on_a_device.rounds = rounds
        kinds[rounds] = on_a_device._kind()
    assert [kinds[rounds] for rounds in range(3)] == [(True, False, False)] * 3
    for rounds in range(3, 13):
        assert kinds[rounds] == (False, rounds % 2 == 0, rounds % 6 == 0)
    on_a_device.options = on_a_device.options.model_copy(update={"n_steps": 5})
    on_a_device.rounds = 5
    assert on_a_device._kind() == (True, False, False)  # the ring has no whole window yet


def test_on_a_device_lanes_explore_as_often_as_they_are_to(on_a_device: Any) -> None:
    """A lane that sees n rates action n highest, which a random action is in a third of the cases too."""
    lanes, learner = 3_000, on_a_device
    learner.lanes.count, learner._turned = lanes, th.arange(3)
    learner.lanes.observations = th.arange(lanes) % 3
    learner._nowhere, learner._lane_numbers = th.zeros(lanes, dtype=th.int64), th.arange(lanes)
    learner.sight = SimpleNamespace(look=lambda ring, row, lane, _: ring[row, lane], rate=lambda net, seen: net(seen))
    learner.policy = SimpleNamespace(q_net=lambda seen: th.eye(3)[seen])
    th.manual_seed(0)
    for exploration, at_random, greedy in ((0.0, False, 1.0), (0.4, False, 0.6 + 0.4 / 3), (0.0, True, 1 / 3)):
        learner._epsilon = th.tensor(exploration)
        actions = learner._decide(at_random)
        assert (actions == learner.lanes.observations).double().mean() == pytest.approx(greedy, abs=0.03)
        assert actions.bincount(minlength=3).tolist() == pytest.approx([lanes / 3] * 3, abs=0.03 * lanes)


def test_on_a_device_each_gradient_step_has_a_batch_of_its_own(on_a_device: Any) -> None:
    """Sixteen lanes and a step every eight commands: two steps a round, on windows that are drawn together."""
    learner, told, batches = on_a_device, list[Any](), list[Any]()
    learner.lanes.count = 16
    learner.options = learner.options.model_copy(update={"batch_size": 3, "gamma": 0.25})

    def windows(row: th.Tensor, lane: th.Tensor, *more: Any) -> Windows:
        told.append((row.tolist(), lane.tolist(), *more[:2], more[2].tolist()))
        return Windows(*(th.arange(6) + 10 * column for column in range(8)))

    drawn = th.arange(6), th.arange(6, 12)
    learner.replay = SimpleNamespace(draw=lambda count, n: {(6, 2): drawn}[count, n], windows=windows)
    learner._prepared, learner._descend = (lambda batch: batch), batches.append
    for mirror in (True, False):
        learner.config = learner.config.model_copy(update={"mirror": mirror})
        learner._learn()
    places = [each.tolist() for each in drawn]
    assert told == [(*places, 2, 0.25, [True, False] * 3), (*places, 2, 0.25, [False] * 6)]
    expected = [[[10 * column + at for at in part] for column in range(8)] for part in ((0, 1, 2), (3, 4, 5))]
    assert [[each.tolist() for each in batch] for batch in batches] == expected * 2


def test_on_a_device_a_round_keeps_and_charges_what_was_going_when_it_began(on_a_device: Any) -> None:
    """Its last lane flies no more, and with this command the first one's game is over."""
    learner = on_a_device
    said: list[tuple[Any, ...]] = []
    online, target = th.nn.Linear(1, 1), th.nn.Linear(1, 1)
    learner.policy = SimpleNamespace(q_net=online, q_net_target=target)
    before = [each.detach().clone() for each in (*online.parameters(), *target.parameters())]
    results = {name: th.tensor([number, 0.0]) for number, name in enumerate(("rewards", "terminated", "truncated"))}
    learner.config = SimpleNamespace(commands_per_gradient_step=1, inference_s=0.5, learning_s=0.125)

    def fly(actions: Any) -> None:
        said.append(("flies", actions))
        vars(learner.lanes).update(results)
        learner.lanes.going.copy_(th.tensor([False, False]))

    learner.lanes = SimpleNamespace(going=th.tensor([True, False]), observations="seen", fly=fly, count=2)
    learner.lanes.charge = lambda flown, *what: said.append(("charges", flown.tolist(), *what))
    learner.replay = SimpleNamespace(
        start_round=lambda *told: said.append(("begins", *told)),
        end_round=lambda *told: said.append(("ends", *told[:3], told[3].tolist())),
    )
    learner._decide = lambda at_random: f"at random: {at_random}"
    learner._learning_stream = SimpleNamespace(following=nullcontext, join=lambda: said.append(("joins",)))
    learner._learn = lambda: said.append(("learns",))
    learner._schedule = lambda: said.append(("schedules",))
    learner._work(True, False, False)
    flown = [True, False]
    decided = ("charges", flown, 0.5, "inference")
    ends = ("ends", *results.values(), flown)
    assert said == [
        *(("begins", "seen", "at random: True"), ("flies", "at random: True"), decided),
        *(ends, ("schedules",)),
    ]
    assert all(th.equal(*each) for each in zip(before[2:], target.parameters(), strict=True))
    said.clear()
    learner._work(False, True, True)
    kinds = ["begins", "learns", "flies", "joins", "charges", "charges", "ends", "schedules"]
    assert [each[0] for each in said] == kinds
    assert said[5] == ("charges", [False, False], 0.125, "learning"), "two steps a round, one for each lane"
    for network in (online, target):
        assert all(th.equal(*each) for each in zip(before[:2], network.parameters(), strict=True))


def test_on_a_device_games_are_read_from_the_log_up_to_the_last_one_of_the_training(on_a_device: Any) -> None:
    """Three are over in a chunk of two rounds, of which the training still needs two; they share its four seconds."""
    learner, at = on_a_device, on_a_device._at
    refilled: list[Any] = []
    log = th.zeros((2, 4, at.columns), dtype=th.float64)
    for line, lane, reward in ((0, 2, 1.5), (1, 0, -2.5), (1, 3, 9.0)):
        log[line, lane, at.over], log[line, lane, at.reward] = 1.0, reward
    learner.lanes.info = lambda lane, outcome: {"reward": outcome[at.reward]}
    learner.lanes.games = SimpleNamespace(refill=refilled.append)
    learner._clock, read = (SimpleNamespace(now_ns=lambda: 5_000_000_000), SimpleNamespace(synchronize=lambda: None))
    sums = th.tensor([6.0, 8.0, 4.0], dtype=th.float64)
    learner._unread, learner.games = deque([(read, log, th.tensor([3, 1, 4, 1]), sums, 1_000_000_000)]), 6
    games = learner._read_chunk()
    assert [(each.number, each.lane, each.reward, each.loss, each.mean_q) for each in games] == [
        *((6, 2, 1.5, 1.5, 2.0), (7, 0, -2.5, 1.5, 2.0))
    ]
    for game in games:
        assert game.info["reward"] == game.reward
        assert game.info["host_phase_s"] == {**dict.fromkeys(PHASES, 0.0), "simulation": 2.0}
        assert game.exploration_rate == 0.2
    assert (learner.games, refilled, learner.at_rest) == (8, [[3, 1, 4, 1]], True)


SCHEDULE = {0: (1.0, 1.0), 1: (7 / 8, 1.0 - 0.8 / 2.4), 3: (5 / 8, 0.2), 8: (0.0, 0.2)}  # games: left, exploration


@pytest.mark.parametrize("fraction", [0.3, 0.0])
def test_learning_rate_and_exploration_fall_with_games_on_both(fraction: float, on_a_device: Any) -> None:
    """Exploration that falls over no games is the final one from the first; after the last game a device learns no
    more.
    """
    options = {"learning_rate": 3e-4, "exploration_final_eps": 0.2, "exploration_fraction": fraction}
    host, device, at = learning(1, options, games=8)[0], on_a_device, on_a_device._at.over
    device.options = DqnOptions(**options)
    device._log = th.zeros((8, 4, device._at.columns), dtype=th.float64)
    device._line, device._epsilon = th.zeros(1, dtype=th.int64), th.ones(())
    device._done, flown = th.zeros((), dtype=th.float64), 0
    rates = {"lr": th.tensor(0.0)}
    device.policy = SimpleNamespace(optimizer=SimpleNamespace(param_groups=[rates]))
    for line, (games, (left, exploration)) in enumerate(SCHEDULE.items()):
        host.games = games
        host._schedule()
        expected = (3e-4 * (0.02 + 0.98 * left), exploration if fraction else 0.2)
        assert (host.policy.optimizer.param_groups[0]["lr"], host.exploration_rate) == pytest.approx(expected)
        ended = min(games - flown, 4)
        device.lanes.ended[:, at] = (th.arange(4) < ended).double()
        device._done += games - flown - ended
        device._schedule()
        assert rates["lr"].item() == pytest.approx(expected[0] if left else 0.0)
        assert device._epsilon.item() == pytest.approx(expected[1])
        assert device._log[line, :, at].sum() == ended
        flown = games


@pytest.mark.usefixtures("host_kernels")
def test_on_a_device_the_first_convolution_is_a_product_of_patches(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same ratings as the policy's own, here in single precision."""
    from uavaccel.rl.patches import Patches

    monkeypatch.setattr(th, "autocast", lambda *_, **__: nullcontext())
    config = tiny_config(channels=[3, 4], hidden=[5])
    net = first_policy(config).q_net
    frames, rows, columns = config.task.observation_space().shape
    seen = th.from_numpy(np.random.default_rng(0).integers(0, 256, (2, frames, rows, columns)).astype(np.float32))
    patches = th.nn.functional.unfold(contrast(seen.clone()), 8, stride=4, padding=2)
    flat = patches.transpose(1, 2).reshape(-1, frames * 64)
    with th.no_grad():
        ours = Patches((frames, rows, columns), th.device("cpu")).rate(net, flat)
        np.testing.assert_allclose(ours.numpy(), net(seen).numpy(), atol=1e-5)


def test_adam_is_pytorchs_to_the_bit() -> None:
    generator = th.Generator().manual_seed(0)
    shapes = [(20, 30), (30,)]
    weights = [th.randn(shape, generator=generator) for shape in shapes]
    gradients = [[th.randn(shape, generator=generator) for shape in shapes] for _ in range(20)]
    learned = []
    for kind in (Adam, th.optim.Adam):
        parameters = [th.nn.Parameter(weight.clone()) for weight in weights]
        optimizer = kind(parameters, lr=1e-3, fused=True)
        for step in gradients:
            optimizer.zero_grad()
            for parameter, gradient in zip(parameters, step, strict=True):
                parameter.grad = gradient.clone()
            optimizer.step()
        optimizer.load_state_dict(optimizer.state_dict())
        learned.append([*parameters, *(each for state in optimizer.state.values() for each in state.values())])
    assert all(th.equal(ours, theirs) for ours, theirs in zip(*learned, strict=True))
