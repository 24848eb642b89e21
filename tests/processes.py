"""Processes as /proc shows them: what one has started, and whether any of that is left."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from pathlib import Path

from uavaccel.clock import MonotonicClock
from uavaccel.units import NS_PER_S

LOOK_NS = 50_000_000


def descendants(pid: int) -> set[int]:
    """Processes below one, all the way down."""
    found: set[int] = set()
    pending = [pid]
    while pending:
        tasks = Path(f"/proc/{pending.pop()}/task")
        with contextlib.suppress(OSError):
            below = {int(each) for task in tasks.iterdir() for each in (task / "children").read_text().split()}
            found |= below
            pending += below
    return found


def servers(pid: int) -> set[int]:
    """Those below a process that serve a session in `wall`."""
    return {descendant for descendant in descendants(pid) if "uavaccel.wire.service" in command_line(descendant)}


def command_line(pid: int) -> str:
    """Empty where there is no such process."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""


def state_of(pid: int) -> str:
    """The kernel's letter for it: R, S, T where it was stopped; Z where there is no such process any more."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


def alive(pid: int) -> bool:
    """Whether it is there, and more than an entry that its parent has not read yet."""
    return state_of(pid) != "Z"


def left_after(pids: Iterable[int], seconds: float) -> set[int]:
    """Those that are still alive after so many seconds of wall time; returns sooner if none is."""
    clock = MonotonicClock()
    end_ns = clock.now_ns() + round(seconds * NS_PER_S)
    while left := {pid for pid in pids if alive(pid)}:
        if clock.now_ns() > end_ns:
            return left
        clock.sleep_until(clock.now_ns() + LOOK_NS)
    return set()


def resident_mib(pid: int) -> float:
    """Resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
