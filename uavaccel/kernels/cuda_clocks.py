"""Lanes' clocks on one GPU: kernels/lane_clocks as CUDA kernels, a thread a lane."""

from __future__ import annotations

from typing import NamedTuple

from numba import cuda

from uavaccel.kernels import lane_clocks as of_lane
from uavaccel.kernels.operands import Launchable


def begin(renewed, rows, scales, games, timing, clocks):  # type: ignore[no-untyped-def]
    """Of lanes that begin the games of these rows (L,)."""
    lane = cuda.grid(1)
    if lane < len(renewed) and renewed[lane] != 0:
        of_lane.begin(lane, rows[lane], scales[rows[lane]], games, timing, clocks)


def show_start(renewed, levels, timing, clocks):  # type: ignore[no-untyped-def]
    """Of lanes whose first picture is there."""
    lane = cuda.grid(1)
    if lane < len(renewed) and renewed[lane] != 0:
        of_lane.show_start(lane, levels, timing, clocks)


def issue(going, now, timing, clocks, legs):  # type: ignore[no-untyped-def]
    """Of lanes that fly."""
    lane = cuda.grid(1)
    if lane < len(going) and going[lane] != 0:
        of_lane.issue(lane, now, timing, clocks, legs)


def take(going, hold_ticks, directions, games, now):  # type: ignore[no-untyped-def]
    """Of lanes that have flown to where their commands act."""
    lane = cuda.grid(1)
    if lane < len(going) and going[lane] != 0:
        of_lane.take(lane, hold_ticks, directions, games, now)


def reach(going, sample, now, timing, clocks, looking, legs):  # type: ignore[no-untyped-def]
    """Of lanes that fly; `looking` (L,) is 0 for all others."""
    lane = cuda.grid(1)
    if lane < len(going):
        looking[lane] = 0
        if going[lane] != 0:
            of_lane.reach(lane, sample, now, timing, clocks, looking, legs)


def leave(looking, sample, levels, now, timing, clocks):  # type: ignore[no-untyped-def]
    """Of lanes that have a sample."""
    lane = cuda.grid(1)
    if lane < len(looking) and looking[lane] != 0:
        of_lane.leave(lane, sample, levels, now, timing, clocks)


def split(which, now, clocks, legs, to_shown):  # type: ignore[no-untyped-def]
    """Of lanes that are about to fly."""
    lane = cuda.grid(1)
    if lane < len(which) and which[lane] != 0:
        of_lane.split(lane, now, clocks, legs, to_shown)


def keep(which, now, clocks, to_shown):  # type: ignore[no-untyped-def]
    """Of lanes that have flown to what is shown."""
    lane = cuda.grid(1)
    if lane < len(which) and which[lane] != 0 and to_shown[lane] >= 0:
        of_lane.keep_shown(lane, now, clocks)


def turn(looking, now, clocks):  # type: ignore[no-untyped-def]
    """Of lanes that look."""
    lane = cuda.grid(1)
    if lane < len(looking) and looking[lane] != 0:
        of_lane.turn_to_shown(lane, now, clocks)


class ClockKernels(NamedTuple):
    """What can be launched; the first argument says which lanes are meant, (L,) uint8."""

    begin: Launchable
    show_start: Launchable
    issue: Launchable
    take: Launchable
    reach: Launchable
    leave: Launchable
    split: Launchable
    keep: Launchable
    turn: Launchable


def compiled() -> ClockKernels:
    """The kernels, from numba's cache if they are there."""
    functions = begin, show_start, issue, take, reach, leave, split, keep, turn
    return ClockKernels(*(cuda.jit(function, cache=True) for function in functions))
