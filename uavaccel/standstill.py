"""Processes that stand still: stopped, or waiting for what never comes. The system is asked what they have computed.

Linux tells; elsewhere nothing is known, and nobody is said to stand still.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

LOOK_S = 1.0  # of silence, after which one looks, and between looks
STOPPED_LOOKS, LOOKS = 5, 8  # that find it stopped, or no work done
FIRST_LOOKS = 60  # of a process that loads its modules, from a slow disk perhaps


def cpu_time_s(pid: int) -> float | None:
    """What a process has computed so far; None where the system does not say."""
    fields = _stat(pid)
    return None if fields is None else (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def is_stopped(pid: int) -> bool:
    """Whether somebody has stopped it."""
    fields = _stat(pid)
    return fields is not None and fields[0] in "Tt"


def _stat(pid: int) -> list[str] | None:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None


def _with_children(pid: int) -> list[int]:
    found = [pid]
    for each in found:
        try:
            lists = [(task / "children").read_text() for task in Path(f"/proc/{each}/task").iterdir()]
        except OSError:  # it has ended
            continue
        found += [int(child) for children in lists for child in children.split()]
    return found


class Standstill:
    """Whether somebody whose answer is overdue stands still.

    Looks are counted, not seconds: who was stopped together with those for whom it works has not kept them waiting.
    """

    def __init__(self) -> None:
        self._cpu_s: dict[int, list[float | None]] = {}
        self._idle: dict[int, int] = {}

    def look(self, pids: Collection[int], helper: int | None = None, looks: int = LOOKS) -> list[int]:
        """Those of some processes that have been stopped, or without work, for so many looks one after another.

        What its children do is its work too, and, unless it is stopped, that of a `helper`, for whom it may wait.
        """
        helped = helper is not None and self._worked(helper)
        for pid in pids:
            worked = self._worked(pid)
            idle = is_stopped(pid) or not (worked or helped)
            self._idle[pid] = self._idle.get(pid, 0) + 1 if idle else 0
        for pid in set(self._idle) - set(pids):  # nobody waits for it
            del self._idle[pid]
        return [pid for pid in pids if self._idle[pid] >= (STOPPED_LOOKS if is_stopped(pid) else looks)]

    def _worked(self, pid: int) -> bool:
        """Whether it has, or cannot be known to have done nothing, since the last look."""
        now, before = [cpu_time_s(each) for each in _with_children(pid)], self._cpu_s.get(pid)
        self._cpu_s[pid] = now
        return now != before or now[0] is None
