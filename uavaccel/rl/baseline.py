"""stable-baselines3's algorithms as learners: one rollout at a time, schedules by games instead of steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy

from uavaccel.clock import MonotonicClock
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.envs.values import Frame
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.rl.algorithms import baseline_class, policy_keywords, policy_name
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.lanes import Lanes
from uavaccel.rl.learner import (
    Game,
    LearnerState,
    charge_inference,
    charge_learning,
    falling,
    finished_games,
    learning_rhythm,
    plain_generator,
    set_generator,
)

COUNTERS = ("num_timesteps", "_n_calls", "_n_updates", "exploration_rate", "_current_progress_remaining")
BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class Baseline:
    """A stable-baselines3 algorithm that learns from lanes; `algorithm` is the library's own object."""

    def __init__(self, config: LearnerConfig, lanes: Lanes) -> None:
        self.config, self.lanes = config, lanes
        self.games, self.returns = 0, [0.0] * lanes.num_envs
        self.stopwatch = Stopwatch(MonotonicClock())
        self.algorithm = self._make(baseline_class(config.algorithm))
        self._watch("train", "learning")
        self._watch("predict", "inference")
        self._callback = _Games(self)
        self._begun = self.holding = False

    @property
    def policy(self) -> BasePolicy:
        return self.algorithm.policy

    @property
    def exploration_rate(self) -> float | None:
        """Share of random actions; None for an algorithm that explores differently."""
        return getattr(self.algorithm, "exploration_rate", None)

    @property
    def loss(self) -> float | None:
        """The last update's loss as the algorithm logs it; None before it, and where it has several losses."""
        logged = self.algorithm.logger.name_to_value.get("train/loss")
        return None if logged is None else float(logged)

    @property
    def at_rest(self) -> bool:
        """See `Learner`: between two rollouts a checkpoint can always be taken."""
        return True

    def begin(self) -> None:
        """See `Learner`: here the algorithm resets the lanes itself."""

    def advance(self) -> list[Game]:
        """Collect one rollout and learn from it."""
        self._callback.finished = []
        self.algorithm.learn(1, self._callback, log_interval=1 << 30, reset_num_timesteps=not self._begun)
        self._begun = True
        charge_learning(self.lanes, self.config, getattr(self.algorithm, "gradient_steps", 0))
        return self._callback.finished

    def _make(self, base: type[BaseAlgorithm]) -> BaseAlgorithm:
        """Make the algorithm. Raises UserError for options that it rejects."""
        config, keywords = self.config, dict(self.config.options)
        scheduled: Any = type(f"{base.__name__}ByGames", (_ByGames, base), {"remaining": staticmethod(self._remaining)})
        if issubclass(base, OffPolicyAlgorithm):
            steps, gradient_steps = learning_rhythm(config.commands_per_gradient_step, config.environments)
            keywords = {"train_freq": steps, "gradient_steps": gradient_steps, **keywords}
        if (rate := keywords.get("learning_rate")) is not None:
            keywords["learning_rate"] = partial(falling, float(rate), config.final_learning_rate_share)
        layout = policy_keywords(config)
        try:
            algorithm: BaseAlgorithm = scheduled(
                policy_name(config),
                self.lanes,
                policy_kwargs=layout,
                seed=config.seed,
                device=config.device,
                **keywords,
            )
        except (TypeError, ValueError, AssertionError) as error:
            raise UserError(f"options of {config.algorithm}: {error}") from error
        algorithm.set_logger(Logger(None, []))
        return algorithm

    def _remaining(self) -> float:
        return 1.0 - self.games / self.config.games

    def _watch(self, method: str, phase: str) -> None:
        work: Callable[..., object] = getattr(self.algorithm, method)

        def watched(*arguments: object, **keywords: object) -> object:
            with self.stopwatch.phase(phase):
                return work(*arguments, **keywords)

        setattr(self.algorithm, method, watched)

    # --- going on after a stop --------------------------------------------------------------------

    def get_state(self) -> LearnerState:
        """Return networks, optimizer, buffer, counters and generators."""
        model = self.algorithm
        tensors = {
            "policy": model.policy.state_dict(),
            "optimizer": model.policy.optimizer.state_dict(),
            "torch": th.get_rng_state(),
        }
        counters: dict[str, Plain] = {name: getattr(model, name) for name in COUNTERS if hasattr(model, name)}
        counters |= {"returns": self.returns, "games": self.games}
        counters["random"] = plain_generator(np.random.mtrand._rand)
        return LearnerState(tensors, self._buffer_state(), counters)

    def set_state(self, state: LearnerState, observations: Frame) -> None:
        """Restore what `get_state` returned; `observations` are the lanes' present ones."""
        model: Any = self.algorithm
        model.policy.load_state_dict(state.tensors["policy"])
        model.policy.optimizer.load_state_dict(state.tensors["optimizer"])
        self._set_buffer(state.arrays)
        for name in COUNTERS:
            if name in state.counters:
                setattr(model, name, state.counters[name])
        self.returns, self.games = state.counters["returns"], state.counters["games"]
        model._last_obs, model._last_episode_starts = observations, np.zeros(self.lanes.num_envs, bool)
        set_generator(np.random.mtrand._rand, state.counters["random"])
        th.set_rng_state(state.tensors["torch"].cpu())
        self._begun = True

    def _buffer_state(self) -> dict[str, NDArray[np.generic]]:
        buffer = getattr(self.algorithm, "replay_buffer", None)
        if buffer is None:
            return {}
        filled = buffer.buffer_size if buffer.full else buffer.pos
        arrays = {name: getattr(buffer, name)[:filled] for name in BUFFER}
        return arrays | {"place": np.array([buffer.pos, buffer.full])}

    def _set_buffer(self, arrays: dict[str, NDArray[np.generic]]) -> None:
        buffer = getattr(self.algorithm, "replay_buffer", None)
        if buffer is None:
            return
        buffer.pos, buffer.full = int(arrays["place"][0]), bool(arrays["place"][1])
        for name in BUFFER:
            getattr(buffer, name)[: len(arrays[name])] = arrays[name]


class _ByGames:
    """Mixin that lets an algorithm's schedules follow the share of games flown instead of time steps."""

    remaining: Callable[[], float]

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:
        self._current_progress_remaining = self.remaining()


class _Games(BaseCallback):
    """Collects the games that end during a rollout, and stops it after the last one of the training."""

    def __init__(self, learner: Baseline) -> None:
        super().__init__()
        self.learner = learner
        self.finished: list[Game] = []

    def _on_step(self) -> bool:
        learner, now = self.learner, self.locals
        games = finished_games(learner, now["rewards"], now["dones"], now["infos"])
        self.finished += [replace(game, loss=learner.loss) for game in games]
        charge_inference(learner.lanes, learner.config)
        return learner.games < learner.config.games
