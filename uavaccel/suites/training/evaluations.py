"""Evaluations during a training: its policy of the moment on lanes of their own, which the training never notices.

They are flown between two steps of the training, in processes and with generators of their own, by a copy of the policy
that is kept below policies/: the weights are those of a training without them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypedDict

from uavaccel.config import validate
from uavaccel.files import append_line, read_lines, to_json
from uavaccel.records import RunDirectory
from uavaccel.rl.learner import Learner
from uavaccel.rl.policy import export_policy, weights_sha256
from uavaccel.suites.evaluation.batch import GamesInBatch
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.report import Row
from uavaccel.suites.training.config import TrainConfig

FILE, POLICIES = "evaluations.jsonl", "policies"
FIRST_LANE = 500_000  # beyond those of `uavaccel evaluate`, for which the best policy may be chosen by these


class EvaluationLine(TypedDict):
    """An evaluation of the policy of the moment, as a line of evaluations.jsonl."""

    games: int
    """Learned from so far."""
    weights_sha256: str
    successes: int
    lanes: list[int]
    is_success: list[bool]
    """By lane, as `distance_m`, metres north."""
    distance_m: list[float]


class Evaluations:
    """Flies them when they are due, and writes a line each to evaluations.jsonl."""

    def __init__(self, config: TrainConfig, run: RunDirectory) -> None:
        self._config, self._run = config, run
        self._lanes = range(FIRST_LANE, FIRST_LANE + config.evaluation_games)
        done = evaluations(run)
        self._done = int(done[-1]["games"]) if done else 0
        self._batch: GamesInBatch | None = None

    def due(self, games: int) -> bool:
        """Whether a multiple of `evaluate_every_games`, or the last game, has been passed since the last one."""
        every = self._config.evaluate_every_games
        if not every or games <= self._done:
            return False
        return games // every > self._done // every or games == self._config.games

    def fly(self, learner: Learner) -> EvaluationLine:
        """The greedy policy on every lane; the line that was written."""
        folder = self._run.file(f"{POLICIES}/{learner.games:07d}/policy.pt").parent
        sha256 = weights_sha256(learner.policy)
        export_policy(
            folder, learner.policy, self._config, {"games": learner.games, "weights_sha256": sha256}
        )
        rows = self._fly_lanes(evaluation_of(self._config, folder))
        line: EvaluationLine = {
            "games": learner.games,
            "weights_sha256": sha256,
            "successes": sum(row["is_success"] for row in rows),
            "lanes": [row["lane"] for row in rows],
            "is_success": [row["is_success"] for row in rows],
            "distance_m": [row["distance_m"] for row in rows],
        }
        append_line(self._run.file(FILE), line)
        self._done = learner.games
        return line

    def _fly_lanes(self, config: EvaluateConfig) -> list[Row]:
        if self._batch is None:
            self._batch = GamesInBatch(config, self._lanes)
        else:
            self._batch.begin(config, self._lanes)
        return [self._batch.game(lane).row for lane in self._lanes]

    def close(self) -> None:
        """End the processes."""
        if self._batch is not None:
            self._batch.close()


def evaluation_of(config: TrainConfig, folder: Path) -> EvaluateConfig:
    """The evaluation, as `uavaccel evaluate` would fly it, of a policy of that training."""
    keys = {
        "agent": str(folder),
        "seed": config.seed,
        "games": config.evaluation_games,
        "first_lane": FIRST_LANE,
        "environments": min(config.environments, config.evaluation_games),
        "inference_s": config.inference_s,
        "task": {**config.task.model_dump(mode="json"), "split": "evaluation"},
    }
    return validate(EvaluateConfig, keys, "evaluation")


def evaluations(run: RunDirectory) -> list[EvaluationLine]:
    """What evaluations.jsonl holds."""
    lines: list[EvaluationLine] = read_lines(run.path / FILE)
    return lines


def drop_evaluations_after(run: RunDirectory, games: int) -> None:
    """Forget those that a checkpoint of so many games does not know: they are flown again."""
    if (run.path / FILE).is_file():
        kept = [line for line in evaluations(run) if line["games"] <= games]
        run.write_text(FILE, "".join(to_json(line) + "\n" for line in kept))
