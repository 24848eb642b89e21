"""The games of a training."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from uavaccel.suites.training.config import TrainConfig


@dataclass(frozen=True)
class Case:
    """One game to learn from."""

    game: int
    timing: str
    typical_s: float

    @property
    def id(self) -> str:
        return f"game-{self.game:07d}"

    def simulated_s(self) -> float:
        return self.typical_s


def cases(config: TrainConfig) -> Iterator[Case]:
    """Games by number: which lane and environment each one is comes out of the training."""
    for game in range(config.games):
        yield Case(game, config.task.timing, config.task.typical_s)
