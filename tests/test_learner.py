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
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv

from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from tests.learning import tiny_config
from uavaccel.config import validate
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.rl import device_network, double_dqn, graph
from uavaccel.rl.agents import first_policy
from uavaccel.rl.algorithms import Adam
from uavaccel.rl.baseline import Baseline
from uavaccel.rl.config import DqnOptions, LearnerConfig, check_algorithm
from uavaccel.rl.contrast import contrast
from uavaccel.rl.double_dqn import DoubleDQN
from uavaccel.rl.graph import GraphedStep
from uavaccel.rl.lanes import BatchVecEnv, seed_lanes
from uavaccel.rl.learner import Game, learning_rhythm
from uavaccel.rl.policy import weights_sha256
from uavaccel.rl.replay import Batch
from uavaccel.rl.statistics import StepStatistics
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
        self.observation_space = spaces.Box(-np.inf, np.inf, SHAPE, np.float32)
        self.action_space = spaces.Discrete(2)
        self.log: list[list[Any]] = [[] for _ in range(lanes)]
        self._states, self._commands = [lane % 2 for lane in range(lanes)], [0] * lanes
        self._actions: dict[int, int] = {}

    def reset(self) -> np.ndarray:
        return self._seen(range(self.num_envs))

    def step_async(self, actions: np.ndarray, lanes: Sequence[int] | None = None) -> None:
        lanes = range(self.num_envs) if lanes is None else lanes
        assert not set(lanes) & set(self._actions), "a lane that flies cannot be told to"
        self._actions |= dict(zip(lanes, actions.tolist(), strict=True))

    def step_wait(self, lanes: Sequence[int] | None = None) -> tuple[Any, ...]:
        lanes = range(self.num_envs) if lanes is None else lanes
        rewards, dones, infos = zip(*(self._fly(lane) for lane in lanes), strict=True)
        return self._seen(lanes), np.array(rewards), np.array(dones), list(infos)

    def env_method(self, name: str, seconds: float, phase: str, indices: Any = None) -> None:
        assert name == "charge"
        for lane in range(self.num_envs) if indices is None else indices:
            self.log[lane].append((phase, seconds))

    def flown(self, lane: int) -> list[Flown]:
        return [each for each in self.log[lane] if isinstance(each, Flown)]

    def _fly(self, lane: int) -> tuple[float, bool, dict[str, Any]]:
        state, action = self._states[lane], self._actions.pop(lane)
        self._commands[lane] += 1
        over = state != action
        truncated = not over and self._commands[lane] == LAST
        reward = (0.3 if state == 0 else 1.0) if over else 0.0
        after = 2 if over else 1 - state
        self.log[lane].append(Flown(state, action, reward, after, over or truncated, truncated))
        info: dict[str, Any] = {"TimeLimit.truncated": truncated}
        if over or truncated:
            info |= {"terminal_observation": seen_of(after)}
            after, self._commands[lane] = lane % 2, 0
        self._states[lane] = after
        return reward, over or truncated, info

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
    return DoubleDQN(config_of(lanes, options, **keys), flown), flown  # type: ignore[arg-type]


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
    learner, _ = learning(lanes, options, turns=turns, games=300, commands_per_gradient_step=1)
    train(learner)
    with th.no_grad():
        rated = learner.policy.q_net(th.from_numpy(np.stack([seen_of(0), seen_of(1)])))
    np.testing.assert_allclose(rated.numpy(), TwoStates.ratings, atol=0.01)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_what_lanes_flew_is_what_can_be_learned_from(turns: int) -> None:
    learner, lanes = learning(3, turns=turns, games=60)
    games = train(learner)
    while len(learner._flying):  # down with them
        learner.holding = True
        learner.advance()
    kept = learner.buffer.get_state()
    names = ("observations", "actions", "rewards", "next_observations", "dones", "truncated")
    for lane in range(3):
        flown = lanes.flown(lane)[: len(learner.buffer)]
        for name, column in zip(names, zip(*flown, strict=True), strict=True):
            stored = kept[name][:, lane]
            if name.endswith("observations"):
                stored = stored[:, 0].argmax(axis=-1)
            np.testing.assert_allclose(stored, column, err_msg=name)
    assert [game.number for game in games] == list(range(60))
    if turns == 1:
        assert len(learner.buffer) == learner.steps == len(lanes.flown(0)) - 1, "nothing of the last one is kept"
    for lane in range(3):
        sums, total = [], 0.0
        for each in lanes.flown(lane):
            total += each.reward
            if each.over:
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


def test_without_a_simulated_wall_clock_nobody_pays() -> None:
    learner, lanes = learning(2, games=20)
    train(learner)
    assert all(isinstance(each, Flown) for log in lanes.log for each in log)
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


