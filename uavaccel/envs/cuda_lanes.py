"""Lanes of one task on one GPU: flown, seen and judged there, in tensors; games are drawn by the host, ahead of time.

A round is a command of every lane: the same calls of PyTorch and of the kernels each time, on tensors that stay where
they are, so that it can be recorded as a CUDA graph. A lane whose next game has not been drawn yet waits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch as th

from uavaccel.envs.context_planes import age_levels
from uavaccel.envs.cuda_clocks import DeviceClocks
from uavaccel.envs.cuda_courses import copied, put, taken, tensors
from uavaccel.envs.cuda_games import GamesAhead
from uavaccel.envs.cuda_view import LaneView
from uavaccel.envs.flyable import CUDA, check_flyable, passes_together, profile_of
from uavaccel.envs.kernel_games import one_course, step_result
from uavaccel.envs.kernel_plan import slices_of
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Moment, Moments
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import lanes
from uavaccel.kernels.fields import COLUMNS, DVS, STATE
from uavaccel.kernels.flight import TOUCHED
from uavaccel.kinematics import Kinematics
from uavaccel.sim.saved import State
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, NEVER
from uavaccel.units import NS_PER_S
from uavaccel.vision.observation import BLOCK_SIDE


class Ended(NamedTuple):
    """What is known of a round's games, for the host: (L, ...) float64, in this order of columns."""

    over: int = 0
    success: int = 1
    touched: int = 2  # 0, or one more than the number of the solid
    commands: int = 3
    place: int = 4  # three
    wall_ns: int = 7
    reward: int = 8
    game: int = 9
    phase_ns: int = 10  # of PHASES each
    columns: int = 10 + len(PHASES)


AT = Ended()


