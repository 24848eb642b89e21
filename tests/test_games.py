"""Games of the tasks, command by command, as recorded in tests/data/games.txt: what is seen, rewarded, ended and told.

A game is a heading, an environment with its keys, and calls of it; below each stands what it returned, written anew
with RECORD=1: of a reset the observation and info, of a step also reward and end. `until` repeats an action. Games with
`pictures` are the kernels', of which is told what a camera sees.
"""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.lanes import stored
from tests.test_flights import assert_scenario_as_recorded, plain, scenarios
from uavaccel.envs.arrays import picture_of
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.gates import Gates
from uavaccel.envs.hover import Hover
from uavaccel.envs.kernel_batch import KernelBatch
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


class Filmed:
    """A game of the kernels with pictures, of which is told what they are like in coarse parts, state beside them."""

    def __init__(self, env: str, pictures: bool, **keys: Any) -> None:
        self._batch = KernelBatch(KINDS[env], 1, autoreset_mode="Disabled", threads=1, **keys)
        self.close = self._batch.close

    def do(self, line: str) -> str:
        return str(eval(line[2:], {"reset": self.reset, "step": self.step}))

    def reset(self, seed: int, **options: Any) -> str:
        return coarse(self._batch.reset(seed=seed, options=options or None)[0])

    def step(self, action: Any) -> str:
        seen, rewards, terminated, truncated, _ = self._batch.step(np.array([action], self._batch.action_space.dtype))
        end = " over" * int(terminated[0]) + " cut short" * int(truncated[0])
        return f"{plain(float(rewards[0]))}{end}; {coarse(seen)}"


def coarse(seen: Any) -> str:
    """Mean levels of 3 x 4 parts of the newest frame of a batch of one, mean and spread of each, and the state."""
    frames = np.asarray(picture_of(seen)[0], float)
    rows, columns = (
        np.array_split(np.arange(size), parts) for size, parts in zip(frames.shape[1:], (3, 4), strict=True)
    )
    parts = [[f"{frames[-1][np.ix_(row, column)].mean():.1f}" for column in columns] for row in rows]
    told = [" ".join(row) for row in parts] + [f"{frame.mean():.1f} ± {frame.std():.1f}" for frame in frames]
    return " | ".join([*told, plain(seen["state"][0].tolist())] if isinstance(seen, dict) else told)


def shown(seen: Any) -> str:
    """The newest frame of an observation, and a sum of all."""
    frames = np.atleast_2d(np.asarray(seen, float))
    weights = np.outer(np.arange(1, len(frames) + 1), np.arange(1, frames.shape[1] + 1))
    return f"{plain(frames[-1].tolist())} of {plain(float((weights * frames).sum()))}"


@pytest.mark.parametrize("heading", GAMES)
def test_a_game_is_as_recorded(heading: str) -> None:
    made: Any = Filmed if "pictures" in GAMES[heading].options else Game
    with closing(made(**GAMES[heading].options)) as game:
        assert_scenario_as_recorded(FILE, GAMES[heading], game.do)