def test_a_game_that_is_over_at_its_time_limit_is_over_and_not_cut_short() -> None:
    """Its last observation and info are the ended game's, the observation that is returned the next one's."""
    ends = np.array([[True, True, False], [True, False, True]])  # terminated, truncated
    infos = [{"final_info": {"game": lane}, "final_obs": 9 + lane, "next": True} for lane in range(3)]
    batch: Any = SimpleNamespace(
        num_envs=3,
        single_observation_space=spaces.Box(0, 1, (1,)),
        single_action_space=spaces.Discrete(2),
        render_mode=None,
        step_wait=lambda lanes: (np.zeros((3, 1)), np.ones(3), *ends, infos),
    )
    lanes = BatchVecEnv(batch)
    _, _, dones, told = lanes.step_wait()
    assert dones.tolist() == [True] * 3
    assert told == [
        {"game": lane, "terminal_observation": 9 + lane, "TimeLimit.truncated": lane == 2} for lane in range(3)
    ]
    assert lanes.reset_infos == [{"next": True}] * 3


def test_what_a_reset_brings_and_was_given_is_of_each_lane_and_of_that_reset() -> None:
    """Seeds and options hold for one reset; the infos of a game that begins by itself are its own lane's."""
    asked: list[Any] = []
    begun: list[dict[str, Any]] = [{"begun": lane} for lane in range(3)]
    batch: Any = SimpleNamespace(
        num_envs=3,
        single_observation_space=spaces.Box(0, 1, (1,)),
        single_action_space=spaces.Discrete(2),
        render_mode=None,
        reset_each=lambda seeds, options: say_and(asked, (list(seeds), options), lambda: begun[:]),
        observations=lambda: np.zeros((3, 1)),
    )
    lanes = BatchVecEnv(batch)
    lanes.seed(5)
    lanes.set_options([{}, {"lane": 4}, {}])
    for expected in (([5, 6, 7], [None, {"lane": 4}, None]), ([None] * 3, [None] * 3)):
        lanes.reset()
        assert asked.pop() == expected
        assert lanes.reset_infos == begun
    infos = [{"now": 0}, {"final_info": {"last": 1}, "final_obs": 9, "now": 2}]
    batch.step_wait = lambda which: (np.zeros((2, 1)), np.ones(2), *np.zeros((2, 2), bool), infos)
    told = lanes.step_wait([0, 2])[3]
    assert told == [
        {"now": 0, "TimeLimit.truncated": False},
        {"last": 1, "terminal_observation": 9, "TimeLimit.truncated": False},
    ]
    assert lanes.reset_infos == [*begun[:2], {"now": 2}]


# --- a gradient step --------------------------------------------------------------------------------------------


def descended(batch: Batch, **options: Any) -> tuple[Any, np.ndarray, np.ndarray]:
    """The learner after one step of plain descent at a rate of 0.1, and its weights (2, numbers + bias) around it."""
    learner, _ = learning(1, options)
    net = learner.policy.q_net
    learner.policy.optimizer = th.optim.SGD(net.parameters(), lr=9.0)
    learner.rate = 0.1
    learner._sample = lambda: batch
    before = weights_of(net)
    learner._prepare_batch()
    learner._step()
    return learner, before, weights_of(net)


def weights_of(net: Any) -> np.ndarray:
    weights, bias = (parameter.detach().numpy() for parameter in net.parameters())
    return np.concatenate([weights, bias[:, None]], axis=1).copy()


def random_batch(count: int) -> Batch:
    random = np.random.default_rng(0)
    seen, after = random.normal(size=(2, count, *SHAPE)).astype(np.float32)
    rewards = random.normal(size=(count, 1)).astype(np.float32) * 3  # beyond the knee of Huber's loss, some
    dones = (random.random((count, 1)) < 0.3).astype(np.float32)
    discounts = random.uniform(0.2, 0.9, size=(count, 1)).astype(np.float32)
    actions = random.integers(2, size=(count, 1))
    return Batch(*(th.from_numpy(each) for each in (seen, actions, after, dones, rewards, discounts)))


def gradient(batch: Batch, weights: np.ndarray) -> np.ndarray:
    """Of the mean of Huber's loss, by hand; the target network is the online one."""
    total = np.zeros_like(weights)
    columns = (each.numpy().reshape(len(batch.actions), -1).astype(float) for each in batch)
    for seen, (action,), after, (done,), (reward,), (discount,) in zip(*columns, strict=True):
        seen, after = np.append(seen, 1.0), np.append(after, 1.0)
        target = reward + (1 - done) * discount * (weights @ after).max()
        error = (weights @ seen)[int(action)] - target
        total[int(action)] += np.clip(error, -1.0, 1.0) * seen
    return total / len(batch.actions)


def test_a_step_moves_the_weights_down_the_gradient_worked_out_by_hand() -> None:
    batch = random_batch(16)
    learner, before, after = descended(batch)
    np.testing.assert_allclose(after, before - 0.1 * gradient(batch, before), atol=1e-6)
    np.testing.assert_array_equal(weights_of(learner.policy.q_net_target), before)
    assert learner.updates == 1


