"""How a command's time is cut into samples."""

from __future__ import annotations

from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S, seconds_to_ns, ticks_exactly

TAIL = (
    0.05  # of T_sample: 1 s in steps of .33 s is three samples, the last of .34 s, as the paper counts them
)


def slice_of(t_move_ns: int, t_sample_ns: int) -> int:
    """T_wakeup = min(T_move, T_sample), but a tail too short for a sample of its own is flown at once."""
    return t_move_ns if t_move_ns - t_sample_ns < TAIL * t_sample_ns else t_sample_ns


def samples_due(t_move_s: float, t_sample_s: float) -> list[int]:
    """Simulated nanoseconds after a command's start at which its samples are due; the last one is its end."""
    due, left, t_sample = [0], seconds_to_ns(t_move_s), seconds_to_ns(t_sample_s)
    while left > 0:
        t_wakeup = slice_of(left, t_sample)
        due.append(due[-1] + t_wakeup)
        left -= t_wakeup
    return due[1:]


def check_times(t_move_s: float, t_sample_s: float, tick_ns: int, exact_times: bool) -> None:
    """Raise UserError where T_move or T_sample is shorter than a tick, or, with `exact_times`, no whole number of them.

    Samples that lie closer than a tick would show the same state again and again. With exact times every slice of a
    command is checked: also the last, longer or shorter one.
    """
    for name, duration_s in (("t_move_s", t_move_s), ("t_sample_s", min(t_sample_s, t_move_s))):
        if seconds_to_ns(duration_s) < tick_ns:
            raise UserError(
                f"{name}: {duration_s:g} s is shorter than the physics step of {tick_ns / 1e6:g} ms; "
                f"{tick_ns / NS_PER_S:g} s is the least"
            )
    if exact_times:
        ticks_exactly(t_move_s, tick_ns, "t_move_s")
        for due_ns in samples_due(t_move_s, t_sample_s):
            ticks_exactly(due_ns / NS_PER_S, tick_ns, "t_sample_s")
