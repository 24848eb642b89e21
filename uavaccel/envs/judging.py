"""What a command comes to in many games at once: judged, observed and reported over arrays or PyTorch's tensors.

So lanes on the CPU and on a GPU treat a task's functions alike, as `FlightEnv` treats them game by game.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from uavaccel.envs.agreement import check_agreement
from uavaccel.envs.arrays import cast, full, joined, mapped, namespace_of, picture_of
from uavaccel.envs.checks import Functions, as_sampled, check_features, check_reward
from uavaccel.envs.sensors import NO_ACTION
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import RAD, Task
from uavaccel.envs.values import Action, Collisions, Info, Moments, Number
from uavaccel.errors import UserError
from uavaccel.kernels.bodies import Surroundings
from uavaccel.kinematics import AttitudeGoal, BodyRatesGoal, FlightGoal, Kinematics, VelocityGoal
from uavaccel.own_code import file_of
from uavaccel.sim import flight as goals
from uavaccel.sim.vehicle.autopilot import THROTTLE, Goal, Yaw
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, KINEMATICS, NEVER
from uavaccel.units import NS_PER_S


class Running(NamedTuple):
    """What n running games carry from one command to the next: arrays (n, ...)."""

    course: Mapping[str, Any]  # as in `Moments`
    numbers: Number  # (n, KINEMATICS) float64: the state of the last sample, of those before a collision
    time_ns: Number  # (n,) int64: its simulated time
    position_m: Number  # (n, 3) float64: position or, after a collision, first contact; NED
    collision: Number  # (n,) int64: index into the names of all that can be hit, -1 without a collision
    commands: Number  # (n,) int64
    actions: Number  # (n,) int64: the last discrete action, NO_ACTION before the first
    taken_ns: Number  # (n, frames) int64: when the frames of the observation were taken
    observations: Any  # (n, ...), or a mapping of such arrays


class Flown(NamedTuple):
    """How a command was flown in n games, with S samples: arrays (n, ...)."""

    numbers: Number  # (n, KINEMATICS) float64: the state at its end
    tick: Number  # (n,) int64: the tick at its end
    position_m: Number  # (n, 3) float64: as in `Running`
    collision: Number  # (n,) int64: as in `Running`
    ticks: Number  # (n, S) int64: ticks of its samples
    taken: Number  # (n,) int64: number of samples before a collision
    samples: Number  # (n, S, KINEMATICS) float64: the states of the samples
    pictures: Number  # (n, S, ...): their frames, blank where there is none; not read with observation "state"


class Judged(NamedTuple):
    """How a command ended in n games: arrays (n,)."""

    reward: Number
    success: Number
    terminated: Number
    truncated: Number


class Judge:
    """A task's functions over many games.

    `since_ns` is the wall time for which ADSC flies on before a decision. Raises UserError for a task whose `goal`
    takes no arrays, and as `check_agreement`.
    """

    def __init__(self, task: Task, surroundings: Surroundings, tick_ns: int, since_ns: int = 0) -> None:
        self.task, self._surroundings, self._tick_ns, self._since_ns = task, surroundings, tick_ns, since_ns
        self.objects = (*surroundings.obstacle_names, *surroundings.names)
        space = task.action_space()
        self.discrete = not space.shape  # an action is one number
        self._kind = "float64" if isinstance(space, spaces.Box) else "int64"
        self._context, self._blank = task.context_planes(), task.sensor().blank
        self._sees_state = task.observation == "state" and not task.blank_images
        any_goal = self._goal(np.zeros((2, *(space.shape or ())), space.dtype), {})
        self.modes = np.array(_modes_of(any_goal))
        """What the four numbers of all goals are: the autopilot's modes of xy, z and yaw."""
        check_agreement(task)

    # --- before a command -----------------------------------------------------------------------

    def goals(self, actions: Action, keys: Mapping[str, Number]) -> Number:
        """Return the goals (n, 4) float64 of actions (n, ...), given keys of the task that differ from game to game.

        Raises UserError for a goal that takes no arrays, or is of another kind than the first.
        """
        goal = self._goal(actions, keys)
        if _modes_of(goal) != tuple(self.modes):
            raise Functions(self.task).wrong("goal", "all actions must ask for the same kind of goal")
        like = cast(actions.reshape(len(actions), -1)[:, 0], "float64")
        numbers = joined([full(number, like) for number in goal.values], like)
        if isinstance(numbers, np.ndarray) and not np.isfinite(numbers).all():  # nothing waits for a GPU
            raise Functions(self.task).wrong("goal", "returned a number that is not finite")
        return numbers

    def _goal(self, actions: Action, keys: Mapping[str, Number]) -> Goal:
        task = self.task.model_copy(update=dict(keys)) if keys else self.task
        given = actions if self.discrete else namespace_of(actions).moveaxis(cast(actions, self._kind), 0, -1)
        goal: Goal = self._over_arrays("goal", actions, lambda: autopilot_goal(task.goal(given)))
        return goal

    # --- a game's beginning -----------------------------------------------------------------------

    def begun(self, course: Mapping[str, Any], numbers: Number, pictures: Number | None) -> Running:
        """Return games that begin, from their states (n, KINEMATICS) and pictures (n, ...), None for blank ones."""
        xp, frames = namespace_of(numbers), self.task.frames_per_command * self.task.history
        none = cast(xp.zeros_like(numbers[:, 0]), "int64")
        if self._sees_state and self.task.sees_start:
            pictures = self._finite(self._features(course, numbers, none))
        elif pictures is None:
            level, shape = int(self._blank.flat[0]), (len(none), *self._blank.shape)
            pictures = xp.full(shape, level, dtype=getattr(xp, self._blank.dtype.name), device=none.device)
        ages_ns = xp.stack([none] * frames, 1)
        seen = self._with_context(xp.concatenate([pictures] * frames, 1), none + NO_ACTION, ages_ns)
        begun = Running(course, numbers, none, numbers[:, :3], none - 1, none, none + NO_ACTION, ages_ns, seen)
        return begun._replace(observations=self._beside_state(begun))

    # --- after a command ------------------------------------------------------------------------

    def end(self, flight: Number, ticks: Number, solids: Number, counts: Number) -> tuple[Number, Number, Number]:
        """Return states (n, KINEMATICS), positions (n, 3) and collisions (n,) of flights.

        `flight` and `ticks` (n, columns) are FLIGHT_DTYPE as float64 and as int64; `solids` (n,) ended the flights, and
        `counts` (n,) is how many there are in the games.
        """
        xp, touched = namespace_of(flight), ticks[:, COLLISION] != int(NEVER)
        position_m = xp.where(touched[:, None], flight[:, CONTACT : CONTACT + 3], flight[:, 1:4])
        around = self._surroundings
        obstacles = counts - len(around.fixed)
        beyond = solids - obstacles + len(around.obstacle_names)
        collision = xp.where(solids < obstacles, solids, beyond) if around.scene is None else solids
        return flight[:, 1 : 1 + KINEMATICS], position_m, xp.where(touched, collision, -1)

    def after(self, before: Running, flown: Flown, actions: Number) -> tuple[Running, Judged]:
        """Return the games after a command, and how it ended; `actions` (n,) are those of a discrete space.

        Their observations have the pictures from before it, until `observe`: cameras need not have rendered yet.
        """
        xp = namespace_of(flown.numbers)
        seen, taken_ns = self._times(flown)
        free, some, last = flown.collision < 0, flown.taken > 0, (flown.taken - 1).clip(0)
        row = xp.arange(len(last), device=last.device)
        numbers = xp.where(some[:, None], flown.samples[row, last], before.numbers)  # before a collision
        time_ns = xp.where(some, flown.ticks[row, last] * self._tick_ns, before.time_ns)
        now = before._replace(
            numbers=xp.where(free[:, None], flown.numbers, numbers),
            time_ns=xp.where(free, flown.tick * self._tick_ns, time_ns),
            position_m=flown.position_m,
            collision=flown.collision,
            commands=before.commands + 1,
            actions=actions if self.discrete else before.actions,
            taken_ns=xp.concatenate([before.taken_ns, taken_ns], 1)[:, taken_ns.shape[1] :],
        )
        if self._sees_state:
            frames = self._frames_of_states(before.course, flown, seen)
            now = now._replace(observations=self._later(before.observations, frames, now, flown))
        course, judged = self._judge(self.moments(before), self.moments(now))
        now = now._replace(course=course)
        return now._replace(observations=self._beside_state(now)), judged

    def observe(self, games: Running, flown: Flown) -> Any:
        """Return the observations of games `after` a command, with its pictures."""
        if self._sees_state:
            return games.observations
        frames = flown.pictures.reshape(len(flown.tick), -1, *self._blank.shape[1:])
        pictures = self._later(picture_of(games.observations), frames, games, flown)
        return {**games.observations, "image": pictures} if self.task.also_state else pictures

    def _later(self, pictures: Number, frames: Number, now: Running, flown: Flown) -> Number:
        """Return pictures (n, ...) in which a command's frames (n, S * ..., ...) have replaced the oldest."""
        earlier = pictures[:, frames.shape[1] : frames.shape[1] * self.task.history]
        frames = namespace_of(frames).concatenate([earlier, frames], 1)
        if self._context is None:
            return frames
        return self._with_context(frames, now.actions, self._decided_ns(flown)[:, None] - now.taken_ns)

    def moments(self, games: Running) -> Moments:
        """Return the games as the task's functions take them."""
        state, collision = kinematics_of(games.numbers, games.time_ns), Collisions(games.collision, self.objects)
        return Moments(state, list(games.position_m.T), collision, games.commands, games.course)

    def _judge(self, before: Moments, flown: Moments) -> tuple[Mapping[str, Any], Judged]:
        """Judge a command as `FlightEnv.step` judges one."""
        task, like = self.task, flown.commands
        course = self._over_arrays("advance", like, lambda: task.advance(before, flown))
        now = flown._replace(course=as_sampled(task, course, flown.course))
        success = self._over_arrays("success", like, lambda: full(task.success(now), like) != 0)
        failure = self._over_arrays("failure", like, lambda: full(task.failure(now), like) != 0)
        reward = self._over_arrays("reward", like, lambda: full(task.reward(before, now), like))
        if isinstance(reward, np.ndarray):
            for wrong in reward[~np.isfinite(reward)][:1]:
                check_reward(task, float(wrong))
        terminated = success | failure
        truncated = ~terminated & (now.commands >= task.max_commands)
        return now.course, Judged(reward, success, terminated, truncated)

    def _times(self, flown: Flown) -> tuple[Number, Number]:
        """Return which samples (n, S) precede a collision, and the frames' times.

        Frames that a collision leaves blank are of the time of the next decision.
        """
        xp = namespace_of(flown.tick)
        seen = xp.arange(flown.ticks.shape[1], device=flown.ticks.device) < flown.taken[:, None]
        return seen, xp.where(seen, flown.ticks * self._tick_ns, self._decided_ns(flown)[:, None])

    def _decided_ns(self, flown: Flown) -> Number:
        """Return the simulated time (n,) of the next decision."""
        present_ns = flown.tick * self._tick_ns
        if not self._since_ns:
            return present_ns
        since_ns = self._since_ns * cast(flown.collision < 0, "float64") * float(self.task.clock_speed)
        return present_ns + cast(since_ns.round(), "int64")

    # --- what is observed -------------------------------------------------------------------------

    def _frames_of_states(self, course: Mapping[str, Any], flown: Flown, seen: Number) -> Number:
        """Return the command's frames (n, S * ..., ...), the oldest first, which show the course before it."""
        xp, frames = namespace_of(seen), []
        for sample in range(seen.shape[1]):
            shown = self._features(course, flown.samples[:, sample], flown.ticks[:, sample] * self._tick_ns)
            which = seen[:, sample].reshape(-1, *(1,) * self._blank.ndim)
            frames.append(xp.where(which, shown, xp.zeros_like(shown)))
        return self._finite(xp.concatenate(frames, 1))

    def _features(
        self, course: Mapping[str, Any], numbers: Number, time_ns: Number, shape: tuple[int, ...] | None = None
    ) -> Number:
        """Return the frames (n, ...) float32 of observation "state", or these in another shape."""
        state, shape = kinematics_of(numbers, time_ns), (len(numbers), *(shape or self._blank.shape))
        like, own = numbers[:, 0], type(self.task).features is not Task.features

        def frames() -> Number:
            made: Any = self.task.features(state, course) if own else self.task.fields(state, course)
            if not own:
                made = mapped(lambda number: cast(full(number, like), "float64"), list(made))
            is_listed = isinstance(made, list | tuple)
            made = joined(made, like) if is_listed else namespace_of(like).moveaxis(made, -1, 0)
            return cast(made, "float32").reshape(shape)

        with np.errstate(all="ignore"):  # what is computed after a collision is not shown
            return self._over_arrays("features" if own else "fields", like, frames)

    def _beside_state(self, games: Running) -> Number | Mapping[str, Number]:
        """Return the observations: frames, or with `also_state` a mapping of those and of states, 0 after a touch."""
        if not self.task.also_state:
            return games.observations
        state = self._features(games.course, games.numbers, games.time_ns, (-1,))
        free = (games.collision < 0)[:, None]
        xp = namespace_of(state)
        beside = self._finite(xp.where(free, state, xp.zeros_like(state)))
        return {"image": picture_of(games.observations), "state": beside}

    def _finite(self, seen: Number) -> Number:
        """Return what is observed of states (n, ...). Raises UserError for a number of an array that is not finite."""
        if isinstance(seen, np.ndarray):
            for wrong in seen[~np.isfinite(seen).all(tuple(range(1, seen.ndim)))][:1]:
                check_features(self.task, wrong, wrong.shape)
        return seen

    def _with_context(self, frames: Number, actions: Number, ages_ns: Number) -> Number:
        """Return frames with the task's context planes (envs/sensors) behind them."""
        if self._context is None:
            return frames
        return namespace_of(frames).concatenate([frames, self._context.observe(actions, ages_ns)], 1)

    # --- what is reported -------------------------------------------------------------------------

    def infos(self, games: Running, success: Number, wall_ns: Number, phases_ns: Number) -> Info:
        """Return the infos of n games as arrays, or lists of them, with the items that `FlightEnv` gives each.

        `collision` is an index into `objects`; `phases_ns` (n, phases) is the wall time spent in each of PHASES.
        """
        own = self._over_arrays("info", wall_ns, lambda: self.task.info(self.moments(games)))
        wall_s, phases_s = (cast(spent_ns, "float64") / NS_PER_S for spent_ns in (wall_ns, phases_ns))
        return {
            "is_success": success,
            "position_m": games.position_m,
            "collision": games.collision,
            "commands": games.commands,
            "wall_s": wall_s,
            "phase_s": dict(zip(PHASES, list(phases_s.T), strict=True)),
            **own,
        }

    def _over_arrays(self, name: str, like: Number, call: Callable[[], Any]) -> Any:
        """Call the task's function of that name with arrays such as `like`. Raises UserError where it takes none."""
        torch = None if isinstance(like, np.ndarray) else namespace_of(like)
        before = torch and torch.get_default_dtype()
        if torch is not None:  # so that a number times a flag is computed in double precision
            torch.set_default_dtype(torch.float64)
        try:
            return call()
        except UserError:
            raise
        except Exception as error:
            file = file_of(type(self.task))
            raise UserError(
                f"simulator = kernels: {f'{file}: ' if file else ''}{type(self.task).__name__}.{name} must compute "
                f"with plain arithmetic, the same for numbers and arrays ({type(error).__name__}: {error}); or use "
                "simulator = mujoco"
            ) from error
        finally:
            if torch is not None:
                torch.set_default_dtype(before)


