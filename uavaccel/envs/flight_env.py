"""The Gymnasium environment of every task: one step flies one synchronous command, observed by the task's sensor."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, Generic

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.commands import COMMANDS
from uavaccel.envs.arrays import copied
from uavaccel.envs.checks import (
    RENDER_MODES,
    Functions,
    TaskT,
    check_features,
    check_render_mode,
    check_reward,
    known_options,
    layout_of,
    make_task,
    refuse_copy,
    seed_of,
    within,
)
from uavaccel.envs.sensors import NO_ACTION, EventCamera
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.envs.task import Mediation, Task, told_of
from uavaccel.envs.values import CONDITIONS, Action, Course, Frame, Info, Moment, Observation, State
from uavaccel.errors import UserError
from uavaccel.kinematics import Kinematics
from uavaccel.sim.camera import gl
from uavaccel.units import NS_PER_S, plain, seconds_to_ns

if TYPE_CHECKING:  # a task can be made without what flies it
    from uavaccel.envs.camera_client import FlightClient, Sample
    from uavaccel.envs.observer import Observer
    from uavaccel.sim.recording import Recording
    from uavaccel.wire.session import Session


def sample_game(
    task: Task, random: np.random.Generator, games: int, options: Mapping[str, object]
) -> tuple[Course, np.random.SeedSequence]:
    """Sample the next game of an environment that has had `games` before: its course, and the seed of its latencies."""
    course, latencies = task.sample(random, options), np.random.SeedSequence(int(random.integers(2**63)))
    conditions = task.sample_conditions(random, games)
    return {**course, CONDITIONS: conditions} if conditions else course, latencies


class FlightEnv(gymnasium.Env[Observation, Action], Generic[TaskT]):
    """An environment of a task, whose keys are the keywords of `gymnasium.make`; a subclass names the task.

    `reset` takes the `options` that the task knows. Infos have `is_success`, `position_m` (NED), `collision` (the
    object that was hit, or None), `commands`, `wall_s` (seconds on the game's own wall clock), `phase_s` (the same by
    phase), and the task's own items. Raises UserError for keywords that do not fit.
    """

    metadata: Info = {"render_modes": RENDER_MODES, "render_fps": 10}  # noqa: RUF012 - Gymnasium's own
    task_class: type[TaskT]

    def __init__(self, render_mode: str | None = None, **keys: object) -> None:
        from uavaccel.vision.noise import ImageNoise

        self.task: TaskT = make_task(self.task_class, keys, type(self).__name__)
        self.episode_task: TaskT = self.task
        """The task under the running game's conditions."""
        self._games = 0
        self.over = False
        """Whether the last step has ended the game."""
        self.render_mode = check_render_mode(render_mode)
        self.observation_space = self.task.observation_space()
        self.action_space = self.task.action_space()
        self.sensor, self._told = self.task.sensor(), self.task.told
        self._context = self.task.context_planes()
        self._frames: deque[Frame] = deque(maxlen=self.task.frames_per_command * self.task.history)
        self._taken_ns: deque[int] = deque(maxlen=self._frames.maxlen)
        self._acted, self._decides_ns = NO_ACTION, 0  # which and when, for what is told beside the frames
        self._session: Session | None = None
        self._client: FlightClient | None = None
        self._noise = ImageNoise()
        self._observers: list[Observer] = []
        self._stopwatches: list[Stopwatch] = []
        self._now: Moment
        self._conditions: Info = {}
        self._flown: list[tuple[Any, ...]] = []  # what changed the running game: a method and its arguments

    # --- Gymnasium --------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, object] | None = None
    ) -> tuple[Observation, Info]:
        """Begin a game in a settled hover; all frames of the first observation show the start, or are blank.

        Raises UserError for options that the task does not know, and for a lane that cannot be built.
        """
        super().reset(seed=seed_of(seed))
        options = known_options(options, self.task.reset_options)
        self._games, self._flown = self._games + 1 if seed is None else 1, []
        self._begun, self._options = self._next_game(), options
        self._start_game(*sample_game(self.task, self.np_random, self._games - 1, options))
        self.over = False
        return self._observation(), self._info()

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, Info]:
        """Fly one command. Raises UserError before the first `reset`, and for an action outside the space."""
        from uavaccel.wire.rpc import RpcError

        if self._client is None:
            raise UserError("reset the environment before its first step")
        action, before = within(self.action_space, action), self._now
        self._flown.append(("step", plain(action)))
        self._switch("simulation")
        try:
            now = self._fly(self._client, action)
        except RpcError as error:  # what the server refused of a goal
            raise Functions(self.task).wrong("goal", error.reason) from error
        self._switch(None)
        self._now = now._replace(course=self.task.advance(before, now))
        success = self.task.success(self._now)
        terminated = success or self.task.failure(self._now)
        truncated = not terminated and self._now.commands >= self.task.max_commands
        self.over = bool(terminated or truncated)
        info = self._info() | (self._host_disturbances() if self.over else {})
        check_reward(self.task, reward := self.task.reward(before, self._now))
        return self._observation(), reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """Return the front camera's picture (144, 256, 3) uint8; None without a render mode."""
        if self._client is None or self.render_mode is None:
            return None
        self._flown.append(("render",))
        return self._client.client.image("colour")

    def pop_events(self) -> NDArray[np.float32]:
        """Return the running game's events (n, 4) since the last call: rows (t in s, x, y, p = 1 or -1).

        Raises UserError unless the task has `list_events`.
        """
        if not self.task.list_events or not isinstance(self.sensor, EventCamera):
            raise UserError("list_events must be true for a list of events")
        return self.sensor.counter.pop_events()

    def recording(self) -> Recording:
        """Return the present game's path and commands so far. Raises UserError before the first `reset`."""
        if self._client is None:
            raise UserError("reset the environment before asking for its recording")
        self._flown.append(("recording",))
        return self._client.client.recording()

    def add_observer(self, observer: Observer) -> None:
        """Register an observer, which is called from the next game on."""
        self._observers.append(observer)

    def close(self) -> None:
        if self._session is not None:
            self._session.close()
        self._session = self._client = None

    def __getstate__(self) -> object:
        return super().__getstate__() if self._session is None else refuse_copy(self)

    # --- time, and going on after a stop ----------------------------------------------------------

    def charge(self, duration_s: float, phase: str = "inference") -> None:
        """Charge the agent's work since the last command to the wall clock of `virtual`; no effect in other timings."""
        if self.task.timing != "virtual" or self._client is None:
            return
        self._flown.append(("charge", duration_s, phase))
        self._client.client.transport.clock.charge(round(duration_s * NS_PER_S))
        self._stopwatches[0].add(phase, duration_s)

    def get_state(self) -> State:
        """Return what the running game was flown from, between two steps, for np.savez: texts and numbers.

        Another environment of this task flies it again. In `wall`, where that cannot be done, and before the first
        game it is only what the next game is sampled from.
        """
        if self.task.timing == "wall" or self._client is None:
            return {**self._next_game(), "games": self._games}
        flown = {"options": self._options, "flown": self._flown}
        texts = {name: json.dumps(each, default=plain) for name, each in flown.items()}
        return {**self._begun, **texts, "digest": self._digest()}

    def set_state(self, state: Mapping[str, Any]) -> Observation:
        """Fly the game of `get_state` again, or begin one if none was running; returns the last observation.

        Observers see it from its beginning; pictures are drawn again. Raises UserError where it does not end in the
        same state.
        """
        self.np_random.bit_generator.state = json.loads(str(state["generator"]))
        self._games = int(state["games"])
        observation, _ = self.reset(options=json.loads(str(state.get("options", "{}"))))
        if "flown" not in state:
            return observation
        for name, *arguments in json.loads(str(state["flown"])):
            if name == "step":
                observation = self.step(np.asarray(arguments[0], self.action_space.dtype))[0]
            elif name in ("charge", "recording", "render"):
                getattr(self, name)(*arguments)
            else:
                raise UserError(f"a saved game: {name!r} is no part of one")
        if self._digest() != str(state["digest"]):
            raise UserError(
                "a saved game, flown again, did not end as it was saved: go on with the versions and on the kind of "
                "machine that saved it, or begin anew"
            )
        return observation

    def _next_game(self) -> State:
        """Return what a game is sampled from that begins now."""
        return {"generator": json.dumps(self.np_random.bit_generator.state), "games": self._games - 1}

    def _digest(self) -> str:
        """Return a hash of where the game is: its moment, its wall clock, and what the next game is sampled from."""
        assert self._client is not None
        reached = self._now, self._client.now_ns(), self.np_random.bit_generator.state
        return hashlib.sha256(repr(reached).encode()).hexdigest()

    # --- a game -----------------------------------------------------------------------------------

    def _opened(self, course: Course) -> Session:
        """Return the session; task, sensor and latency model follow the conditions of this game."""
        from uavaccel.wire.session import open_session

        task, before = self.task, self.episode_task
        if self.sensor.picture is not None:
            gl.check_process()
        if self._session is None:
            self._session = open_session(task.timing, task.profile, task.scene, before.latency)
            if task.dvs_ticks and not task.blank_images:
                self._session.watch(task.dvs_ticks, self._look)
        self._conditions = {name: course[name] for name in (CONDITIONS,) if name in course}
        self.episode_task = task = task.with_conditions(course.get(CONDITIONS, {}))
        if task.dvs_parameters != before.dvs_parameters:
            self.sensor = task.sensor()
        if task.latency.scale != before.latency.scale:
            self._session.set_latency(task.latency)
        return self._session

    def _look(self, time_ns: int) -> None:
        """Let the event camera see a frame between two samples; it is on board, so nothing is charged."""
        assert isinstance(self.sensor, EventCamera)
        assert self._session is not None
        if not self._stopwatches:  # latencies may let time pass before a game begins
            return
        with ExitStack() as phases:
            for stopwatch in self._stopwatches:
                phases.enter_context(stopwatch.aside("image_processing"))
            picture = self._noise.add(self._session.picture(self.task.picture_size), time_ns)
            self.sensor.counter.process_frame(picture, time_ns - self._began_ns)

    def _in_game(self, state: Kinematics) -> Kinematics:
        """Return a state with the time since the game's start, from which a task and its sensor count."""
        return replace(state, time_ns=state.time_ns - self._began_ns)

    def _start_game(self, course: Course, latencies: np.random.SeedSequence) -> None:
        from uavaccel.envs.camera_client import FlightClient
        from uavaccel.envs.observer import Game
        from uavaccel.vision.noise import ImageNoise, noise_seed
        from uavaccel.wire.rpc import RpcError

        session, self._stopwatches = self._opened(course), []
        task = self.episode_task
        lane, height_m = task.layout(course), -task.altitude_m
        try:
            started = session.start_game(task.clock_speed, latencies, lane=lane, height_m=height_m)
        except RpcError as error:
            layout_of(task, course)  # raises UserError for what the server refused
            raise Functions(task).wrong("altitude_m", error.reason) from error
        self._start_ns = started.now_ns()
        self._stopwatches = [Stopwatch(started.transport.clock)]
        if task.report_host_times:
            self._stopwatches.append(Stopwatch(MonotonicClock()))
        client = FlightClient(started, self.sensor.picture, self._stopwatches, task.picture_size)
        self._client, start, seed = client, client.kinematics(), noise_seed(latencies)
        self._noise = client.noise = ImageNoise(task.image_noise, seed, start.time_ns)
        if isinstance(self.sensor, EventCamera):
            self.sensor.noise_seed = task.events_seed(seed)
        first, self._began_ns = client.read_sample(start), start.time_ns
        self._switch(None)
        state = self._in_game(first.state)
        self._now = Moment(state, state.position_m, None, 0, course)
        frame = self.sensor.reset(state, first.image, course)
        seen = self._checked(frame) if task.sees_start and not task.blank_images else self.sensor.blank
        self._frames.extend([seen] * (self._frames.maxlen or 0))
        self._taken_ns.extend([state.time_ns] * (self._frames.maxlen or 0))
        self._acted, self._decides_ns = NO_ACTION, state.time_ns
        COMMANDS[task.command].begin(client)
        game = Game(task, session, self._noise, first.state)
        for observer in self._observers:
            observer.game_begun(game)

    def _fly(self, client: FlightClient, action: Action) -> Moment:
        """Fly one command; after a collision it stops at the next sample, and the remaining frames are blank."""
        task, now = self.episode_task, self._now
        goal = task.goal(action.astype(np.float64) if isinstance(self.action_space, spaces.Box) else action)
        missing = task.frames_per_command
        taken_ns, gathered_ns, ended_ns = [], 0, 0
        if task.mediation != Mediation():
            self._fly_gap(client, task.mediation)
        times = task.t_move_s, task.t_sample_s, task.t_th_ns, seconds_to_ns(task.mediation.image_age_s)
        for sample in COMMANDS[task.command].fly(client, goal, *times):
            gathered_ns = client.now_ns()
            for observer in self._observers:
                observer.sample_taken(sample, now.commands)
            sample = sample._replace(state=self._in_game(sample.state))
            ended_ns = sample.state.time_ns
            if sample.collision:
                north, east, down = sample.collision["position_m"]
                now = now._replace(position_m=(north, east, down), collision=sample.collision["object"])
                break
            now = now._replace(state=sample.state, position_m=sample.state.position_m)
            self._frames.append(self._observe(sample))
            taken_ns.append(sample.state.time_ns)
            missing -= 1
        self._frames.extend([self.sensor.blank] * missing)
        if self._context is not None:
            since_ns = client.now_ns() - gathered_ns if task.command == "adsc" else 0  # TCSC's clock is paused
            self._acted, self._decides_ns = int(action), ended_ns + round(since_ns * task.clock_speed)
            self._taken_ns.extend([*taken_ns, *[self._decides_ns] * missing])
        return now._replace(commands=now.commands + 1)

    def _fly_gap(self, client: FlightClient, gap: Mediation) -> None:
        """Fly on before a command, and begin it as `gap` says."""
        assert self._session is not None
        before = None if gap.start_speed is None else self._session.motion()
        if gap.gap_s:
            client.continue_for(seconds_to_ns(gap.gap_s))
        if before is not None and gap.start_speed is not None:
            self._session.resume(before, gap.start_speed)

    def _observe(self, sample: Sample) -> Frame:
        self._switch("image_processing")
        frame = self.sensor.blank
        if not self.task.blank_images:
            frame = self._checked(self.sensor.frame(sample.state, sample.image, self._now.course))
        if self.task.timing == "virtual" and self._client is not None:
            self._client.client.transport.clock.charge(round(self.task.image_processing_s * NS_PER_S))
        self._switch("simulation")
        return frame

    def _checked(self, frame: Frame) -> Frame:
        if self.task.observation == "state":
            check_features(self.task, frame, self.sensor.blank.shape)
        return frame

    def _switch(self, phase: str | None) -> None:
        for stopwatch in self._stopwatches:
            stopwatch.switch(phase)

    def _observation(self) -> Observation:
        frames = np.concatenate(self._frames)
        if self._context is not None:
            ages_ns = self._decides_ns - np.array([self._taken_ns])
            frames = np.concatenate([frames, *self._context.observe(np.array([self._acted]), ages_ns)])
        if not self.task.also_state:
            return frames
        state = np.zeros(self._told, np.float32)
        if self._now.free:
            state = np.asarray(self.task.features(self._now.state, self._now.course), np.float32).ravel()
            check_features(self.task, state, (self._told,))
        return {"image": frames, "state": state}

    def _info(self) -> Info:
        wall_s = (self._client.now_ns() - self._start_ns) / NS_PER_S if self._client else 0.0
        spent = {"wall_s": wall_s, "phase_s": self._stopwatches[0].spent_s()}
        host = {"host_phase_s": self._stopwatches[1].spent_s()} if self.task.report_host_times else {}
        own = copied({**self.task.info(self._now), **self._conditions})  # not the game's
        return {**told_of(self.task, self._now), **spent, **own, **host}

    def _host_disturbances(self) -> Info:
        """Return the seconds of wall time that a finished game in `wall` lost, and for which its server stalled."""
        if self.task.timing != "wall" or self._client is None:
            return {}
        client = self._client.client
        found = {"lost_wall_s": client.speed()["lost_wall_ns"], "stalled_wall_s": client.transport.stalled_ns}
        return {name: spent_ns / NS_PER_S for name, spent_ns in found.items() if spent_ns}


@cache
def environment_of(found: type[Task] | type[FlightEnv[Any]]) -> type[FlightEnv[Any]]:
    """Return an environment's class, for the class of a task one that flies it; processes import both by one name."""
    if issubclass(found, FlightEnv):
        return found
    names = {"task_class": found, "__module__": found.__module__, "__qualname__": found.__qualname__}
    return type(found.__name__, (FlightEnv,), names)
