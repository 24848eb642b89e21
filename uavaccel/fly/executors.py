"""Python's thread pools, event loops and scheduler on a simulated clock.

`concurrent.futures` and `asyncio` make threads, locks and queues through the modules `threading`, `queue` and `time`
that they have imported. These are replaced by modules that give a script objects that take turns (uavaccel.fly.threads)
and everyone else, such as a library with its own pools, Python's.
"""

from __future__ import annotations

import concurrent.futures
import logging
import selectors
import sys
import threading
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import TYPE_CHECKING

from uavaccel.clock import changed
from uavaccel.fly.modules import called_by_a_script
from uavaccel.fly.patches import Patches
from uavaccel.fly.script import FlightOver
from uavaccel.fly.threads import ThreadClasses
from uavaccel.fly.turns import Turns
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:
    import asyncio

FREE_TURNS = 100  # of a loop while the clock is paused; each further one reads the clock, so that polling ends
POOLS = ("concurrent.futures._base", "concurrent.futures.thread")


class SimulatedSelector:
    """The selector in which an event loop waits; `poll` charges what reading the clock costs.

    Data on sockets and pipes arrive in the machine's time: they are waited for when nothing else can continue.
    """

    def __init__(self, selector: selectors.BaseSelector, turns: Turns, poll: Callable[[], object]) -> None:
        self._selector, self._turns, self._poll = selector, turns, poll
        self._stood_ns, self._turns_since = 0, 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready: list[tuple[selectors.SelectorKey, int]] = []

        def happened() -> bool:
            ready[:] = self._selector.select(0)
            return bool(ready)

        if timeout is not None and timeout <= 0:
            self._let_others_run()
            happened()
        else:
            self._turns.until(happened, timeout, lambda: self._selector.select(None))
        return ready

    def _let_others_run(self) -> None:
        now_ns = self._turns.now_ns()
        self._turns_since = self._turns_since + 1 if now_ns == self._stood_ns else 0
        if self._turns_since > FREE_TURNS:
            self._poll()
        self._stood_ns = self._turns.now_ns()
        self._turns.wait_until(self._stood_ns)

    def __getattr__(self, name: str) -> object:
        return getattr(self._selector, name)


def loops_taking_turns(module: ModuleType, patches: Patches, turns: Turns, poll: Callable[[], object]) -> None:
    """Put the event loops of asyncio.selector_events that a script makes on its clock."""
    original: Callable[..., None] = module.BaseSelectorEventLoop.__init__

    def init(self: asyncio.BaseEventLoop, selector: selectors.BaseSelector | None = None) -> None:
        if not (turns.is_mine() and called_by_a_script()):
            return original(self, selector)
        self.time = lambda: turns.now_ns() / NS_PER_S  # type: ignore[method-assign]
        return original(self, SimulatedSelector(selector or selectors.DefaultSelector(), turns, poll))

    patches.set(module.BaseSelectorEventLoop, "__init__", init)


def let_executors_take_turns(patches: Patches, turns: Turns, kinds: ThreadClasses, clock: ModuleType) -> None:
    """Let the pools, event loops and schedulers that a script makes take turns.

    `clock` is the script's module `time`.
    """
    sleep, now_s = (getattr(clock, name) for name in ("sleep", "monotonic"))
    stand_ins = {module: dispatching(module, own, turns) for module, own in kinds.own.items()}
    stand_ins[sys.modules["time"]] = dispatching(
        sys.modules["time"], {name: getattr(clock, name) for name in ("monotonic", "sleep", "time")}, turns
    )

    def change(module: ModuleType) -> None:
        for original, stand_in in stand_ins.items():
            if vars(module).get(original.__name__) is original:
                patches.set(module, original.__name__, stand_in)

    def change_thread_pool(module: ModuleType) -> None:
        patches.set(module, "ThreadPool", _thread_pool(module.ThreadPool, turns))

    def change_scheduler(module: ModuleType) -> None:
        patches.set(module.scheduler.__init__, "__defaults__", (now_s, sleep))

    for name in ("concurrent.futures._base", "asyncio.log"):
        patches.when_imported(name, lambda module: _leave_ends_unsaid(module, patches))
    for name in POOLS:
        patches.when_imported(name, change)
    patches.when_imported("concurrent.futures.process", lambda module: _wait_for_the_machine(module, patches))
    patches.when_imported("multiprocessing.pool", change_thread_pool)
    patches.when_imported("sched", change_scheduler)
    patches.when_imported("asyncio.base_events", change)  # its loops read the clock by their own `time`
    patches.when_imported("asyncio.selector_events", lambda module: loops_taking_turns(module, patches, turns, now_s))


def dispatching(module: ModuleType, own: Mapping[str, Callable[..., object]], turns: Turns) -> ModuleType:
    """Return a copy of a module in which some names mean `own` for a script's calls."""

    def chosen(name: str, kind: Callable[..., object]) -> Callable[..., object]:
        original = getattr(module, name)
        return lambda *arguments, **options: (kind if _of_a_script(turns) else original)(*arguments, **options)

    return changed(module, **{name: chosen(name, kind) for name, kind in own.items()})


def _leave_ends_unsaid(module: ModuleType, patches: Patches) -> None:
    """Keep a pool or an event loop from logging the end of the flight, which reaches its workers as an exception."""
    logger = module.LOGGER if hasattr(module, "LOGGER") else module.logger
    logger.addFilter(_is_no_end)
    patches.undo(lambda: logger.removeFilter(_is_no_end))


def _is_no_end(record: logging.LogRecord) -> bool:
    """Return whether a log record is about anything but the end of the flight."""
    return not (record.exc_info and isinstance(record.exc_info[1], FlightOver))


def _of_a_script(turns: Turns) -> bool:
    return turns.is_mine() and called_by_a_script()


def _wait_for_the_machine(module: ModuleType, patches: Patches) -> None:
    """Wait for the futures of processes in the machine's time, in which they compute."""
    condition = threading.Condition

    class Future(concurrent.futures.Future[object]):
        def __init__(self) -> None:
            super().__init__()
            self._condition = condition()

    patches.set(module, "_base", changed(module._base, Future=Future))


def _thread_pool(original: type, turns: Turns) -> type:
    """multiprocessing's ThreadPool, which is ours when a script makes it."""

    def new(cls: type, *arguments: object, **options: object) -> object:
        if not _of_a_script(turns):
            return object.__new__(cls)
        from uavaccel.fly.thread_pool import ThreadPool

        make: Callable[..., ThreadPool] = ThreadPool
        return make(*arguments, **options)

    return type(original.__name__, (original,), {"__new__": new})


def end_pools() -> None:
    """Let executors finish that nobody has shut down, as Python does at its end."""
    if (pools := sys.modules.get("concurrent.futures.thread")) is not None:
        pools._python_exit()
        vars(pools)["_shutdown"] = False