def autopilot_goal(goal: FlightGoal) -> Goal:
    """Return the autopilot's goal, as the server makes it of AirSim's command (wire/flight_api)."""
    if isinstance(goal, VelocityGoal):  # whose yaw AirSim's commands take in degrees
        return goals.of_velocity(replace(goal, yaw=goal.yaw * (180.0 / math.pi) * RAD))
    if isinstance(goal, AttitudeGoal):
        return goals.attitude(goal.roll_rad, goal.pitch_rad, Yaw(goal.yaw_rate_rad_s), goal.throttle, THROTTLE)
    if isinstance(goal, BodyRatesGoal):
        rates = goal.roll_rad_s, goal.pitch_rad_s, goal.yaw_rad_s
        return goals.body_rates(*rates, goal.throttle, THROTTLE)
    return goals.motors(goal.front_right, goal.rear_left, goal.front_left, goal.rear_right)


def kinematics_of(numbers: Number, time_ns: Number) -> Kinematics:
    """Return the kinematics of n states (n, KINEMATICS), as arrays or tensors (n,)."""
    columns, ends = list(numbers.T), (0, 3, 7, 10, 13, 16, KINEMATICS)
    parts = [columns[first:last] for first, last in pairwise(ends)]
    return Kinematics(time_ns, *parts)  # type: ignore[arg-type]


def _modes_of(goal: Goal) -> tuple[int, int, int]:
    return goal.xy_mode, goal.z_mode, goal.yaw_mode


# Columns of FLIGHT_DTYPE, all of whose numbers have eight bytes.
_FIELDS: Any = FLIGHT_DTYPE.fields
TICK, COLLISION, CONTACT = (int(_FIELDS[name][1]) // 8 for name in ("tick", "collision_tick", "contact_position"))
