"""A task as kernels take it: games, sampled in the order in which `FlightEnv` samples, as rows; commands as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.commands import samples_due
from uavaccel.envs.arrays import named_leaves, rank, stacked
from uavaccel.envs.checks import Functions, known_options, layout_of
from uavaccel.envs.flight_env import sample_game
from uavaccel.envs.sensors import PICTURE_SIZE
from uavaccel.envs.simulators import check_conditions, clutter_of, kind_of, latency_of, profile_of, speed_of
from uavaccel.envs.task import AnyLayout, Task
from uavaccel.envs.values import CONDITIONS, Course
from uavaccel.kernels import timeline
from uavaccel.kernels.appearance import fill_scenes, read_appearance, read_looks
from uavaccel.kernels.bodies import Surroundings, read_scene, read_surroundings
from uavaccel.kernels.clutter_games import clutter_worlds
from uavaccel.kernels.events import camera_row
from uavaccel.kernels.fields import DEPTH, NO_APPEARANCE, NO_LOOKS, STATE, Appearance, Looks
from uavaccel.kernels.lanes import Games, game_rows
from uavaccel.kernels.scene import empty_scene
from uavaccel.kernels.timeline import Command, Latencies, Timing
from uavaccel.sim.lane import LaneLayout
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.scene import PLAIN
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S, ceil_div, exact, seconds_to_ns
from uavaccel.vision.noise import noise_seed
from uavaccel.wire.latency import BETWEEN_NS, DEFAULT, RESENT_NS, STALLED_NS, WAITS_MS, FaultConfig, LatencyConfig


class Drawn(NamedTuple):
    """A sampled game before it begins."""

    course: Course
    task: Task  # under the game's conditions
    layout: AnyLayout | None
    latencies: np.random.SeedSequence

    @property
    def own_course(self) -> Course:
        """The course without the conditions, which are no numbers of all games."""
        return {name: each for name, each in self.course.items() if name != CONDITIONS}


class GameMaker:
    """Samples a task's games and writes them into rows of `Games`."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self._world = World(task.scene, profile_of(task))
        self.surroundings: Surroundings = read_surroundings(self._world.model, task.scene)
        self.sees = kind_of(task) != STATE
        self.in_lane = task.scene == "lane" and task.picture_size == PICTURE_SIZE
        self.looks: Appearance | Looks = NO_APPEARANCE if self.surroundings.scene is None else NO_LOOKS
        if self.sees and self.in_lane:
            self.looks = read_appearance(self._world.model)
        elif self.sees:
            self.looks = read_looks(self._world.model, task.picture_size, task.observation == "depth")
        self.nominal = self._world.lead.parameters.copy()
        self._start = lru_cache(maxsize=64)(self._settled)

    def sample(self, random: np.random.Generator, games: int, options: Mapping[str, object] | None = None) -> Drawn:
        """Sample the next game of an environment that has had `games` before. Raises UserError for wrong options."""
        known = known_options(options, self.task.reset_options)
        course, latencies = sample_game(self.task, random, games, known)
        task = self.task.with_conditions(course.get(CONDITIONS, {}))
        check_conditions(self.task, task)
        return Drawn(course, task, layout_of(task, course), latencies)

    def courses(self, games: Sequence[Drawn], kept: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the courses of games over arrays, which are to replace some of `kept`.

        Raises UserError unless all have the same items, numbers of the same kinds.
        """
        with suppress(IndexError, KeyError, OverflowError, TypeError, ValueError):
            course = stacked([game.own_course for game in games])
            kinds = _ranks(course if kept is None else kept)
            if kinds.keys() == (now := _ranks(course)).keys() and all(now[name] <= kinds[name] for name in kinds):
                return course
        what = "over arrays, the courses of all games must have the same items, numbers of the same kinds"
        raise Functions(self.task).wrong("sample", f"{what}; or use simulator = mujoco")

    def rows(self, count: int) -> Games:
        """Allocate rows for `count` games."""
        scene, clutter, seen = self.surroundings.scene, clutter_of(self.task), None
        if scene is not None and clutter:
            scene, seen = clutter_worlds(clutter, scene, count)
        elif self.sees and not self.in_lane:
            seen = read_scene(self._world.model, seen=True)
        if scene is not None and not self.sees:
            seen = empty_scene(0, 0, 0, 0, seen=True)
        return game_rows(count, self.surroundings.most if scene is None else scene, seen)

    def write(self, drawn: Drawn, games: Games, row: int) -> None:
        """Fill a game's row, except for the accelerations at its start (kernels/lanes.refresh)."""
        task, layout = drawn.task, drawn.layout if isinstance(drawn.layout, LaneLayout) else None
        ratios = (1.0, 1.0) if layout is None else (layout.mass_ratio, layout.thrust_ratio)
        parameters, start, body = self._start(task.altitude_m, *ratios)
        games.parameters[row], games.start[row], games.body[row] = parameters, start, body
        games.start["wind"][row] = 0.0 if layout is None else layout.wind_m_s
        games.counts[row] = self.surroundings.put(drawn.layout, games, row)
        if isinstance(self.looks, Appearance) and self.sees and layout is not None:
            plain = replace(layout, scenery=PLAIN)  # whose depths are all sceneries'
            fill_scenes(self.looks, games.scenes, [row], [plain])
        games.cameras[row] = camera_row(task.dvs_parameters, task.image_noise)
        seed = noise_seed(drawn.latencies)
        games.seeds[row] = seed, task.events_seed(seed)

    def _settled(self, altitude_m: float, mass_ratio: float, thrust_ratio: float) -> tuple[np.void, np.void, Any]:
        """Return parameters, state and body (BODY_FIELDS,) of a settled hover. Raises UserError if none is possible."""
        world = self._world
        world.lead.set_airframe(mass_ratio, thrust_ratio)
        world.reset((0.0, 0.0, -altitude_m))
        data = world.data
        body = np.concatenate([data.qpos, data.qvel, data.qfrc_applied, np.zeros(6)])
        return world.lead.parameters.copy(), world.lead.state.copy(), body


def _ranks(course: Mapping[str, Any]) -> dict[str, int]:
    return {name: rank(array) for name, array in named_leaves(course, "course").items()}


def keys_of(task: Task, games: Sequence[Drawn]) -> dict[str, NDArray[np.float64]]:
    """Return the task's numbers under the conditions of n games, arrays (n,), for `Task.goal`; {} if it has none."""
    if type(task).with_conditions is Task.with_conditions:
        return {}
    names = [name for name, key in task if isinstance(key, float)]
    return {name: np.array([getattr(game.task, name) for game in games], float) for name in names}


class Slices(NamedTuple):
    """What is flown in each command where no message takes time (`passes_together`), S samples."""

    ticks: NDArray[np.int64]  # (S,): from each sample to the next, the first from the command's beginning
    wall_ns: NDArray[np.int64]  # (S,): that each takes in lockstep, the gap before a command with its first
    gap_ticks: int
    acts_in: int  # the slice in which the command's goal begins to act, `late_ticks` after the slice's beginning
    late_ticks: int


def slices_of(task: Task) -> Slices:
    """Return what a task's commands fly, gaps included."""
    tick_ns, speed = PROFILES[task.profile].tick_ns, exact(task.clock_speed)
    due_ns = [0, *samples_due(task.t_move_s, task.t_sample_s)]
    gap_ns, late_ns = gap_of(task)
    acts_in = max(number for number, begin_ns in enumerate(due_ns[:-1]) if begin_ns <= late_ns)
    late_ns -= due_ns[acts_in]
    legs_ns = [[later - earlier] for earlier, later in pairwise(due_ns)]
    legs_ns[acts_in] = [late_ns, legs_ns[acts_in][0] - late_ns]
    legs_ns[0].append(gap_ns)
    wall_ns = [sum(ceil_div(leg_ns * speed.denominator, speed.numerator) for leg_ns in legs) for legs in legs_ns]
    ticks = np.diff(due_ns) // tick_ns
    return Slices(ticks, np.array(wall_ns), gap_ns // tick_ns, acts_in, late_ns // tick_ns)


def gap_of(task: Task) -> tuple[int, int]:
    """Return the simulated ns for which a vehicle flies on before each command, and for which a command acts late."""
    return seconds_to_ns(task.mediation.gap_s), seconds_to_ns(task.mediation.image_age_s)


def plan_of(task: Task, hull: NDArray[np.float64], modes: NDArray[np.int64], pictures: bool) -> Command:
    """Describe a task's command for vehicles with this hull; `pictures`: whether the lanes render any.

    `modes` are those of all goals (envs/judging).
    """
    profile = profile_of(task)
    hold = profile.command_ticks(task.t_move_s) + profile.hover_after_ticks
    timing = timing_of(task, pictures)
    kept = task.mediation.start_speed
    start_speed = np.nan if kept is None else kept
    return Command(task.dvs_ticks or 0, profile.tick_ns, hull, modes, hold, start_speed, timing)


def since_ns_of(task: Task) -> int:
    """Return the wall time, ns, for which ADSC flies on between a command's end and the next decision."""
    return round(task.image_processing_s * NS_PER_S) if (task.timing, task.command) == ("virtual", "adsc") else 0


def timing_of(task: Task, pictures: bool) -> Timing:
    """Describe how a task's command passes on a lane's clock."""
    due_ns = samples_due(task.t_move_s, task.t_sample_s)
    slices_ns = [later - earlier for earlier, later in pairwise([0, *due_ns])]
    offsets_ns = [round(each / float(task.clock_speed)) for each in due_ns]
    profile, speed, asked = profile_of(task), speed_of(task), exact(task.clock_speed)
    latency, rules = latency_of(task), np.zeros(timeline.RULES, np.int64)
    platform, virtual = latency.platform, task.timing == "virtual"
    rules[timeline.IS_ADSC] = task.command == "adsc"
    rules[timeline.EXACT_PAUSES], rules[timeline.TICK_NS] = profile.exact_pauses, profile.tick_ns
    rules[timeline.SPEED], rules[timeline.TICK_WALL] = speed.numerator, profile.tick_ns * speed.denominator
    rules[timeline.ASKED], rules[timeline.ASKED_UNDER] = asked.numerator, asked.denominator
    rules[timeline.COMMAND_TICKS] = profile.command_ticks(task.t_move_s)
    rules[timeline.T_TH_NS] = task.t_th_ns
    rules[timeline.STALL_NS], rules[timeline.FRAME_NS] = round(platform.stall_us * 1e3), platform.frame_ns()
    rules[timeline.STALE_POSE] = bool(platform.frame_ns()) and platform.frames.stale_pose
    rules[timeline.AFTER_CONTINUE] = platform.frames.after_continue
    rules[timeline.IMAGES] = task.sensor().picture is not None
    rules[timeline.GUARDED] = pictures and virtual and kind_of(task) != DEPTH  # which has no brightness
    rules[timeline.PROCESSING_NS] = round(task.image_processing_s * NS_PER_S) if virtual else 0
    rules[timeline.LAYS_OUT] = task.layout(task.sample(np.random.default_rng(0), {})) is not None
    rules[timeline.LATENCY] = virtual
    rules[timeline.FAULTS] = platform.faults != FaultConfig()
    rules[timeline.GAP_NS], rules[timeline.LATE_NS] = gap_of(task)
    return Timing(rules, np.array(slices_ns), np.array(offsets_ns), _tables(latency))


def _tables(latency: LatencyConfig) -> Latencies:
    """Tabulate the quantiles of latencies by channel and wait (wire/latency.Latency)."""
    tables = np.zeros((timeline.TABLES, len(latency.quantiles)))
    for first, of in ((timeline.REQUEST, latency.request_us), (timeline.REPLY, latency.reply_us)):
        for place, channel in enumerate(timeline.CHANNELS):
            for wait, name in enumerate([channel, *(f"{channel}@{each}ms" for each in WAITS_MS)]):
                known = name if name in of else channel if channel in of else DEFAULT
                tables[first + place * timeline.WAITS + wait] = of[known]
    tables[timeline.ISSUE], tables[timeline.TIMER] = latency.issue_us, latency.timer_us
    tables[timeline.FRAME] = 2 * latency.platform.frame_ns() / 1e3 * np.array(latency.quantiles)
    faults = latency.platform.faults
    shares = np.cumsum([faults.dropped, faults.stalled, faults.late])
    delays = np.array([RESENT_NS, STALLED_NS, round(faults.late_us * 1e3), 0])
    return Latencies(np.array(latency.quantiles), tables, np.array(BETWEEN_NS), shares, delays)
