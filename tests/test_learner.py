"""Double DQN by hand, on lanes of the host and of a GPU: a game learned to its exact values, gradients, who pays."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from copy import deepcopy
from itertools import pairwise, product
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from torch.nn.utils import parameters_to_vector

from tests.golden import assert_numbers_as_recorded
from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from tests.learning import tiny_config
from uavaccel.errors import UserError
from uavaccel.rl.agents import first_policy
from uavaccel.rl.config import check_algorithm
from uavaccel.rl.double_dqn import DeviceDQN, HostDQN
from uavaccel.rl.learner import Game, StepStatistics, first_seed, learning_rhythm
from uavaccel.rl.network import Adam, Windows, contrast
from uavaccel.rl.policy import weights_sha256
from uavaccel.suites.train import TrainConfig

pytestmark = pytest.mark.filterwarnings("ignore:.*CUDA is not available:UserWarning")

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


class OnDevice(TwoStates):
    """The same games as tensors, with what a learner on a GPU asks of lanes."""

    def __init__(self, lanes: int) -> None:
        from uavaccel.envs.cuda_lanes import AT

        super().__init__(lanes)
        self._at, self.count, self.device = AT, lanes, th.device("cpu")
        self.observations = th.from_numpy(self._seen(range(lanes)))
        self.rewards, self.terminated, self.truncated = th.zeros(lanes), *(th.zeros(lanes).bool() for _ in range(2))
        self.going, self.ended = th.ones(lanes, dtype=th.uint8), th.zeros((lanes, AT.columns), dtype=th.float64)
        self.returns = np.zeros(lanes)
        self.begun_when_refilled: list[list[int]] = []
        self.games = SimpleNamespace(begun=th.zeros(lanes), seed=self.seeds.append, has_games=False)
        self.games.refill = self.begun_when_refilled.append

    def begin(self) -> None:
        self.games.has_games = True

    def fly(self, actions: th.Tensor) -> None:
        lanes = range(self.count)
        assert self.begun_when_refilled[0] == [1] * self.count, "a lane has a game to go on with"
        self.step_async(actions.numpy(), lanes)
        seen, *told, _ = self.step_wait(lanes)
        self.observations.copy_(th.from_numpy(seen))
        for room, values in zip((self.rewards, self.terminated, self.truncated), told, strict=True):
            room.copy_(th.from_numpy(values))
        self.truncated &= ~self.terminated
        over = told[1] | told[2]
        self.returns += told[0]
        self.ended[:, self._at.over], self.ended[:, self._at.reward] = th.tensor(over).double(), th.tensor(self.returns)
        self.returns[over] = 0.0

    def charge(self, flown: th.Tensor, seconds: float, phase: str) -> None:
        assert flown.all()
        self.call_each("charge", [(seconds, phase)] * self.count, range(self.count))

    def info(self, lane: int, outcome: Any) -> dict[str, Any]:
        return {"of": lane}


def config_of(lanes: int, options: dict[str, Any] | None = None, **keys: Any) -> TrainConfig:
    """A linear network, which rates a one-hot state by a number of its own."""
    task = {**TASK, **keys.pop("task", {})}
    keys = {"hidden": [], "mirror": False, "environments": lanes, "games": 400, **keys}
    return tiny_config(task, options={**OPTIONS, **(options or {})}, **keys)


def learning(lanes: int, options: dict[str, Any] | None = None, kind: Any = HostDQN, **keys: Any) -> tuple[Any, Any]:
    """A learner and its lanes; `kind` is HostDQN or DeviceDQN."""
    flown = TwoStates(lanes) if kind is HostDQN else OnDevice(lanes)
    return kind(config_of(lanes, options, **keys), flown), flown


def train(learner: Any, games: int | None = None) -> list[Game]:
    """Until so many games are over, by default all, and nothing flies any more."""
    ended: list[Game] = []
    enough = games or learner.config.games
    while learner.games < enough or (learner._unread if isinstance(learner, DeviceDQN) else learner._flying):
        learner.holding = learner.games >= enough
        ended += learner.advance()
    learner.holding = False
    return ended


@pytest.fixture(autouse=True)
def _on_one_thread(host_kernels: None) -> Iterator[None]:  # noqa: F811
    """More threads wait for each other longer than such networks take."""
    before = th.get_num_threads()
    th.set_num_threads(1)
    yield
    th.set_num_threads(before)
    th.use_deterministic_algorithms(False)


BOTH = pytest.mark.parametrize("kind", [HostDQN, DeviceDQN])

# --- a whole training -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lanes", "keys"),
    [(1, {}), (3, {"turns": 2}), (4, {"kind": DeviceDQN, "options": {"n_steps": 1, "target_update_interval": 32}})],
)
def test_a_game_of_two_states_is_learned_to_its_exact_ratings(lanes: int, keys: dict[str, Any]) -> None:
    """Wrong at once if the loss rises, an end leads on, a cut-off does not, or the discount is another."""
    options = {"target_update_interval": 20, "exploration_fraction": 0.8, "exploration_final_eps": 0.5}
    keys = {"games": 300, "commands_per_gradient_step": 1, **keys, "options": options | keys.get("options", {})}
    learner, flown = learning(lanes, **keys)
    train(learner)
    with th.no_grad():
        rated = learner.policy.q_net(th.from_numpy(np.stack([seen_of(0), seen_of(1)])))
    np.testing.assert_allclose(rated.numpy(), TwoStates.ratings, atol=0.02)
    assert flown.seeds == [first_seed(learner.config.seed)]


@pytest.mark.parametrize("keys", [{"turns": 1}, {"turns": 2}, {"turns": 3}, {"kind": DeviceDQN}], ids=str)
def test_what_lanes_flew_is_what_can_be_learned_from(keys: dict[str, Any]) -> None:
    learner, lanes = learning(3, games=60, **keys)
    games = train(learner)
    kept, rows = learner.replay.get_state(), int(learner.replay.filled)
    for lane in range(3):
        flown = lanes.flown(lane)[:rows]
        for name, column in zip(NAMES, zip(*flown, strict=True), strict=True):
            if name in kept:  # on a GPU what follows is the next row's
                stored = kept[name][:rows, lane]
                if name.endswith("observations"):
                    stored = stored[:, 0].argmax(axis=-1)
                np.testing.assert_allclose(stored, column, err_msg=name)
    assert [game.number for game in games] == list(range(60))
    assert all(game.info["of"] == game.lane for game in games)
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


NAMES = ("observations", "actions", "rewards", "next_observations", "over", "cut")


@pytest.mark.parametrize("keys", [{"turns": 1}, {"turns": 3}, {"kind": DeviceDQN}], ids=str)
def test_each_lane_pays_its_share_of_learning_and_each_decision(keys: dict[str, Any]) -> None:
    """Three gradient steps after every second command of three lanes: one for each lane, before its next command."""
    told: dict[str, Any] = {
        "commands_per_gradient_step": 2,
        "learning_s": 0.25,
        "inference_s": 0.125,
        "options": {"target_update_interval": 1},  # more often than once a round it cannot be
        "task": {"timing": "virtual"},
    }
    learner, lanes = learning(3, games=30, **told, **keys)
    train(learner)
    for log in lanes.log:
        decided = [each for before, each in pairwise(log) if isinstance(before, Flown)]
        assert set(decided) == {("inference", 0.125)}
        paid = [number for number, each in enumerate(log) if each == ("learning", 0.25)]
        flown = [sum(isinstance(each, Flown) for each in log[:number]) for number in paid]
        assert set(np.diff(flown)) == {2}
        assert flown[0] in (3, 4, 5), "from more than eight commands on"
    learner, lanes = learning(2, games=20, **keys | ({"turns": 1} if "turns" in keys else {}))
    train(learner)
    assert all(isinstance(each, Flown) or each[1] == 0.0005 for log in lanes.log for each in log) or "kind" in keys


def test_each_second_of_the_machine_is_told_of_once() -> None:
    """While one chunk is read the next is in flight; each look at the clock takes a second, and the pause a minute."""
    learner, _ = learning(3, kind=DeviceDQN)
    told_s, looks = 0.0, [0]

    def now_ns() -> int:
        looks.append(looks[-1] + 1)
        return looks[-1] * 1_000_000_000

    learner._clock = SimpleNamespace(now_ns=now_ns)
    for pauses in (0, 1):
        for holding in (False, False, False, True, True):
            learner.holding = holding
            told_s += sum(game.info["host_phase_s"]["simulation"] for game in learner.advance())
        assert learner.at_rest
        assert told_s == pytest.approx(looks[-1] - 1 - 61 * pauses)
        looks.append(looks[-1] + 60)


@BOTH
def test_what_begins_with_learned_weights_takes_no_action_at_random(kind: Any) -> None:
    """Where exploration falls over no games: it is the final one from the first. A GPU learns nothing after the last.

    The greedy action is 1 everywhere.
    """
    options = {"exploration_fraction": 0.0, "exploration_final_eps": 0.0, "learning_starts": 10**6}
    learner, lanes = learning(4, options, kind, games=60)
    learner.config = learner.config.model_copy(update={"start_from": "default"})
    with th.no_grad():
        learner.policy.q_net.q_net[0].bias.copy_(th.tensor([-100.0, 100.0]))
    train(learner)
    assert {each.action for lane in range(4) for each in lanes.flown(lane)[1:]} == {1}
    assert learner.exploration_rate == 0.0
    assert kind is HostDQN or float(learner.optimizer.param_groups[0]["lr"]) == 0.0


MOVED: dict[str, dict[str, Any]] = {
    "defaults": {},
    "turns 2": {"turns": 2},
    **{f"{name} {value}": {"options": {name: value}} for name, value in (
        ("learning_rate", 0.01), ("buffer_size", 24), ("learning_starts", 30), ("batch_size", 5), ("gamma", 0.9),
        ("n_steps", 3), ("target_update_interval", 12), ("exploration_initial_eps", 0.4), ("exploration_fraction", 0.9),
        ("exploration_final_eps", 0.5), ("max_grad_norm", 0.01),
    )},
    **{f"{name} {value}": {name: value} for name, value in (
        ("final_learning_rate_share", 0.7), ("commands_per_gradient_step", 1), ("hidden", [5]), ("seed", 3),
    )},
}  # fmt: skip


def test_each_setting_changes_what_is_learned_as_recorded() -> None:
    """In the middle and at the end: exploration, learning rate, loss, mean value, weights of both networks, actions."""
    told: dict[str, list[float]] = {}
    for kind, (label, keys) in product((HostDQN, DeviceDQN), MOVED.items()):
        on_host = kind is HostDQN
        if "turns" in keys and not on_host:
            continue
        options = {"target_update_interval": 40} | keys.get("options", {})
        learner, lanes = learning(4, **{**keys, "options": options, "games": 60, "kind": kind})
        numbers: list[float] = []
        for games in (30, 60) if on_host else (60,):
            train(learner, games)
            networks = (learner.policy.q_net, learner.policy.q_net_target)
            weights = [parameters_to_vector(net.parameters()).detach().double() for net in networks]
            flown = (each.action for lane in range(4) for each in lanes.flown(lane))
            numbers += [learner.exploration_rate, float(learner.optimizer.param_groups[0]["lr"]), sum(flown)]
            numbers += [learner.statistics.loss, learner.statistics.mean_q]
            numbers += [float(number) for each in weights for number in (each.sum(), each.std())]
        told[f"{kind.__name__}, {label}"] = numbers
    assert_numbers_as_recorded("learned_by_double_dqn", told)


def test_a_learner_goes_on_from_its_state() -> None:
    """From where it owes gradient steps on, another one flies, pays and learns the same, to the last bit."""
    keys: dict[str, Any] = {"games": 60, "task": {"timing": "virtual"}, "learning_s": 0.25, "mirror": False}
    first, lanes = learning(2, **keys)
    while not (first.games > 20 and first.at_rest and first.owed):
        first.advance()
    second, others = learning(2, **keys, seed=5)
    state = deepcopy(first.get_state())
    json.dumps(state.counters)
    second.set_state(state, first.observations)
    vars(others).update(deepcopy(vars(lanes)))
    ended = []
    for each in (first, second):
        th.set_rng_state(state.tensors["torch"])
        ended.append((train(each), weights_sha256(each.policy)))
    assert ended[0] == ended[1]
    assert lanes.log == others.log


# --- a gradient step --------------------------------------------------------------------------------------------


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
def test_a_step_follows_the_gradient_worked_out_by_hand(limit: float) -> None:
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
    learner.optimizer = th.optim.SGD(online.parameters(), lr=0.1)
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
        train(learner, 10)
        learner.updates = 0
        learner.config = learner.config.model_copy(update={"mirror": True})
    drawn = one._sample(3)
    assert drawn.mirrored.tolist() == ([True] * 8 + [False] * 8) * 3
    one._sample = lambda batches: drawn
    one._steps_at_once(3)
    for batch in drawn.split(16):
        other._batch = other._prepared(batch)
        other._step()
    assert (one.updates, other.updates) == (3, 3)
    assert weights_sha256(one.policy) == weights_sha256(other.policy)


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


@pytest.mark.parametrize(
    ("algorithm", "fits", "too_large"),
    [
        ("double_dqn", {"buffer_size": 100}, {"buffer_size": 101}),
        ("ppo", {"rollout": 50, "minibatches": 5}, {"rollout": 51, "minibatches": 2}),  # of each of two lanes
    ],
)
def test_what_takes_too_much_memory_is_refused_beforehand(
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


@pytest.mark.parametrize(
    ("commands", "environments", "rhythm"), [(4, 1, (4, 1)), (4, 5, (4, 5)), (4, 8, (1, 2)), (1, 3, (1, 3))]
)
def test_the_ratio_of_learning_is_exact(commands: int, environments: int, rhythm: tuple[int, int]) -> None:
    assert learning_rhythm(commands, environments) == rhythm
    assert rhythm[1] * commands == rhythm[0] * environments


def test_statistics_are_means_over_the_steps_between_reads() -> None:
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


def test_the_first_convolution_is_a_product_of_patches(monkeypatch: pytest.MonkeyPatch) -> None:
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
