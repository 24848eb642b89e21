"""Games of the tasks, command by command, as recorded in tests/data/games.txt: what is seen, rewarded, ended and told.

A game is a heading, an environment with its keys, and calls of it; below each stands what it returned, written anew
with RECORD=1: of a reset the observation and info, of a step also reward and end. `until` repeats an action.
"""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.lanes import stored
from tests.test_flights import assert_scenario_as_recorded, plain, scenarios
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.gates import Gates
from uavaccel.envs.hover import Hover
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError

FILE = Path(__file__).parent / "data/games.txt"
KINDS: dict[str, type[FlightEnv]] = {kind.__name__: kind for kind in (ObstacleLane, Hover, Gates, Navigate)}
GAMES = {scenario.heading: scenario for scenario in scenarios(FILE)}


class Game:
    """An environment, and what came of a call of it as text; info is told where it changes."""

    def __init__(self, env: str, **keys: Any) -> None:
        self._kind, self._keys = KINDS[env], {"observation": "state", **keys}
        self._env, self._told = self._kind(**self._keys), dict[str, str]()

    def do(self, line: str) -> str:
        calls = {each.__name__: each for each in (self.reset, self.step, self.until, self.charge, self.move)}
        try:
            return str(eval(line[2:], {**calls}))
        except UserError as error:
            return f"refused: {error}"

    def reset(self, seed: int | None = None, **options: Any) -> str:
        seen, info = self._env.reset(seed=seed, options=options or None)
        return "; ".join([shown(seen), *self._changed(info)])

    def step(self, action: Any) -> str:
        seen, reward, terminated, truncated, info = self._env.step(np.array(action))
        end = " over" * terminated + " cut short" * truncated
        return "; ".join([f"{plain(float(reward))}{end}", shown(seen), *self._changed(info)])

    def until(self, action: Any) -> str:
        commands = [self.step(action)]
        while not commands[-1].partition(";")[0].endswith(("over", "cut short")):
            commands.append(self.step(action))
        return f"{len(commands)} commands; {commands[-1]}"

    def charge(self, seconds: float, phase: str = "inference") -> None:
        self._env.charge(seconds, phase)

    def move(self) -> None:
        """To an environment that has flown another game."""
        state = stored(self._env.get_state())
        self._env.close()
        self._env = self._kind(**self._keys)
        self._env.reset(seed=99)
        self._env.set_state(state)

    def close(self) -> None:
        self._env.close()

    def _changed(self, info: dict[str, Any]) -> list[str]:
        now = {name: plain(value) for name, value in info.items()}
        before, self._told = self._told, now
        return [f"{name} {text}" for name, text in now.items() if before.get(name) != text]


def shown(seen: Any) -> str:
    """The newest frame of an observation, and a sum of all."""
    frames = np.atleast_2d(np.asarray(seen, float))
    weights = np.outer(np.arange(1, len(frames) + 1), np.arange(1, frames.shape[1] + 1))
    return f"{plain(frames[-1].tolist())} of {plain(float((weights * frames).sum()))}"


@pytest.mark.parametrize("heading", GAMES)
def test_a_game_is_as_recorded(heading: str) -> None:
    with closing(Game(**GAMES[heading].options)) as game:
        assert_scenario_as_recorded(FILE, GAMES[heading], game.do)