class CudaLanes:
    """`count` lanes of a task on `device`. Raises UserError for what is not flown there.

    `observations` (L, ...) are what the lanes show now; after a round `rewards`, `terminated`, `truncated`, and in
    `going` who will fly the next one. Unless it `renews`, a lane whose game is over waits. `games` are the next ones.
    """

    def __init__(self, task: Any, count: int, device: th.device, renews: bool = True) -> None:
        check_flyable(task, count, CUDA)
        self.task, self.count, self.device, self.renews = task, count, device, renews
        self.games = GamesAhead(task, count, device)
        self.kernels = kernels.compiled(self.games.maker.usual)
        self.now, self._now_there = kernels.on_device(lanes.flights(count), device)
        self._tick_ns = profile_of(task).tick_ns
        self._threads = kernels.threads_a_lane(count, device)
        self.view = LaneView(
            task, self.games.maker, count, device, self.games.there, self._now_there, self._tick_ns
        )
        self.kind = self.view.kind
        hull = self.games.maker.surroundings.hull
        self.clocks = (
            None
            if passes_together(task)
            else DeviceClocks(task, count, device, hull, self._now_there, self.view, self._advance)
        )
        self.action_space = task.action_space()
        self._allocate()

    def _allocate(self) -> None:
        count, task, device = self.count, self.task, self.device
        self._flight = self.now.state.view(th.float64)  # (L, numbers) of FLIGHT_DTYPE, all of eight bytes
        self._ticks_of = self.now.state.view(th.int64)
        blank, space, samples = task.sensor().blank, task.observation_space(), task.frames_per_command
        kind = th.uint8 if blank.dtype == np.uint8 else th.float32
        self.blank = th.tensor(blank, device=device)
        self.frame_shape = blank.shape
        self._frames = th.zeros((samples, count, *blank.shape), dtype=kind, device=device)
        self.observations = th.zeros((count, *space.shape), dtype=kind, device=device)
        self.going, self._renewed = (th.zeros(count, dtype=th.uint8, device=device) for _ in range(2))
        self.commands, self._rows, self._actions = (
            th.zeros(count, dtype=th.int64, device=device) for _ in range(3)
        )
        self._place = th.zeros((3, count), dtype=th.float64, device=device)
        self.rewards, self.returns = (th.zeros(count, dtype=th.float64, device=device) for _ in range(2))
        self.terminated, self.truncated, self.success = (
            th.zeros(count, dtype=th.bool, device=device) for _ in range(3)
        )
        self.ended = th.zeros((count, AT.columns), dtype=th.float64, device=device)
        self._course: dict[str, Any] = {}
        self._allocate_commands()

    def _allocate_commands(self) -> None:
        count, task, device = self.count, self.task, self.device
        self.slices, wall_ns = slices_of(task)
        self._slice_wall_ns = th.tensor(np.cumsum(wall_ns), device=device)
        self._ends = th.tensor(np.cumsum(self.slices), device=device)
        self._slice_ticks = [th.full((count,), int(ticks), device=device) for ticks in self.slices]
        self._eyes, seen_apart = kernels.SideStream(), self.kind != STATE and self.clocks is None
        self._moments = [self._moment() for _ in self.slices if seen_apart and not task.dvs_ticks]
        self._directions = th.zeros((count, 3), dtype=th.float64, device=device)
        table = task.directions
        self._table = None if table is None else th.tensor(table, dtype=th.float64, device=device)
        frames = len(self.slices) * task.history
        self._taken_ns = th.zeros((count, frames), dtype=th.int64, device=device)
        self._wall_ns, self._present_ns = (th.zeros(count, dtype=th.int64, device=device) for _ in range(2))
        told = task.context_planes()
        self._shown = None if told is None else th.tensor(told.actions_shown(), device=device)
        self._rows_frames = None if told is None else th.tensor(told.rows_frames(), device=device)

    def _moment(self) -> tuple[th.Tensor, Any]:
        """Room for where the lanes are at a sample, to be seen while they fly on: tensor, and all of it for kernels."""
        state = th.zeros_like(self.now.state)
        return state, self._now_there._replace(state=kernels.shared(state, FLIGHT_DTYPE))

    # --- games ------------------------------------------------------------------------------------

    def seed(self, seeds: int | Sequence[int | None]) -> None:
        """Draw all games anew, those of lane i from the i-th seed, or from the first one plus i."""
        self.games.seed(seeds)

    @property
    def begun_yet(self) -> bool:
        """Whether games are under way."""
        return self.games.any_drawn

    def begin(self) -> None:
        """Draw and begin the first games everywhere."""
        if not self.begun_yet:
            self.games.draw_one_each()
        self.going.zero_()
        self.renew(th.ones(self.count, dtype=th.bool, device=self.device))

    def renew(self, idle: th.Tensor) -> None:
        """Begin the next games of lanes that are `idle` (L,) bool, where there are some."""
        renewed = self.games.begin(idle, self._rows)
        self._renewed.copy_(renewed.byte())
        self._launch("begin", self._renewed, kernels.shared(self._rows), self.games.there, self._now_there)
        for name, starts in self.games.starts.items():
            if name not in self._course:
                self._course[name] = copied(taken(starts, self._rows))
            put(self._course[name], taken(starts, self._rows), renewed)
        if self.clocks is not None:
            self.clocks.begin(self._renewed, self._rows, self.games.scales, self.games.there)
        first = self._first_frames()
        if self.clocks is not None:
            self.clocks.show_start(self._renewed)
        for numbers in (self.commands, self._wall_ns, self.returns):
            numbers.copy_(th.where(renewed, 0, numbers))
        self._taken_ns.copy_(th.where(renewed[:, None], 0, self._taken_ns))
        self._place.copy_(th.where(renewed, self._flight[:, 1:4].T, self._place))
        self._show_first(renewed, first)
        self.going.copy_(self.going | self._renewed)

    def _first_frames(self) -> th.Tensor:
        """What is seen of a start (L, ...)."""
        blank = self.blank.expand(self.count, *self.frame_shape)
        if self.kind == DVS:
            self.view.start(self._renewed)
        elif self.kind != STATE and (
            self.task.sees_start or (self.clocks is not None and self.clocks.guards)
        ):
            frames = th.zeros_like(self._frames[0])
            self.view.show(self._renewed, frames)  # the guard looks at it, if the task does not
            return frames if self.task.sees_start else blank
        elif self.kind == STATE and self.task.sees_start and not self.task.blank_images:
            return self._features(self._flight[:, 1:14])
        return blank

    def _show_first(self, renewed: th.Tensor, first: th.Tensor) -> None:
        planes = [th.cat([first] * self._taken_ns.shape[1], 1)]
        if self._shown is not None:
            ages = age_levels(th.zeros_like(self._taken_ns))
            planes.append(self._planes(self._shown[-1:].expand(self.count, -1, -1), ages))
        over_rows = (slice(None), *(None,) * (self.observations.ndim - 1))
        self.observations.copy_(th.where(renewed[over_rows], th.cat(planes, 1), self.observations))

    # --- a round ----------------------------------------------------------------------------------

    def fly(self, actions: th.Tensor) -> None:
        """A command of every lane that has a game: (L,) numbers of actions, or (L, 3) directions."""
        self._directions.copy_(actions if self._table is None else self._table[actions])
        if self._table is not None:
            self._actions.copy_(actions)
        states = self._fly_together() if self.clocks is None else self._fly_by_clocks(self.clocks)
        self._land(states)

    def recorded_flight(self) -> Callable[[th.Tensor], None]:
        """`fly` as a CUDA graph, for whoever does not record more than that."""
        directions = self._directions if self._table is None else self._actions
        given = th.zeros_like(directions)
        flight = kernels.Recorded(lambda: self.fly(given))

        def fly(actions: th.Tensor) -> None:
            given.copy_(actions)
            flight()

        return fly

    def charge(self, flown: th.Tensor, duration_s: float, phase: str) -> None:
        """Work of an agent's between two commands of the lanes (L,) uint8: in `virtual` ADSC flies on meanwhile."""
        if self.clocks is not None and self.task.timing == "virtual":
            self.clocks.charge(flown, duration_s, phase)

    def _fly_together(self) -> list[th.Tensor]:
        """The same ticks in all lanes; the states (L, 13) of the samples."""
        self._launch(
            "command", self.going, kernels.shared(self._directions), self.games.there, self._now_there
        )
        states: list[th.Tensor] = []
        for sample, ticks in enumerate(self._slice_ticks):
            if self.kind == DVS and self.task.dvs_ticks:
                self._fly_looking_on(sample, self.task.dvs_ticks)
                continue
            self._advance(self.going, ticks)
            if self.kind != STATE:
                self._look_apart(sample)
            else:
                states.append(self._flight[:, 1:14].clone())
        self._eyes.join()
        return states

    def _look_apart(self, sample: int) -> None:
        """See where the lanes are now, while they fly on."""
        state, now = self._moments[sample]
        state.copy_(self.now.state)
        with self._eyes.following():
            self.view.look(self.going, self._frames[sample], now=now)

    def _fly_looking_on(self, sample: int, every: int) -> None:
        """To a sample, of an event camera that sees a frame each `every` ticks on the way."""
        total, flown = int(self.slices[sample]), 0
        before = int(self.slices[:sample].sum())
        while flown < total:
            due = min(every - (before + flown) % every, total - flown)
            self._advance(self.going, th.full_like(self._slice_ticks[sample], due))
            flown += due
            if (before + flown) % every == 0 or flown == total:
                self.view.look(self.going, self._frames[sample], take=flown == total)

    def _fly_by_clocks(self, clocks: DeviceClocks) -> list[th.Tensor]:
        """Each lane to where its own clock says that its samples are."""
        self._frames.copy_(self.blank.expand_as(self._frames))
        clocks.issue(self.going, self._directions, self.games.there)
        states: list[th.Tensor] = []
        for sample in range(len(self.slices)):
            clocks.reach(self.going, sample)
            if self.kind != STATE:
                clocks.look(self._frames[sample])
            else:
                states.append(self._flight[:, 1:14].clone())
            clocks.leave(sample)
        return states

    def _advance(self, which: th.Tensor, ticks: th.Tensor) -> None:
        """Let lanes (L,) uint8 fly so many ticks (L,) int64."""
        grid = kernels.grid(self.count * self._threads, kernels.FLYING_THREADS)
        self.kernels.fly[(*grid, kernels.stream())](
            kernels.shared(which),
            kernels.shared(ticks),
            self.games.there,
            self._now_there,
            self.view.plan.hull,
            self._threads,
        )

    def _launch(self, name: str, which: th.Tensor, *arguments: Any) -> None:
        """Run a kernel of one thread per lane."""
        grid = kernels.grid(self.count, kernels.FLYING_THREADS)
        getattr(self.kernels, name)[(*grid, kernels.stream())](kernels.shared(which), *arguments)

    # --- after it ---------------------------------------------------------------------------------

    def _land(self, states: Sequence[th.Tensor]) -> None:
        """Judge the command, show what was seen of it, and begin new games where one is over."""
        going = self.going.bool()
        before = Moments(None, list(self._place.clone()), None, None, copied(self._course))
        self.commands += going
        hit = self._ticks_of[:, _COLLISION]
        touched = hit != int(NEVER)
        contact = self._flight[:, _CONTACT : _CONTACT + 3]
        self._place.copy_(th.where(touched, contact.T, self._flight[:, 1:4].T))
        now = Moments(None, list(self._place), touched, self.commands, copied(self._course))
        th.set_default_dtype(th.float64)  # of a number times a flag
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
        for name, value in judged.course.items():  # frames were of the course before
            put(self._course[name], value, going)
        self._show()
        over = self.terminated | self.truncated
        self._tell(over, touched)
        self.going.copy_((going & ~over).byte())
        if self.renews:
            self.renew(self.going == 0)

    def _note_times(self, hit: th.Tensor, touched: th.Tensor, going: th.Tensor) -> th.Tensor:
        """Which samples (L, S) were seen before a touch; wall time and the frames' times follow from them."""
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

    def _features(self, numbers: th.Tensor) -> th.Tensor:
        """What observation "state" shows (L, ...) of states (L, 13)."""
        columns = list(numbers.T)
        state = Kinematics(0, columns[:3], columns[3:7], columns[7:10], columns[10:13])  # type: ignore[arg-type]
        fields = th.stack([*self.task.fields(state, self._course)], 1).float()
        return fields.reshape(self.count, *self.frame_shape)

    def _show(self) -> None:
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
        told, solids = self.ended, self.now.watch[:, TOUCHED].double()
        told[:, AT.over], told[:, AT.success] = over.double(), self.success.double()
        told[:, AT.touched] = th.where(touched, solids + 1.0, 0.0)
        told[:, AT.commands], told[:, AT.place : AT.place + 3] = self.commands.double(), self._place.T
        told[:, AT.wall_ns], told[:, AT.reward] = self._wall_ns.double(), self.returns
        told[:, AT.game] = (self.games.begun - 1).double()
        if self.clocks is None:
            told[:, AT.phase_ns + PHASES.index("simulation")] = self._wall_ns.double()
        else:
            told[:, AT.phase_ns :] = self.clocks.phase_ns.double()

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
        flown = {name: tensor[..., lane].cpu().numpy() for name, tensor in self._lanes_last().items()}
        return self.games.get_state(lane) | flown

    def set_state(self, lane: int, state: Mapping[str, Any]) -> Any:
        """Go on with what `get_state` gave; the last observation."""
        self.games.set_state(lane, state)
        if not self._course:
            self._course = {
                name: copied(taken(starts, self._rows)) for name, starts in self.games.starts.items()
            }
        for name, tensor in self._lanes_last().items():
            tensor[..., lane] = th.from_numpy(np.ascontiguousarray(state[name])).to(self.device)
        return self.observations[lane].cpu().numpy()

    def _lanes_last(self) -> dict[str, th.Tensor]:
        """All that changes while games are flown, the lane as the last axis."""
        parts = {f"now.{name}": each for name, each in self.now._asdict().items()}
        parts |= {f"pixels.{name}": each for name, each in self.view.pixels._asdict().items() if len(each)}
        if self.clocks is not None:
            parts |= {f"clocks.{name}": each for name, each in self.clocks.tensors._asdict().items()}
        names = ("observations", "going", "commands", "_actions", "_taken_ns", "returns", "_wall_ns")
        parts |= {name: getattr(self, name) for name in names}
        last = {name: each.movedim(0, -1) for name, each in parts.items()}
        courses = {f"course.{number}": each for number, each in enumerate(tensors(self._course))}
        return last | courses | {"place": self._place}

    def close(self) -> None:
        """The device's memory goes with the tensors."""

    # --- what the host is told --------------------------------------------------------------------

    def info(self, lane: int, told: Sequence[float], course: Any = None) -> dict[str, Any]:
        """The info of a lane's game, of a row of `ended`."""
        drawn = self.games.drawn(lane, int(told[AT.game]))
        hit = None
        if told[AT.touched]:
            hit = self.games.maker.name_of(int(told[AT.touched]) - 1, drawn.layout)
        place = tuple(told[AT.place : AT.place + 3])
        moment = Moment(None, place, hit, int(told[AT.commands]), course or drawn.course)  # type: ignore[arg-type]
        phases_s = [spent_ns / NS_PER_S for spent_ns in told[AT.phase_ns :]]
        return {
            "is_success": bool(told[AT.success]),
            "position_m": list(place),
            "collision": hit,
            "commands": moment.commands,
            "wall_s": told[AT.wall_ns] / NS_PER_S,
            "phase_s": dict(zip(PHASES, phases_s, strict=True)),
            **self.task.info(moment),
        }

    def positions(self) -> th.Tensor:
        """Where the vehicles are: NED (L, 3) float64."""
        return self._place.T.clone()

    def course_of(self, lane: int) -> dict[str, Any]:
        """A lane's present course, as plain numbers."""
        return dict(one_course(self._course, lane))


def _field(name: str) -> int:
    """The column of a field of FLIGHT_DTYPE among its numbers."""
    fields = FLIGHT_DTYPE.fields
    assert fields is not None
    return int(fields[name][1]) // 8


_COLLISION, _CONTACT, _TICK = _field("collision_tick"), _field("contact_position"), _field("tick")
