"""The clocks of lanes on one GPU: the functions of kernels/lane_clocks as CUDA kernels, one thread per lane.

Each kernel does what the function of its name does, for every lane whose flag in the first argument (L,) is set.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import cuda

from uavaccel.kernels import lane_clocks as of_lane
from uavaccel.kernels.operands import Launchable


def begin(renewed, rows, scales, games, timing, clocks):  # type: ignore[no-untyped-def]
    """Begin the games of `rows` (L,)."""
    lane = cuda.grid(1)
    if lane < len(renewed) and renewed[lane] != 0:
        of_lane.begin(lane, rows[lane], scales[rows[lane]], games, timing, clocks)


def show_start(renewed, levels, timing, clocks):  # type: ignore[no-untyped-def]
    """Account for the first image of each game."""
    lane = cuda.grid(1)
    if lane < len(renewed) and renewed[lane] != 0:
        of_lane.show_start(lane, levels, timing, clocks)


def issue(going, now, timing, clocks, legs):  # type: ignore[no-untyped-def]
    """Issue a command."""
    lane = cuda.grid(1)
    if lane < len(going) and going[lane] != 0:
        of_lane.issue(lane, now, timing, clocks, legs)


def take(going, hold_ticks, goals, modes, now):  # type: ignore[no-untyped-def]
    """Apply the commands, in lanes that have reached the tick at which they act."""
    lane = cuda.grid(1)
    if lane < len(going) and going[lane] != 0:
        of_lane.take(lane, hold_ticks, goals, modes, now)


def reach(going, sample, now, timing, clocks, looking, legs):  # type: ignore[no-untyped-def]
    """Wait for a sample; `looking` (L,) becomes 0 in all other lanes."""
    lane = cuda.grid(1)
    if lane < len(going):
        looking[lane] = 0
        if going[lane] != 0:
            of_lane.reach(lane, sample, now, timing, clocks, looking, legs)


def leave(looking, sample, levels, now, timing, clocks):  # type: ignore[no-untyped-def]
    """Continue after a sample."""
    lane = cuda.grid(1)
    if lane < len(looking) and looking[lane] != 0:
        of_lane.leave(lane, sample, levels, now, timing, clocks)


def split(which, now, clocks, legs, to_shown):  # type: ignore[no-untyped-def]
    """Split the coming flight at the tick of the next displayed pose."""
    lane = cuda.grid(1)
    if lane < len(which) and which[lane] != 0:
        of_lane.split(lane, now, clocks, legs, to_shown)


def keep(which, now, clocks, to_shown):  # type: ignore[no-untyped-def]
    """Store the present pose as the displayed one, in lanes that have reached it."""
    lane = cuda.grid(1)
    if lane < len(which) and which[lane] != 0 and to_shown[lane] >= 0:
        of_lane.save_shown(lane, now, clocks)


def turn(looking, now, clocks):  # type: ignore[no-untyped-def]
    """Swap present and displayed pose."""
    lane = cuda.grid(1)
    if lane < len(looking) and looking[lane] != 0:
        of_lane.turn_to_shown(lane, now, clocks)


class ClockKernels(NamedTuple):
    """The compiled kernels; their first argument selects lanes, (L,) uint8."""

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
    """Compile the kernels, or load them from numba's cache."""
    functions = begin, show_start, issue, take, reach, leave, split, keep, turn
    return ClockKernels(*(cuda.jit(function, cache=True) for function in functions))
