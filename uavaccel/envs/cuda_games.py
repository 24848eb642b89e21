"""Games of lanes on one GPU: dealt there where the arithmetic is known, else sampled by the host ahead of time.

`Dealt` games are lanes of the task's own distribution, sampled by a kernel when a lane needs one. Whatever else a task
samples is its own Python: the host fills rows `SampledAhead` and transfers them, so that lanes need not wait.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch as th
from gymnasium.utils import seeding
from numpy.typing import NDArray

from uavaccel.envs.arrays import mapped
from uavaccel.envs.checks import known_options, layout_of
from uavaccel.envs.conditions import OF_SENSOR
from uavaccel.envs.kernel_games import Drawn, GameMaker, keys_of
from uavaccel.envs.navigate import NavigateTask
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.task import Task
from uavaccel.envs.values import CONDITIONS, State
from uavaccel.kernels import clutter_games, lane_games
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels.fields import NO_APPEARANCE, Appearance
from uavaccel.kernels.scene import Scene
from uavaccel.sim.lane import WIDTH_M, lane_seed
from uavaccel.sim.pcg64 import stream_of
from uavaccel.units import plain

AHEAD = 4  # games per lane: the one being flown, and those sampled ahead


class LaneGames:
    """The games of `count` lanes: what `Dealt` and `SampledAhead` have in common.

    `rows` is a kernels/lanes.Games of tensors, K rows a lane, and `arrays` the same memory for kernels. `starts` holds
    the games' courses, `conditions` what was sampled for them (NaN for what was not), `keys` the task's numbers under
    these, and `scales` the factors on their latencies, a row each. Lanes have `begun` games (L,) so far; `label` (L,)
    int64 is what the running game is found by afterwards. `one_camera`: all games have the task's own.
    """

    rows: Any
    arrays: Any

    def __init__(self, task: Task, count: int, device: th.device, rows_a_lane: int) -> None:
        self.maker = GameMaker(task)
        self.count, self.device, self.one_camera = count, device, _has_one_camera(task)
        self._host = self.maker.rows(count * rows_a_lane)
        self.scales = th.ones(count * rows_a_lane, dtype=th.float64, device=device)
        self.begun = th.zeros(count, dtype=th.int64, device=device)
        self.starts: dict[str, Any] = {}
        self.conditions: dict[str, th.Tensor] = {}
        self.keys: dict[str, th.Tensor] = {}

    def _on_device(self) -> tuple[Any, Any]:
        """Copy the rows to the device; what is seen of clutter has the cells of what is touched."""
        both = kernels.on_device(self._host, self.device)
        touched, seen = self._host.solids, self._host.scenes
        if not (isinstance(touched, Scene) and isinstance(seen, Scene) and seen.start is touched.start):
            return both
        tensors, arrays = (
            games._replace(scenes=games.scenes._replace(start=games.solids.start, items=games.solids.items))
            for games in both
        )
        return tensors, arrays

    def generators(self, seeds: int | Sequence[int | None]) -> list[np.random.Generator]:
        """Return a new generator for each lane: of the i-th of several seeds, or of a single seed plus i."""
        each = [seeds + lane for lane in range(self.count)] if isinstance(seeds, int) else seeds
        return [seeding.np_random(seed)[0] for seed in each]


def games_of(task: Task, count: int, device: th.device) -> Dealt | SampledAhead:
    """Return the games of a task's lanes, dealt on the device if they are sampled as the shipped tasks' are."""

    def samples_as(kind: type[Task], *more: str) -> bool:
        sampled = ("sample", "sample_conditions", "with_conditions", "layout", "lane_layout", "events_seed", *more)
        return isinstance(task, kind) and all(getattr(type(task), name) is getattr(kind, name) for name in sampled)

    if samples_as(NavigateTask):
        return DealtClutter(task, count, device)
    drawn = isinstance(task, LaneTask) and task.lane is None and task.randomise is None
    return (
        Dealt(task, count, device) if drawn and samples_as(LaneTask, "wire_lane") else SampledAhead(task, count, device)
    )


def _has_one_camera(task: Task) -> bool:
    conditioned = type(task).with_conditions
    if isinstance(task, LaneTask) and task.randomise is not None:
        return conditioned is LaneTask.with_conditions and not set(task.randomise.given()) & set(OF_SENSOR)
    return conditioned in (Task.with_conditions, LaneTask.with_conditions)


class Dealt(LaneGames):
    """Games of the obstacle lane that a kernel samples when they are needed; lane i flies row i."""

    def __init__(self, task: Task, count: int, device: th.device) -> None:
        super().__init__(task, count, device, 1)
        self._any = drawn = self.maker.sample(np.random.default_rng(0), 0)
        self.maker.write(drawn, self._host, 0)
        for array in _leaves(self._host):
            array[1:] = array[0]
        self.rows, self.arrays = self._on_device()
        self.scales *= task.latency.scale
        self._allocate_deals(task)
        self._kernels = kernels.compiled(self.maker.nominal)
        self._all = th.arange(count, device=device)
        self.has_games = False

    def _allocate_deals(self, task: Any) -> None:
        of, numbers = task.difficulty, np.zeros(lane_games.NUMBERS)
        obstacles = len(self._any.layout) if self._any.layout is not None else 0
        numbers[lane_games.FIRST_SEED] = lane_seed(task.split, 0)
        numbers[lane_games.PER_ROW] = of.obstacles_per_row
        numbers[lane_games.ROWS] = obstacles // max(of.obstacles_per_row, 1)
        numbers[lane_games.SLACK_M] = WIDTH_M - max(of.obstacles_per_row - 1, 0) * of.pitch_m
        numbers[lane_games.PITCH_M], numbers[lane_games.VARIED] = of.pitch_m, of.texture_variation
        low, high = of.light
        numbers[lane_games.LIGHT_LOW], numbers[lane_games.LIGHT_SPAN] = low, high - low
        numbers[lane_games.WIND_M_S], numbers[lane_games.LIT] = of.wind_m_s, task.observation != "state"
        numbers[lane_games.NOISY_EVENTS] = task.events_seed(1)
        looks = self.maker.looks if isinstance(self.maker.looks, Appearance) else NO_APPEARANCE
        distribution = lane_games.Distribution(numbers, looks.wearing)
        self._memory, self._distribution = kernels.on_device(distribution, self.device)
        self._tensors, self._deals = kernels.on_device(lane_games.deals(self.count), self.device)
        self.starts = {"lane": self._tensors.indices}

    @property
    def label(self) -> th.Tensor:
        indices: th.Tensor = self._tensors.indices
        return indices

    def seed(self, seeds: int | Sequence[int | None]) -> None:
        """Seed all lanes anew: lane i with the i-th of several seeds, or with a single seed plus i."""
        streams = np.stack([stream_of(generator) for generator in self.generators(seeds)])
        self._tensors.streams[:, lane_games.OWN] = to_device(streams.view(np.int64), self.device)
        self.begun.zero_()

    def sample_games(self, options: Sequence[Mapping[str, Any] | None] | None = None) -> None:
        """Let the next game of every lane be as the lane's options have it."""
        self.has_games = True
        for lane, option in enumerate(options or ()):
            if option:
                known = known_options(option, self.maker.task.reset_options)
                course = self.maker.task.sample(np.random.default_rng(0), known)
                layout_of(self.maker.task, course)  # raises UserError for a lane that is none
                self._tensors.given[lane] = course[next(iter(known))]

    def refill(self, begun: Sequence[int]) -> None:
        """Do nothing: games are dealt when they are needed."""

    def discard(self) -> None:
        """Do nothing: no games are sampled ahead."""

    def begin(self, idle: th.Tensor, rows: th.Tensor) -> th.Tensor:
        """Sample a game for each of the `idle` lanes (L,), count it as begun, and write its row to `rows` (L,)."""
        rows.copy_(self._all)
        self._deal(idle.byte())
        self.begun += idle
        return idle

    def _deal(self, idle: th.Tensor) -> None:
        kernels.in_each_lane(self._kernels.deal, idle, self._distribution, self._deals, self.arrays)

    def found(self, lane: int, label: int) -> Drawn:
        """Return a lane's game as it was sampled, by its label."""
        return self._any._replace(course={"lane": label})

    def get_states(self) -> list[State]:
        """Return what each lane's running game and its next ones are sampled from."""
        before, indices = self._tensors.streams[:, lane_games.BEFORE].cpu().numpy(), self._tensors.indices.tolist()
        each = zip(before, indices, self.begun.tolist(), strict=True)
        return [{"dealt_from": stream, "index": index, "begun": begun} for stream, index, begun in each]

    def set_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Sample the games of the states that `get_states` returned again."""
        own = np.array([state["dealt_from"] for state in states], np.int64)
        self._tensors.streams[:, lane_games.OWN] = to_device(own, self.device)
        self._tensors.given.copy_(th.tensor([int(state["index"]) for state in states]))
        self._deal(th.ones_like(self._all, dtype=th.uint8))
        self.begun.copy_(th.tensor([int(state["begun"]) for state in states]))
        self.has_games = True


class DealtClutter(Dealt):
    """Games of Navigate, dealt in the same way."""

    def _allocate_deals(self, task: Any) -> None:
        numbers, (near_m, far_m) = np.zeros(clutter_games.NUMBERS), task.goal_m
        numbers[clutter_games.FIRST_SEED] = lane_seed(task.split, 0)
        numbers[clutter_games.NOISY_EVENTS] = task.events_seed(1)
        numbers[clutter_games.NEAR_M], numbers[clutter_games.SPAN_M] = near_m, far_m - near_m
        numbers[clutter_games.ASIDE_RAD] = math.radians(task.goal_bearing_deg)
        numbers[clutter_games.ALTITUDE_M] = task.altitude_m
        distribution = clutter_games.Distribution(numbers, task.clutter.numbers())
        self._memory, self._distribution = kernels.on_device(distribution, self.device)
        deals = clutter_games.deals(self.count, task.clutter.shapes)
        self._tensors, self._deals = kernels.on_device(deals, self.device)
        self.starts = {"world": self._tensors.indices, "goal_m": list(self._tensors.goals.T)}

    def _deal(self, idle: th.Tensor) -> None:
        grid = kernels.grid(self.count * kernels.DEALING_THREADS, kernels.DEALING_THREADS)
        self._kernels.deal_clutter[grid](kernels.shared(idle), self._distribution, self._deals, self.arrays)

    def found(self, lane: int, label: int) -> Drawn:
        """Return a lane's present game, by its label."""
        return self._any._replace(course={"world": label, "goal_m": self._tensors.goals[lane].tolist()})


