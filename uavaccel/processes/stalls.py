"""Stalled processes: the detection of those that were stopped or wait for ever, and a guard that ends stopped ones.

Their state and CPU time are read from the system, on Linux; elsewhere no process is reported as stalled. A process
that was stopped ends neither by itself nor with its parent, so without the guard its command would wait for ever.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from textwrap import shorten
from types import FrameType

POLL_S = 1.0  # seconds of silence before the first poll, and between polls
STOPPED_POLLS, IDLE_POLLS = 5, 8  # successive looks that find it stopped, or idle
GUARD_POLLS = 8  # as many, of the guard: whoever waits for an answer has less patience, and can say more about it
FIRST_POLLS = 60  # the same while a process loads its modules, perhaps from a slow disk


def cpu_time_s(pid: int) -> float | None:
    """Return the CPU time of a process in seconds; None where the system does not tell it."""
    fields = _stat(pid)
    return None if fields is None else (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def is_stopped(pid: int) -> bool:
    fields = _stat(pid)
    return fields is not None and fields[0] in "Tt"


def _stat(pid: int) -> list[str] | None:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None


def command_of(pid: int) -> str:
    """Return the command line of a process; empty where there is none."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    except OSError:
        return ""


def with_children(pid: int) -> list[int]:
    """Return a process and all below it: those that it has started, those that they have, and so on."""
    found = [pid]
    for each in found:
        try:
            lists = [(task / "children").read_text() for task in Path(f"/proc/{each}/task").iterdir()]
        except OSError:  # it has ended
            continue
        found += [int(child) for children in lists for child in children.split()]
    return found


class StallDetector:
    """Decides whether processes whose reply is overdue are stalled.

    Polls are counted, not seconds, since a process that was stopped together with its client has not kept it waiting.
    """

    def __init__(self) -> None:
        self._cpu_s: dict[int, list[float | None]] = {}
        self._idle: dict[int, int] = {}

    def poll(self, pids: Collection[int], polls: int = IDLE_POLLS) -> list[int]:
        """Return the processes that have been stopped or idle for so many successive looks.

        The work of its children counts as a process's own.
        """
        for pid in pids:
            idle = not self._worked(pid) or is_stopped(pid)
            self._idle[pid] = self._idle.get(pid, 0) + 1 if idle else 0
        for pid in set(self._idle) - set(pids):  # nobody waits for it
            del self._idle[pid]
        return [pid for pid in pids if self._idle[pid] >= (min(STOPPED_POLLS, polls) if is_stopped(pid) else polls)]

    def _worked(self, pid: int) -> bool:
        """Return whether a process has worked since the last poll, or may have."""
        now, before = [cpu_time_s(process) for process in with_children(pid)], self._cpu_s.get(pid)
        self._cpu_s[pid] = now
        return now != before or now[0] is None


_GUARDING: set[int] = set()


def guard_children(say: Callable[[str], object]) -> None:
    """From now on end processes below this one that stay stopped, and `say` a line about each; on Linux only.

    At Ctrl-C, and at the end of this process, those that are stopped are ended at once. Call it in the main
    thread; a second call does nothing.
    """
    if os.getpid() in _GUARDING:
        return
    _GUARDING.add(os.getpid())
    threading.Thread(target=_look, args=(say,), daemon=True, name="guard").start()
    atexit.register(end_stopped)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)


def end_stopped() -> None:
    for pid in _stopped():
        _kill(pid)


def _stopped() -> list[int]:
    return [pid for pid in with_children(os.getpid())[1:] if is_stopped(pid)]


def _interrupt(number: int, frame: FrameType | None) -> None:
    end_stopped()
    signal.default_int_handler(number, frame)


def _look(say: Callable[[str], object]) -> None:
    polls: dict[int, int] = {}
    while not threading.Event().wait(POLL_S):
        polls = {pid: polls.get(pid, 0) + 1 for pid in _stopped()}
        for pid in (poll for poll, count in polls.items() if count == GUARD_POLLS):
            command = shorten(command_of(pid), 100, placeholder=" ...")
            _kill(pid)
            say(f"process {pid} ({command}) was stopped, and was ended since it did not go on")


def _kill(pid: int) -> None:
    with suppress(OSError):  # it has ended, or is another's
        os.kill(pid, signal.SIGKILL)
