"""Evaluations of the current policy during a training, on lanes of their own.

They are flown between two steps of the training, in processes and with random generators of their own, by a copy of the
policy that is stored below policies/, so that the weights are those of a training without them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator
from typing_extensions import TypedDict

from uavaccel.config import validate
from uavaccel.files import append_line, read_lines, to_json
from uavaccel.forms import Count, Number, check_all
from uavaccel.records import RunDirectory
from uavaccel.rl.learner import Learner
from uavaccel.rl.policy import export_policy, weights_sha256
from uavaccel.suites.evaluation.batch import GamesInBatch
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.rows import Row
from uavaccel.suites.training.config import TrainConfig

FILE, POLICIES = "evaluations.jsonl", "policies"
FIRST_LANE = 500_000  # beyond those of `uavaccel evaluate`, so that policies may be selected on these


class EvaluationLine(TypedDict):
    """A line of evaluations.jsonl: an evaluation of the current policy."""

    games: Count
    """Games learned from so far."""
    weights_sha256: str
    successes: Count
    lanes: list[Count]
    is_success: list[bool]
    """By lane, as is `distance_m`, in metres north."""
    distance_m: list[Number]


def _of_its_lanes(line: EvaluationLine) -> EvaluationLine:
    lanes = len(line["lanes"])
    if not lanes or {len(line["is_success"]), len(line["distance_m"])} != {lanes}:
        raise ValueError("lanes, is_success and distance_m should have one entry for each lane")
    if line["successes"] != sum(line["is_success"]):
        raise ValueError("successes should be the number of lanes won")
    return line


class Evaluations:
    """Flies evaluations when they are due, and writes a line of evaluations.jsonl for each."""

    def __init__(self, config: TrainConfig, run: RunDirectory) -> None:
        self._config, self._run = config, run
        self._lanes = range(FIRST_LANE, FIRST_LANE + config.evaluation_games)
        done = evaluations(run)
        self._done = int(done[-1]["games"]) if done else 0
        self._batch: GamesInBatch | None = None

    def due(self, games: int) -> bool:
        """Return whether a multiple of `evaluate_every_games` or the last game has passed since the last evaluation."""
        every = self._config.evaluate_every_games
        if not every or games <= self._done:
            return False
        return games // every > self._done // every or games == self._config.games

    def fly(self, learner: Learner) -> EvaluationLine:
        """Evaluate the greedy policy on every lane, and return the line written."""
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
    """Return the configuration with which `uavaccel evaluate` flies the same evaluation of a training's policy."""
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
    """Return the lines of evaluations.jsonl. Raises UserError, naming the line, for one of another form."""
    lines: list[EvaluationLine] = read_lines(run.path / FILE)
    check_all(Annotated[EvaluationLine, AfterValidator(_of_its_lanes)], lines, run.path / FILE)
    return lines


def drop_evaluations_after(run: RunDirectory, games: int) -> None:
    """Drop the evaluations after a checkpoint of so many games, since they will be flown again."""
    if (run.path / FILE).is_file():
        kept = [line for line in evaluations(run) if line["games"] <= games]
        run.write_text(FILE, "".join(to_json(line) + "\n" for line in kept))