class SampledAhead(LaneGames):
    """Games that the host samples; lane i cycles through the AHEAD rows from i * AHEAD on.

    Each lane has had `available` games (L,) so far.
    """

    def __init__(self, task: Task, count: int, device: th.device) -> None:
        super().__init__(task, count, device, AHEAD)
        self._rows = count * AHEAD
        if isinstance(task, LaneTask) and task.randomise is not None:
            # some may first be sampled when a round is recorded
            self.conditions = {name: th.full_like(self.scales, np.nan) for name in task.randomise.given()}
        self.rows, self.arrays = self._on_device()
        self.available = th.zeros(count, dtype=th.int64, device=device)
        self._generators: list[Any] = [None] * count
        self._games, self._written = [0] * count, [0] * count
        self._drawn: list[dict[int, Drawn]] = [{} for _ in range(count)]
        # State of the generator before each of these games, and the options that it was sampled with.
        self._sampled_by: list[dict[int, tuple[Any, Mapping[str, Any] | None]]] = [{} for _ in range(count)]

    @property
    def has_games(self) -> bool:
        """Whether any games have been sampled."""
        return bool(self._written[0])

    @property
    def label(self) -> th.Tensor:
        return self.begun - 1

    def seed(self, seeds: int | Sequence[int | None]) -> None:
        """Seed all lanes anew: lane i with the i-th of several seeds, or with a single seed plus i."""
        self._generators = self.generators(seeds)
        self._games, self._written = [0] * self.count, [0] * self.count
        for drawn in self._drawn:
            drawn.clear()
        self.begun.zero_()

    def sample_games(self, options: Sequence[Mapping[str, Any] | None] | None = None) -> None:
        """Sample and transfer the next game of every lane, with the lane's options."""
        each = options or [None] * self.count
        self._send([self._draw(lane, each[lane]) for lane in range(self.count)])

    def discard(self) -> None:
        """Forget the games that were sampled ahead, as if they had not been."""
        for lane, begun in enumerate(self.begun.tolist()):
            if begun < self._written[lane]:
                self._generators[lane].bit_generator.state = self._sampled_by[lane][begun][0]
                self._games[lane] -= self._written[lane] - begun
                self._written[lane] = begun
        self.available.copy_(self.begun)

    def refill(self, begun: Sequence[int]) -> None:
        """Sample games until all rows are in use again, given how many games each lane has begun; transfer them."""
        missing = [range(written, count - 1 + AHEAD) for written, count in zip(self._written, begun, strict=True)]
        self._send([self._draw(lane) for lane, games in enumerate(missing) for _ in games])

    def begin(self, idle: th.Tensor, rows: th.Tensor) -> th.Tensor:
        """Return which `idle` lanes (L,) have a game to begin, count it as begun, and write its row to `rows` (L,)."""
        renewed = idle & (self.begun < self.available)
        rows.copy_(th.arange(self.count, device=self.device) * AHEAD + self.begun % AHEAD)
        self.begun += renewed
        return renewed

    def found(self, lane: int, label: int) -> Drawn:
        """Return one of a lane's latest AHEAD games as it was sampled."""
        return self._drawn[lane][label]

    def get_states(self) -> list[State]:
        """Return what each lane's running game and its next ones are sampled from."""
        return [self._get_state(lane, begun - 1) for lane, begun in enumerate(self.begun.tolist())]

    def _get_state(self, lane: int, flown: int) -> State:
        (generator, options), written = self._sampled_by[lane][flown], self._written[lane]
        texts = {"drawn_by": json.dumps(generator), "options": json.dumps(options, default=plain)}
        return {**texts, "flown": flown, "games": self._games[lane] - (written - flown)}

    def set_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Sample the games of the states that `get_states` returned again."""
        self._send([row for lane, state in enumerate(states) for row in self._drawn_again(lane, state)])
        self.begun.copy_(th.tensor([int(state["flown"]) + 1 for state in states]))

    def _drawn_again(self, lane: int, state: Mapping[str, Any]) -> list[int]:
        generator = self._generators[lane] = seeding.np_random(0)[0]
        generator.bit_generator.state = json.loads(str(state["drawn_by"]))
        self._games[lane], self._written[lane] = int(state["games"]), int(state["flown"])
        options = json.loads(str(state["options"]))
        return [self._draw(lane, None if later else options) for later in range(AHEAD)]

    def _draw(self, lane: int, options: Mapping[str, Any] | None = None) -> int:
        """Sample a lane's next game into the host's rows, and return its row."""
        number = self._written[lane]
        before = self._generators[lane].bit_generator.state
        drawn = self.maker.sample(self._generators[lane], self._games[lane], options)
        self._games[lane] += 1
        row = lane * AHEAD + number % AHEAD
        self.maker.write(drawn, self._host, row)
        latest: dict[int, Any]
        for latest in (self._drawn[lane], self._sampled_by[lane]):
            latest.pop(number - AHEAD, None)
        self._drawn[lane][number], self._sampled_by[lane][number] = drawn, (before, options)
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
        """Transfer what the kernels do not read: the games' courses, conditions, keys, and scales of latencies."""
        self._write(self.starts, target, self.maker.courses(games, self.starts or None))
        sampled = [game.course.get(CONDITIONS, {}) for game in games]
        for name in dict.fromkeys([*self.conditions, *(name for conditions in sampled for name in conditions)]):
            values = np.array([conditions.get(name, np.nan) for conditions in sampled])
            rows = self.conditions.setdefault(name, th.full_like(self.scales, np.nan))
            rows[target] = to_device(values, self.device)
        self._write(self.keys, target, keys_of(self.maker.task, games))
        self.scales[target] = to_device(np.array([game.task.latency.scale for game in games]), self.device)

    def _write(self, kept: dict[str, Any], rows: th.Tensor, values: Mapping[str, Any]) -> None:
        """Write the values (n,) of games to `rows` (n,) of tensors, which are allocated when they first come."""
        for name, value in values.items():
            if name not in kept:
                kept[name] = mapped(lambda array: to_device(np.zeros(self._rows, array.dtype), self.device), value)
            mapped(lambda part, array: part.__setitem__(rows, to_device(array, self.device)), kept[name], value)

    def _latest(self, row: int) -> Drawn:
        """Return the game that was written to a row last."""
        lane, place = divmod(row, AHEAD)
        last = self._written[lane] - 1
        return self._drawn[lane][last - (last - place) % AHEAD]


def to_device(values: NDArray[Any], device: th.device) -> th.Tensor:
    """Copy a NumPy array to the device without waiting for the transfer."""
    tensor = th.from_numpy(np.ascontiguousarray(values))
    return tensor.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else tensor


def _leaves(arrays: Any) -> list[Any]:
    """Return the arrays of nested tuples, in order, but for a scene of one world, which all games share."""
    if isinstance(arrays, Scene):
        return list(arrays[:4]) if len(arrays.shapes) > 1 else []
    return [arrays] if not isinstance(arrays, tuple) else [leaf for array in arrays for leaf in _leaves(array)]
