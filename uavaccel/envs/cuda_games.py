"""Games of lanes on one GPU: drawn by the host ahead of time, and sent over, so that none of them has to wait."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch as th
from gymnasium.utils import seeding

from uavaccel.envs.cuda_courses import fill, room, sent
from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.kernel_games import Drawn, GameMaker
from uavaccel.envs.task import Task
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import lanes
from uavaccel.sim.saved import State

AHEAD = 4  # games that a lane has at most: the one that it flies, and those drawn ahead


class GamesAhead:
    """The next games of each of `count` lanes; lane i has the AHEAD rows from i * AHEAD on, and uses them in turn.

    `rows` are tensors of kernels/lanes.Games and `there` the same memory for kernels. `starts` are the games' courses
    and `scales` what their latencies are multiplied by, a row each. Of each lane `available` games (L,) have been
    drawn so far, and `begun` were begun.
    """

    def __init__(self, task: Task, count: int, device: th.device) -> None:
        self.maker = GameMaker(task)
        self.count, self.device = count, device
        self._host = lanes.game_rows(count * AHEAD, self.maker.surroundings.most)
        self.rows, self.there = kernels.on_device(self._host, device)
        self.scales = th.ones(count * AHEAD, dtype=th.float64, device=device)
        self.begun = th.zeros(count, dtype=th.int64, device=device)
        self.available = th.zeros(count, dtype=th.int64, device=device)
        self.starts: dict[str, Any] = {}
        self._generators: list[Any] = [None] * count
        self._games = [0] * count
        self._drawn: list[dict[int, Drawn]] = [{} for _ in range(count)]
        self._drawn_by: list[dict[int, Mapping[str, Any]]] = [{} for _ in range(count)]
        self._written = [0] * count

    @property
    def any_drawn(self) -> bool:
        """Whether there are games to begin."""
        return bool(self._written[0])

    def seed(self, seeds: int | Sequence[int | None]) -> None:
        """Draw all games anew, those of lane i from the i-th seed, or from the first one plus i."""
        each = [seeds + lane for lane in range(self.count)] if isinstance(seeds, int) else seeds
        for lane, seed in enumerate(each):
            self._generators[lane], self._games[lane] = seeding.np_random(seed)[0], 0
            self._drawn[lane].clear()
            self._written[lane] = 0
        self.begun.zero_()

    def draw_one_each(self, options: Sequence[Mapping[str, Any] | None] | None = None) -> None:
        """Draw and send the next game of every lane, with options of its own."""
        each = options or [None] * self.count
        self._send([self._draw(lane, each[lane]) for lane in range(self.count)])

    def refill(self, begun: Sequence[int]) -> None:
        """Draw as many games ahead as there is room for, given how many each lane has begun; send them over."""
        rows = [
            self._draw(lane)
            for lane, count in enumerate(begun)
            for _ in range(self._written[lane], count - 1 + AHEAD)
        ]
        self._send(rows)

    def begin(self, idle: th.Tensor, rows: th.Tensor) -> th.Tensor:
        """Which of the lanes that are `idle` (L,) have a game to begin, and count it; `rows` (L,) take where it is."""
        renewed = idle & (self.begun < self.available)
        rows.copy_(th.arange(self.count, device=self.device) * AHEAD + self.begun % AHEAD)
        self.begun += renewed
        return renewed

    def drawn(self, lane: int, number: int) -> Drawn:
        """One of a lane's latest games, by its number."""
        return self._drawn[lane][number]

    def get_state(self, lane: int) -> State:
        """What a lane's running game and its next ones are drawn from."""
        flown, written = int(self.begun[lane]) - 1, self._written[lane]
        games = self._games[lane] - (written - flown)
        return {
            "drawn_by": json.dumps(self._drawn_by[lane][flown]),
            "flown": flown,
            "written": written,
            "games": games,
        }

    def set_state(self, lane: int, state: Mapping[str, Any]) -> None:
        """Draw them again."""
        generator = self._generators[lane] = seeding.np_random(0)[0]
        generator.bit_generator.state = json.loads(str(state["drawn_by"]))
        flown, written = int(state["flown"]), int(state["written"])
        self._games[lane], self._written[lane] = int(state["games"]), flown
        self._send([self._draw(lane) for _ in range(flown, written)])
        self.begun[lane], self.available[lane] = flown + 1, written

    def _draw(self, lane: int, options: Mapping[str, Any] | None = None) -> int:
        """Draw a lane's next game into the host's rows; which row."""
        number = self._written[lane]
        before = self._generators[lane].bit_generator.state
        drawn = self.maker.draw(self._generators[lane], self._games[lane], options)
        self._games[lane] += 1
        row = lane * AHEAD + number % AHEAD
        self.maker.write(drawn, self._host, row)
        for kept in (self._drawn[lane], self._drawn_by[lane]):
            kept.pop(number - AHEAD, None)
        self._drawn[lane][number], self._drawn_by[lane][number] = drawn, before
        self._written[lane] = number + 1
        return row

    def _send(self, rows: Sequence[int]) -> None:
        """Copy rows of games to the device."""
        if not rows:
            return
        which = np.asarray(rows)
        there = sent(which, self.device)
        for host, tensor in zip(_leaves(self._host), _leaves(self.rows), strict=True):
            part = host[which]
            if part.dtype.names:
                part = part.view(np.uint8).reshape(len(which), part.dtype.itemsize)
            tensor[there] = sent(part, self.device)
        self._send_courses([self._latest(row) for row in rows], there)
        self.available.copy_(sent(np.asarray(self._written), self.device))

    def _send_courses(self, games: Sequence[Drawn], there: th.Tensor) -> None:
        """What is no array of the kernels': the games' courses, and how their latencies are scaled."""
        courses = [{name: each for name, each in game.course.items() if name != CONDITIONS} for game in games]
        for name in courses[0]:
            if name not in self.starts:
                self.starts[name] = room(courses[0][name], self.count * AHEAD, self.device)
            fill(self.starts[name], there, np.array([course[name] for course in courses]))
        fill(self.scales, there, np.array([game.task.latency.scale for game in games]))

    def _latest(self, row: int) -> Drawn:
        """The game that was written to a row last."""
        lane, place = divmod(row, AHEAD)
        last = self._written[lane] - 1
        return self._drawn[lane][last - (last - place) % AHEAD]


def _leaves(arrays: Any) -> list[Any]:
    return [arrays] if not isinstance(arrays, tuple) else [leaf for each in arrays for leaf in _leaves(each)]
