"""Stand-ins for `threading` and `queue` whose threads take turns on a simulated clock (uavaccel.fly.turns).

Only one thread of a script runs at a time, so that locks are plain flags.
"""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from types import ModuleType
from typing import Any, TypeVar

from uavaccel.clock import changed
from uavaccel.fly.script import FlightOver, hide_ours
from uavaccel.fly.turns import Turn, Turns
from uavaccel.units import NS_PER_S

Class = TypeVar("Class", bound=type)
Result = TypeVar("Result")


def bound(kind: Class, turns: Turns) -> Class:
    """Return a subclass whose objects wait through `turns`."""
    return type(kind.__name__, (kind,), {"turns": turns})  # type: ignore[return-value]


class Lock:
    turns: Turns

    def __init__(self) -> None:
        self._held = False

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if self._held and not (blocking and self.turns.until(self._is_free, None if timeout < 0 else timeout)):
            return False
        self._held = True
        return True

    def release(self) -> None:
        if not self._held:
            raise RuntimeError("release unlocked lock")
        self._held = False

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *exception: object) -> None:
        self.release()

    def locked(self) -> bool:
        return self._held

    def _is_free(self) -> bool:
        return not self._held


class RLock(Lock):
    def __init__(self) -> None:
        super().__init__()
        self._owner, self._depth = 0, 0

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        me = threading.get_ident()
        if self._owner != me and not super().acquire(blocking, timeout):
            return False
        self._owner, self._depth = me, self._depth + 1
        return True

    def release(self) -> None:
        if self._owner != threading.get_ident():
            raise RuntimeError("cannot release un-acquired lock")
        self._depth -= 1
        if self._depth == 0:
            self._owner = 0
            super().release()

    def _is_owned(self) -> bool:
        return self._owner == threading.get_ident()

    def _release_save(self) -> int:
        depth, self._depth = self._depth, 1
        self.release()
        return depth

    def _acquire_restore(self, depth: int) -> None:
        self.acquire()
        self._depth = depth


class Condition(threading.Condition):
    turns: Turns
    _waiters: deque[Lock]
    _is_owned: Callable[[], bool]
    _release_save: Callable[[], Any]
    _acquire_restore: Callable[[Any], None]

    def __init__(self, lock: Lock | None = None) -> None:
        super().__init__(bound(RLock, self.turns)() if lock is None else lock)  # type: ignore[arg-type]

    def wait(self, timeout: float | None = None) -> bool:
        if not self._is_owned():
            raise RuntimeError("cannot wait on un-acquired lock")
        me = bound(Lock, self.turns)()
        me.acquire()
        self._waiters.append(me)  # `notify` releases it
        depth = self._release_save()
        try:
            return me.acquire(timeout=-1 if timeout is None else max(timeout, 0.0))
        finally:
            if me in self._waiters:
                self._waiters.remove(me)
            self._acquire_restore(depth)

    def wait_for(self, predicate: Callable[[], Result], timeout: float | None = None) -> Result:
        end_ns = None if timeout is None else self.turns.now_ns() + round(timeout * NS_PER_S)
        while not (found := predicate()):
            if not self.wait(None if end_ns is None else (end_ns - self.turns.now_ns()) / NS_PER_S):
                return predicate()
        return found


class Event(threading.Event):
    turns: Turns

    def __init__(self) -> None:
        super().__init__()
        self._cond = bound(Condition, self.turns)()

    def wait(self, timeout: float | None = None) -> bool:
        return self.turns.until(self.is_set, timeout)


class Semaphore(threading.Semaphore):
    turns: Turns

    def __init__(self, value: int = 1) -> None:
        super().__init__(value)
        self._cond = bound(Condition, self.turns)()

    def acquire(self, blocking: bool = True, timeout: float | None = None) -> bool:
        if not blocking and timeout is not None:
            raise ValueError("can't specify timeout for non-blocking acquire")
        if self._value == 0 and not (blocking and self.turns.until(lambda: self._value > 0, timeout)):
            return False
        self._value -= 1
        return True

    __enter__ = acquire


