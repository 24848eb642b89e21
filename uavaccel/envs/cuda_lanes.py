"""Lanes of one task on one GPU: flown, seen and judged there, in tensors; games are drawn by the host, ahead of time.

A round is a command of every lane: the same calls of PyTorch and of the kernels each time, on tensors that stay where
they are, so that it can be recorded as a CUDA graph. A lane whose next game has not been drawn yet waits.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch as th
from gymnasium.utils import seeding

from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.judged import judge
from uavaccel.envs.kernel_games import Drawn, GameMaker, one_course
from uavaccel.envs.kernel_plan import check_flyable, slices_of
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Moment, Moments
from uavaccel.envs.told import age_levels
from uavaccel.errors import UserError
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import events, lanes
from uavaccel.kernels.cpu import COLOUR, DEPTH, DVS, STATE
from uavaccel.kernels.fields import COLUMNS, FIELDS, NO_LOOKS, ROWS
from uavaccel.kernels.flight import TOUCHED
from uavaccel.kinematics import Kinematics
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.saved import State
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, NEVER
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs_sensor import draw_pixels
from uavaccel.vision.observation import BLOCK_SIDE

KINDS = {"state": STATE, "dvs": DVS, "colour": COLOUR, "depth": DEPTH}
AHEAD = 4  # games that a lane has at most: the one that it flies, and those drawn ahead


class Ended(NamedTuple):
    """What is known of a round's games, for the host: (L, ...) float64, in this order of columns."""

    over: int = 0
    success: int = 1
    touched: int = 2
    commands: int = 3
    place: int = 4  # three
    spent_ns: int = 7
    reward: int = 8
    game: int = 9
    columns: int = 10


AT = Ended()


