"""Games of lanes on one GPU: sampled by the host ahead of time and transferred, so that lanes need not wait."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch as th
from gymnasium.utils import seeding

from uavaccel.envs.cuda_courses import allocate, to_device, write_rows
from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.kernel_games import Drawn, GameMaker
from uavaccel.envs.task import Task
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import lanes
from uavaccel.sim.state import State

AHEAD = 4  # games per lane: the one being flown, and those sampled ahead


class GamesAhead:
    """The next games of each of `count` lanes; lane i cycles through the AHEAD rows from i * AHEAD on.

    `rows` is a kernels/lanes.Games of tensors, and `arrays` the same memory for kernels. `starts` holds the games'
    courses and `scales` the factors on their latencies, a row each. Each lane has had `available` games (L,) so far, of
    which `begun` (L,) have begun.
    """

    def __init__(self, task: Task, count: int, device: th.device) -> None:
        self.maker = GameMaker(task)
        self.count, self.device = count, device
        self._host = lanes.game_rows(count * AHEAD, self.maker.surroundings.most)
        self.rows, self.arrays = kernels.on_device(self._host, device)
        self.scales = th.ones(count * AHEAD, dtype=th.float64, device=device)
        self.begun = th.zeros(count, dtype=th.int64, device=device)
        self.available = th.zeros(count, dtype=th.int64, device=device)
        self.starts: dict[str, Any] = {}
        self._generators: list[Any] = [None] * count
        self._games = [0] * count
        self._drawn: list[dict[int, Drawn]] = [{} for _ in range(count)]
        self._generator_states: list[dict[int, Mapping[str, Any]]] = [{} for _ in range(count)]
        self._written = [0] * count

    @property
    def has_games(self) -> bool:
        """Whether any games have been sampled."""
        return bool(self._written[0])

    def seed(self, seeds: int | Sequence[int | None]) -> None:
        """Seed all lanes anew: lane i with the i-th of several seeds, or with a single seed plus i."""
        each = [seeds + lane for lane in range(self.count)] if isinstance(seeds, int) else seeds
        for lane, seed in enumerate(each):
            self._generators[lane], self._games[lane] = seeding.np_random(seed)[0], 0
            self._drawn[lane].clear()
            self._written[lane] = 0
        self.begun.zero_()

    def sample_games(self, options: Sequence[Mapping[str, Any] | None] | None = None) -> None:
        """Sample and transfer the next game of every lane, with the lane's options."""
        each = options or [None] * self.count
        self._send([self._draw(lane, each[lane]) for lane in range(self.count)])

    def refill(self, begun: Sequence[int]) -> None:
        """Sample games until all rows are in use again, given how many games each lane has begun; transfer them."""
        rows = [
            self._draw(lane) for lane, count in enumerate(begun) for _ in range(self._written[lane], count - 1 + AHEAD)
        ]
        self._send(rows)

    def begin(self, idle: th.Tensor, rows: th.Tensor) -> th.Tensor:
        """Return which `idle` lanes (L,) have a game to begin, count it as begun, and write its row to `rows` (L,)."""
        renewed = idle & (self.begun < self.available)
        rows.copy_(th.arange(self.count, device=self.device) * AHEAD + self.begun % AHEAD)
        self.begun += renewed
        return renewed

    def drawn(self, lane: int, number: int) -> Drawn:
        """Return one of a lane's latest AHEAD games by its number."""
        return self._drawn[lane][number]

    def get_state(self, lane: int) -> State:
        """Return what a lane's running game and its next ones are sampled from."""
        flown, written = int(self.begun[lane]) - 1, self._written[lane]
        games = self._games[lane] - (written - flown)
        return {
            "drawn_by": json.dumps(self._generator_states[lane][flown]),
            "flown": flown,
            "written": written,
            "games": games,
        }

    def set_state(self, lane: int, state: Mapping[str, Any]) -> None:
        """Sample the games of a state that `get_state` returned again."""
        generator = self._generators[lane] = seeding.np_random(0)[0]
        generator.bit_generator.state = json.loads(str(state["drawn_by"]))
        flown, written = int(state["flown"]), int(state["written"])
        self._games[lane], self._written[lane] = int(state["games"]), flown
        self._send([self._draw(lane) for _ in range(flown, written)])
        self.begun[lane], self.available[lane] = flown + 1, written

    def _draw(self, lane: int, options: Mapping[str, Any] | None = None) -> int:
        """Sample a lane's next game into the host's rows, and return its row."""
        number = self._written[lane]
        before = self._generators[lane].bit_generator.state
        drawn = self.maker.sample(self._generators[lane], self._games[lane], options)
        self._games[lane] += 1
        row = lane * AHEAD + number % AHEAD
        self.maker.write(drawn, self._host, row)
        for latest in (self._drawn[lane], self._generator_states[lane]):
            latest.pop(number - AHEAD, None)
        self._drawn[lane][number], self._generator_states[lane][number] = drawn, before
        self._written[lane] = number + 1
        return row

    def _send(self, rows: Sequence[int]) -> None:
        """Transfer rows of games to the device."""
        if not rows:
            return
        which = np.asarray(rows)
        target = to_device(which, self.device)
        for host, tensor in zip(_leaves(self._host), _leaves(self.rows), strict=True):
            part = host[which]
            if part.dtype.names:
                part = part.view(np.uint8).reshape(len(which), part.dtype.itemsize)
            tensor[target] = to_device(part, self.device)
        self._send_courses([self._latest(row) for row in rows], target)
        self.available.copy_(to_device(np.asarray(self._written), self.device))

    def _send_courses(self, games: Sequence[Drawn], target: th.Tensor) -> None:
        """Transfer what the kernels do not read: the games' courses and the scales of their latencies."""
        courses = [{name: each for name, each in game.course.items() if name != CONDITIONS} for game in games]
        for name in courses[0]:
            if name not in self.starts:
                self.starts[name] = allocate(courses[0][name], self.count * AHEAD, self.device)
            write_rows(self.starts[name], target, np.array([course[name] for course in courses]))
        write_rows(self.scales, target, np.array([game.task.latency.scale for game in games]))

    def _latest(self, row: int) -> Drawn:
        """Return the game that was written to a row last."""
        lane, place = divmod(row, AHEAD)
        last = self._written[lane] - 1
        return self._drawn[lane][last - (last - place) % AHEAD]


def _leaves(arrays: Any) -> list[Any]:
    """Return the arrays of nested tuples, in order."""
    return [arrays] if not isinstance(arrays, tuple) else [leaf for array in arrays for leaf in _leaves(array)]
