"""A task's commands and latencies, as the arrays that kernels take."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.commands.slices import samples_due
from uavaccel.envs.flyable import kind_of, latency_of, profile_of, speed_of
from uavaccel.envs.task import Task
from uavaccel.kernels import timeline
from uavaccel.kernels.fields import DEPTH
from uavaccel.kernels.timeline import Command, Latencies, Timing
from uavaccel.sim.profile import PROFILES
from uavaccel.units import NS_PER_S, ceil_div, exact, seconds_to_ns
from uavaccel.wire.latency import BETWEEN_NS, DEFAULT, WAITS_MS, LatencyConfig
from uavaccel.wire.platform import RESENT_NS, STALLED_NS, FaultConfig


class Slices(NamedTuple):
    """What is flown in each command where no message takes time (flyable.passes_together), S samples."""

    ticks: NDArray[np.int64]
    """(S,): ticks from each sample to the next, the first from the command's beginning."""
    wall_ns: NDArray[np.int64]
    """(S,): wall time that each takes in lockstep, the gap before a command with its first."""
    gap_ticks: int
    acts_in: int
    """The slice in which the command's goal begins to act, `late_ticks` after the slice's beginning."""
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
    ticks = slices_of(task).ticks
    return Command(ticks, task.dvs_ticks or 0, profile.tick_ns, hull, modes, hold, start_speed, timing)


def since_ns_of(task: Task) -> int:
    """Return the wall time, ns, for which ADSC flies on between a command's end and the next decision."""
    rules = _rules(task, False)
    return int(rules[timeline.PROCESSING_NS] * rules[timeline.IS_ADSC])


def timing_of(task: Task, pictures: bool) -> Timing:
    """Describe how a task's command passes on a lane's clock."""
    due_ns = samples_due(task.t_move_s, task.t_sample_s)
    slices_ns = [later - earlier for earlier, later in pairwise([0, *due_ns])]
    offsets_ns = [round(each / float(task.clock_speed)) for each in due_ns]
    return Timing(_rules(task, pictures), np.array(slices_ns), np.array(offsets_ns), _tables(latency_of(task)))


def _rules(task: Task, pictures: bool) -> NDArray[np.int64]:
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
    return rules


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
