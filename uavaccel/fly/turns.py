"""Threads of a script on a simulated clock: one runs at a time, until it waits; then the next to wake does.

So a script with threads flies the same every time: who runs, and when, is decided by the simulated clock alone.
"""

from __future__ import annotations

import heapq
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from uavaccel.clock import VirtualClock
from uavaccel.units import NS_PER_S

LOOK_NS = 1_000_000  # a thread that waits for another one's doing looks so often


@dataclass(order=True)
class Turn:
    """A thread that waits for a time; of two for the same time, the one that has waited longer goes first."""

    wake_ns: int
    order: int
    begins: threading.Event = field(default_factory=threading.Event, compare=False)


class Turns:
    """Hands the run of a script from thread to thread. Made in the first thread, which runs."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._waiting: list[Turn] = []
        self._order = 0
        self._threads = {threading.get_ident()}

    def earliest_ns(self) -> int | None:
        """When the next other thread wants to run; None if there is none."""
        return self._waiting[0].wake_ns if self._waiting else None

    def is_mine(self) -> bool:
        """Whether the calling thread is one of those that take turns."""
        return threading.get_ident() in self._threads

    def wait_until(self, wall_ns: int) -> None:
        """Let the others run until it is the caller's turn again, not before `wall_ns`."""
        mine = self.announce(wall_ns)
        following = heapq.heappop(self._waiting)
        self._clock.sleep_until(following.wake_ns)
        if following is not mine:
            following.begins.set()
            mine.begins.wait()

    def until(self, happened: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Let the others run until something has happened, or the time is over: then False.

        Raises RuntimeError where nobody is left who could let it happen.
        """
        now_ns = self._clock.now_ns
        end_ns = None if timeout_s is None else now_ns() + round(max(timeout_s, 0.0) * NS_PER_S)
        while not happened():
            if end_ns is not None and now_ns() >= end_ns:
                return False
            if end_ns is None and not self._waiting:
                raise RuntimeError("this would wait for ever: no other thread of the script runs")
            look_ns = now_ns() + LOOK_NS
            self.wait_until(look_ns if end_ns is None else min(look_ns, end_ns))
        return True

    def announce(self, wall_ns: int | None = None) -> Turn:
        """Somebody waits for a time, or for now."""
        self._order += 1
        turn = Turn(self._clock.now_ns() if wall_ns is None else wall_ns, self._order)
        heapq.heappush(self._waiting, turn)
        return turn

    def begin(self, turn: Turn) -> None:
        """In a new thread: wait for its first turn."""
        turn.begins.wait()
        self._threads.add(threading.get_ident())

    def end(self) -> None:
        """The calling thread runs no more."""
        self._threads.discard(threading.get_ident())
        following = heapq.heappop(self._waiting)
        self._clock.sleep_until(following.wake_ns)
        following.begins.set()
