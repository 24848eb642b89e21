"""Many environments of one task flown over arrays, in threads of this process: `simulator="kernels"`, `device="cpu"`.

Each flies as it would in the exact simulator, and sees what the kernels draw in place of OpenGL (docs/kernels.md).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.envs.checks import make_task, within
from uavaccel.envs.flight_env import CONDITIONS, FlightEnv
from uavaccel.envs.judged import Judged, judge
from uavaccel.envs.kernel_games import Drawn, GameMaker, one_course, put_course, stacked
from uavaccel.envs.kernel_plan import check_flyable, plan_of, slices_of
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Moment, Moments
from uavaccel.envs.told import NO_ACTION, age_levels
from uavaccel.errors import UserError
from uavaccel.kernels import cpu, events
from uavaccel.kernels import lanes as rows
from uavaccel.kernels.fields import COLUMNS, NO_LOOKS, ROWS
from uavaccel.kernels.flight import TOUCHED
from uavaccel.kinematics import Kinematics
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs_sensor import draw_pixels
from uavaccel.vision.observation import BLOCK_SIDE

KINDS = {"state": cpu.STATE, "dvs": cpu.DVS, "colour": cpu.COLOUR, "depth": cpu.DEPTH}
Steps = tuple[NDArray[Any], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], list[dict[str, Any]]]


class KernelBatch(VectorEnv[Any, Any, Any]):
    """`num_envs` environments of `environment`, a class of FlightEnv's kind, with the keywords that it takes.

    They fly in `threads` threads (as many as there are cores). Raises UserError for keywords that do not fit, and for
    what only the exact simulator flies.
    """

    def __init__(
        self,
        environment: type[FlightEnv],
        num_envs: int = 1,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **keys: Any,
    ) -> None:
        self.task: Any = make_task(environment.task_class, keys, environment.__name__)
        check_flyable(self.task, num_envs)
        self.num_envs, self.render_mode = num_envs, None
        self.metadata = {**environment.metadata, "autoreset_mode": AutoresetMode(autoreset_mode)}
        self._same_step = self.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        self._next_step = self.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        self.single_observation_space = self.task.observation_space()
        self.single_action_space = self.task.action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._maker = GameMaker(self.task)
        self._plan, self._wall_ns = plan_of(self.task, self._maker.surroundings.hull), slices_of(self.task)[1]
        self._allocate()
        self._threads = min(threads or _cores(), num_envs)
        self._pool = ThreadPoolExecutor(self._threads)
        self._flying: dict[int, list[Future[None]]] = {}
        self._clock = MonotonicClock()
        self._generators: list[Any] = [None] * num_envs
        self._games = [0] * num_envs
        self._drawn: list[Drawn] = []

    def _allocate(self) -> None:
        count, task, space = self.num_envs, self.task, self.single_observation_space
        self._rows = rows.game_rows(count, self._maker.surroundings.most)
        self._now = rows.flights(count)
        blank = task.sensor().blank
        draws = draw_pixels(task.dvs_parameters, (ROWS, COLUMNS), task.dvs_seed)
        kind = cpu.STATE if task.blank_images else KINDS[task.observation]
        pixels = events.pixels_of(count if kind == cpu.DVS else 0, task.dvs_parameters)
        self._compiled = cpu.entry_points(kind)
        self._view = cpu.View(self._maker.looks or NO_LOOKS, events.sensor_of(draws), pixels)
        samples = task.frames_per_command
        self._blank = blank
        self._frames = np.empty((count, samples, *blank.shape), blank.dtype)
        drawn = self._frames if blank.dtype == np.uint8 else np.empty((0, samples, 1, 0, 0), np.uint8)
        self._pictures = drawn  # of one type whatever is observed: machine code is made for types
        self._samples = np.zeros((count, samples, cpu.SAMPLE_FIELDS))
        self._observations = np.zeros((count, *space.shape), space.dtype)
        self._last = np.zeros_like(self._observations)
        self._directions = np.zeros((count, 3))
        self._actions = np.full(count, NO_ACTION)
        self._commands = np.zeros(count, np.int64)
        self._taken_ticks = np.zeros((count, samples * task.history), np.int64)
        self._spent_ns = np.zeros(count, np.int64)
        self._host_s = np.zeros(count)
        self._over = np.zeros(count, bool)
        self._told = task.told()

    # --- Gymnasium --------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """New games everywhere; environment i gets `seed` + i, or the i-th of several."""
        infos = self.reset_each(seeds_of(seed, self.num_envs), [options] * self.num_envs)
        return self.observations(), self._merged(infos)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One command each."""
        self.step_async(actions)
        observations, rewards, terminated, truncated, infos = self.step_wait()
        return observations, rewards, terminated, truncated, self._merged(infos)

    def close_extras(self, **_: Any) -> None:
        """End the threads."""
        if hasattr(self, "_pool"):
            self._pool.shutdown()

    # --- learners ---------------------------------------------------------------------------------

    def reset_each(self, seeds: Sequence[int | None], options: Sequence[dict[str, Any] | None]) -> list[Any]:
        """A new game everywhere, each with its own seed and options; the infos."""
        for lane, seed in enumerate(seeds):
            if seed is not None or self._generators[lane] is None:
                self._generators[lane] = seeding.np_random(seed)[0]
            self._games[lane] = self._games[lane] + 1 if seed is None else 1
        drawn = [self._draw(lane, options[lane]) for lane in range(self.num_envs)]
        self._drawn, self._course = drawn, stacked([each.course for each in drawn])
        return self._begin(np.arange(self.num_envs))

    def step_async(self, actions: Any, lanes: Sequence[int] | None = None) -> None:
        """Send a command each to some environments (all), and come back at once: they fly meanwhile."""
        if not self._drawn:
            raise UserError("reset the environments before their first step")
        which = np.arange(self.num_envs) if lanes is None else np.asarray(lanes)
        for lane, action in zip(which, actions, strict=True):
            self._take(int(lane), within(self.single_action_space, action))
        self._frames[which] = self._blank
        self._begun_ns = self._clock.now_ns()
        going = which[~self._over[which]]
        parts = [part for part in np.array_split(going, self._threads) if len(part)]
        self._flying[int(which[0])] = [self._pool.submit(self._fly, part) for part in parts]

    def step_wait(self, lanes: Sequence[int] | None = None) -> Steps:
        """Observations, rewards, ends, truncations and infos of the environments that `step_async` sent off.

        With autoreset SAME_STEP the info of a game's end is in `final_info` and its observation in `final_obs`.
        """
        which = np.arange(self.num_envs) if lanes is None else np.asarray(lanes)
        for part in self._flying.pop(int(which[0])):
            part.result()
        self._host_s[which] += (self._clock.now_ns() - self._begun_ns) / NS_PER_S / len(which)
        going = which[~self._over[which]]
        idle = which[self._over[which]]
        rewards, terminated, truncated = (
            np.zeros(self.num_envs),
            *(np.zeros(self.num_envs, bool) for _ in "et"),
        )
        infos: dict[int, dict[str, Any]] = {}
        if len(going):
            judged = self._land(going)
            rewards[going], terminated[going], truncated[going] = (
                judged.reward,
                judged.terminated,
                judged.truncated,
            )
            infos = {
                int(lane): self._info(int(lane), won) for lane, won in zip(going, judged.success, strict=True)
            }
        if len(idle) and self._next_step:
            infos |= dict(zip(idle.tolist(), self._renew(idle), strict=True))
        elif len(idle):
            infos |= {int(lane): {} for lane in idle}
        ended = going[terminated[going] | truncated[going]]
        if self._same_step and len(ended):
            self._last[ended] = self._observations[ended]
            for lane, info in zip(ended.tolist(), self._renew(ended), strict=True):
                infos[lane] = info | {"final_info": infos[lane], "final_obs": self._last[lane].copy()}
        else:
            self._over[ended] = True
        seen = self._observations[which]
        return seen, rewards[which], terminated[which], truncated[which], [infos[int(lane)] for lane in which]

    def observations(self) -> NDArray[Any]:
        """The present observation of every environment."""
        return self._observations.copy()

    # --- inside -----------------------------------------------------------------------------------

    def _draw(self, lane: int, options: Mapping[str, Any] | None = None) -> Drawn:
        drawn = self._maker.draw(self._generators[lane], self._games[lane] - 1, options)
        self._maker.write(drawn, self._rows, lane)
        return drawn

    def _renew(self, lanes: NDArray[np.int64]) -> list[dict[str, Any]]:
        """New games where one is over."""
        for lane in lanes.tolist():
            self._games[lane] += 1
            self._drawn[lane] = self._draw(lane)
            course = {name: each for name, each in self._drawn[lane].course.items() if name != CONDITIONS}
            put_course(self._course, lane, course)
        return self._begin(lanes)

    def _begin(self, lanes: NDArray[np.int64]) -> list[dict[str, Any]]:
        self._compiled.look_at_starts(self._rows, lanes)
        for part in [
            self._pool.submit(self._compiled.begin, each, each, self._view, self._rows, self._now, self._plan)
            for each in np.array_split(lanes, self._threads)
            if len(each)
        ]:
            part.result()
        self._over[lanes], self._commands[lanes], self._actions[lanes] = False, 0, NO_ACTION
        self._spent_ns[lanes], self._host_s[lanes], self._taken_ticks[lanes] = 0, 0.0, 0
        self._place = self._places()
        first = self._first_frames(lanes)
        frames = self._taken_ticks.shape[1]
        self._show(lanes, np.concatenate([first] * frames, axis=1))
        return [self._info(int(lane), False) for lane in lanes]

    def _first_frames(self, lanes: NDArray[np.int64]) -> NDArray[Any]:
        """What the frames of a first observation show (n, ...)."""
        blank = np.repeat(self._blank[None], len(lanes), axis=0)
        if not self.task.sees_start or self.task.blank_images:
            return blank
        if self.task.observation == "state":
            return self._features(lanes, np.asarray(self._state_fields(lanes)))
        if self.task.observation == "dvs":
            return blank
        frames = np.empty((self.num_envs, 1, *self._blank.shape), self._blank.dtype)
        self._compiled.show(lanes, self._view, self._rows, self._now, self._plan, frames)
        return frames[lanes, 0]

    def _take(self, lane: int, action: Any) -> None:
        """An action as a direction."""
        directions = self.task.directions
        if directions is None:
            self._directions[lane] = action
        else:
            self._actions[lane] = int(action)
            self._directions[lane] = directions[int(action)]

    def _fly(self, lanes: NDArray[np.int64]) -> None:
        self._compiled.fly(
            lanes,
            self._directions,
            self._view,
            self._rows,
            self._now,
            self._plan,
            self._pictures,
            self._samples,
        )

    def _land(self, lanes: NDArray[np.int64]) -> Judged:
        """What became of a command, and what is seen of it."""
        before = Moments(None, [axis[lanes] for axis in self._place], None, None, self._course_of(lanes))
        self._commands[lanes] += 1
        self._place = self._places()
        flown = self._moments(lanes)
        judged = judge(self.task, before, flown)
        if self.task.observation == "state" and not self.task.blank_images:
            self._put_features(lanes)
        for name, value in judged.course.items():
            _assign(self._course[name], lanes, value)
        samples = self._plan.slices
        ends = np.cumsum(samples)
        hit_tick = np.where(flown.touched, self._now.state["collision_tick"][lanes], np.iinfo(np.int64).max)
        begun = (self._commands[lanes] - 1) * ends[-1]
        seen = begun[:, None] + ends < hit_tick[:, None]
        flown_slices = np.minimum(seen.sum(axis=1) + 1, len(ends))
        self._spent_ns[lanes] += np.cumsum(self._wall_ns)[flown_slices - 1]
        present = begun + ends[flown_slices - 1]
        taken = np.where(seen, begun[:, None] + ends, present[:, None])
        self._taken_ticks[lanes] = np.concatenate([self._taken_ticks[lanes], taken], axis=1)[:, len(ends) :]
        self._present = present
        shape = (len(lanes), -1, *self._blank.shape[1:])
        fresh = self._frames[lanes].reshape(shape)
        kept = self._observations[lanes][:, fresh.shape[1] : fresh.shape[1] * self.task.history]
        self._show(lanes, np.concatenate([kept, fresh], axis=1))
        return judged

    def _show(self, lanes: NDArray[np.int64], frames: NDArray[Any]) -> None:
        """An observation of frames, oldest first, and of what the agent is told."""
        self._observations[lanes, : frames.shape[1]] = frames
        if self._told is None:
            return
        fresh = self._commands[lanes] == 0
        present = np.where(fresh, 0, 0 if fresh.all() else self._present)
        ages = age_levels((present[:, None] - self._taken_ticks[lanes]) * self._plan.tick_ns)
        for plane, what in enumerate(self.task.knows, frames.shape[1]):
            if what == "last_action":
                self._observations[lanes, plane] = self._told.actions_shown()[self._actions[lanes]]
            else:
                self._observations[lanes, plane] = ages[:, self._told.rows_frames()][:, :, None]

    def _places(self) -> list[NDArray[np.float64]]:
        """Where the vehicles are, or where they touched something: north, east, down (L,)."""
        state = self._now.state
        touched = state["collision_tick"] != rows.NEVER
        places = np.where(touched[:, None], state["contact_position"], state["position"])
        return [places[:, axis].copy() for axis in range(3)]

    def _moments(self, lanes: NDArray[np.int64]) -> Moments:
        touched = self._now.state["collision_tick"][lanes] != rows.NEVER
        place = [axis[lanes] for axis in self._place]
        return Moments(None, place, touched, self._commands[lanes], self._course_of(lanes))

    def _course_of(self, lanes: NDArray[np.int64]) -> dict[str, Any]:
        return {name: _pick(value, lanes) for name, value in self._course.items()}

    def _state_fields(self, lanes: NDArray[np.int64]) -> NDArray[np.float64]:
        """The present states (n, SAMPLE_FIELDS)."""
        state = self._now.state[lanes]
        return np.concatenate(
            [state[name] for name in ("position", "quaternion", "velocity", "rate")], axis=1
        )

    def _features(self, lanes: NDArray[np.int64], samples: NDArray[np.float64]) -> NDArray[np.float32]:
        """The frames (n, ...) of samples (n, SAMPLE_FIELDS)."""
        columns = list(samples.T)
        state = Kinematics(0, columns[:3], columns[3:7], columns[7:10], columns[10:13])  # type: ignore[arg-type]
        numbers = self.task.fields(state, self._course_of(lanes))
        return np.stack(numbers, axis=1).astype(np.float32).reshape(len(lanes), *self._blank.shape)

    def _put_features(self, lanes: NDArray[np.int64]) -> None:
        """Frames of observation "state", but for what comes after a touch."""
        hit = self._now.state["collision_tick"][lanes]
        ends = (self._commands[lanes] - 1)[:, None] * self._plan.slices.sum() + np.cumsum(self._plan.slices)
        for sample in range(self._frames.shape[1]):
            seen = lanes[ends[:, sample] <= np.where(hit == rows.NEVER, np.iinfo(np.int64).max, hit)]
            if len(seen):
                self._frames[seen, sample] = self._features(seen, self._samples[seen, sample])

    def _info(self, lane: int, won: Any) -> dict[str, Any]:
        drawn, state = self._drawn[lane], self._now.state[lane]
        hit = None
        if state["collision_tick"] != rows.NEVER:
            hit = self._maker.name_of(int(self._now.watch[lane, TOUCHED]), drawn.layout)
        place = tuple(float(axis[lane]) for axis in self._place)
        course = one_course(self._course, lane)
        if CONDITIONS in drawn.course:
            course[CONDITIONS] = drawn.course[CONDITIONS]
        moment = Moment(None, place, hit, int(self._commands[lane]), course)  # type: ignore[arg-type]
        spent_s = int(self._spent_ns[lane]) / NS_PER_S
        info = {
            "is_success": bool(won),
            "position_m": list(place),
            "collision": hit,
            "commands": moment.commands,
            "wall_s": spent_s,
            "phase_s": {**dict.fromkeys(PHASES, 0.0), "simulation": spent_s},
            **self.task.info(moment),
        }
        if self.task.report_host_times:
            info["host_phase_s"] = {**dict.fromkeys(PHASES, 0.0), "simulation": float(self._host_s[lane])}
        return info

    def _merged(self, infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """Infos as Gymnasium's own vectors have them: an array a key, and one that says whose it is."""
        merged: dict[str, Any] = {}
        for lane, info in enumerate(infos):
            merged = self._add_info(merged, info, lane)
        return merged


def _pick(value: Any, lanes: Any) -> Any:
    return [_pick(each, lanes) for each in value] if isinstance(value, list) else value[lanes]


def _assign(whole: Any, lanes: Any, part: Any) -> None:
    if isinstance(whole, list):
        for each, new in zip(whole, part, strict=True):
            _assign(each, lanes, new)
    else:
        whole[lanes] = part


def seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """A seed for each environment, counted up from one, or as they are."""
    if seed is None:
        return [None] * count
    if isinstance(seed, (int, np.integer)):
        return [int(seed) + index for index in range(count)]
    if len(seed) != count:
        raise UserError(f"seed: {len(seed)} seeds for {count} environments")
    return [None if each is None else int(each) for each in seed]


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
