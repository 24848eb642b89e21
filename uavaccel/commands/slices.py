"""The division of a command's time into slices, each of which ends with a sample."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from uavaccel.units import NS_PER_S, seconds_to_ns

# Shortest last slice, as a share of T_sample: 1 s in steps of .33 s is three samples, as the paper counts them.
TAIL = 0.05


def slice_of(t_move_ns: int, t_sample_ns: int) -> int:
    """Return T_wakeup = min(T_move, T_sample), with a rest shorter than TAIL included."""
    return t_move_ns if t_move_ns - t_sample_ns < TAIL * t_sample_ns else t_sample_ns


def samples_due(t_move_s: float, t_sample_s: float) -> list[int]:
    """Return the simulated nanoseconds from a command's start to each sample; the last one is its end."""
    due, left, t_sample = [0], seconds_to_ns(t_move_s), seconds_to_ns(t_sample_s)
    while left > 0:
        t_wakeup = slice_of(left, t_sample)
        due.append(due[-1] + t_wakeup)
        left -= t_wakeup
    return due[1:]


def check_times(t_move_s: float, t_sample_s: float, check_duration: Callable[[float, str], None]) -> None:
    """Call `check_duration(seconds, name)`, which may raise, for a command's duration and those of its slices."""
    check_duration(t_move_s, "t_move_s")
    check_duration(min(t_sample_s, t_move_s), "t_sample_s")
    due_ns = [0, *samples_due(t_move_s, t_sample_s)]
    for slice_ns in {later - earlier for earlier, later in pairwise(due_ns)}:
        check_duration(slice_ns / NS_PER_S, "t_sample_s")
