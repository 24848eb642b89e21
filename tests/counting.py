"""Environments that count, for tests of real time; they load little, as processes of their own load them too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray


class Counting(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A stranger's: it counts its steps, a reward each is its action, and an episode ends after 50."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    dt = 0.02

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        self.applied: list[float] = []
        return np.zeros(1, np.float32), {"drawn": self.np_random.random(), "options": options}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        self.applied.append(float(action[0]))
        count = len(self.applied)
        return np.full(1, count, np.float32), float(action[0]), count >= 50, False, {}


class Closing(Counting):
    """It leaves a file where it is closed."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def close(self) -> None:
        self._file.touch()


class Failing(Counting):
    """It fails in a step: with an exception, in a process of its own too."""

    def __init__(self, error: BaseException) -> None:
        self._error = error

    def step(self, action: Any) -> Any:
        raise self._error


class OwnError(Exception):
    """It cannot be unpickled."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")
