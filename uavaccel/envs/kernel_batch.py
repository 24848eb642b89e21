"""Many environments of one task over arrays, in threads of this process: `simulator="kernels"`, `device="cpu"`.

They fly as in the exact simulator, and observe images of the kernels instead of OpenGL's (docs/kernels.md).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.envs.checks import actions_of, autoreset_of, make_task, whole_number
from uavaccel.envs.context_planes import NO_ACTION, age_levels
from uavaccel.envs.flight_env import CONDITIONS, FlightEnv
from uavaccel.envs.flyable import CPU, check_flyable, kind_of
from uavaccel.envs.kernel_games import (
    Drawn,
    GameMaker,
    StepResult,
    game_info,
    kinematics_of,
    one_course,
    select,
    set_course,
    stacked,
    step_result,
)
from uavaccel.envs.kernel_plan import plan_of
from uavaccel.envs.sensors import blank_frame
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Moment, Moments, Task
from uavaccel.envs.turn_batch import TurnBatch
from uavaccel.envs.values import Action, Actions, Answer, Frame, Info, Number, Observation, Steps
from uavaccel.errors import UserError
from uavaccel.kernels import cpu, events, timeline
from uavaccel.kernels import lanes as rows
from uavaccel.kernels.fields import DVS, STATE
from uavaccel.kernels.flight import TOUCHED
from uavaccel.limits import MOST_PROCESSES
from uavaccel.machine import usable_cores
from uavaccel.sim.state import SavedState, State
from uavaccel.sim.vehicle.quadrotor import NEVER
from uavaccel.units import NS_PER_S
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
        self.task: Task = make_task(environment.task_class, keys, environment.__name__)
        check_flyable(self.task, num_envs, CPU)
        if threads is not None:
            whole_number("threads", threads, MOST_PROCESSES)
        self.num_envs, self.render_mode = num_envs, None
        self.metadata = {**environment.metadata, "autoreset_mode": autoreset_of(autoreset_mode)}
        self._same_step = self.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        self._next_step = self.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        self.single_observation_space = self.task.observation_space()
        self.single_action_space = self.task.action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._maker = GameMaker(self.task)
        self._allocate()
        self._plan = plan_of(self.task, self._maker.surroundings.hull, self._view.kind != STATE)
        self._threads = min(usable_cores() if threads is None else threads, num_envs)
        self._pool = ThreadPoolExecutor(self._threads)
        self._flying: dict[int, list[Future[None]]] = {}
        self._clock = MonotonicClock()
        self._generators: dict[int, np.random.Generator] = {}
        self._games = [0] * num_envs
        self._drawn: list[Drawn] = []
        # States of the generators before the running games were sampled.
        self._generator_states: list[Mapping[str, object] | None] = [None] * num_envs

    def _allocate(self) -> None:
        count, task, space = self.num_envs, self.task, self.task.frames_space()
        self._rows = self._maker.rows(count)
        self._now = rows.flights(count)
        blank = task.sensor().blank
        kind, size = kind_of(task), task.picture_size[::-1]
        draws = sample_pixels(task.dvs_parameters, size, task.dvs_seed)
        pixels = events.pixels_of(
            count if kind == DVS else 0, task.dvs_parameters, size, blank_frame("dvs", task.picture_size).shape[1:]
        )
        self._view = cpu.View(kind, size, self._maker.looks, events.sensor_of(draws), pixels)
        samples = task.frames_per_command
        self._blank = blank
        self._frames = np.empty((count, samples, *blank.shape), blank.dtype)
        drawn = self._frames if blank.dtype == np.uint8 else np.empty((0, samples, 1, 0, 0), np.uint8)
        self._pictures = drawn  # always uint8: machine code is compiled for types
        self._samples = np.zeros((count, samples, cpu.SAMPLE_FIELDS))
        self._observations = np.zeros((count, *space.shape), space.dtype)
        self._told = np.zeros((count, task.told), np.float32)
        self._directions = np.zeros((count, 3))
        self._position = [np.zeros(count) for _ in range(3)]  # north, east, down
        self._actions = np.full(count, NO_ACTION)
        self._commands = np.zeros(count, np.int64)
        self._taken_ns = np.zeros((count, samples * task.history), np.int64)
        self._present_ns = np.zeros(count, np.int64)
        self._clocks = timeline.clocks(count, samples)
        self._host_s = np.zeros(count)
        self._over = np.zeros(count, bool)
        self._context = task.context_planes()

    def close_extras(self, **_: object) -> None:
        """End the threads."""
        if hasattr(self, "_pool"):
            self._pool.shutdown()

    # --- learners ---------------------------------------------------------------------------------

    def reset_each(self, seeds: Sequence[int | None], options: Sequence[Mapping[str, object] | None]) -> list[Info]:
        """Begin a game in every environment, with its own seed and options, and return the infos."""
        for lane, seed in enumerate(seeds):
            if seed is not None or lane not in self._generators:
                self._generators[lane] = seeding.np_random(seed)[0]
            self._games[lane] = self._games[lane] + 1 if seed is None else 1
        drawn = [self._draw(lane, options[lane]) for lane in range(self.num_envs)]
        self._drawn, self._course = drawn, stacked([each.course for each in drawn])
        return self._begin(np.arange(self.num_envs))

    def step_async(self, actions: Actions, slots: Sequence[int] | None = None) -> None:
        """As `TurnBatch` has it. Raises UserError before the first reset."""
        if not self._drawn:
            raise UserError("reset the environments before their first step")
        which = np.arange(self.num_envs) if slots is None else np.asarray(slots)
        for lane, action in zip(which, actions_of(self.single_action_space, actions, len(which)), strict=True):
            self._set_direction(int(lane), action)
        self._frames[which] = self._blank
        self._begun_ns = self._clock.now_ns()
        going = which[~self._over[which]]
        parts = [part for part in np.array_split(going, self._threads) if len(part)]
        self._flying[int(which[0])] = [self._pool.submit(self._fly, part) for part in parts]

    def step_wait(self, slots: Sequence[int] | None = None) -> Steps:
        """As `TurnBatch` has it. Raises UserError where no command was started."""
        which = np.arange(self.num_envs) if slots is None else np.asarray(slots)
        flown = self._flying.pop(int(which[0]), None)
        if flown is None:
            raise UserError("no command was started in these environments: step_async comes before step_wait")
        for part in flown:
            part.result()
        self._host_s[which] += (self._clock.now_ns() - self._begun_ns) / NS_PER_S / len(which)
        going = which[~self._over[which]]
        idle = which[self._over[which]]
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool)
        infos: dict[int, Info] = {}
        if len(going):
            judged = self._finish_commands(going)
            rewards[going], terminated[going], truncated[going] = (judged.reward, judged.terminated, judged.truncated)
            infos = {int(lane): self._info(int(lane), won) for lane, won in zip(going, judged.success, strict=True)}
        self._autoreset(idle, going[terminated[going] | truncated[going]], infos)
        seen = self._seen_by(which)
        return seen, rewards[which], terminated[which], truncated[which], [infos[int(lane)] for lane in which]

    def _autoreset(self, idle: NDArray[np.int64], ended: NDArray[np.int64], infos: dict[int, Info]) -> None:
        """Begin games as `autoreset_mode` says, in lanes that waited or have just ended, and update their infos."""
        if len(idle):
            renewed = self._renew(idle) if self._next_step else [{} for _ in idle]
            infos.update(zip(idle.tolist(), renewed, strict=True))
        if self._same_step and len(ended):
            last = [self._seen_by(lane) for lane in ended.tolist()]
            for lane, seen, info in zip(ended.tolist(), last, self._renew(ended), strict=True):
                infos[lane] = info | {"final_info": infos[lane], "final_obs": seen}
        else:
            self._over[ended] = True

    def charge(self, lane: int, duration_s: float, phase: str = "inference") -> None:
        """In timing `virtual`, charge a lane for its agent's work since the last command; with ADSC it flies on."""
        if self.task.timing == "virtual" and self._drawn:
            duration_ns = round(duration_s * NS_PER_S)
            timeline.charge.py_func(self._clocks.row[lane], duration_ns, PHASES.index(phase))

    def observations(self) -> Observation:
        """Return the present observation of every environment."""
        return self._seen_by(slice(None))

    def _seen_by(self, which: Any) -> Observation:
        """Return copies of the present observations of lanes, or of one."""
        frames = self._observations[which].copy()
        return {"image": frames, "state": self._told[which].copy()} if self.task.also_state else frames

    def call_each(
        self, name: str, arguments: Sequence[tuple[Any, ...]], slots: Sequence[int] | None = None
    ) -> list[Answer]:
        """Call `charge`, `get_state` or `set_state` of the environments `lanes`, by default all. Raises UserError."""
        methods = {"charge": self.charge, "get_state": self._get_state, "set_state": self._set_state}
        if name not in methods:
            raise UserError(f"simulator = kernels: {name} is not available; use simulator = mujoco")
        which = range(self.num_envs) if slots is None else slots
        return [methods[name](lane, *argument) for lane, argument in zip(which, arguments, strict=True)]  # type: ignore[operator]

    # --- saving -----------------------------------------------------------------------------------

    def _get_state(self, lane: int) -> State:
        """Return a lane's running game for np.savez: another batch of this task continues it to the same bytes."""
        state: State = {"generator": json.dumps(self._generators[lane].bit_generator.state)}
        state |= {"drawn_by": json.dumps(self._generator_states[lane]), "games": self._games[lane]}
        state["course"] = json.dumps(one_course(self._course, lane))
        return state | {name: array[lane].copy() for name, array in self._state_arrays().items()}

    def _set_state(self, lane: int, state: SavedState) -> Observation:
        """Restore a state that `_get_state` returned, and return the lane's observation."""
        generator = self._generators[lane] = seeding.np_random(0)[0]
        generator.bit_generator.state = json.loads(str(state["drawn_by"]))
        self._games[lane] = int(state["games"])
        if not self._drawn:
            self._drawn = [self._sample_any() for _ in range(self.num_envs)]
            self._course = stacked([each.course for each in self._drawn])
        self._drawn[lane] = self._draw(lane)
        generator.bit_generator.state = json.loads(str(state["generator"]))
        set_course(self._course, lane, json.loads(str(state["course"])))
        for name, array in self._state_arrays().items():
            array[lane] = state[name]
        self._update_positions(np.array([lane]))
        return self._seen_by(lane)

    def _sample_any(self) -> Drawn:
        """Sample a game that is not flown, for the shape of its course."""
        return self._maker.sample(np.random.default_rng(0), 0)

    def _state_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return all arrays (L, ...) that change in a game."""
        arrays = {f"pixels.{name}": array for name, array in self._view.pixels._asdict().items() if len(array)}
        arrays |= {f"now.{name}": getattr(self._now, name) for name in ("body", "watch", "game")}
        arrays |= {f"clocks.{name}": array for name, array in self._clocks._asdict().items()}
        arrays |= {f"state.{name}": self._now.state[name] for name in self._now.state.dtype.names or ()}
        names = ("observations", "told", "actions", "commands", "taken_ns", "present_ns", "over")
        return arrays | {name: getattr(self, f"_{name}") for name in names}

    # --- inside -----------------------------------------------------------------------------------

    def _draw(self, lane: int, options: Mapping[str, object] | None = None) -> Drawn:
        self._generator_states[lane] = self._generators[lane].bit_generator.state
        drawn = self._maker.sample(self._generators[lane], self._games[lane] - 1, options)
        self._maker.write(drawn, self._rows, lane)
        return drawn

    def _renew(self, lanes: NDArray[np.int64]) -> list[Info]:
        """Begin the next games of these lanes, and return the infos."""
        for lane in lanes.tolist():
            self._games[lane] += 1
            self._drawn[lane] = self._draw(lane)
            course = {name: each for name, each in self._drawn[lane].course.items() if name != CONDITIONS}
            set_course(self._course, lane, course)
        return self._begin(lanes)

    def _begin(self, lanes: NDArray[np.int64]) -> list[Info]:
        """Begin the games sampled for these lanes, and return the infos."""
        cpu.CPU.observe_starts(self._rows, lanes)
        self._clocks.scale[lanes] = [self._drawn[lane].task.latency.scale for lane in lanes.tolist()]
        for part in [
            self._pool.submit(cpu.CPU.begin, each, each, self._view, self._rows, self._now, self._plan, self._clocks)
            for each in np.array_split(lanes, self._threads)
            if len(each)
        ]:
            part.result()
        self._over[lanes], self._commands[lanes], self._actions[lanes] = False, 0, NO_ACTION
        self._host_s[lanes], self._taken_ns[lanes], self._present_ns[lanes] = 0.0, 0, 0
        self._update_positions(lanes)
        self._tell(lanes)
        first = self._first_frames(lanes)
        frames = self._taken_ns.shape[1]
        self._observe(lanes, np.concatenate([first] * frames, axis=1))
        return [self._info(int(lane), False) for lane in lanes]

    def _first_frames(self, lanes: NDArray[np.int64]) -> Frame:
        """Return the first frames (n, ...) of games that begin."""
        blank = np.repeat(self._blank[None], len(lanes), axis=0)
        if not self.task.sees_start or self.task.blank_images:
            return blank
        if self.task.observation == "state":
            return self._features(lanes, np.asarray(self._state_fields(lanes)))
        if self.task.observation == "dvs":
            return blank
        frames = np.empty((self.num_envs, 1, *self._blank.shape), self._blank.dtype)
        cpu.CPU.show(lanes, self._view, self._rows, self._now, self._plan, frames)
        drawn: Frame = frames[lanes, 0]
        return drawn

    def _set_direction(self, lane: int, action: Action) -> None:
        """Set a lane's direction from an action."""
        directions = self.task.directions
        if directions is None:
            self._directions[lane] = action
        else:
            self._actions[lane] = int(action)
            self._directions[lane] = directions[int(action)]

    def _fly(self, lanes: NDArray[np.int64]) -> None:
        cpu.CPU.fly(
            lanes,
            self._directions,
            self._view,
            self._rows,
            self._now,
            self._plan,
            self._clocks,
            self._pictures,
            self._samples,
        )

    def _finish_commands(self, lanes: NDArray[np.int64]) -> StepResult:
        """Judge the commands of these lanes and update their observations."""
        before = Moments(None, [axis[lanes].copy() for axis in self._position], None, None, self._course_of(lanes))
        self._commands[lanes] += 1
        self._update_positions(lanes)
        flown = self._moments(lanes)
        judged = step_result(self.task, before, flown)
        if self.task.observation == "state" and not self.task.blank_images:
            self._write_features(lanes)
        for name, value in judged.course.items():
            set_course(self._course[name], lanes, value)
        self._tell(lanes)
        self._note_times(lanes)
        shape = (len(lanes), -1, *self._blank.shape[1:])
        fresh = self._frames[lanes].reshape(shape)
        earlier = self._observations[lanes][:, fresh.shape[1] : fresh.shape[1] * self.task.history]
        self._observe(lanes, np.concatenate([earlier, fresh], axis=1))
        return judged

    def _note_times(self, lanes: NDArray[np.int64]) -> None:
        """Update the present time and the frames' times, from which their ages follow (envs/context_planes)."""
        tick_ns, clocks = self._plan.tick_ns, self._clocks
        seen = np.arange(clocks.ticks.shape[1]) < clocks.taken[lanes, None]
        now_ns = self._now.state["tick"][lanes] * tick_ns
        if self.task.command == "adsc":  # TCSC has paused the clock
            since_ns = self._plan.timing.rules[timeline.PROCESSING_NS] * self._moments(lanes).free
            now_ns = now_ns + np.rint(since_ns * float(self.task.clock_speed)).astype(np.int64)
        taken_ns = np.where(seen, clocks.ticks[lanes] * tick_ns, now_ns[:, None])
        self._present_ns[lanes] = now_ns
        self._taken_ns[lanes] = np.concatenate([self._taken_ns[lanes], taken_ns], axis=1)[:, seen.shape[1] :]

    def _observe(self, lanes: NDArray[np.int64], frames: Frame) -> None:
        """Update the observations: frames, oldest first, then context planes."""
        self._observations[lanes, : frames.shape[1]] = frames
        if self._context is None:
            return
        ages = age_levels(self._present_ns[lanes, None] - self._taken_ns[lanes])
        for plane, what in enumerate(self._context.knows, frames.shape[1]):
            if what == "last_action":
                self._observations[lanes, plane] = self._context.actions_shown()[self._actions[lanes]]
            else:
                self._observations[lanes, plane] = ages[:, self._context.rows_frames()][:, :, None]

    def _update_positions(self, lanes: NDArray[np.int64]) -> None:
        """Store the positions, or first contacts, of these lanes' vehicles; the other lanes may be flying."""
        state = self._now.state[lanes]
        touched = state["collision_tick"] != NEVER
        places = np.where(touched[:, None], state["contact_position"], state["position"])
        for axis in range(3):
            self._position[axis][lanes] = places[:, axis]

    def _moments(self, lanes: NDArray[np.int64]) -> Moments:
        touched = self._now.state["collision_tick"][lanes] != NEVER
        place = [axis[lanes] for axis in self._position]
        return Moments(None, place, touched, self._commands[lanes], self._course_of(lanes))

    def _course_of(self, lanes: NDArray[np.int64]) -> dict[str, Number]:
        return {name: select(value, lanes) for name, value in self._course.items()}

    def _state_fields(self, lanes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the present states (n, SAMPLE_FIELDS)."""
        state = self._now.state[lanes]
        return np.concatenate([state[name] for name in ("position", "quaternion", "velocity", "rate")], axis=1)

    def _tell(self, lanes: NDArray[np.int64]) -> None:
        """Update the states beside frames, all 0 after a collision."""
        if self.task.also_state:
            free = self._now.state["collision_tick"][lanes] == NEVER
            self._told[lanes] = np.where(free[:, None], self._numbers(lanes, self._state_fields(lanes)), 0.0)

    def _features(self, lanes: NDArray[np.int64], samples: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the frames (n, ...) of observation "state" for samples (n, SAMPLE_FIELDS)."""
        return self._numbers(lanes, samples).reshape(len(lanes), *self._blank.shape)

    def _numbers(self, lanes: NDArray[np.int64], samples: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the task's fields (n, fields) for samples (n, SAMPLE_FIELDS)."""
        numbers = self.task.fields(kinematics_of(samples), self._course_of(lanes))
        return np.stack(numbers, axis=1).astype(np.float32)

    def _write_features(self, lanes: NDArray[np.int64]) -> None:
        """Write the frames of observation "state" before a collision."""
        for sample in range(self._frames.shape[1]):
            seen = lanes[sample < self._clocks.taken[lanes]]
            if len(seen):
                self._frames[seen, sample] = self._features(seen, self._samples[seen, sample])

    def _info(self, lane: int, won: bool) -> Info:
        drawn, state = self._drawn[lane], self._now.state[lane]
        hit = None
        if state["collision_tick"] != NEVER:
            hit = self._maker.surroundings.name_of(int(self._now.watch[lane, TOUCHED]), drawn.obstacles)
        position = tuple(float(axis[lane]) for axis in self._position)
        course = one_course(self._course, lane)
        if CONDITIONS in drawn.course:
            course[CONDITIONS] = drawn.course[CONDITIONS]
        moment = Moment(None, position, hit, int(self._commands[lane]), course)  # type: ignore[arg-type]
        clock = self._clocks.row[lane].tolist()
        wall_ns = clock[timeline.NOW] - clock[timeline.START]
        info = game_info(self.task, moment, bool(won), wall_ns, clock[timeline.FIRST_PHASE :])
        if self.task.report_host_times:
            info["host_phase_s"] = {**dict.fromkeys(PHASES, 0.0), "simulation": float(self._host_s[lane])}
        return info