class BoundedSemaphore(Semaphore, threading.BoundedSemaphore):
    pass


class Barrier(threading.Barrier):
    turns: Turns

    def __init__(self, parties: int, action: Callable[[], None] | None = None, timeout: float | None = None) -> None:
        super().__init__(parties, action, timeout)
        self._cond = bound(Condition, self.turns)()


class Thread(threading.Thread):
    """A thread that runs in turns. Not the process but the flight waits for its end, unless it is a daemon."""

    turns: Turns
    running: list[Thread]
    is_daemon = False
    over = False

    def start(self) -> None:
        turn, run = self.turns.announce(), self.run
        self.run = lambda: self._in_turns(turn, run)  # type: ignore[method-assign]
        self.is_daemon, self.daemon = self.daemon, True
        self.running.append(self)
        super().start()

    def _in_turns(self, turn: Turn, run: Callable[[], None]) -> None:
        self.turns.begin(turn)
        try:
            run()
        except FlightOver:
            pass
        except BaseException as error:
            hide_ours(error)
            error.__traceback__ = error.__traceback__ and error.__traceback__.tb_next  # without this frame
            threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, self)))
        finally:
            self.over = True
            self.running.remove(self)
            self.turns.end()

    def is_alive(self) -> bool:
        return super().is_alive() and not self.over

    def join(self, timeout: float | None = None) -> None:
        self.turns.until(lambda: self.over, timeout)


class Timer(Thread):
    def __init__(
        self,
        interval: float,
        function: Callable[..., object],
        args: Iterable[object] | None = None,
        kwargs: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__()
        self.finished = bound(Event, self.turns)()
        self._call = partial(function, *(args or ()), **(kwargs or {}))
        self._interval = interval

    def cancel(self) -> None:
        self.finished.set()

    def run(self) -> None:
        if not self.finished.wait(self._interval):
            self._call()
        self.finished.set()


class Queue(queue.Queue[object]):
    turns: Turns

    def put(self, item: object, block: bool = True, timeout: float | None = None) -> None:
        def has_room() -> bool:
            return self.maxsize <= 0 or self._qsize() < self.maxsize

        if not has_room() and not (block and self.turns.until(has_room, timeout)):
            raise queue.Full
        self._put(item)
        self.unfinished_tasks += 1

    def get(self, block: bool = True, timeout: float | None = None) -> object:
        if not self._qsize() and not (block and self.turns.until(lambda: self._qsize() > 0, timeout)):
            raise queue.Empty
        return self._get()

    def join(self) -> None:
        self.turns.until(lambda: self.unfinished_tasks == 0)


class LifoQueue(Queue, queue.LifoQueue[object]):
    pass


class PriorityQueue(Queue, queue.PriorityQueue[object]):  # type: ignore[type-var]  # what a script orders
    pass


class ThreadClasses:
    """The stand-ins by module and name, bound to one flight, and the script's running threads."""

    def __init__(self, turns: Turns) -> None:
        self.running: list[Thread] = []
        kinds: tuple[type, ...] = (Lock, RLock, Condition, Event, Semaphore, BoundedSemaphore, Barrier)
        kinds += (Queue, LifoQueue, PriorityQueue)
        own = {kind.__name__: bound(kind, turns) for kind in kinds}
        own["SimpleQueue"] = own["Queue"]
        for kind in (Thread, Timer):
            own[kind.__name__] = thread = bound(kind, turns)
            thread.running = self.running
        self.own = {
            module: {name: kind for name, kind in own.items() if hasattr(module, name)} for module in (threading, queue)
        }

    def modules(self) -> dict[str, ModuleType]:
        """Return the modules `threading` and `queue` for a script."""
        return {module.__name__: changed(module, **kinds) for module, kinds in self.own.items()}
