"""The threads of a script on a simulated clock: one runs until it waits, then the next one to wake runs.

The simulated clock alone decides which thread runs when, so that a script with threads flies the same every time. A
lock and a thread that wait in this way are all that Python's own conditions, queues and pools are made of
(uavaccel.fly.threads).
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf
from typing import TypeVar
from weakref import WeakSet

from uavaccel.clock import WallClock
from uavaccel.errors import UserError
from uavaccel.fly.script import FlightOver, hide_ours
from uavaccel.processes.lifetime import END_WITH_PARENT
from uavaccel.units import NS_PER_S

FOREIGN_S = 1e-3  # the machine's time between two checks of what has happened outside of the turns
BUSY_S = 10.0  # the machine's time for which a thread may compute before it is worth a line that others wait
BUSY = "uavaccel: busy loops"
OURS = {END_WITH_PARENT, BUSY}  # names of such threads that do nothing for a script
Class = TypeVar("Class", bound=type)
TURN_POLL_NS = 1_000_000  # a thread whose answer depends on another thread polls at this interval


@dataclass(eq=False)
class Turn:
    """A waiting thread: it waits for a time, for an event, or for whichever comes first.

    Of the threads that may continue, the one whose time came first does, or that has waited longest. `outside` waits
    for events of the machine, such as data on a socket, for so many of the machine's seconds; it is called when no
    thread can continue, and of a `patient` thread also before its time-out, if nothing but that can make any thread
    continue.
    """

    wake_ns: float
    happened: Callable[[], bool] | None = None
    outside: Callable[[float], object] | None = None
    patient: bool = False
    begins: threading.Event = field(default_factory=threading.Event)

    def due_ns(self, now_ns: int) -> float:
        """Return when the thread may continue."""
        ready = self.wake_ns > now_ns and self.happened is not None and self.happened()
        return now_ns if ready else self.wake_ns


class Turns:
    """Passes the execution of a script from thread to thread. Made in the main thread, which runs first.

    Waits end with FlightOver at the clock's `limit_ns`.
    """

    def __init__(self, clock: WallClock, limit_ns: int | None = None) -> None:
        self._clock = clock
        self._limit_ns = inf if limit_ns is None else limit_ns
        self._waiting: list[Turn] = []  # who has waited longest comes first
        self._threads = {threading.get_ident()}
        self._strangers = WeakSet(threading.enumerate())  # threads older than the script do nothing for it
        self.running: list[Thread] = []
        self.before_passing: Callable[[], None] = lambda: None  # called by a thread that lets another one run
        self.simulated = True  # no longer so in a forked process
        self.flown_ns: Callable[[], int] = lambda: 0  # simulated time, which one sleep or call may take long to fly
        self._acts, self._is_watched = 0, False

    def now_ns(self) -> int:
        return self._clock.now_ns()

    def earliest_ns(self) -> int | None:
        """Return when the next waiting thread may run; None if time alone wakes no thread."""
        wake_ns = min((turn.due_ns(self.now_ns()) for turn in self._waiting), default=inf)
        return None if wake_ns == inf else int(wake_ns)

    def is_mine(self) -> bool:
        return threading.get_ident() in self._threads

    def check_thread(self) -> None:
        """Raise UserError in a thread that does not take turns."""
        self._acts += 1
        if not self.is_mine():
            raise UserError(
                "a library's thread calls the simulation; on a simulated clock the script's own may: --timing wall"
            )

    def wait_until(self, wall_ns: int, happened: Callable[[], bool] | None = None) -> None:
        """Let other threads run until it is the caller's turn again, at `wall_ns` or later, or once it has happened."""
        self._wait(self.announce(wall_ns, happened))

    def until(
        self,
        happened: Callable[[], bool],
        timeout_s: float | None = None,
        outside: Callable[[float], object] | None = None,
        patient: bool = False,
    ) -> bool:
        """Let other threads run until something has happened; False if the time-out passes first.

        Raises RuntimeError if no thread is left that could let it happen, and FlightOver at the limit.
        """
        if happened():
            return True
        self.check_thread()
        end_ns = inf if timeout_s is None else self.now_ns() + round(max(timeout_s, 0.0) * NS_PER_S)
        mine = Turn(min(end_ns, self._limit_ns), happened, outside, patient)
        self._waiting.append(mine)
        self._wait(mine)
        if happened():
            return True
        if self.now_ns() >= self._limit_ns:
            raise FlightOver
        if self.now_ns() < end_ns:
            raise RuntimeError("this would wait for ever: no other thread of the script runs")
        return False

    def announce(self, wall_ns: int | None = None, happened: Callable[[], bool] | None = None) -> Turn:
        """Queue a thread that waits for a time, for an event, or for its first turn."""
        turn = Turn(self.now_ns() if wall_ns is None else wall_ns, happened)
        self._waiting.append(turn)
        return turn

    def begin(self, turn: Turn) -> None:
        """Wait for the first turn of a new thread, which calls this."""
        turn.begins.wait()
        self._threads.add(threading.get_ident())

    def end(self) -> None:
        following = self._following() if self._waiting else None  # to which this thread is no stranger yet
        self._threads.discard(threading.get_ident())
        self.before_passing()
        if following is not None:
            following.begins.set()

    def tell_of_busy_loops(self) -> None:
        """Say in a line, while there are threads, if one of them does not let the others run, which may be for ever."""
        if not self._is_watched:
            self._is_watched = True
            threading.Thread(target=self._watch, name=BUSY, daemon=True).start()

    def _watch(self) -> None:
        before = -1, -1
        while self.running and self.simulated:
            now = self._acts, self.flown_ns()
            if before == now and any(turn.wake_ns < self._limit_ns for turn in self._waiting):
                said = f"the script has computed for {BUSY_S:g} s, and its other threads wait until it sleeps or calls"
                print(f"uavaccel: warning: {said}; if it waits for them: --timing wall", file=sys.stderr, flush=True)
                return
            before = now
            threading.Event().wait(BUSY_S)
        self._is_watched = False

    def forked(self, clock: WallClock) -> None:
        """In a forked process, go on with its only thread on another clock."""
        self._clock, self._limit_ns, self.simulated = clock, inf, False
        self._waiting.clear()
        self.running.clear()
        self._threads = {threading.get_ident()}

    def _wait(self, mine: Turn) -> None:
        following = self._following()
        if following is not mine:
            self.before_passing()
            following.begins.set()
            mine.begins.wait()

    def _following(self) -> Turn:
        """Take the next thread out of the queue, and advance the clock to its time."""
        self._acts += 1
        while True:
            now_ns = self.now_ns()
            following = min(self._waiting, key=lambda turn: turn.due_ns(now_ns))
            wake_ns = following.due_ns(now_ns)
            if following.outside and following.patient and now_ns < wake_ns < inf and self._is_alone(following):
                following.patient = False
                following.outside((wake_ns - now_ns) / NS_PER_S)
            elif wake_ns < inf or not self._wait_outside():
                break
        self._waiting.remove(following)
        if wake_ns < inf:  # otherwise no thread can continue, and the longest-waiting one raises
            self._clock.sleep_until(int(wake_ns))
        return following

    def _is_alone(self, patient: Turn) -> bool:
        """Return whether nothing but its time-out can make any thread continue."""
        now_ns = self.now_ns()
        return all(turn is patient or turn.due_ns(now_ns) == inf for turn in self._waiting)

    def _wait_outside(self) -> bool:
        """Wait for events of the machine, or of a thread outside of the turns; False if there can be none."""
        outside = next((turn.outside for turn in self._waiting if turn.outside is not None), None)
        if outside is not None:
            outside(FOREIGN_S)  # others wait for events of their own
        elif any(
            thread.ident not in self._threads and thread.name not in OURS and thread not in self._strangers
            for thread in threading.enumerate()
        ):
            threading.Event().wait(FOREIGN_S)
        else:
            return False
        return True


