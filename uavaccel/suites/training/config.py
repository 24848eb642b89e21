"""Configuration of a training."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from uavaccel.limits import MOST_GAMES, Games
from uavaccel.rl.config import LearnerConfig
from uavaccel.suites.experiment import Experiment

CHECKPOINTS = "checkpoints"  # the folder from which a training is resumed


def game_case(game: int) -> str:
    """Return the name of a game, counted from 0."""
    return f"game-{game:07d}"


class TrainConfig(LearnerConfig, Experiment):
    """`suite: train`."""

    suite: Literal["train"] = "train"
    evaluate_every_games: Annotated[int, Field(ge=0, le=MOST_GAMES)] = 0
    """Interval in games at which the greedy policy is evaluated, as it is after the last game; 0: never."""
    evaluation_games: Games = 100
    """Lanes of each of these evaluations, from number 500 000 on, so that those of `uavaccel evaluate` stay unseen."""

    @model_validator(mode="after")
    def _evaluations_fit(self) -> TrainConfig:
        if self.evaluate_every_games and self.task.timing == "wall":
            raise ValueError(
                "evaluate_every_games must be 0 with timing wall: the clock would run on meanwhile"
            )
        return self
