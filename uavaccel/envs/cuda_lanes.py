"""Lanes of one task on one GPU: flown, observed and judged there; the host samples games ahead of time.

A round is one command of every lane. It makes the same calls of PyTorch and of the kernels each time, on tensors that
never move, so that it can be recorded as a CUDA graph. A lane whose next game has not been sampled yet waits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch as th

from uavaccel.envs.context_planes import age_levels
from uavaccel.envs.cuda_clocks import DeviceClocks
from uavaccel.envs.cuda_courses import assign_where, clone, tensors
from uavaccel.envs.cuda_games import games_of
from uavaccel.envs.cuda_view import view_of
from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.flyable import CUDA, check_flyable, passes_together, profile_of
from uavaccel.envs.kernel_games import game_info, kinematics_of, one_course, select, step_result
from uavaccel.envs.kernel_plan import slices_of
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Moment, Moments
from uavaccel.envs.values import Info
from uavaccel.errors import UserError
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import lanes
from uavaccel.kernels.fields import COLUMNS, DVS, STATE
from uavaccel.kernels.flight import TOUCHED
from uavaccel.kernels.recording import recorded
from uavaccel.sim.state import State
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, NEVER
from uavaccel.units import NS_PER_S
from uavaccel.vision.observation import BLOCK_SIDE


class Ended(NamedTuple):
    """The columns of `CudaLanes.ended` (L, columns) float64, in which the host reads the outcome of a round."""

    over: int = 0
    success: int = 1
    touched: int = 2  # 0 without a collision, else the solid's index + 1
    commands: int = 3
    place: int = 4  # position: three columns
    wall_ns: int = 7
    reward: int = 8
    label: int = 9  # by which the games find it
    phase_ns: int = 10  # a column for each of PHASES
    columns: int = 10 + len(PHASES)


AT = Ended()


class CudaLanes:
    """`count` lanes of a task on `device`. Raises UserError for tasks that cannot be flown there.

    `observations` (L, ...) are the present ones. After a round, `rewards`, `terminated` and `truncated` (L,) are those
    of its commands, and `going` (L,) uint8 says which lanes fly the next round. With `renews`, a lane whose game is
    over begins the next one of `games` at once; without, it waits for `renew`. With `reports`, `final_observations` (L,
    ...) and `final_info` hold the observations and infos before the next games began.
    """

    def __init__(self, task: Any, count: int, device: th.device, renews: bool = True, reports: bool = False) -> None:
        check_flyable(task, count, CUDA)
        self.task, self.count, self.device, self.renews, self.reports = task, count, device, renews, reports
        self.games = games_of(task, count, device)
        self.kernels = kernels.compiled(self.games.maker.nominal)
        self.now, self._now_arrays = kernels.on_device(lanes.flights(count), device)
        self._tick_ns = profile_of(task).tick_ns
        self._threads = kernels.threads_a_lane(count, device)
        self.view = view_of(task, self.games.maker, count, device, self.games.arrays, self._now_arrays, self._tick_ns)
        self.kind = self.view.kind
        hull = self.games.maker.surroundings.hull
        self.clocks = (
            None
            if passes_together(task)
            else DeviceClocks(task, count, device, hull, self._now_arrays, self.view, self._advance)
        )
        self.action_space = task.action_space()
        self._allocate()

    def _allocate(self) -> None:
        count, task, device = self.count, self.task, self.device
        self._flight = self.now.state.view(th.float64)  # (L, columns): FLIGHT_DTYPE as float64
        self._ticks_of = self.now.state.view(th.int64)
        blank, space, samples = task.sensor().blank, task.frames_space(), task.frames_per_command
        kind = th.uint8 if blank.dtype == np.uint8 else th.float32
        self.blank = th.tensor(blank, device=device)
        self.frame_shape = blank.shape
        self._frames = th.zeros((samples, count, *blank.shape), dtype=kind, device=device)
        self.observations = th.zeros((count, *space.shape), dtype=kind, device=device)
        self.going, self._renewed = (th.zeros(count, dtype=th.uint8, device=device) for _ in range(2))
        self.commands, self._rows, self._actions = (th.zeros(count, dtype=th.int64, device=device) for _ in range(3))
        self._position = th.zeros((3, count), dtype=th.float64, device=device)
        self.rewards, self.returns = (th.zeros(count, dtype=th.float64, device=device) for _ in range(2))
        self.terminated, self.truncated, self.success = (
            th.zeros(count, dtype=th.bool, device=device) for _ in range(3)
        )
        self.ended = th.zeros((count, AT.columns), dtype=th.float64, device=device)
        self._course: dict[str, Any] = {}
        self._told = th.zeros((count, task.told), device=device)
        self.final_observations: Any = clone(self.seen()) if self.reports else None
        self.final_info: dict[str, Any] = {}
        self._allocate_commands()

    def _allocate_commands(self) -> None:
        count, task, device = self.count, self.task, self.device
        self.slices, wall_ns = slices_of(task)
        self._slice_wall_ns = th.tensor(np.cumsum(wall_ns), device=device)
        self._ends = th.tensor(np.cumsum(self.slices), device=device)
        self._slice_ticks = [th.full((count,), int(ticks), device=device) for ticks in self.slices]
        self._render_stream = kernels.SideStream()
        concurrent = self.kind != STATE and self.clocks is None and not task.dvs_ticks
        self._moments = [self._moment() for _ in self.slices if concurrent]
        self._directions = th.zeros((count, 3), dtype=th.float64, device=device)
        table = task.directions
        self._table = None if table is None else th.tensor(table, dtype=th.float64, device=device)
        frames = len(self.slices) * task.history
        self._taken_ns = th.zeros((count, frames), dtype=th.int64, device=device)
        self._wall_ns, self._present_ns = (th.zeros(count, dtype=th.int64, device=device) for _ in range(2))
        context = task.context_planes()
        self._action_planes = None if context is None else th.tensor(context.actions_shown(), device=device)
        self._rows_frames = None if context is None else th.tensor(context.rows_frames(), device=device)

    def _moment(self) -> tuple[th.Tensor, Any]:
        """Allocate a copy of the flights, to be rendered while the lanes fly on: states, and numba arrays."""
        state = th.zeros_like(self.now.state)
        return state, self._now_arrays._replace(state=kernels.shared(state, FLIGHT_DTYPE))

    # --- games ------------------------------------------------------------------------------------

    def seed(self, seeds: int | Sequence[int | None]) -> None:
        """Seed all lanes anew: lane i with the i-th of several seeds, or with a single seed plus i."""
        self.games.seed(seeds)

    @property
    def has_begun(self) -> bool:
        """Whether games have begun."""
        return self.games.has_games

    def begin(self) -> None:
        """Sample and begin the first game of every lane."""
        if not self.has_begun:
            self.games.sample_games()
        self.going.zero_()
        self.renew(th.ones(self.count, dtype=th.bool, device=self.device))

    def renew(self, idle: th.Tensor) -> None:
        """Begin the next games of lanes that are `idle` (L,) bool, where there are some."""
        renewed = self.games.begin(idle, self._rows)
        self._renewed.copy_(renewed.byte())
        self._launch("begin", self._renewed, kernels.shared(self._rows), self.games.arrays, self._now_arrays)
        for name, starts in self.games.starts.items():
            if name not in self._course:
                self._course[name] = clone(select(starts, self._rows))
            assign_where(self._course[name], select(starts, self._rows), renewed)
        if self.clocks is not None:
            self.clocks.begin(self._renewed, self._rows, self.games.scales, self.games.arrays)
        first = self._first_frames()
        if self.clocks is not None:
            self.clocks.show_start(self._renewed)
        for numbers in (self.commands, self._wall_ns, self.returns):
            numbers.copy_(th.where(renewed, 0, numbers))
        self._taken_ns.copy_(th.where(renewed[:, None], 0, self._taken_ns))
        self._position.copy_(th.where(renewed, self._flight[:, 1:4].T, self._position))
        self._observe_start(renewed, first)
        self._tell()
        self.going.copy_(self.going | self._renewed)

    def _first_frames(self) -> th.Tensor:
        """Return the first frames (L, ...) of games that begin."""
        blank = self.blank.expand(self.count, *self.frame_shape)
        if self.kind == DVS:
            self.view.start(self._renewed)
        elif self.kind != STATE and (self.task.sees_start or (self.clocks is not None and self.clocks.guards)):
            frames = th.zeros_like(self._frames[0])
            self.view.show(self._renewed, frames)  # for the guard, even if the task does not observe it
            return frames if self.task.sees_start else blank
        elif self.kind == STATE and self.task.sees_start and not self.task.blank_images:
            return self._features(self._flight[:, 1:14])
        return blank

    def _observe_start(self, renewed: th.Tensor, first: th.Tensor) -> None:
        planes = [th.cat([first] * self._taken_ns.shape[1], 1)]
        if self._action_planes is not None:
            ages = age_levels(th.zeros_like(self._taken_ns))
            planes.append(self._planes(self._action_planes[-1:].expand(self.count, -1, -1), ages))
        over_rows = (slice(None), *(None,) * (self.observations.ndim - 1))
        self.observations.copy_(th.where(renewed[over_rows], th.cat(planes, 1), self.observations))

    # --- a round ----------------------------------------------------------------------------------

    def fly(self, actions: th.Tensor) -> None:
        """Fly one command in every lane that has a game; `actions` are indices (L,) or directions (L, 3)."""
        self._directions.copy_(actions if self._table is None else self._table[actions])
        if self._table is not None:
            self._actions.copy_(actions)
        states = self._fly_together() if self.clocks is None else self._fly_by_clocks(self.clocks)
        self._finish_commands(states)

    def recorded_flight(self) -> Callable[[th.Tensor], None]:
        """Return `fly` as a CUDA graph, for callers that do not record more than that."""
        directions = self._directions if self._table is None else self._actions
        given = th.zeros_like(directions)
        flight = recorded(lambda: self.fly(given), self.device)

        def fly(actions: th.Tensor) -> None:
            given.copy_(actions)
            flight()

        return fly

    def charge(self, flown: th.Tensor, duration_s: float, phase: str) -> None:
        """In timing `virtual`, charge the lanes in `flown` (L,) uint8 for their agent's work; with ADSC they fly on."""
        if self.clocks is not None and self.task.timing == "virtual":
            self.clocks.charge(flown, duration_s, phase)

    def _fly_together(self) -> list[th.Tensor]:
        """Fly the same ticks in all lanes and return the states (L, 13) of the samples, for observation "state"."""
        self._launch("command", self.going, kernels.shared(self._directions), self.games.arrays, self._now_arrays)
        states: list[th.Tensor] = []
        for sample, ticks in enumerate(self._slice_ticks):
            if self.kind == DVS and self.task.dvs_ticks:
                self._fly_recording_events(sample, self.task.dvs_ticks)
                continue
            self._advance(self.going, ticks)
            if self.kind != STATE:
                self._look_concurrently(sample)
            else:
                states.append(self._flight[:, 1:14].clone())
        self._render_stream.join()
        return states

    def _look_concurrently(self, sample: int) -> None:
        """Render the lanes' present images while they fly on."""
        state, now = self._moments[sample]
        state.copy_(self.now.state)
        with self._render_stream.following():
            self.view.render(self.going, self._frames[sample], now=now)

    def _fly_recording_events(self, sample: int, every: int) -> None:
        """Fly to a sample with an event camera that records a frame `every` so many ticks."""
        total, flown = int(self.slices[sample]), 0
        before = int(self.slices[:sample].sum())
        while flown < total:
            due = min(every - (before + flown) % every, total - flown)
            self._advance(self.going, th.full_like(self._slice_ticks[sample], due))
            flown += due
            if (before + flown) % every == 0 or flown == total:
                self.view.render(self.going, self._frames[sample], take=flown == total)

    def _fly_by_clocks(self, clocks: DeviceClocks) -> list[th.Tensor]:
        """Fly each lane to the samples that its own clock times, and return the states (L, 13) as `_fly_together`."""
        self._frames.copy_(self.blank.expand_as(self._frames))
        clocks.issue(self.going, self._directions, self.games.arrays)
        states: list[th.Tensor] = []
        for sample in range(len(self.slices)):
            clocks.reach(self.going, sample)
            if self.kind != STATE:
                clocks.render(self._frames[sample])
            else:
                states.append(self._flight[:, 1:14].clone())
            clocks.leave(sample)
        return states

    def _advance(self, which: th.Tensor, ticks: th.Tensor) -> None:
        """Fly the lanes selected by `which` (L,) uint8 for `ticks` (L,) int64."""
        grid = kernels.grid(self.count * self._threads, kernels.FLYING_THREADS)
        self.kernels.fly[grid](
            kernels.shared(which),
            kernels.shared(ticks),
            self.games.arrays,
            self._now_arrays,
            self.view.plan.hull,
            self._threads,
        )

    def _launch(self, name: str, which: th.Tensor, *arguments: Any) -> None:
        """Launch a kernel with one thread per lane."""
        grid = kernels.grid(self.count, kernels.FLYING_THREADS)
        getattr(self.kernels, name)[grid](kernels.shared(which), *arguments)

    # --- after it ---------------------------------------------------------------------------------

    def _finish_commands(self, states: Sequence[th.Tensor]) -> None:
        """Judge the commands, update the observations, and with `renews` begin the next games."""
        going = self.going.bool()
        before = Moments(None, list(self._position.clone()), None, None, clone(self._course))
        self.commands += going
        hit = self._ticks_of[:, _COLLISION]
        touched = hit != int(NEVER)
        contact = self._flight[:, _CONTACT : _CONTACT + 3]
        self._position.copy_(th.where(touched, contact.T, self._flight[:, 1:4].T))
        now = Moments(None, list(self._position), touched, self.commands, clone(self._course))
        th.set_default_dtype(th.float64)  # so that a number times a flag is computed in double precision
        judged = step_result(self.task, before, now)
        th.set_default_dtype(th.float32)
        self.rewards.copy_(th.where(going, judged.reward, 0.0))
        self.success.copy_(judged.success & going)
        self.terminated.copy_(judged.terminated & going)
        self.truncated.copy_(judged.truncated & going)
        self.returns += self.rewards
        seen = self._note_times(hit, touched, going)
        if self.task.blank_images:
            self._frames.copy_(self.blank.expand_as(self._frames))
        elif self.kind == STATE:
            for sample, numbers in enumerate(states):
                over_rows = (slice(None), *(None,) * len(self.frame_shape))
                shown = self._features(numbers)
                self._frames[sample].copy_(th.where(seen[:, sample][over_rows], shown, self.blank))
        for name, value in judged.course.items():  # after the frames, which show the course before
            assign_where(self._course[name], value, going)
        self._observe()
        over = self.terminated | self.truncated
        self._write_outcomes(over, touched)
        self._tell()
        if self.reports:
            for final, seen in zip(tensors(self.final_observations), tensors(self.seen()), strict=True):
                final.copy_(seen)
            self.final_info = self._report(touched)
        self.going.copy_((going & ~over).byte())
        if self.renews:
            self.renew(self.going == 0)

    def _report(self, touched: th.Tensor) -> dict[str, Any]:
        """Return the infos of all lanes' present games as tensors (L, ...), with the items of `game_info`."""
        games, rows = self.games, self._rows
        moments = Moments(None, list(self._position), touched, self.commands, self._course)
        try:
            own = self.task.info(moments)
        except (TypeError, ValueError, RuntimeError):
            name = type(self.task).__name__
            raise UserError(f"device = cuda: {name}.info must compute with plain arithmetic; or take cpu") from None
        solid, obstacles = self.now.watch[:, TOUCHED], games.rows.counts[rows] - len(games.maker.surroundings.names)
        beyond = solid - obstacles + len(games.maker.surroundings.obstacle_names)
        clocks = self.clocks
        spent_s = (
            [th.zeros_like(self.rewards) for _ in PHASES]
            if clocks is None
            else list(clocks.phase_ns.T.double() / NS_PER_S)
        )
        wall_s = self._wall_ns.double() / NS_PER_S
        if clocks is None:
            spent_s[PHASES.index("simulation")] = wall_s
        conditions = {name: values[rows] for name, values in games.conditions.items()}
        return {
            "is_success": self.success.clone(),
            "position_m": self.positions(),
            "collision": th.where(touched, th.where(solid < obstacles, solid, beyond), -1),
            "commands": self.commands.clone(),
            "wall_s": wall_s,
            "phase_s": dict(zip(PHASES, spent_s, strict=True)),
            **{name: _stacked(value) for name, value in own.items()},
            **({CONDITIONS: conditions} if conditions else {}),
        }

    def _note_times(self, hit: th.Tensor, touched: th.Tensor, going: th.Tensor) -> th.Tensor:
        """Update wall times and the frames' times, and return which samples (L, S) precede a collision."""
        if self.clocks is not None:
            self._wall_ns.copy_(self.clocks.wall_ns)
            self._present_ns.copy_(self.clocks.present_ns(self._ticks_of[:, _TICK], ~touched))
            seen, taken_ns = self.clocks.taken_ns(self._present_ns)
        else:
            begun = ((self.commands - 1) * self._ends[-1])[:, None]
            ends = begun + self._ends
            seen = ends <= hit[:, None]
            flown = (seen.sum(1)).clamp(max=len(self._ends) - 1)
            self._wall_ns += th.where(going, self._slice_wall_ns[flown], 0)
            self._present_ns.copy_((begun[:, 0] + self._ends[flown]) * self._tick_ns)
            taken_ns = th.where(seen, ends * self._tick_ns, self._present_ns[:, None])
        self._taken_ns.copy_(th.cat([self._taken_ns, taken_ns], 1)[:, len(self._ends) :])
        return seen

    def seen(self) -> Any:
        """Return the present observations: `observations`, or a mapping of them and of the states."""
        return {"image": self.observations, "state": self._told} if self.task.also_state else self.observations

    def _tell(self) -> None:
        """Update the states (L, fields) beside frames, all 0 after a collision."""
        if self.task.also_state:
            free = (self._ticks_of[:, _COLLISION] == int(NEVER))[:, None]
            self._told.copy_(th.where(free, self._numbers(self._flight[:, 1:14]), 0.0))

    def _features(self, numbers: th.Tensor) -> th.Tensor:
        """Return the frames (L, ...) of observation "state" for states (L, 13)."""
        return self._numbers(numbers).reshape(self.count, *self.frame_shape)

    def _numbers(self, numbers: th.Tensor) -> th.Tensor:
        """Return the task's fields (L, fields) for states (L, 13)."""
        return th.stack([*self.task.fields(kinematics_of(numbers), self._course)], 1).float()

    def _observe(self) -> None:
        """Update the observations: frames, oldest first, then context planes."""
        fresh = self._frames.transpose(0, 1).reshape(self.count, -1, *self.frame_shape[1:])
        width, history = fresh.shape[1], self.task.history
        planes = [self.observations[:, width : width * history], fresh]
        if self._action_planes is not None:
            ages = age_levels(self._present_ns[:, None] - self._taken_ns)
            planes.append(self._planes(self._action_planes[self._actions], ages))
        self.observations.copy_(th.cat(planes, 1))

    def _planes(self, shown: th.Tensor, ages: th.Tensor) -> th.Tensor:
        aged = ages[:, self._rows_frames][:, :, None].expand(-1, -1, COLUMNS // BLOCK_SIDE).to(th.uint8)
        both = {"last_action": shown, "frame_age": aged}
        return th.stack([both[what] for what in self.task.knows], 1)

    def _write_outcomes(self, over: th.Tensor, touched: th.Tensor) -> None:
        """Write the outcome of the round to `ended`, for the host."""
        outcome, solids = self.ended, self.now.watch[:, TOUCHED].double()
        outcome[:, AT.over], outcome[:, AT.success] = over.double(), self.success.double()
        outcome[:, AT.touched] = th.where(touched, solids + 1.0, 0.0)
        outcome[:, AT.commands], outcome[:, AT.place : AT.place + 3] = (self.commands.double(), self._position.T)
        outcome[:, AT.wall_ns], outcome[:, AT.reward] = self._wall_ns.double(), self.returns
        outcome[:, AT.label] = self.games.label.double()
        if self.clocks is None:
            outcome[:, AT.phase_ns + PHASES.index("simulation")] = self._wall_ns.double()
        else:
            outcome[:, AT.phase_ns :] = self.clocks.phase_ns.double()

    # --- saving, with the methods of Stable-Baselines3's VecEnv --------------------------------------

    @property
    def num_envs(self) -> int:
        return self.count

    def env_method(self, name: str, *arguments: Any, indices: Sequence[int] | None = None) -> list[Any]:
        """Call `get_state`, or `set_state` with a state, of the lanes `indices`, by default all."""
        which = range(self.count) if indices is None else indices
        return [getattr(self, name)(lane, *arguments) for lane in which]

    def get_state(self, lane: int) -> State:
        """Return a lane's running game, and what its next ones are sampled from, for np.savez."""
        flown = {name: tensor[..., lane].cpu().numpy() for name, tensor in self._state_tensors().items()}
        return self.games.get_state(lane) | flown

    def set_state(self, lane: int, state: Mapping[str, Any]) -> Any:
        """Restore a state that `get_state` returned, and return the lane's observation."""
        self.games.set_state(lane, state)
        if not self._course:
            self._course = {name: clone(select(starts, self._rows)) for name, starts in self.games.starts.items()}
        for name, tensor in self._state_tensors().items():
            tensor[..., lane] = th.from_numpy(np.ascontiguousarray(state[name])).to(self.device)
        return self.observations[lane].cpu().numpy()

    def _state_tensors(self) -> dict[str, th.Tensor]:
        """Return all tensors that change in a game, with the lane as the last axis."""
        parts = {f"now.{name}": each for name, each in self.now._asdict().items()}
        parts |= {f"pixels.{name}": each for name, each in self.view.pixels._asdict().items() if len(each)}
        if self.clocks is not None:
            parts |= {f"clocks.{name}": each for name, each in self.clocks.tensors._asdict().items()}
        names = ("observations", "_told", "going", "commands", "_actions", "_taken_ns", "returns", "_wall_ns")
        parts |= {name: getattr(self, name) for name in names}
        last = {name: part.movedim(0, -1) for name, part in parts.items()}
        courses = {f"course.{number}": tensor for number, tensor in enumerate(tensors(self._course))}
        return last | courses | {"place": self._position}

    def close(self) -> None:
        """Do nothing: the tensors free the device's memory."""

    # --- what the host reads --------------------------------------------------------------------

    def info(self, lane: int, outcome: Sequence[float], course: Any = None) -> Info:
        """Return the info of a lane's game from a row of `ended`, with the game's first course unless one is given."""
        first, obstacles = self.games.found(lane, int(outcome[AT.label]))
        hit = None
        if outcome[AT.touched]:
            hit = self.games.maker.surroundings.name_of(int(outcome[AT.touched]) - 1, obstacles)
        position = tuple(outcome[AT.place : AT.place + 3])
        moment = Moment(None, position, hit, int(outcome[AT.commands]), course or first)  # type: ignore[arg-type]
        times_ns = outcome[AT.wall_ns], outcome[AT.phase_ns :]
        return game_info(self.task, moment, bool(outcome[AT.success]), *times_ns)

    def positions(self) -> th.Tensor:
        """Return the vehicles' positions, NED (L, 3) float64, metres."""
        return self._position.T.clone()

    def course_of(self, lane: int) -> dict[str, Any]:
        """Return a lane's present course, as plain numbers."""
        return dict(one_course(self._course, lane))


def _stacked(value: Any) -> th.Tensor:
    """Return a new tensor (L, ...) of a course's numbers, as nested lists of tensors (L,)."""
    return th.stack([_stacked(part) for part in value], 1) if isinstance(value, (list, tuple)) else value.clone()


def _field(name: str) -> int:
    """Return the column of a field of FLIGHT_DTYPE, all of whose numbers have eight bytes."""
    fields = FLIGHT_DTYPE.fields
    assert fields is not None
    return int(fields[name][1]) // 8


_COLLISION, _CONTACT, _TICK = _field("collision_tick"), _field("contact_position"), _field("tick")