def test_a_gradient_is_no_longer_than_its_limit() -> None:
    batch = random_batch(16)
    _, before, after = descended(batch, max_grad_norm=0.05)
    down = gradient(batch, before)
    length = np.linalg.norm(down)
    assert length > 0.1
    np.testing.assert_allclose(after, before - 0.1 * 0.05 * down / length, atol=1e-6)


def test_steps_at_once_are_steps_of_a_batch_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU, where batches are drawn together and a step is recorded once."""

    class Recorded:
        def __init__(self, step: Any, networks: Any, optimizer: Any, batch: Batch) -> None:
            self.step = step

        def __call__(self, batch: Batch) -> None:
            self.step(batch)

    monkeypatch.setattr(double_dqn, "GraphedStep", Recorded)
    drawn = random_batch(48)
    one, other = (learning(1)[0] for _ in range(2))
    for learner in (one, other):
        learner.policy.optimizer = th.optim.SGD(learner.policy.q_net.parameters(), lr=9.0)
        learner.rate = 0.1
    asked: list[str] = []
    one._sample = lambda batches: say_and(asked, str(batches), lambda: drawn)
    one._steps_at_once(3)
    for first in (0, 16, 32):
        other._sample = lambda at=first: Batch(*(each[at : at + 16] for each in drawn))
        other._prepare_batch()
        other._step()
    assert (asked, one.updates) == (["3"], 3)
    np.testing.assert_allclose(weights_of(one.policy.q_net), weights_of(other.policy.q_net), atol=1e-7)
    one._steps_at_once(0)
    assert (asked, one.updates) == (["3"], 3)
    one.device = SimpleNamespace(type="cuda")
    assert [part.args[0] for part in one._parts_of(5, 3)] == [2, 1, 2]


class OnCpu:
    """A linear network, its optimizer, and the batches that it has learned from."""

    def __init__(self, net: th.nn.Module) -> None:
        self.net, self.optimizer = net, th.optim.Adam(net.parameters(), lr=0.1)
        self.at: list[Batch] = []
        self.addresses: list[int] = []

    def held(self) -> list[tuple[str, th.Tensor]]:
        """Weights and moments."""
        moments = [each for of in self.optimizer.state.values() for each in of.items()]
        return [*self.net.named_parameters(), *moments]

    def learn(self, batch: Batch) -> None:
        self.optimizer.zero_grad(set_to_none=False)
        th.nn.functional.mse_loss(self.net(batch.observations.flatten(1)), batch.rewards).backward()
        self.optimizer.step()
        self.at.append(batch)
        self.addresses = [each.data_ptr() for _, each in self.held()]


@pytest.mark.parametrize("before", [0, 2])
def test_recording_a_step_leaves_weights_and_moments_as_they_were(before: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes steps of its own, of which nothing stays; a launch is then a plain step on the batch that it is given.

    A graph knows addresses alone, so that what it is recorded on has to stay where it is.
    """
    stream = SimpleNamespace(wait_stream=lambda _: None)
    for name in ("Stream", "current_stream"):
        monkeypatch.setattr(th.cuda, name, lambda: stream)
    monkeypatch.setattr(th.cuda, "stream", nullcontext)
    one = OnCpu(th.nn.Linear(math.prod(SHAPE), 1))
    plain = OnCpu(deepcopy(one.net))
    launched = SimpleNamespace(replay=lambda: one.learn(one.at[-1]))
    monkeypatch.setattr(th.cuda, "CUDAGraph", lambda: launched)
    monkeypatch.setattr(graph, "recording", nullcontext)
    batches = [random_batch(4)._replace(rewards=th.full((4, 1), float(n))) for n in range(before + 3)]
    for batch in batches[:before]:
        one.learn(batch)
        plain.learn(batch)
    recorded = GraphedStep(one.learn, one.net, one.optimizer, batches[before])
    assert one.addresses == [each.data_ptr() for _, each in one.held()]
    unmoved = [(name, th.zeros_like(each)) for name, each in one.held()[2:]]
    for (name, ours), (_, theirs) in zip(one.held(), [*plain.held(), *unmoved][: len(one.held())], strict=True):
        assert th.equal(ours, theirs), name
    for batch in batches[before + 1 :]:
        recorded(batch)
        plain.learn(batch)
    for (name, ours), (_, theirs) in zip(one.held(), plain.held(), strict=True):
        np.testing.assert_allclose(ours.detach(), theirs.detach(), atol=1e-7, err_msg=name)
    assert (batches[before].rewards == before).all(), "it has a batch of its own"


class Rated(th.nn.Module):
    """A network whose ratings of the actions are known: one row an observation."""

    def __init__(self, ratings: list[list[float]]) -> None:
        super().__init__()
        self.ratings, self.features_extractor = th.tensor(ratings), None

    def forward(self, observations: th.Tensor) -> th.Tensor:
        return self.ratings


