"""Lanes of one task on one GPU: flown, observed and judged there; the host samples games ahead of time.

A round is one command of every lane. It makes the same calls of PyTorch and of the kernels each time, on tensors that
never move, so that it can be recorded as a CUDA graph. A lane whose next game has not been sampled yet waits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch as th

from uavaccel.envs.arrays import assign_where, each_of, joined, mapped, named_leaves, select, stacked
from uavaccel.envs.cuda_clocks import DeviceClocks
from uavaccel.envs.cuda_games import games_of
from uavaccel.envs.cuda_view import view_of
from uavaccel.envs.judging import COLLISION, TICK, Flown, Judge, Running
from uavaccel.envs.kernel_games import plan_of, since_ns_of, slices_of
from uavaccel.envs.simulators import CUDA, check_flyable, passes_together, profile_of
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Mediation
from uavaccel.envs.values import CONDITIONS, Info, State
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import lanes
from uavaccel.kernels.fields import DVS, STATE
from uavaccel.kernels.lanes import TOUCHED
from uavaccel.kernels.recording import recorded
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, KINEMATICS
from uavaccel.units import NS_PER_S


class Ended(NamedTuple):
    """The columns of `CudaLanes.ended` (L, columns) float64, in which the host reads the outcome of a round."""

    over: int = 0
    success: int = 1
    collision: int = 2  # index into the names of all that can be hit, -1 without a collision
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
        self.view = view_of(task, self.games, self._now_arrays, self._tick_ns)
        self.kind = self.view.kind
        self.judge = Judge(task, self.games.maker.surroundings, self._tick_ns, since_ns_of(task))
        self.clocks: DeviceClocks | None = None
        if not passes_together(task):
            of_lanes = self._now_arrays, self.view, self._advance
            self.clocks = DeviceClocks(task, count, device, self.judge.modes, *of_lanes)
        self._allocate()
        self._allocate_commands()

    def _zeros(self, kind: th.dtype, *shape: int) -> th.Tensor:
        return th.zeros((self.count, *shape), dtype=kind, device=self.device)

    def _allocate(self) -> None:
        task, zeros = self.task, self._zeros
        self._flight = self.now.state.view(th.float64)  # (L, columns): FLIGHT_DTYPE as float64
        self._ticks_of = self.now.state.view(th.int64)
        blank, space, samples = task.sensor().blank, task.frames_space(), task.frames_per_command
        self.blank = th.tensor(blank, device=self.device)
        self._pictures = self.blank.expand(samples, self.count, *blank.shape).clone()
        seen: Any = zeros(th.uint8 if blank.dtype == np.uint8 else th.float32, *space.shape)
        if task.also_state:
            seen = {"image": seen, "state": zeros(th.float32, task.told)}
        self._rows, whole, numbers = zeros(th.int64), zeros(th.int64), zeros(th.float64, KINEMATICS)
        taken_ns = zeros(th.int64, samples * task.history)
        running = Running({}, numbers, whole, numbers[:, :3], whole, whole, whole, taken_ns, seen)
        self.running: Running = mapped(th.clone, running)
        self.going, self._renewed = zeros(th.uint8), zeros(th.uint8)
        self.rewards, self.returns, self._wall_ns = zeros(th.float64), zeros(th.float64), zeros(th.int64)
        self.terminated, self.truncated, self.success = zeros(th.bool), zeros(th.bool), zeros(th.bool)
        self.ended = zeros(th.float64, AT.columns)
        self.final_observations = mapped(th.clone, seen) if self.reports else self.observations
        self.final_info: dict[str, Any] = {}

    def _allocate_commands(self) -> None:
        task, device, space = self.task, self.device, self.task.action_space()
        self.slices = slices_of(task)
        self._slice_wall_ns = th.tensor(np.cumsum(self.slices.wall_ns), device=device)
        self._ends = th.tensor(self.slices.gap_ticks + np.cumsum(self.slices.ticks), device=device)
        flown = self.slices.ticks.copy()
        flown[self.slices.acts_in] -= self.slices.late_ticks
        every = (*flown.tolist(), self.slices.gap_ticks, self.slices.late_ticks)
        legs = [th.full((self.count,), ticks, device=device) for ticks in every]
        *self._slice_ticks, self._gap_ticks, self._late_ticks = legs
        self._render_stream = kernels.SideStream()
        self._moments: list[tuple[th.Tensor, Any]] = []  # copies of the flights, rendered while the lanes fly on
        if self.kind != STATE and self.clocks is None and not task.dvs_ticks:
            states = [th.zeros_like(self.now.state) for _ in self.slices.ticks]
            self._moments = [
                (state, self._now_arrays._replace(state=kernels.shared(state, FLIGHT_DTYPE))) for state in states
            ]
        self._mediated = task.mediation != Mediation()
        if self._mediated:
            self._before, self._before_arrays = kernels.on_device(lanes.flights(self.count), device)
            self._hold_ticks = plan_of(task, np.zeros(3), self.judge.modes, self.kind != STATE).hold_ticks
        self._modes, self._goals = th.tensor(self.judge.modes, device=device), self._zeros(th.float64, 4)
        self._actions = self._zeros(getattr(th, np.dtype(space.dtype).name), *(space.shape or ()))
        self._is_flight = th.tensor([phase == "simulation" for phase in PHASES], device=device)

    @property
    def observations(self) -> Any:
        """The present observations (L, ...), or a mapping of these."""
        return self.running.observations

    # --- games ------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Sample and begin the first game of every lane."""
        if not self.games.has_games:
            self.games.sample_games()
        self.going.zero_()
        self.renew(th.ones(self.count, dtype=th.bool, device=self.device))

    def renew(self, idle: th.Tensor) -> None:
        """Begin the next games of lanes that are `idle` (L,) bool, where there are some."""
        renewed = self.games.begin(idle, self._rows)
        self._renewed.copy_(renewed.byte())
        rows = kernels.shared(self._rows)
        kernels.in_each_lane(self.kernels.begin, self._renewed, rows, self.games.arrays, self._now_arrays)
        starts = select(self.games.starts, self._rows)
        if self.games.starts.keys() != self.running.course.keys():
            self.running = self.running._replace(course=mapped(th.clone, starts))
        if self.clocks is not None:
            self.clocks.begin(self._renewed, self._rows, self.games.scales, self.games.arrays)
        first = self._first_pictures()
        if self.clocks is not None:
            self._render_stream.join()
            self.clocks.show_start(self._renewed)
        for numbers in (self._wall_ns, self.returns):
            numbers.copy_(th.where(renewed, 0, numbers))
        begun = self.judge.begun(starts, self._flight[:, 1 : 1 + KINEMATICS], first)
        assign_where(self.running, renewed, begun)
        self._render_stream.join()
        self.going.copy_(self.going | self._renewed)

    def _first_pictures(self) -> th.Tensor | None:
        """Return pictures (L, ...) of the starts of games that begin, None where they are not observed."""
        if self.kind == DVS:
            with self._render_stream.following():
                self.view.start(self._renewed)
        elif self.kind != STATE and (self.task.sees_start or (self.clocks is not None and self.clocks.guards)):
            frames = th.zeros_like(self._pictures[0])
            self.view.show(self._renewed, frames)  # for the guard, even if the task does not observe it
            return frames if self.task.sees_start else None
        return None

    # --- a round ----------------------------------------------------------------------------------

    def fly(self, actions: th.Tensor) -> None:
        """Fly one command in every lane that has a game; `actions` (L, ...) are elements of the action space."""
        self._actions.copy_(actions)
        keys = {name: values[self.now.game] for name, values in self.games.keys.items()}
        self._goals.copy_(self.judge.goals(self._actions, keys))
        states = self._fly_together() if self.clocks is None else self._fly_by_clocks(self.clocks)
        self._finish_commands(states)

    def recorded_flight(self) -> Callable[[th.Tensor], None]:
        """Return `fly` as a CUDA graph, for callers that do not record more than that."""
        given = th.zeros_like(self._actions)
        flight = recorded(lambda: self.fly(given), self.device)

        def fly(actions: th.Tensor) -> None:
            given.copy_(actions)
            flight()

        return fly

    def charge(self, flown: th.Tensor, duration_s: float, phase: str) -> None:
        """In timing `virtual`, charge the lanes in `flown` (L,) uint8 for their agent's work; with ADSC they fly on."""
        if self.clocks is not None and self.task.timing == "virtual":
            self.clocks.charge(flown.long() * round(duration_s * NS_PER_S), phase)

    def _fly_together(self) -> list[th.Tensor]:
        """Fly the same ticks in all lanes, and return the samples' states (L, KINEMATICS).

        The last pictures may still be rendered on the stream for it.
        """
        states: list[th.Tensor] = []
        if self._mediated:
            self._fly_gap()
        for sample, ticks in enumerate(self._slice_ticks):
            if sample == self.slices.acts_in:
                self._begin_to_act()
            if self.kind == DVS and self.task.dvs_ticks:
                self._fly_recording_events(sample, self.task.dvs_ticks)
            else:
                self._advance(self.going, ticks)
                if self.kind != STATE:  # what renders the lanes' present images while they fly on
                    state, now = self._moments[sample]
                    state.copy_(self.now.state)
                    with self._render_stream.following():
                        self.view.render(self.going, self._pictures[sample], now=now)
            states.append(self._flight[:, 1 : 1 + KINEMATICS].clone())
        return states

    def _fly_gap(self) -> None:
        """Fly on before a command, and begin it as the task's mediation says."""
        start_speed = self.task.mediation.start_speed
        if start_speed is not None:
            self._before.state.copy_(self.now.state)
            self._before.body.copy_(self.now.body)
        self._advance(self.going, self._gap_ticks)
        if start_speed is not None:
            flights = self._before_arrays, start_speed, self.games.arrays, self._now_arrays
            kernels.in_each_lane(self.kernels.resume, self.going, *flights)

    def _begin_to_act(self) -> None:
        """Let the commands' goals act; only a gap lets position hold take over after them."""
        goals = kernels.shared(self._goals), kernels.shared(self._modes), self._now_arrays
        if not self._mediated:
            kernels.in_each_lane(self.kernels.command, self.going, *goals)
            return
        self._advance(self.going, self._late_ticks)
        kernels.in_each_lane(self.kernels.take, self.going, self._hold_ticks, *goals)

    def _fly_recording_events(self, sample: int, every: int) -> None:
        """Fly to a sample with an event camera that records a frame `every` so many ticks."""
        left = self._slice_ticks[sample].clone()
        at_samples = not (self.slices.ticks % every).any()  # whose frame is the sample's own
        for _ in range(-(-int(self.slices.ticks[sample]) // every) - at_samples):  # as many as there can be before it
            to_frame = every - self._ticks_of[:, TICK] % every
            recording = self.going * (to_frame < left)
            self._advance(recording, to_frame)
            left -= to_frame * recording
            self.view.render(recording, self._pictures[sample], take=False)
        self._advance(self.going, left)
        self.view.render(self.going, self._pictures[sample])

    def _fly_by_clocks(self, clocks: DeviceClocks) -> list[th.Tensor]:
        """Fly each lane to the samples that its own clock times, and return the states as `_fly_together`."""
        self._pictures.copy_(self.blank.expand_as(self._pictures))
        clocks.issue(self.going, self._goals)
        states: list[th.Tensor] = []
        for sample in range(len(self.slices.ticks)):
            clocks.reach(self.going, sample)
            if self.kind != STATE:
                clocks.render(self._pictures[sample])
            states.append(self._flight[:, 1 : 1 + KINEMATICS].clone())
            clocks.leave(sample)
        return states

    def _advance(self, which: th.Tensor, ticks: th.Tensor) -> None:
        """Fly the lanes selected by `which` (L,) uint8 for `ticks` (L,) int64."""
        flown = kernels.shared(ticks), self.games.arrays, self._now_arrays, self.view.hull, self._threads
        grid = kernels.grid(self.count * self._threads, kernels.FLYING_THREADS)
        self.kernels.fly[grid](kernels.shared(which), *flown)

    # --- after it ---------------------------------------------------------------------------------

    def _finish_commands(self, states: Sequence[th.Tensor]) -> None:
        """Judge the commands, update the games, and with `renews` begin the next ones.

        All that pictures do not decide is computed while the last of them are rendered.
        """
        going, counts = self.going.bool(), self.games.rows.counts[self.now.game].long()
        solids = self.now.watch[:, TOUCHED]
        numbers, position_m, collision = self.judge.end(self._flight, self._ticks_of, solids, counts)
        tick, ticks, taken = self._times(going)
        pictures = self._pictures.transpose(0, 1)
        flown = Flown(numbers, tick, position_m, collision, ticks, taken, th.stack([*states], 1), pictures)
        after, judged = self.judge.after(self.running, flown, self._actions)
        assign_where(_without_observations(self.running), going, _without_observations(after))
        self.rewards.copy_(th.where(going, judged.reward, 0.0))
        self.success.copy_(judged.success & going)
        self.terminated.copy_(judged.terminated & going)
        self.truncated.copy_(judged.truncated & going)
        self.returns += self.rewards
        over = self.terminated | self.truncated
        self._write_outcomes(over)
        if self.reports:
            self.final_info = self._report()
        self._render_stream.join()
        assign_where(self.observations, going, self.judge.observe(after, flown))
        if self.reports:
            mapped(th.Tensor.copy_, self.final_observations, self.observations)
        self.going.copy_((going & ~over).byte())
        if self.renews:
            self.renew(self.going == 0)

    def _times(self, going: th.Tensor) -> tuple[th.Tensor, th.Tensor, th.Tensor]:
        """Update wall times, and return the ticks (L,) at the commands' ends and (L, S) of their samples, and how many
        of these (L,) precede a collision."""
        if self.clocks is not None:
            self._wall_ns.copy_(self.clocks.wall_ns)
            return self._ticks_of[:, TICK], self.clocks.tensors.ticks, self.clocks.tensors.taken
        ticks = self.running.commands[:, None] * self._ends[-1] + self._ends
        taken = (ticks <= self._ticks_of[:, COLLISION, None]).sum(1)
        last = taken.clamp(max=len(self._ends) - 1)
        self._wall_ns += th.where(going, self._slice_wall_ns[last], 0)
        return ticks.gather(1, last[:, None])[:, 0], ticks, taken

    @property
    def _phases_ns(self) -> th.Tensor:
        """Wall time (L, phases) spent in each of PHASES; where all fly together, nothing but the flight takes any."""
        if self.clocks is not None:
            return self.clocks.phase_ns
        return self._wall_ns[:, None] * self._is_flight

    def _report(self) -> dict[str, Any]:
        """Return the infos of all lanes' present games as tensors (L, ...)."""
        infos = self.judge.infos(self.running, self.success, self._wall_ns, self._phases_ns)
        conditions = {name: values[self.now.game] for name, values in self.games.conditions.items()}
        return dict(_cloned(infos | ({CONDITIONS: conditions} if conditions else {}), self.rewards))

    def _write_outcomes(self, over: th.Tensor) -> None:
        """Write the outcome of the round to `ended`, for the host."""
        outcome, games = self.ended, self.running
        outcome[:, AT.over], outcome[:, AT.success] = over.double(), self.success.double()
        outcome[:, AT.collision], outcome[:, AT.commands] = games.collision.double(), games.commands.double()
        outcome[:, AT.place : AT.place + 3] = games.position_m
        outcome[:, AT.wall_ns], outcome[:, AT.reward] = self._wall_ns.double(), self.returns
        outcome[:, AT.label], outcome[:, AT.phase_ns :] = self.games.label.double(), self._phases_ns.double()

    # --- saving -----------------------------------------------------------------------------------

    @property
    def num_envs(self) -> int:
        return self.count

    def get_states(self) -> list[State]:
        """Return each lane's running game, and what its next ones are sampled from, for np.savez."""
        flown = {name: tensor.cpu().numpy() for name, tensor in self._state_tensors().items()}
        return [
            sampled | {name: array[..., lane] for name, array in flown.items()}
            for lane, sampled in enumerate(self.games.get_states())
        ]

    def set_states(self, states: Sequence[Mapping[str, Any]]) -> Any:
        """Restore states that `get_states` returned, and return the lanes' observations as arrays of the host."""
        self.games.set_states(states)
        if not self.running.course:
            self.running = self.running._replace(course=mapped(th.clone, select(self.games.starts, self._rows)))
        for name, tensor in self._state_tensors().items():
            tensor.copy_(th.from_numpy(np.stack([state[name] for state in states], axis=-1)))
        return mapped(lambda seen: seen.cpu().numpy(), self.observations)

    def _state_tensors(self) -> dict[str, th.Tensor]:
        """Return all tensors that change in a game, with the lane as the last axis."""
        parts = {f"now.{name}": each for name, each in self.now._asdict().items()}
        parts |= {f"pixels.{name}": each for name, each in self.view.pixels._asdict().items() if len(each)}
        if self.clocks is not None:
            parts |= {f"clocks.{name}": each for name, each in self.clocks.tensors._asdict().items()}
        parts |= {name: getattr(self, name) for name in ("going", "returns", "_wall_ns")}
        parts |= named_leaves(self.running, "running")
        return {name: part.movedim(0, -1) for name, part in parts.items()}

    def close(self) -> None:
        """Do nothing: the tensors free the device's memory."""

    # --- what the host reads --------------------------------------------------------------------

    def info(self, lane: int, outcome: Sequence[float]) -> Info:
        """Return the info of a lane's game from a row of `ended`, with the game's first course."""
        found, row = self.games.found(lane, int(outcome[AT.label])), np.array([outcome])
        whole = row.astype(np.int64)
        place, collision, commands = row[:, AT.place : AT.place + 3], whole[:, AT.collision], whole[:, AT.commands]
        numbers = np.zeros((1, KINEMATICS))
        games = Running(
            stacked([found.own_course]), numbers, commands, place, collision, commands, commands, commands, numbers
        )
        times_ns = whole[:, AT.wall_ns], row[:, AT.phase_ns :]
        info = each_of(self.judge.infos(games, row[:, AT.success] > 0.0, *times_ns), 1)[0]
        info["collision"] = None if collision[0] < 0 else self.judge.objects[collision[0]]
        conditions = {name: found.course[name] for name in (CONDITIONS,) if name in found.course}
        return {**info, **conditions}


def _without_observations(games: Running) -> Running:
    return games._replace(observations=())


def _cloned(value: Any, like: th.Tensor) -> Any:
    """Return new tensors (L, ...) of numbers, and of nested lists of them, in nested mappings."""
    if isinstance(value, dict):
        return {name: _cloned(each, like) for name, each in value.items()}
    return joined(value, like).clone()