class Lock:
    """threading.Lock, as a plain flag; `turns` are those of a flight (`bound`)."""

    turns: Turns

    def __init__(self) -> None:
        self._held = False

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if timeout != -1 and (timeout < 0 or not blocking):
            threading.Lock().acquire(blocking, timeout)  # raises ValueError, in this Python's words
        timeout_s = None if timeout == -1 else timeout
        if self._held and not (blocking and self.turns.until(lambda: not self._held, timeout_s)):
            return False
        self._held = True
        return True

    def release(self) -> None:
        if not self._held:
            raise RuntimeError("release unlocked lock")
        self._held = False

    def locked(self) -> bool:
        return self._held

    __enter__ = acquire

    def __exit__(self, *exception: object) -> None:
        self.release()


class Thread(threading.Thread):
    """A thread that runs in turns. Not the process but the flight waits for its end, unless it is a daemon."""

    turns: Turns
    over = False
    _daemonic: bool

    def start(self) -> None:
        if self.ident is None:  # otherwise it has been started, and the next line says so
            turn, run = self.turns.announce(), self.run
            self.run = lambda: self._run_in_turns(turn, run)  # type: ignore[method-assign]
        daemon, self._daemonic = self._daemonic, True  # for the process, which ends without it
        try:
            super().start()
        finally:
            self._daemonic = daemon
        self.turns.running.append(self)
        self.turns.tell_of_busy_loops()

    def _run_in_turns(self, turn: Turn, run: Callable[[], None]) -> None:
        self.turns.begin(turn)
        try:
            run()
        except FlightOver:
            pass
        except BaseException as error:
            hide_ours(error)
            shown = None if isinstance(error, UserError) else error.__traceback__
            error.__traceback__ = shown and shown.tb_next  # without this frame
            threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, self)))
        finally:
            self.over = True
            self.turns.running.remove(self)
            self.turns.end()

    def is_alive(self) -> bool:
        return super().is_alive() and not self.over

    def join(self, timeout: float | None = None) -> None:
        if self.ident is None:
            raise RuntimeError("cannot join thread before it is started")
        if self is threading.current_thread():
            raise RuntimeError("cannot join current thread")
        self.turns.until(lambda: self.over, timeout)


def bound(kind: Class, turns: Turns) -> Class:
    """Return a subclass whose objects wait through `turns`."""
    return type(kind.__name__, (kind,), {"turns": turns, "__module__": "threading"})  # type: ignore[return-value]