RATED = SimpleNamespace(
    q_net=Rated([[1.0, 2.0], [4.0, 3.0], [0.0, 9.0]]), q_net_target=Rated([[10.0, 20.0], [30.0, 40.0], [5.0, 6.0]])
)


def a_batch(count: int) -> Batch:
    """Observations (count, 1, 1, 2), actions 0, 1, ...; the last game is over, and each discount its own."""
    images = th.arange(count * 2, dtype=th.float32).reshape(count, 1, 1, 2)
    actions = th.arange(count).reshape(-1, 1)
    rewards = th.arange(1.0, count + 1).reshape(-1, 1)
    dones, discounts = th.zeros(count, 1), 0.5 ** th.arange(1.0, count + 1).reshape(-1, 1)
    dones[-1] = 1.0
    return Batch(images, actions, images + 100, dones, rewards, discounts)


def test_the_target_network_rates_what_the_online_network_would_do() -> None:
    learner, _ = learning(1)
    learner.policy = RATED
    # 1 + 0.5 * 20 and 2 + 0.25 * 30, where plain DQN would take 40; the last game is over.
    np.testing.assert_allclose(learner.targets(a_batch(3)).numpy(), [[11.0], [9.5], [3.0]])


def test_half_of_a_batch_is_seen_in_a_mirror() -> None:
    batch, (learner, _) = a_batch(4), learning(1)
    assert learner._half_mirrored(batch) is batch
    learner.mirror = th.tensor((3, 2, 1, 0))
    turned = learner._half_mirrored(batch)
    np.testing.assert_array_equal(turned.actions.ravel(), [3, 2, 2, 3])
    for before, after in (
        (batch.observations, turned.observations),
        (batch.next_observations, turned.next_observations),
    ):
        np.testing.assert_array_equal(after[:2], before[:2].flip(-1))
        np.testing.assert_array_equal(after[2:], before[2:])
    np.testing.assert_array_equal(turned.rewards, batch.rewards)
    learner._sample, learner.targets = lambda: batch, lambda drawn: drawn.actions
    learner._prepare_batch()
    np.testing.assert_array_equal(learner._batch.actions, turned.actions)
    np.testing.assert_array_equal(learner._targets, turned.actions)


# --- exploration and schedules ----------------------------------------------------------------------------------


def test_it_explores_as_often_as_it_is_to() -> None:
    """Its greedy action is 1 everywhere; of those at random every second one is too."""
    learner, _ = learning(1, {"learning_starts": 100})
    with th.no_grad():
        learner.policy.q_net.q_net[0].bias.copy_(th.tensor([-100.0, 100.0]))

    def share(commands: int, exploration: float, count: int = 2_000) -> float:
        learner.commands, learner.exploration_rate = commands, exploration
        return float(np.mean([learner._act(seen_of(0)[None])[0] for _ in range(count)]))

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
        return first, coin, [each.action for each in lanes.flown(0)]

    once, again, other = drawn(5), drawn(5), drawn(6)
    assert once == again
    assert all(ours != theirs for ours, theirs in zip(once, other, strict=True))


def test_learning_rate_and_exploration_fall_with_games() -> None:
    learner, _ = learning(1, {"learning_rate": 3e-4, "exploration_final_eps": 0.2}, games=8)
    expected = {
        0: (3e-4, 1.0),
        1: (3e-4 * (0.02 + 0.98 * 7 / 8), 1.0 - 0.8 / 2.4),
        2: (3e-4 * (0.02 + 0.98 * 6 / 8), 1.0 - 1.6 / 2.4),
        3: (3e-4 * (0.02 + 0.98 * 5 / 8), 0.2),
        8: (6e-6, 0.2),
    }
    for games, (rate, exploration) in expected.items():
        learner.games = games
        learner._schedule()
        assert (learner.rate, learner.exploration_rate) == pytest.approx((rate, exploration))
    learner._sample = lambda: random_batch(16)
    learner._prepare_batch()
    learner._step()
    assert learner.policy.optimizer.param_groups[0]["lr"] == pytest.approx(6e-6)


def test_exploration_that_falls_over_no_games_is_the_final_one_from_the_first() -> None:
    options = DqnOptions(exploration_fraction=0.0, exploration_final_eps=0.2)
    assert [options.exploration_rate(remaining) for remaining in (1.0, 0.5, 0.0)] == [0.2, 0.2, 0.2]