class CudaLanes:
    """`count` lanes of a task on `device`. Raises UserError for what only the exact simulator flies.

    `observations` (L, ...) are what the lanes show now; after a round `rewards`, `terminated`, `truncated`, and in
    `going` who has flown it. `after` are the observations before games that ended gave way to the next ones.
    """

    def __init__(self, task: Any, count: int, device: th.device, renews: bool = True) -> None:
        check_flyable(task, count)
        if (task.timing, task.profile, task.command) != ("lockstep", "native", "tcsc"):
            raise UserError(
                f"device = {device.type}: flies TCSC in lockstep with profile native, not {task.command} in "
                f"{task.timing} with {task.profile}; use device = cpu"
            )
        self.task, self.count, self.device, self.renews = task, count, device, renews
        self.maker = GameMaker(task)
        self.kernels = kernels.compiled(self.maker.usual)
        self.tick_ns = PROFILES[task.profile].tick_ns
        self.slices, wall_ns = slices_of(task)
        self._wall_ns = th.tensor(np.cumsum(wall_ns), device=device)
        self._ends = th.tensor(np.cumsum(self.slices), device=device)
        self.kind = STATE if task.blank_images else KINDS[task.observation]
        self.action_space = task.action_space()
        self._generators: list[Any] = [None] * count
        self._games = [0] * count
        self._drawn: list[dict[int, Drawn]] = [{} for _ in range(count)]
        self._drawn_by: list[dict[int, str]] = [{} for _ in range(count)]
        self._written = [0] * count
        self._allocate()

    def _allocate(self) -> None:
        count, task, device = self.count, self.task, self.device
        self._host = lanes.game_rows(count * AHEAD, self.maker.surroundings.most)
        self.games, self._games_there = kernels.on_device(self._host, device)
        self.now, self._now_there = kernels.on_device(lanes.flights(count), device)
        parameters = task.dvs_parameters
        self.pixels, self._pixels_there = kernels.on_device(
            events.pixels_of(count if self.kind == DVS else 0, parameters), device
        )
        looks, looks_there = kernels.on_device(self.maker.looks or NO_LOOKS, device)
        sensor, sensor_there = kernels.on_device(
            events.sensor_of(draw_pixels(parameters, (ROWS, COLUMNS), task.dvs_seed)), device
        )
        self._hull = th.tensor(self.maker.surroundings.hull, device=device)
        self._plan = kernels.Plan(
            kernels.shared(self._hull), looks_there.texels, looks_there.textures, looks_there, sensor_there
        )
        self._kept = looks, sensor  # the memory behind what numba sees
        lookers = count if self.kind != STATE else 1
        self._faces = th.zeros((lookers, kernels.SLOTS, FIELDS), device=device)
        self._seen_faces = th.zeros((lookers, ROWS, COLUMNS), dtype=th.int16, device=device)
        self._flight = self.now.state.view(th.float64)  # (L, numbers) of FLIGHT_DTYPE, all of eight bytes
        self._ticks_of = self.now.state.view(th.int64)
        self._zeros = th.zeros(count, dtype=th.int64, device=device)
        self._allocate_results()

    def _allocate_results(self) -> None:
        count, task, device = self.count, self.task, self.device
        blank = task.sensor().blank
        space = task.observation_space()
        kind = th.uint8 if blank.dtype == np.uint8 else th.float32
        self.blank = th.tensor(blank, device=device)
        self.frame_shape = blank.shape
        samples = task.frames_per_command
        self._frames = th.zeros((samples, count, *blank.shape), dtype=kind, device=device)
        self.observations = th.zeros((count, *space.shape), dtype=kind, device=device)
        self.after = th.zeros_like(self.observations)
        self._directions = th.zeros((count, 3), dtype=th.float64, device=device)
        table = task.directions
        self._table = None if table is None else th.tensor(table, dtype=th.float64, device=device)
        self._slice_ticks = [th.full((count,), int(ticks), device=device) for ticks in self.slices]
        self.going = th.zeros(count, dtype=th.uint8, device=device)
        self._renewed = th.zeros(count, dtype=th.uint8, device=device)
        self._rows = th.zeros(count, dtype=th.int64, device=device)
        self.begun = th.zeros(count, dtype=th.int64, device=device)
        self.available = th.zeros(count, dtype=th.int64, device=device)
        self.commands = th.zeros(count, dtype=th.int64, device=device)
        self._actions = th.full((count,), 0, dtype=th.int64, device=device)
        self._taken_ns = th.zeros((count, samples * task.history), dtype=th.int64, device=device)
        self._place = th.zeros((3, count), dtype=th.float64, device=device)
        self.rewards = th.zeros(count, dtype=th.float64, device=device)
        self.returns = th.zeros(count, dtype=th.float64, device=device)
        self._spent_ns = th.zeros(count, dtype=th.int64, device=device)
        self.terminated, self.truncated, self.success = (
            th.zeros(count, dtype=th.bool, device=device) for _ in range(3)
        )
        self.ended = th.zeros((count, AT.columns), dtype=th.float64, device=device)
        self._starts: Any = None
        self._course: Any = None
        told = task.told()
        self._shown = None if told is None else th.tensor(told.actions_shown(), device=device)
        self._rows_frames = None if told is None else th.tensor(told.rows_frames(), device=device)

    # --- games, drawn by the host -----------------------------------------------------------------

    def seed(self, seeds: int | Sequence[int | None]) -> None:
        """Draw all games anew, those of lane i from the i-th seed, or from the first one plus i."""
        each = [seeds + lane for lane in range(self.count)] if isinstance(seeds, int) else seeds
        for lane, seed in enumerate(each):
            self._generators[lane], self._games[lane] = seeding.np_random(seed)[0], 0
            self._drawn[lane].clear()
            self._written[lane] = 0
        self.begun.zero_()

    def draw(self, lane: int, options: Mapping[str, Any] | None = None) -> int:
        """Draw a lane's next game into the host's rows; which row."""
        number = self._written[lane]
        before = json.dumps(self._generators[lane].bit_generator.state)
        drawn = self.maker.draw(self._generators[lane], self._games[lane], options)
        self._games[lane] += 1
        row = lane * AHEAD + number % AHEAD
        self.maker.write(drawn, self._host, row)
        for kept in (self._drawn[lane], self._drawn_by[lane]):
            kept.pop(number - AHEAD, None)
        self._drawn[lane][number], self._drawn_by[lane][number] = drawn, before
        self._written[lane] = number + 1
        return row

    def refill(self, begun: Sequence[int]) -> None:
        """Draw as many games ahead as there is room for, given how many each lane has begun; send them over."""
        rows = [
            self.draw(lane)
            for lane, count in enumerate(begun)
            for _ in range(self._written[lane], count - 1 + AHEAD)
        ]
        self.send(rows)

    def send(self, rows: Sequence[int]) -> None:
        """Copy rows of games to the device."""
        if not rows:
            return
        which = np.asarray(rows)
        there = th.tensor(which, device=self.device)
        for host, tensor in zip(_leaves(self._host), _leaves(self.games), strict=True):
            part = host[which]
            if part.dtype.names:
                part = part.view(np.uint8).reshape(len(which), part.dtype.itemsize)
            tensor[there] = th.from_numpy(np.ascontiguousarray(part)).to(self.device)
        self._put_courses(which, there)
        self.available.copy_(th.tensor(self._written, device=self.device))

    def _put_courses(self, which: Any, there: th.Tensor) -> None:
        """The numbers of the games' courses, by row; they are tensors (S,) in lists of the course's shape."""
        drawn = [self._drawn[row // AHEAD][self._number_of(row)] for row in which.tolist()]
        courses = [{name: each for name, each in game.course.items() if name != CONDITIONS} for game in drawn]
        if self._starts is None:
            self._starts = {
                name: _room(courses[0][name], self.count * AHEAD, self.device) for name in courses[0]
            }
            self._course = {name: _room(courses[0][name], self.count, self.device) for name in courses[0]}
        for name, room in self._starts.items():
            _fill(room, there, np.array([course[name] for course in courses]))

    def _number_of(self, row: int) -> int:
        """Which of its lane's games a row has: the latest written there."""
        lane, place = divmod(row, AHEAD)
        last = self._written[lane] - 1
        return last - (last - place) % AHEAD

    # --- a round ----------------------------------------------------------------------------------

    @property
    def begun_yet(self) -> bool:
        """Whether games are under way."""
        return bool(self._written[0])

    def begin(self) -> None:
        """Draw and begin the first games everywhere."""
        if not self.begun_yet:
            self.send([self.draw(lane) for lane in range(self.count)])
        self.going.zero_()
        self._renew(th.ones(self.count, dtype=th.bool, device=self.device))

    def fly(self, actions: th.Tensor) -> None:
        """A command of every lane that has a game: (L,) numbers of actions, or (L, 3) directions."""
        self._directions.copy_(actions if self._table is None else self._table[actions])
        if self._table is not None:
            self._actions.copy_(actions)
        launch, stream = self.kernels, kernels.stream()
        per_lane = _grid(self.count, kernels.FLYING_THREADS)
        going = kernels.shared(self.going)
        launch.command[(*per_lane, stream)](
            going, kernels.shared(self._directions), self._games_there, self._now_there
        )
        states = []
        for sample, ticks in enumerate(self._slice_ticks):
            self._fly_sample(sample, ticks)
            states.append(self._flight[:, 1:14].clone() if self.task.observation == "state" else None)
        self._land(states)

    def _fly_sample(self, sample: int, ticks: th.Tensor) -> None:
        every = self.task.dvs_ticks if self.kind == DVS else None
        total, flown = int(self.slices[sample]), 0
        before = int(self.slices[:sample].sum())
        while every and flown < total:
            due = min(every - (before + flown) % every, total - flown)
            self._advance(th.full_like(ticks, due))
            flown += due
            if (before + flown) % every == 0 or flown == total:
                self._look(sample, take=flown == total)
        if not every:
            self._advance(ticks)
            self._look(sample, take=True)

    def _advance(self, ticks: th.Tensor) -> None:
        grid = _grid(self.count, kernels.FLYING_THREADS)
        self.kernels.fly[(*grid, kernels.stream())](
            kernels.shared(self.going),
            kernels.shared(ticks),
            self._games_there,
            self._now_there,
            self._plan.hull,
        )

    def _look(self, sample: int, take: bool) -> None:
        if self.kind == STATE:
            self._frames[sample].copy_(self.blank.expand_as(self._frames[sample]))
            return
        self._project(self.going)
        launch, stream = self.kernels, kernels.stream()
        going, faces, shown = self._looked_at(self.going)
        games, now = self._games_there, self._now_there
        if self.kind != DVS:
            grid = _grid(self.count * kernels.BLOCKS, kernels.SEEING_THREADS)
            frames = kernels.shared(self._frames[sample])
            launch.show[(*grid, stream)](
                going, self.kind, self.tick_ns, faces, shown, self._plan, games, now, frames
            )
            return
        grid = _grid(self.count * kernels.SEEING_THREADS_A_LANE, kernels.SEEING_THREADS)
        frames = kernels.shared(self._frames[sample, :, 0])
        seen = (int(take), faces, shown, self._plan, games, now, self._pixels_there, frames)
        launch.see[(*grid, stream)](going, *seen)
        launch.see_noise[(*grid, stream)](going, self.tick_ns, *seen)
        per_lane = _grid(self.count, kernels.FLYING_THREADS)
        launch.note[(*per_lane, stream)](going, self.tick_ns, now, self._pixels_there)

    def _project(self, which: th.Tensor) -> None:
        grid = _grid(self.count * kernels.WARP, kernels.SEEING_THREADS)
        sky = self.kind != DEPTH
        self.kernels.project[(*grid, kernels.stream())](
            kernels.shared(which),
            sky,
            self._plan.looks,
            self._games_there,
            self._now_there,
            kernels.shared(self._faces),
        )
        grid = _grid(self.count * COLUMNS, kernels.COLUMN_THREADS)
        self.kernels.find[(*grid, kernels.stream())](*self._looked_at(which))

    def _looked_at(self, which: th.Tensor) -> tuple[Any, Any, Any]:
        """Which lanes look, their faces, and the face that each pixel shows."""
        return kernels.shared(which), kernels.shared(self._faces), kernels.shared(self._seen_faces)

    def _land(self, states: Sequence[th.Tensor | None]) -> None:
        """Judge the command, show what was seen of it, and begin new games where one is over."""
        going = self.going.bool()
        before = Moments(None, list(self._place.clone()), None, None, _copied(self._course))
        self.commands += going
        hit = self._ticks_of[:, _COLLISION]
        touched = hit != int(NEVER)
        self._place.copy_(th.where(touched, self._contact().T, self._flight[:, 1:4].T))
        now = Moments(None, list(self._place), touched, self.commands, _copied(self._course))
        th.set_default_dtype(th.float64)  # of a number times a flag
        judged = judge(self.task, before, now)
        th.set_default_dtype(th.float32)
        self.rewards.copy_(th.where(going, judged.reward, 0.0))
        self.success.copy_(judged.success & going)
        self.terminated.copy_(judged.terminated & going)
        self.truncated.copy_(judged.truncated & going)
        self.returns += self.rewards
        seen = self._note_times(hit, touched, going)
        if self.task.observation == "state" and not self.task.blank_images:
            self._put_features(states, seen)
        for name, value in judged.course.items():  # frames were of the course before
            _put(self._course[name], value, going)
        self._show(going)
        over = self.terminated | self.truncated
        self._tell(over, touched)
        self.after.copy_(self.observations)
        self.going.copy_((going & ~over).byte())
        if self.renews:
            self._renew(self.going == 0)

    def _note_times(self, hit: th.Tensor, touched: th.Tensor, going: th.Tensor) -> th.Tensor:
        """Which samples (L, S) were seen before a touch; wall time and the frames' times follow from them."""
        begun = ((self.commands - 1) * self._ends[-1])[:, None]
        ends = begun + self._ends
        seen = ends <= hit[:, None]
        flown = (seen.sum(1)).clamp(max=len(self._ends) - 1)
        spent = self._wall_ns[flown]
        self._spent_ns += th.where(going, spent, 0)
        self._present_ns = (begun[:, 0] + self._ends[flown]) * self.tick_ns
        taken = th.where(seen, ends * self.tick_ns, self._present_ns[:, None])
        self._taken_ns.copy_(th.cat([self._taken_ns, taken], 1)[:, len(self._ends) :])
        return seen

    def _put_features(self, states: Sequence[th.Tensor | None], seen: th.Tensor) -> None:
        for sample, numbers in enumerate(states):
            assert numbers is not None
            columns = list(numbers.T)
            state = Kinematics(0, columns[:3], columns[3:7], columns[7:10], columns[10:13])  # type: ignore[arg-type]
            fields = th.stack([*self.task.fields(state, self._course)], 1).float()
            shown = fields.reshape(self.count, *self.frame_shape)
            room = (slice(None), *(None,) * len(self.frame_shape))
            self._frames[sample].copy_(th.where(seen[:, sample][room], shown, self.blank))

    def _show(self, going: th.Tensor) -> None:
        """The observations: frames, oldest first, and what the agent is told."""
        fresh = self._frames.transpose(0, 1).reshape(self.count, -1, *self.frame_shape[1:])
        width, history = fresh.shape[1], self.task.history
        kept = self.observations[:, width : width * history]
        planes = [kept, fresh]
        if self._shown is not None:
            ages = age_levels(self._present_ns[:, None] - self._taken_ns)
            planes.append(self._planes(self._shown[self._actions], ages))
        self.observations.copy_(th.cat(planes, 1))

    def _planes(self, shown: th.Tensor, ages: th.Tensor) -> th.Tensor:
        aged = ages[:, self._rows_frames][:, :, None].expand(-1, -1, COLUMNS // BLOCK_SIDE).to(th.uint8)
        both = {"last_action": shown, "frame_age": aged}
        return th.stack([both[what] for what in self.task.knows], 1)

    def _tell(self, over: th.Tensor, touched: th.Tensor) -> None:
        """Write down the games for the host."""
        told = self.ended
        told[:, AT.over], told[:, AT.success], told[:, AT.touched] = (
            over.double(),
            self.success.double(),
            touched.double(),
        )
        told[:, AT.commands], told[:, AT.place : AT.place + 3] = self.commands.double(), self._place.T
        told[:, AT.spent_ns], told[:, AT.reward] = self._spent_ns.double(), self.returns
        told[:, AT.game] = (self.begun - 1).double()
        solids = self.now.watch[:, TOUCHED].double()
        told[:, AT.touched] = th.where(touched, solids + 1.0, 0.0)

    def _renew(self, idle: th.Tensor) -> None:
        """Begin the next games, where there are some."""
        renewed = idle & (self.begun < self.available)
        self._renewed.copy_(renewed.byte())
        lane = th.arange(self.count, device=self.device)
        self._rows.copy_(lane * AHEAD + self.begun % AHEAD)
        self.begun += renewed
        launch, stream = self.kernels, kernels.stream()
        per_lane = _grid(self.count, kernels.FLYING_THREADS)
        which = kernels.shared(self._renewed)
        launch.begin[(*per_lane, stream)](
            which, kernels.shared(self._rows), self._games_there, self._now_there
        )
        for name, starts in self._starts.items():
            _put(self._course[name], _taken(starts, self._rows), renewed)
        first = self.blank.expand(self.count, *self.frame_shape)
        if self.kind == DVS:
            self._project(self._renewed)
            grid = _grid(self.count * kernels.SEEING_THREADS_A_LANE, kernels.SEEING_THREADS)
            launch.start[(*grid, stream)](
                *self._looked_at(self._renewed),
                self._plan,
                self._games_there,
                self._now_there,
                self._pixels_there,
            )
        if self.task.sees_start and not self.task.blank_images and self.kind != DVS:
            first = self._start_frames()
        self.commands.copy_(th.where(renewed, 0, self.commands))
        self._spent_ns.copy_(th.where(renewed, 0, self._spent_ns))
        self.returns.copy_(th.where(renewed, 0.0, self.returns))
        self._taken_ns.copy_(th.where(renewed[:, None], 0, self._taken_ns))
        self._place.copy_(th.where(renewed, self._flight[:, 1:4].T, self._place))
        self._show_first(renewed, first)
        self.going.copy_(self.going | self._renewed)

    def _start_frames(self) -> th.Tensor:
        """What is seen of a start (L, ...)."""
        if self.kind == STATE:
            columns = list(self._flight[:, 1:14].T)
            state = Kinematics(0, columns[:3], columns[3:7], columns[7:10], columns[10:13])  # type: ignore[arg-type]
            fields = th.stack([*self.task.fields(state, self._course)], 1).float()
            return fields.reshape(self.count, *self.frame_shape)
        self._project(self._renewed)
        grid = _grid(self.count * kernels.BLOCKS, kernels.SEEING_THREADS)
        frames = th.zeros_like(self._frames[0])
        self.kernels.show[(*grid, kernels.stream())](
            kernels.shared(self._renewed),
            self.kind,
            self.tick_ns,
            kernels.shared(self._faces),
            kernels.shared(self._seen_faces),
            self._plan,
            self._games_there,
            self._now_there,
            kernels.shared(frames),
        )
        return frames

    def _show_first(self, renewed: th.Tensor, first: th.Tensor) -> None:
        frames = len(self._slice_ticks) * self.task.history
        planes = [th.cat([first] * frames, 1)]
        if self._shown is not None:
            ages = age_levels(th.zeros_like(self._taken_ns))
            planes.append(self._planes(self._shown[-1:].expand(self.count, -1, -1), ages))
        room = (slice(None), *(None,) * (self.observations.ndim - 1))
        self.observations.copy_(th.where(renewed[room], th.cat(planes, 1), self.observations))

    def _contact(self) -> th.Tensor:
        return self._flight[:, _CONTACT : _CONTACT + 3]

    # --- saving, as stable-baselines3's vectors are asked for it --------------------------------------

    @property
    def num_envs(self) -> int:
        return self.count

    def env_method(self, name: str, *arguments: Any, indices: Sequence[int] | None = None) -> list[Any]:
        """`get_state`, or `set_state` with a state, of some lanes (all)."""
        which = range(self.count) if indices is None else indices
        return [getattr(self, name)(lane, *arguments) for lane in which]

    def get_state(self, lane: int) -> State:
        """A lane's running game, and what its next ones are drawn from, for np.savez."""
        flown = int(self.begun[lane]) - 1
        state: State = {
            "drawn_by": self._drawn_by[lane][flown],
            "flown": flown,
            "written": self._written[lane],
        }
        state["games"] = self._games[lane] - (self._written[lane] - flown)
        return state | {name: tensor[..., lane].cpu().numpy() for name, tensor in self._lanes_last().items()}

    def set_state(self, lane: int, state: Mapping[str, Any]) -> Any:
        """Go on with what `get_state` gave; the last observation."""
        generator = self._generators[lane] = seeding.np_random(0)[0]
        generator.bit_generator.state = json.loads(str(state["drawn_by"]))
        self._games[lane], self._written[lane] = int(state["games"]), int(state["flown"])
        self.send([self.draw(lane) for _ in range(int(state["flown"]), int(state["written"]))])
        for name, tensor in self._lanes_last().items():
            tensor[..., lane] = th.from_numpy(np.ascontiguousarray(state[name])).to(self.device)
        self.available[lane] = int(state["written"])
        return self.observations[lane].cpu().numpy()

    def _lanes_last(self) -> dict[str, th.Tensor]:
        """All that changes while games are flown, the lane as the last axis."""
        parts = {f"now.{name}": each for name, each in self.now._asdict().items()}
        parts |= {f"pixels.{name}": each for name, each in self.pixels._asdict().items() if len(each)}
        names = (
            "observations",
            "going",
            "begun",
            "commands",
            "_actions",
            "_taken_ns",
            "returns",
            "_spent_ns",
        )
        parts |= {name: getattr(self, name) for name in names}
        last = {name: each.movedim(0, -1) for name, each in parts.items()}
        courses = {f"course.{number}": each for number, each in enumerate(_tensors(self._course))}
        return last | courses | {"place": self._place}

    def close(self) -> None:
        """The device's memory goes with the tensors."""

    # --- what the host is told --------------------------------------------------------------------

    def info(self, lane: int, told: Sequence[float], course: Any = None) -> dict[str, Any]:
        """The info of a lane's game, of a row of `ended`."""
        drawn = self._drawn[lane][int(told[AT.game])]
        hit = self.maker.name_of(int(told[AT.touched]) - 1, drawn.layout) if told[AT.touched] else None
        place = tuple(told[AT.place : AT.place + 3])
        moment = Moment(None, place, hit, int(told[AT.commands]), course or drawn.course)  # type: ignore[arg-type]
        spent_s = told[AT.spent_ns] / NS_PER_S
        return {
            "is_success": bool(told[AT.success]),
            "position_m": list(place),
            "collision": hit,
            "commands": moment.commands,
            "wall_s": spent_s,
            "phase_s": {**dict.fromkeys(PHASES, 0.0), "simulation": spent_s},
            **self.task.info(moment),
        }

    def course_of(self, lane: int) -> dict[str, Any]:
        """A lane's present course, as plain numbers."""
        return dict(one_course(self._course, lane))


def _field(name: str) -> int:
    """The column of a field of FLIGHT_DTYPE among its numbers."""
    fields = FLIGHT_DTYPE.fields
    assert fields is not None
    return int(fields[name][1]) // 8


_COLLISION, _CONTACT = _field("collision_tick"), _field("contact_position")


def _grid(threads: int, per_block: int) -> tuple[int, int]:
    return -(-threads // per_block), per_block


def _leaves(arrays: Any) -> list[Any]:
    return [arrays] if not isinstance(arrays, tuple) else [leaf for each in arrays for leaf in _leaves(each)]


def _tensors(course: Any) -> list[th.Tensor]:
    if isinstance(course, dict):
        return [tensor for each in course.values() for tensor in _tensors(each)]
    return [tensor for each in course for tensor in _tensors(each)] if isinstance(course, list) else [course]


def _room(example: Any, count: int, device: th.device) -> Any:
    if isinstance(example, (list, tuple)):
        return [_room(each, count, device) for each in example]
    kind = {bool: th.bool, int: th.int64}.get(type(example), th.float64)
    return th.zeros(count, dtype=kind, device=device)


def _fill(room: Any, there: th.Tensor, values: Any) -> None:
    if isinstance(room, list):
        for number, part in enumerate(room):
            _fill(part, there, values[:, number])
    else:
        room[there] = th.tensor(values, device=room.device).to(room.dtype)


def _taken(room: Any, rows: th.Tensor) -> Any:
    return [_taken(part, rows) for part in room] if isinstance(room, list) else room[rows]


def _put(room: Any, values: Any, where: th.Tensor) -> None:
    if isinstance(room, list):
        for part, value in zip(room, values, strict=True):
            _put(part, value, where)
    else:
        room.copy_(th.where(where, values, room))


def _copied(course: Any) -> Any:
    if isinstance(course, dict):
        return {name: _copied(each) for name, each in course.items()}
    return [_copied(each) for each in course] if isinstance(course, list) else course.clone()
