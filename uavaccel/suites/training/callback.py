"""What a training does at each step beside learning: it counts games, charges modelled work and logs curves."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from uavaccel.clock import MonotonicClock
from uavaccel.rl.checkpoint import set_random
from uavaccel.suites.suite import Flown, Row
from uavaccel.suites.training.config import TrainConfig
from uavaccel.units import NS_PER_S

RECENT = 100  # games whose success is shown


class TrainingCallback(BaseCallback):
    """Hands out finished games, in `virtual` charges decisions and learning, and stops a rollout after the last game.

    `between_rollouts` is called before each rollout.
    """

    def __init__(
        self,
        config: TrainConfig,
        on_game: Callable[[Flown], None],
        between_rollouts: Callable[[], None],
    ) -> None:
        super().__init__()
        self.games = 0
        self.returns = [0.0] * config.environments
        self._config, self._on_game, self._between_rollouts = config, on_game, between_rollouts
        self._simulated_s = 0.0
        self._random: dict[str, Any] | None = None
        self._recent: deque[bool] = deque(maxlen=RECENT)
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()

    def restore(self, games: int, returns: list[float], random: dict[str, Any], rows: Sequence[Row]) -> None:
        """Go on after `games`, with the returns so far of the games under way and every generator's state."""
        self.games, self.returns, self._random = games, returns, random
        self._recent.extend(row["is_success"] for row in rows[-RECENT:])

    def _on_training_start(self) -> None:
        if self._random is not None:
            set_random(self._random, self.model)
            self._random = None

    def _on_rollout_start(self) -> None:
        self._between_rollouts()
        self._charge_learning()

    def _charge_learning(self) -> None:
        """Each environment pays for the gradient steps that its own commands bring about."""
        owed = self.model.owed  # type: ignore[attr-defined]
        if self._config.task.timing == "virtual" and owed:
            share = owed / self._config.environments
            self.training_env.env_method("charge", share * self._config.learning_s, "learning")

    def _on_step(self) -> bool:
        for index, (done, info) in enumerate(zip(self.locals["dones"], self.locals["infos"], strict=True)):
            self.returns[index] += float(self.locals["rewards"][index])
            if done and self.games < self._config.games:
                self._finish_game(index, info)
        if self._config.task.timing == "virtual":
            self.training_env.env_method("charge", self._config.inference_s, "inference")
        return self.games < self._config.games

    def _finish_game(self, environment: int, info: dict[str, Any]) -> None:
        wall_s = (self._clock.now_ns() - self._start_ns) / NS_PER_S
        names = ("is_success", "distance_m", "collision", "lane", "commands", "phase_s")
        row = {
            "case": f"game-{self.games:07d}",
            "suite": "train",
            "game": self.games,
            "environment": environment,
            "return": self.returns[environment],
            "exploration": getattr(self.model, "exploration_rate", None),
            "sim_time_s": info["commands"] * self._config.task.t_move_s,
            **{name: info[name] for name in names},
        }
        learner_s = self.model.stopwatch.spent_s()  # type: ignore[attr-defined]
        host = {"wall_s": wall_s, "host_phase_s": info["host_phase_s"], "learner_s": learner_s}
        self.returns[environment] = 0.0
        self.games += 1
        self.model.games_done = self.games  # type: ignore[attr-defined]
        self._log(row, wall_s)
        self._on_game(Flown(row, host=host))

    def _log(self, row: Row, wall_s: float) -> None:
        self._simulated_s += row["sim_time_s"]
        self._recent.append(row["is_success"])
        self.logger.record("games/count", self.games)
        self.logger.record("games/success_recent", sum(self._recent) / len(self._recent))
        self.logger.record_mean("games/distance_m", row["distance_m"])
        self.logger.record_mean("games/return", row["return"])
        self.logger.record("games/real_time_factor", self._simulated_s / wall_s)