def test_options_that_are_left_out_are_those_of_the_shipped_policy() -> None:
    assert DqnOptions().model_dump() == {
        "learning_rate": 3e-4, "buffer_size": 150_000, "learning_starts": 2_000, "batch_size": 32, "gamma": 0.95,
        "n_steps": 3, "target_update_interval": 2_000, "exploration_initial_eps": 1.0, "exploration_fraction": 0.3,
        "exploration_final_eps": 0.01, "max_grad_norm": 10.0,
    }  # fmt: skip
    assert LearnerConfig().model_dump(exclude={"task"}) == {
        "seed": 0, "games": 5000, "simulator": "mujoco", "environments": 1, "turns": 1, "algorithm": "double_dqn",
        "options": {}, "final_learning_rate_share": 0.02, "commands_per_gradient_step": 4, "mirror": True,
        "mirrored_decisions": False, "start_from": None, "channels": (16, 32), "hidden": (256,), "device": "cpu",
        "torch_threads": 1, "checkpoint_games": 250, "inference_s": 0.0005, "learning_s": 0.01,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("algorithm", "fits", "too_large"),
    [
        ("double_dqn", {"buffer_size": 100}, {"buffer_size": 101}),
        ("dqn", {"buffer_size": 100}, {"buffer_size": 101}),
        ("ppo", {"n_steps": 50}, {"n_steps": 51}),  # of each of two lanes
    ],
)
def test_what_takes_more_memory_than_there_is_is_refused_beforehand(
    algorithm: str, fits: dict[str, int], too_large: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaccel.rl.config.memory_bytes", lambda: 100 * math.prod(SHAPE) * 4)  # of float32
    config = config_of(2, {}).model_copy(update={"algorithm": algorithm, "options": fits})
    check_algorithm(config)
    check_algorithm(config.model_copy(update={"options": too_large, "device": "cuda"}))  # whose memory is another
    (name,) = fits
    with pytest.raises(UserError, match=rf"^options of {algorithm}: {name}: 10[12] observations take 1\.5\d+e-05 GB"):
        check_algorithm(config.model_copy(update={"options": too_large}))


def test_trainings_of_neighbouring_seeds_fly_lanes_far_apart() -> None:
    """Lane n of a training has its seed plus n, so these have to be farther apart than there are lanes."""
    seeds: list[int] = []
    for _ in range(2):
        for seed in range(20):
            seed_lanes(SimpleNamespace(seed=seeds.append), seed)
    assert seeds[:20] == seeds[20:]
    assert min(after - before for before, after in pairwise(sorted(seeds[:20]))) > 10_000
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
    second.set_state(deepcopy(first.get_state()), first.observations)
    for name in double_dqn.COUNTERS:
        assert getattr(second, name) == getattr(first, name), name
    for each in (first, second):
        th.manual_seed(1)
        for _ in range(4):
            each._prepare_batch()
            each._step()
    np.testing.assert_array_equal(weights_of(first.policy.q_net), weights_of(second.policy.q_net))
    assert second.random.rand() == first.random.rand()
    share_s = second.owed / 2 * 0.25
    second.advance()
    assert [log[0] for log in lanes.log] == [("learning", share_s)] * 2, "what was due is still paid for"


# --- stable-baselines3's algorithms --------------------------------------------------------------------------------


class ThreeCommands(gymnasium.Env[Any, Any]):
    """Games of three commands, every second one cut short, without anything to learn."""

    observation_space = spaces.Box(-1.0, 1.0, SHAPE, np.float32)
    action_space = spaces.Discrete(2)
    charged: ClassVar[list[tuple[float, str]]] = []
    games = 0

    def reset(self, **_: Any) -> Any:
        self.commands, self.games = 0, self.games + 1
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> Any:
        self.commands += 1
        over, cut_short = self.commands == 3, self.games % 2 == 0
        return self.observation_space.sample(), 1.0 + action, over and not cut_short, over and cut_short, {}

    def charge(self, seconds: float, phase: str) -> None:
        self.charged.append((seconds, phase))


def baseline(algorithm: str, options: dict[str, Any], lanes: int = 2, **keys: Any) -> Any:
    config = config_of(lanes, {}, **keys).model_copy(update={"algorithm": algorithm, "options": options})
    ThreeCommands.charged.clear()
    learner = Baseline(config, DummyVecEnv([ThreeCommands] * lanes))
    learner.lanes.seed(config.seed)
    return learner


DQN = {"learning_rate": 2e-3, "learning_starts": 0, "batch_size": 4, "buffer_size": 40}


def test_a_baselines_learning_rate_falls_with_games_and_its_weights_are_of_the_seed() -> None:
    """To the share of the initial one that the training names, as that of this project's own algorithm."""
    options = {"learning_rate": 2e-3, "n_steps": 3, "batch_size": 3, "n_epochs": 1}
    learner = baseline("ppo", options, games=9, final_learning_rate_share=0.1)
    rates = []
    while learner.games < 8:
        assert len(learner.advance()) == 2
        rates.append(learner.policy.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([2e-3 * (0.1 + 0.9 * (1 - games / 9)) for games in (2, 4, 6, 8)])
    assert [game.number for game in learner.advance()] == [8]
    first, again, other = (weights_sha256(baseline("ppo", options, seed=seed).policy) for seed in (3, 3, 4))
    assert first == again != other


def test_a_baseline_with_a_replay_buffer_learns_as_often_as_it_is_to_and_pays() -> None:
    """Two lanes and a gradient step every six commands: after every third command of both."""
    keys: dict[str, Any] = {"task": {"timing": "virtual"}, "learning_s": 0.5, "inference_s": 0.125}
    learner = baseline("dqn", DQN, games=100, commands_per_gradient_step=6, **keys)
    for rollouts in range(1, 4):
        learner.advance()
        assert (learner.algorithm.num_timesteps, learner.algorithm._n_updates) == (6 * rollouts, rollouts)
    assert learner.lanes.envs[0].unwrapped.charged == [*[(0.125, "inference")] * 6, *[(0.25, "learning")] * 2] * 3


def test_a_baseline_learns_from_no_game_beyond_the_last_one() -> None:
    """Its third game is over in the middle of a rollout, which is then left unfinished."""
    learner = baseline("ppo", {"n_steps": 12, "batch_size": 4}, games=3)
    assert [game.number for game in learner.advance()] == [0, 1, 2]
    assert (learner.algorithm.num_timesteps, learner.algorithm._n_updates) == (2 * 6, 0)


def test_a_baselines_phases_are_timed_and_its_games_have_the_loss_before_them() -> None:
    learner = baseline("dqn", DQN, games=100, commands_per_gradient_step=6)
    phases: list[str] = []
    learner.stopwatch = SimpleNamespace(phase=lambda name: say_and(phases, name, nullcontext))
    assert [game.loss for game in learner.advance()] == [None, None]
    assert phases == ["inference"] * 3 + ["learning"]
    for name, value in (("loss", 0.125), ("value_loss", 7.0), ("learning_rate", 9.0)):
        learner.algorithm.logger.record(f"train/{name}", value)
    assert [game.loss for game in learner.advance()] == [0.125, 0.125]


def test_a_baseline_goes_on_from_its_state() -> None:
    """Two that were one learn the same weights from then on, on the same batches."""
    first, second = (baseline("dqn", DQN, games=100, commands_per_gradient_step=2, seed=seed) for seed in (0, 1))
    for _ in range(25):  # the buffer of twenty rows has been filled once
        first.advance()
    state = deepcopy(first.get_state())
    second.set_state(state, first.algorithm._last_obs)
    there, here = first.algorithm, second.algorithm
    assert there.replay_buffer.timeouts.any()
    for name in ("observations", "next_observations", "actions", "rewards", "dones", "timeouts", "pos", "full"):
        kept, back = (getattr(each.replay_buffer, name) for each in (there, here))
        np.testing.assert_array_equal(back, kept, err_msg=name)
    for name in ("num_timesteps", "_n_calls", "_n_updates", "exploration_rate", "_current_progress_remaining"):
        assert getattr(here, name) == getattr(there, name) != getattr(baseline("dqn", DQN).algorithm, name), name
    assert (second.games, second.returns) == (first.games, first.returns)
    hashes = []
    for each in (first, second):
        each.set_state(deepcopy(state), first.algorithm._last_obs)
        each.algorithm.train(4, 4)
        hashes.append(weights_sha256(each.policy))
    assert hashes[0] == hashes[1] != weights_sha256(baseline("dqn", DQN).policy)


# --- the learner beside lanes on a GPU, on tensors of the CPU -----------------------------------------------------


@pytest.fixture
def on_a_device(host_kernels: None) -> Any:  # noqa: F811
    """A learner without lanes or graphs: options, ring and networks of four lanes over pictures of 1 x 1 x 2."""
    from uavaccel.envs.cuda_lanes import AT
    from uavaccel.rl.device_dqn import DeviceDQN

    learner: Any = DeviceDQN.__new__(DeviceDQN)
    learner.config = validate(
        TrainConfig, {"games": 8, "commands_per_gradient_step": 8, "final_learning_rate_share": 0.02}, "test"
    )
    learner.options = DqnOptions(
        learning_starts=8, n_steps=2, target_update_interval=24, exploration_final_eps=0.2, max_grad_norm=0.05
    )
    learner.AT = AT
    learner.lanes = SimpleNamespace(count=4, ended=th.zeros((4, AT.columns), dtype=th.float64))
    learner._turned = th.tensor([1, 0])
    learner.statistics = StepStatistics(th.device("cpu"))
    return learner


def a_window(learner: Any, weights: Sequence[float]) -> Any:
    from uavaccel.rl.device_replay import Windows

    count = len(weights)
    random = np.random.default_rng(0)
    learner.replay = SimpleNamespace(observations=th.from_numpy(random.normal(size=(6, 4, 2)).astype(np.float32)))
    learner._cut = lambda ring, row, lane, mirrored: th.where(
        mirrored[:, None], ring[row, lane].flip(-1), ring[row, lane]
    )
    learner._rate = lambda network, seen: network(seen)
    return Windows(
        th.arange(count),
        th.arange(count) + 2,
        th.arange(count) % 4,
        th.tensor([0, 1, 0, 1][:count]),
        th.tensor([3.0, -2.0, 0.1, 0.2][:count]),
        th.tensor([0.5, 0.25, 0.0, 0.125][:count]),
        th.tensor(weights),
        th.tensor([True, False, True, False][:count]),
    )


@pytest.mark.parametrize("limit", [10.0, 0.05])
def test_on_a_device_a_step_moves_the_weights_down_the_gradient_worked_out_by_hand(
    on_a_device: Any, limit: float
) -> None:
    learner, weights = on_a_device, [1.0, 0.0, 1.0, 1.0]
    batch = a_window(learner, weights)
    learner.options = learner.options.model_copy(update={"max_grad_norm": limit})
    th.manual_seed(0)
    online, target = th.nn.Linear(2, 2), th.nn.Linear(2, 2)
    with th.no_grad():  # which rates highest what the other rates lowest
        target.weight.copy_(-online.weight / 2)
        target.bias.copy_(-online.bias / 2)
    learner.policy = th.nn.ModuleDict({"q_net": online, "q_net_target": target})
    learner.policy.q_net, learner.policy.q_net_target = online, target
    learner.policy.optimizer = th.optim.SGD(online.parameters(), lr=0.1)
    before, rated = weights_of(online), weights_of(target)
    learner._descend(batch)
    ring, total = learner.replay.observations.numpy(), np.zeros((2, 3))
    losses, chosen = [], []
    for at in range(4):
        turn = -1 if batch.mirrored[at] else 1
        seen = np.append(ring[at, at][::turn], 1.0)
        after = np.append(ring[at + 2, at][::turn], 1.0)
        action = int(batch.actions[at]) if turn == 1 else 1 - int(batch.actions[at])
        best = int((before @ after).argmax())
        goal = float(batch.rewards[at] + batch.discounts[at] * (rated @ after)[best])
        error = (before @ seen)[action] - goal
        total[action] += weights[at] * np.clip(error, -1.0, 1.0) * seen / 4
        losses.append(weights[at] * (error**2 / 2 if abs(error) < 1.0 else abs(error) - 0.5))
        chosen.append((before @ seen)[action])
    share: float = min(1.0, limit / float(np.linalg.norm(total)))
    np.testing.assert_allclose(weights_of(online), before - 0.1 * total * share, atol=1e-6)
    np.testing.assert_array_equal(weights_of(target), rated)
    learner.statistics.read(learner.statistics.sums)
    assert learner.statistics.loss == pytest.approx(np.mean(losses), abs=1e-6)
    assert learner.statistics.mean_q == pytest.approx(np.mean(chosen), abs=1e-6)


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


def test_on_a_device_lanes_pay_for_their_decisions_and_their_share_of_learning(on_a_device: Any) -> None:
    """Two gradient steps in a round of four lanes: half of one for each."""
    learner, charged = on_a_device, []
    learner.config = SimpleNamespace(commands_per_gradient_step=2, inference_s=0.5, learning_s=0.125)
    learner.lanes.charge = lambda flown, seconds, phase: charged.append((flown, seconds, phase))
    for learns in (False, True):
        learner._charge("flown", learns)
    decided = ("flown", 0.5, "inference")
    assert charged == [decided, decided, ("flown", 0.0625, "learning")]


def test_on_a_device_lanes_explore_as_often_as_they_are_to(on_a_device: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A lane that sees n rates action n highest, which a random action is in a third of the cases too."""
    from uavaccel.rl import device_dqn

    class Cut:
        down = across = 1

        def __call__(self, ring: th.Tensor, row: th.Tensor, lane: th.Tensor, mirrored: th.Tensor) -> th.Tensor:
            assert not mirrored.any()
            return ring[row, lane]

    lanes, learner = 3_000, on_a_device
    learner.device, learner.lanes.count, learner._turned = th.device("cpu"), lanes, th.arange(3)
    learner.lanes.observations = th.arange(lanes) % 3
    learner._zeros, learner._lane_numbers = th.zeros(lanes, dtype=th.int64), th.arange(lanes)
    learner._cut, learner.policy = Cut(), SimpleNamespace(q_net=lambda seen: th.eye(3)[seen])
    monkeypatch.setattr(device_dqn, "rate", lambda network, seen, down, across: network(seen))
    th.manual_seed(0)
    for exploration, at_random, greedy in ((0.0, False, 1.0), (0.4, False, 0.6 + 0.4 / 3), (0.0, True, 1 / 3)):
        learner._epsilon = th.tensor(exploration)
        actions = learner._decide(at_random)
        assert (actions == learner.lanes.observations).double().mean() == pytest.approx(greedy, abs=0.03)
        assert actions.bincount(minlength=3).tolist() == pytest.approx([lanes / 3] * 3, abs=0.03 * lanes)


def test_on_a_device_each_gradient_step_has_a_batch_of_its_own(on_a_device: Any) -> None:
    """Sixteen lanes and a step every eight commands: two steps a round, on windows that are drawn together."""
    from uavaccel.rl.device_replay import Windows

    learner = on_a_device
    drawn: list[Any] = []
    batches: list[Any] = []
    learner.lanes.count = 16
    learner.options = learner.options.model_copy(update={"batch_size": 3, "gamma": 0.25})
    windows = Windows(*(th.arange(6) + 10 * column for column in range(8)))
    learner.replay = SimpleNamespace(sample=lambda *told: say_and(drawn, told, lambda: windows))
    learner._descend = batches.append
    for mirror in (True, False):
        learner.config = learner.config.model_copy(update={"mirror": mirror})
        learner._learn()
    assert drawn == [(6, 2, 0.25, True), (6, 2, 0.25, False)]
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

    def fly(actions: Any) -> None:
        said.append(("flies", actions))
        vars(learner.lanes).update(results)
        learner.lanes.going.copy_(th.tensor([False, False]))

    learner.lanes = SimpleNamespace(going=th.tensor([True, False]), observations="seen", fly=fly)
    learner.replay = SimpleNamespace(
        start_round=lambda *told: said.append(("begins", *told)),
        end_round=lambda *told: said.append(("ends", *told[:3], told[3].tolist())),
    )
    learner._decide = lambda at_random: f"at random: {at_random}"
    learner._learning_stream = SimpleNamespace(following=nullcontext, join=lambda: said.append(("joins",)))
    learner._learn = lambda: said.append(("learns",))
    learner._charge = lambda flown, learns: said.append(("charges", flown.tolist(), learns))
    learner._schedule = lambda: said.append(("schedules",))
    learner._work(True, False, False)
    flown = [True, False]
    ends = ("ends", *results.values(), flown)
    assert said == [
        *(("begins", "seen", "at random: True"), ("flies", "at random: True"), ("charges", flown, False)),
        *(ends, ("schedules",)),
    ]
    assert all(th.equal(*each) for each in zip(before[2:], target.parameters(), strict=True))
    said.clear()
    learner._work(False, True, True)
    assert [each[0] for each in said] == ["begins", "learns", "flies", "joins", "charges", "ends", "schedules"]
    for network in (online, target):
        assert all(th.equal(*each) for each in zip(before[:2], network.parameters(), strict=True))


def test_on_a_device_games_are_read_from_the_log_up_to_the_last_one_of_the_training(on_a_device: Any) -> None:
    """Three are over in a chunk of two rounds, of which the training still needs two; they share its four seconds."""
    learner, at = on_a_device, on_a_device.AT
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


def test_on_a_device_learning_rate_and_exploration_fall_with_games(on_a_device: Any) -> None:
    learner, at = on_a_device, on_a_device.AT.over
    learner._log = th.zeros((8, 4, learner.AT.columns), dtype=th.float64)
    learner._line, learner._epsilon = th.zeros(1, dtype=th.int64), th.ones(())
    learner._done = th.zeros((), dtype=th.float64)
    rates = {"lr": th.tensor(0.0)}
    learner.policy = SimpleNamespace(optimizer=SimpleNamespace(param_groups=[rates]))
    over = [(0, 1.0, 1.0), (1, 7 / 8, 1.0 - 0.8 / 2.4), (2, 5 / 8, 0.2), (4, 1 / 8, 0.2), (1, None, 0.2)]
    for line, (ended, remaining, exploration) in enumerate(over):
        learner.lanes.ended[:, at] = (th.arange(4) < ended).double()
        learner._schedule()
        rate = 0.0 if remaining is None else 3e-4 * (0.02 + 0.98 * remaining)
        assert rates["lr"].item() == pytest.approx(rate)
        assert learner._epsilon.item() == pytest.approx(exploration)
        assert learner._log[line, :, at].sum() == ended


def test_on_a_device_the_first_convolution_is_a_product_of_patches(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same ratings as the policy's own, here in single precision."""
    monkeypatch.setattr(th, "autocast", lambda *_, **__: nullcontext())
    config = tiny_config(channels=[3, 4], hidden=[5])
    net: Any = first_policy(config, lambda _: 1e-3).q_net
    frames, rows, columns = config.task.observation_space().shape
    seen = th.from_numpy(np.random.default_rng(0).integers(0, 256, (2, frames, rows, columns)).astype(np.float32))
    patches = th.nn.functional.unfold(contrast(seen.clone()), 8, stride=4, padding=2)
    flat = patches.transpose(1, 2).reshape(-1, frames * 64)
    with th.no_grad():
        ours = device_network.rate(net, flat, 9, 16)
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
