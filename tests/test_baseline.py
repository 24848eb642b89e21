"""stable-baselines3's algorithms as learners, its view of a batch, and that nothing else needs the library."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from copy import deepcopy
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium import Wrapper, spaces

from tests.test_learner import SHAPE, config_of
from uavaccel.errors import UserError
from uavaccel.rl import adapters
from uavaccel.rl.baseline import Baseline, BatchVecEnv
from uavaccel.rl.config import check_algorithm
from uavaccel.rl.policy import weights_sha256


class ThreeCommands:
    """A batch of games of three commands, every second one cut short, without anything to learn."""

    def __init__(self, lanes: int) -> None:
        self.num_envs, self.render_mode = lanes, None
        self.single_observation_space = spaces.Box(-1.0, 1.0, SHAPE, np.float32)
        self.single_action_space = spaces.Discrete(2)
        self.charged: list[Any] = []
        self._commands = 0

    def reset_each(self, seeds: Any, options: Any, slots: Any = None) -> list[dict[str, Any]]:
        self._random = np.random.default_rng(seeds[0])
        return [{}] * self.num_envs

    def observations(self) -> np.ndarray:
        return self._random.uniform(-1, 1, (self.num_envs, *SHAPE)).astype(np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions
        self._commands += 1

    def step_wait(self) -> tuple[Any, ...]:
        over, cut_short = self._commands % 3 == 0, self._commands % 6 == 0
        ends = [np.full(self.num_envs, each) for each in (over and not cut_short, cut_short)]
        infos = [{"final_info": {}, "final_obs": self.observations()[0]} if over else {} for _ in range(self.num_envs)]
        return self.observations(), 1.0 + self._actions, *ends, infos

    def call_each(self, name: str, arguments: Any, slots: Any) -> None:
        self.charged += [arguments[0]] * (name == "charge")


def baseline(algorithm: str, options: dict[str, Any], lanes: int = 2, **keys: Any) -> Any:
    config = config_of(lanes, {}, **keys).model_copy(update={"algorithm": algorithm, "options": options})
    return Baseline(config, ThreeCommands(lanes))  # type: ignore[arg-type]


def say_and(said: list[Any], word: Any, work: Any) -> Any:
    said.append(word)
    return work()


DQN = {"learning_rate": 2e-3, "learning_starts": 0, "batch_size": 4, "buffer_size": 40}


def test_a_baselines_learning_rate_falls_and_its_seed_draws() -> None:
    """To the share of the initial one that the training names, as that of this project's own algorithm."""
    options = {"learning_rate": 2e-3, "n_steps": 3, "batch_size": 3, "n_epochs": 1}
    learner = baseline("sb3_ppo", options, games=9, final_learning_rate_share=0.1)
    rates = []
    while learner.games < 8:
        assert len(learner.advance()) == 2
        rates.append(learner.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([2e-3 * (0.1 + 0.9 * (1 - games / 9)) for games in (2, 4, 6, 8)])
    assert [game.number for game in learner.advance()] == [8]
    first, again, other = (weights_sha256(baseline("sb3_ppo", options, seed=seed).policy) for seed in (3, 3, 4))
    assert first == again != other


def test_a_baseline_learns_as_often_as_it_is_to_and_pays() -> None:
    """Two lanes and a gradient step every six commands: after every third command of both."""
    keys: dict[str, Any] = {"task": {"timing": "virtual"}, "learning_s": 0.5, "inference_s": 0.125}
    learner = baseline("sb3_dqn", DQN, games=100, commands_per_gradient_step=6, **keys)
    for rollouts in range(1, 4):
        learner.advance()
        assert (learner.algorithm.num_timesteps, learner.algorithm._n_updates) == (6 * rollouts, rollouts)
    assert learner.lanes.charged == [*[(0.125, "inference")] * 3, (0.25, "learning")] * 3


def test_a_baseline_learns_from_no_game_beyond_the_last_one() -> None:
    """Its third game is over in the middle of a rollout, which is then left unfinished."""
    learner = baseline("sb3_ppo", {"n_steps": 12, "batch_size": 4}, games=3)
    assert [game.number for game in learner.advance()] == [0, 1, 2]
    assert (learner.algorithm.num_timesteps, learner.algorithm._n_updates) == (2 * 6, 0)


def test_a_baselines_phases_are_timed_and_its_games_have_a_loss() -> None:
    learner = baseline("sb3_dqn", DQN, games=100, commands_per_gradient_step=6)
    phases: list[str] = []
    learner.stopwatch = SimpleNamespace(phase=lambda name: say_and(phases, name, nullcontext))
    assert [game.loss for game in learner.advance()] == [None, None]
    assert phases == ["inference"] * 3 + ["learning"]
    for name, value in (("loss", 0.125), ("value_loss", 7.0), ("learning_rate", 9.0)):
        learner.algorithm.logger.record(f"train/{name}", value)
    assert [game.loss for game in learner.advance()] == [0.125, 0.125]


def test_a_baseline_goes_on_from_its_state() -> None:
    """Two that were one learn the same weights from then on, on the same batches."""
    first, second = (baseline("sb3_dqn", DQN, games=100, commands_per_gradient_step=2, seed=seed) for seed in (0, 1))
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
        assert getattr(here, name) == getattr(there, name) != getattr(baseline("sb3_dqn", DQN).algorithm, name), name
    assert (second.games, second.returns) == (first.games, first.returns)
    hashes = []
    for each in (first, second):
        each.set_state(deepcopy(state), first.algorithm._last_obs)
        each.algorithm.train(4, 4)
        hashes.append((weights_sha256(each.policy), each.lanes.single_action_space.sample()))
    assert hashes[0] == hashes[1] != (weights_sha256(baseline("sb3_dqn", DQN).policy), hashes[1][1])


# --- its view of a batch ------------------------------------------------------------------------------------------


def batch_of_three(**methods: Any) -> Any:
    spaces_of = {"single_observation_space": spaces.Box(0, 1, (1,)), "single_action_space": spaces.Discrete(2)}
    return SimpleNamespace(num_envs=3, render_mode=None, **spaces_of, **methods)


def test_a_game_that_is_over_at_its_limit_is_not_cut_short() -> None:
    """Its last observation and info are the ended game's, the observation that is returned the next one's."""
    ends = np.array([[True, True, False], [True, False, True]])  # terminated, truncated
    infos = [{"final_info": {"game": lane}, "final_obs": 9 + lane, "next": True} for lane in range(3)]
    lanes = adapters.vec_env(batch_of_three(step_wait=lambda: (np.zeros((3, 1)), np.ones(3), *ends, infos)))
    _, _, dones, told = lanes.step_wait()
    assert dones.tolist() == [True] * 3
    assert told == [
        {"game": lane, "terminal_observation": 9 + lane, "TimeLimit.truncated": lane == 2} for lane in range(3)
    ]
    assert lanes.reset_infos == [{"next": True}] * 3


def test_what_a_reset_was_given_is_of_that_reset() -> None:
    asked: list[Any] = []
    begun: list[dict[str, Any]] = [{"begun": lane} for lane in range(3)]
    batch = batch_of_three(
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


def test_a_vec_env_asks_the_lanes_that_it_is_asked_about() -> None:
    asked: list[Any] = []
    batch = batch_of_three(mark=7, call_each=lambda *given: say_and(asked, given, lambda: ["c", "a"]))
    lanes = adapters.vec_env(batch)
    assert lanes.env_method("charge", 0.5, "learning", indices=[2, 0]) == ["c", "a"]
    assert asked == [("charge", [(0.5, "learning")] * 2, [2, 0])]
    assert (lanes.get_attr("mark", 1), lanes.env_is_wrapped(Wrapper)) == ([7], [False] * 3)
    with pytest.raises(TypeError, match="charge: keywords do not travel"):
        lanes.env_method("charge", phase="learning")
    with pytest.raises(AttributeError, match="mark: environments of a batch have no attributes of their own"):
        lanes.set_attr("mark", 8)


# --- an extra -----------------------------------------------------------------------------------------------------


def test_without_it_its_algorithms_are_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(UserError, match=r"^algorithm = 'sb3_dqn': needs .* pip install -e '/.*\[sb3\]'$"):
        check_algorithm(config_of(1, {}).model_copy(update={"algorithm": "sb3_dqn"}))
    with pytest.raises(UserError, match=r"^vec_env: needs stable-baselines3: pip install -e '/.*\[sb3\]'$"):
        adapters.vec_env(batch_of_three())
