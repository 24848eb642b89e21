"""Many environments of one task over arrays, in threads of this process: `simulator="kernels"`, `device="cpu"`.

They fly as in the exact simulator, and observe images of the kernels instead of OpenGL's (docs/kernels.md).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.config import MOST_PROCESSES
from uavaccel.envs.arrays import assign, each_of, mapped, named_leaves, select
from uavaccel.envs.batch import Arguments, GameOptions, Seeds, Slots, TurnBatch, set_up
from uavaccel.envs.checks import actions_of, whole_number
from uavaccel.envs.environment_process import BatchError, game_over, still_flying
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.judging import Flown, Judge, Running
from uavaccel.envs.kernel_games import Drawn, GameMaker, keys_of, plan_of, since_ns_of
from uavaccel.envs.sensors import NO_ACTION, blank_frame
from uavaccel.envs.simulators import CPU, check_flyable, kind_of, profile_of
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Task
from uavaccel.envs.values import CONDITIONS, Actions, Answer, Frame, Info, Observation, SavedState, State, Steps
from uavaccel.errors import UserError
from uavaccel.kernels import cpu, events, timeline
from uavaccel.kernels import lanes as rows
from uavaccel.kernels.fields import DVS, STATE
from uavaccel.kernels.lanes import TOUCHED
from uavaccel.machine import usable_cores
from uavaccel.sim.vehicle.quadrotor import KINEMATICS
from uavaccel.units import NS_PER_S, plain
from uavaccel.vision.dvs_sensor import sample_pixels


class KernelBatch(TurnBatch):
    """`num_envs` environments of `environment`, a subclass of FlightEnv, with its keywords.

    They fly in `threads` threads, by default one per core. Raises UserError for keywords that do not fit, and for tasks
    that only the exact simulator flies.
    """

    def __init__(
        self,
        environment: type[FlightEnv[Any]],
        num_envs: int = 1,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **keys: object,
    ) -> None:
        self.task: Task = set_up(self, environment, num_envs, autoreset_mode, keys)
        check_flyable(self.task, num_envs, CPU)
        if threads is not None:
            whole_number("threads", threads, MOST_PROCESSES)
        self.render_mode = None
        self._same_step = self.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        self._next_step = self.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        self._maker = GameMaker(self.task)
        around = self._maker.surroundings
        self._judge = Judge(self.task, around, profile_of(self.task).tick_ns, since_ns_of(self.task))
        self._plan = plan_of(self.task, around.hull, self._judge.modes, kind_of(self.task) != STATE)
        self._allocate()
        self._threads = min(usable_cores() if threads is None else threads, num_envs)
        self._pool = ThreadPoolExecutor(self._threads)
        self._flying: dict[tuple[int, ...], list[Future[None]]] = {}  # by the lanes of a command
        self._clock = MonotonicClock()
        self._generators: dict[int, np.random.Generator] = {}
        self._games = [0] * num_envs
        self._drawn: list[Drawn] = []
        self._running: Running
        # States of the generators before the running games were sampled, and the options that these were sampled with.
        self._sampled_by: list[tuple[Mapping[str, object], Mapping[str, object] | None]] = [({}, None)] * num_envs

    def _allocate(self) -> None:
        count, task = self.num_envs, self.task
        self._rows = self._maker.rows(count)
        self._now = rows.flights(count)
        blank = task.sensor().blank
        kind, size = kind_of(task), task.picture_size[::-1]
        draws, frame = sample_pixels(task.dvs_parameters, size, task.dvs_seed), blank_frame("dvs", task.picture_size)
        pixels = events.pixels_of(count if kind == DVS else 0, task.dvs_parameters, size, frame.shape[1:])
        self._view = cpu.View(kind, size, self._maker.looks, events.sensor_of(draws), pixels)
        samples = task.frames_per_command
        self._blank = blank
        self._frames = np.empty((count, samples, *blank.shape), blank.dtype)
        drawn = self._frames if blank.dtype == np.uint8 else np.empty((0, samples, 1, 0, 0), np.uint8)
        self._pictures = drawn  # always uint8: machine code is compiled for types
        self._samples = np.zeros((count, samples, KINEMATICS))
        self._goals = np.zeros((count, 4))
        self._asked = np.full(count, NO_ACTION)  # discrete actions of the commands in flight
        self._clocks = timeline.clocks(count, samples)
        self._host_s = np.zeros(count)
        self._over = np.zeros(count, bool)

    def close_extras(self, **_: object) -> None:
        """End the threads."""
        if hasattr(self, "_pool"):
            self._pool.shutdown()

    # --- learners ---------------------------------------------------------------------------------

    def reset_each(self, seeds: Seeds, options: GameOptions, slots: Slots = None) -> list[Info]:
        """As `TurnBatch` has it, the first time of all. Raises BatchError once closed."""
        which = self._standing(slots).tolist()
        for lane, seed in zip(which, seeds, strict=True):
            if seed is not None or lane not in self._generators:
                self._generators[lane] = seeding.np_random(seed)[0]
            self._games[lane] = self._games[lane] + 1 if seed is None else 1
        drawn = {lane: self._draw(lane, own) for lane, own in zip(which, options, strict=True)}
        self._drawn = [drawn[lane] if lane in drawn else self._drawn[lane] for lane in range(self.num_envs)]
        if len(which) == self.num_envs:
            self._running = self._blank_games()
        return self._begin(np.array(which))

    def _blank_games(self) -> Running:
        """Return arrays for the games in `_drawn`."""
        course = self._maker.courses(self._drawn)
        games: Running = mapped(np.copy, self._judge.begun(course, np.zeros((self.num_envs, KINEMATICS)), None))
        return games

    def step_async(self, actions: Actions, slots: Slots = None) -> None:
        """As `TurnBatch` has it. Raises UserError before the first reset; BatchError once closed."""
        which = self._standing(slots)
        if not self._drawn:
            raise UserError("reset the environments before their first step")
        if not (self._same_step or self._next_step) and self._over[which].any():
            raise game_over(int(which[self._over[which]][0]))
        given = np.array(actions_of(self.single_action_space, actions, len(which)))
        if self._judge.discrete:
            self._asked[which] = given
        self._goals[which] = self._judge.goals(given, keys_of(self.task, [self._drawn[lane] for lane in which]))
        self._frames[which] = self._blank
        self._begun_ns = self._clock.now_ns()
        self._flying[tuple(which.tolist())] = self._run(cpu.FLY, which[~self._over[which]], self._pictures)

    def step_wait(self, slots: Slots = None) -> Steps:
        """As `TurnBatch` has it. Raises UserError where no command was started."""
        which = self._all(slots)
        flying = self._flying.pop(tuple(which.tolist()), None)
        if flying is None:
            raise UserError("no command was started in these environments: step_async comes before step_wait")
        for part in flying:
            part.result()
        self._host_s[which] += (self._clock.now_ns() - self._begun_ns) / NS_PER_S / len(which)
        going = which[~self._over[which]]
        idle = which[self._over[which]]
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool)
        infos: dict[int, Info] = {}
        if len(going):
            flown = self._flown(going)
            games, judged = self._judge.after(select(self._running, going), flown, self._asked[going])
            games = games._replace(observations=self._judge.observe(games, flown))
            assign(self._running, going, games)
            rewards[going], terminated[going], truncated[going] = judged.reward, judged.terminated, judged.truncated
            infos = dict(zip(going.tolist(), self._infos(going, games, judged.success), strict=True))
        self._autoreset(idle, going[terminated[going] | truncated[going]], infos)
        seen = select(self._running.observations, which)
        return seen, rewards[which], terminated[which], truncated[which], [infos[int(lane)] for lane in which]

    def _autoreset(self, idle: NDArray[np.int64], ended: NDArray[np.int64], infos: dict[int, Info]) -> None:
        """Begin games as `autoreset_mode` says, in lanes that waited or have just ended, and update their infos."""
        if len(idle):
            infos.update(zip(idle.tolist(), self._renew(idle), strict=True))
        if self._same_step and len(ended):
            last = select(self._running.observations, ended)
            for place, (lane, info) in enumerate(zip(ended.tolist(), self._renew(ended), strict=True)):
                infos[lane] = info | {"final_info": infos[lane], "final_obs": select(last, place)}
        else:
            self._over[ended] = True

    def charge(self, lane: int, duration_s: float, phase: str = "inference") -> None:
        """In timing `virtual`, charge a lane for its agent's work since the last command; with ADSC it flies on."""
        if self.task.timing == "virtual" and self._drawn:
            duration_ns = round(duration_s * NS_PER_S)
            timeline.charge.py_func(self._clocks.row[lane], duration_ns, PHASES.index(phase))

    def charge_each(self, durations_ns: NDArray[np.int64]) -> None:
        """As `TurnBatch` has it, all at once."""
        if self.task.timing == "virtual" and self._drawn:
            every_ns: Any = durations_ns  # where the function takes one lane's
            timeline.charge.py_func(self._clocks.row.T, every_ns, PHASES.index("inference"))

    def observations(self) -> Observation:
        """Return the present observation of every environment."""
        return mapped(np.copy, self._running.observations)

    def call_each(self, name: str, arguments: Arguments, slots: Slots = None) -> list[Answer]:
        """Call `charge`, `get_state` or `set_state` of the environments `lanes`, by default all. Raises UserError."""
        methods = {"charge": self.charge, "get_state": self._get_state, "set_state": self._set_state}
        if name not in methods:
            raise UserError(f"simulator = kernels: {name} is not available; use simulator = mujoco")
        which = self._standing(slots).tolist()
        return [methods[name](lane, *argument) for lane, argument in zip(which, arguments, strict=True)]  # type: ignore[operator]

    # --- saving -----------------------------------------------------------------------------------

    def _get_state(self, lane: int) -> State:
        """Return a lane's running game for np.savez: another batch of this task continues it to the same bytes."""
        before, options = self._sampled_by[lane]
        texts = {name: json.dumps(each, default=plain) for name, each in (("drawn_by", before), ("options", options))}
        arrays = {name: array[lane].copy() for name, array in self._state_arrays().items()}
        return {**texts, "games": self._games[lane], **arrays}

    def _set_state(self, lane: int, state: SavedState) -> Observation:
        """Restore a state that `_get_state` returned, and return the lane's observation."""
        generator = self._generators[lane] = seeding.np_random(0)[0]
        generator.bit_generator.state = json.loads(str(state["drawn_by"]))
        self._games[lane] = int(state["games"])
        if not self._drawn:
            self._drawn = [self._maker.sample(np.random.default_rng(0), 0)] * self.num_envs  # none of them is flown
            self._running = self._blank_games()
        self._drawn[lane] = self._draw(lane, json.loads(str(state["options"])))
        for name, array in self._state_arrays().items():
            array[lane] = state[name]
        return mapped(np.copy, select(self._running.observations, lane))

    def _state_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return all arrays (L, ...) that change in a game."""
        arrays = {f"pixels.{name}": array for name, array in self._view.pixels._asdict().items() if len(array)}
        arrays |= {f"now.{name}": getattr(self._now, name) for name in ("body", "watch", "game")}
        arrays |= {f"clocks.{name}": array for name, array in self._clocks._asdict().items()}
        arrays |= {f"state.{name}": self._now.state[name] for name in self._now.state.dtype.names or ()}
        return arrays | named_leaves(self._running, "running") | {"over": self._over}

    # --- inside -----------------------------------------------------------------------------------

    def _all(self, slots: Slots) -> NDArray[np.int64]:
        return np.arange(self.num_envs) if slots is None else np.array(slots, int)

    def _standing(self, slots: Slots) -> NDArray[np.int64]:
        """Return the lanes of `slots`. Raises BatchError once closed, and while one of them flies."""
        if self.closed:
            raise BatchError("this batch is closed")
        which = self._all(slots)
        if busy := {lane for lanes in self._flying for lane in lanes}.intersection(which.tolist()):
            raise still_flying(min(busy))
        return which

    def _run(self, asked: int, lanes: NDArray[np.int64], frames: Frame) -> list[Future[None]]:
        """Start what is `asked` of lanes (kernels/cpu), which are divided among the threads."""
        of_lanes: tuple[Any, ...] = self._goals, self._view, self._rows, self._now, self._plan, self._clocks
        of_lanes = *of_lanes, frames, self._samples
        parts = [part for part in np.array_split(lanes, self._threads) if len(part)]
        return [self._pool.submit(cpu.run_lanes, asked, part, *of_lanes) for part in parts]

    def _draw(self, lane: int, options: Mapping[str, object] | None = None) -> Drawn:
        self._sampled_by[lane] = self._generators[lane].bit_generator.state, options
        drawn = self._maker.sample(self._generators[lane], self._games[lane] - 1, options)
        self._maker.write(drawn, self._rows, lane)
        return drawn

    def _renew(self, lanes: NDArray[np.int64]) -> list[Info]:
        """Begin the next games of these lanes, and return the infos."""
        for lane in lanes.tolist():
            self._games[lane] += 1
            self._drawn[lane] = self._draw(lane)
        return self._begin(lanes)

    def _begin(self, lanes: NDArray[np.int64]) -> list[Info]:
        """Begin the games sampled for these lanes, and return the infos."""
        drawn = [self._drawn[lane] for lane in lanes.tolist()]
        self._clocks.scale[lanes] = [each.task.latency.scale for each in drawn]
        for part in self._run(cpu.BEGIN, lanes, self._pictures):
            part.result()
        self._over[lanes], self._host_s[lanes] = False, 0.0
        numbers, *_ = self._ends(lanes)
        course = self._maker.courses(drawn, self._running.course)
        games = self._judge.begun(course, numbers, self._first_pictures(lanes))
        assign(self._running, lanes, games)
        return self._infos(lanes, games, np.zeros(len(lanes), bool))

    def _first_pictures(self, lanes: NDArray[np.int64]) -> Frame | None:
        """Return pictures (n, ...) of the starts of games, None where they are not shown."""
        if not self.task.sees_start or self._view.kind in (STATE, DVS):
            return None
        frames = np.empty((self.num_envs, 1, *self._blank.shape), self._blank.dtype)
        for part in self._run(cpu.SHOW, lanes, frames):
            part.result()
        drawn: Frame = frames[lanes, 0]
        return drawn

    def _flown(self, lanes: NDArray[np.int64]) -> Flown:
        """Return how the commands of these lanes were flown."""
        numbers, position_m, collision = self._ends(lanes)
        samples = self._clocks.ticks[lanes], self._clocks.taken[lanes], self._samples[lanes], self._frames[lanes]
        return Flown(numbers, self._now.state["tick"][lanes], position_m, collision, *samples)

    def _ends(self, lanes: NDArray[np.int64]) -> tuple[Any, Any, Any]:
        """Return states, positions and collisions of these lanes (Judge.end)."""
        state, rows = self._now.state[lanes], self._now.game[lanes]
        flight, ticks = (state.view(kind).reshape(len(lanes), -1) for kind in (np.float64, np.int64))
        return self._judge.end(flight, ticks, self._now.watch[lanes, TOUCHED], self._rows.counts[rows].astype(np.int64))

    def _infos(self, lanes: NDArray[np.int64], games: Running, won: NDArray[np.bool_]) -> list[Info]:
        """Return the infos of the games of these lanes."""
        clock = self._clocks.row[lanes]
        wall_ns, phases_ns = clock[:, timeline.NOW] - clock[:, timeline.START], clock[:, timeline.FIRST_PHASE :]
        infos = self._judge.infos(games, won, wall_ns, phases_ns)
        each: list[Info] = each_of(infos, len(lanes))
        for lane, info in zip(lanes.tolist(), each, strict=True):
            collision, course = info["collision"], self._drawn[lane].course
            info["collision"] = None if collision < 0 else self._judge.objects[collision]
            if CONDITIONS in course:
                info[CONDITIONS] = course[CONDITIONS]
            if self.task.report_host_times:
                info["host_phase_s"] = {**dict.fromkeys(PHASES, 0.0), "simulation": float(self._host_s[lane])}
        return each
