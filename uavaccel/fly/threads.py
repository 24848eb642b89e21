"""Python's own threading, queues, pools, event loops and scheduler on a simulated clock.

They wait through a lock, a thread and a clock that their modules have imported. A script gets their classes over those
that take turns (uavaccel.fly.turns), and everyone else, such as a library with its own pools, Python's.
"""

from __future__ import annotations

import _thread
import concurrent.futures
import logging
import queue
import select
import selectors
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from types import CellType, FunctionType, ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

from uavaccel.clock import changed
from uavaccel.fly.modules import Patches, called_by_a_script
from uavaccel.fly.script import FlightOver
from uavaccel.fly.turns import Lock, Thread, Turns, bound
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:
    import asyncio
    import socket

FREE_TURNS = 100  # of a loop while the clock is paused; each further one reads the clock, so that polling ends
LOCKS = ("_RLock", "Condition", "Semaphore", "BoundedSemaphore", "Event", "Barrier", "Timer")
POOL = ("ApplyResult", "MapResult", "IMapIterator", "IMapUnorderedIterator", "Pool", "ThreadPool")
QUEUES = ("Queue", "LifoQueue", "PriorityQueue", "_PySimpleQueue")


class Moment(int):
    """A time in ns, to which Python's modules add seconds: of floats the rest of a wait would never be 0."""

    def __add__(self, seconds: float) -> Moment:
        return Moment(int(self) + round(seconds * NS_PER_S))

    def __sub__(self, other: int) -> float:  # type: ignore[override]
        return (int(self) - int(other)) / NS_PER_S


def rebuilt(kind: type, names: dict[str, Any]) -> type:
    """Return a class of Python's once more, whose methods and bases are looked up among `names`."""
    own = CellType()  # where `super()` finds the class

    def again(value: Any) -> Any:
        if isinstance(value, classmethod | staticmethod):
            return type(value)(again(value.__func__))
        if not isinstance(value, FunctionType):
            return value
        closure = (own,) if value.__closure__ else None
        made = FunctionType(value.__code__, names, value.__name__, value.__defaults__, closure)
        made.__kwdefaults__, made.__doc__ = value.__kwdefaults__, value.__doc__
        return made

    body = {name: again(value) for name, value in vars(kind).items() if name not in ("__dict__", "__weakref__")}
    made = type(kind.__name__, tuple(names.get(base.__name__, base) for base in kind.__bases__), body)
    own.cell_contents = made
    return made


class ThreadModules:
    """The modules of threads for the scripts of one flight."""

    def __init__(self, turns: Turns) -> None:
        def now() -> Moment:
            return Moment(turns.now_ns())

        def start_new_thread(function: Callable[..., object], args: Iterable[object], *kwargs: Any) -> int:
            thread = self.threading.Thread(None, function, None, args, *kwargs, daemon=True)
            thread.start()
            return thread.ident or 0

        lock, thread = bound(Lock, turns), bound(Thread, turns)
        names = {**vars(threading), "_time": now, "_allocate_lock": lock, "Lock": lock, "Thread": thread}
        for name in LOCKS:
            names[name] = rebuilt(getattr(threading, name), names)
        names["RLock"] = names["_RLock"]
        own = {name: names[name] for name in ("Lock", "RLock", "Thread", *LOCKS[1:])}
        own["enumerate"] = lambda: [threading.main_thread(), *turns.running]
        own["active_count"] = own["activeCount"] = lambda: 1 + len(turns.running)
        self.threading = changed(threading, **own)
        names = {**vars(queue), "threading": self.threading, "time": now}
        for name in QUEUES:  # of which the first is the base of others
            names[name] = rebuilt(getattr(queue, name), names)
        kinds = {name: names[name] for name in QUEUES}
        kinds["SimpleQueue"] = kinds.pop("_PySimpleQueue")
        names |= kinds
        begin = {"start_new_thread": start_new_thread, "start_new": start_new_thread}
        self.own: dict[ModuleType, dict[str, Any]] = {
            threading: own,
            queue: kinds,
            _thread: {"allocate_lock": lock, "LockType": lock, **begin},
        }

    def in_scripts(self) -> dict[str, ModuleType]:
        """Return the modules `threading`, `queue` and `_thread` for a script."""
        own = {module.__name__: changed(module, **kinds) for module, kinds in self.own.items()}
        return own | {"threading": self.threading}


# --- modules that everybody shares ---------------------------------------------------------------------------------


class SharedModules:
    """Lets Python's modules that wait for threads do so in turns where a script calls them.

    `clock` is the script's module `time`.
    """

    def __init__(
        self, patches: Patches, turns: Turns, modules: ThreadModules, outside: OutsideEvents, clock: ModuleType
    ) -> None:
        self._patches, self._turns, self._modules, self._clock = patches, turns, modules, clock
        self._outside = outside
        waits = {name: getattr(clock, name) for name in ("monotonic", "sleep", "time")}
        self._stand_ins = {
            module: changed(module, **self._chosen(module, own))
            for module, own in {**modules.own, sys.modules["time"]: waits}.items()
        }
        for name in ("concurrent.futures._base", "asyncio.log"):
            patches.when_imported(name, self._leave_ends_unsaid)
        for name in ("concurrent.futures._base", "concurrent.futures.thread", "asyncio.base_events", "socketserver"):
            patches.when_imported(name, self._change)
        patches.when_imported("concurrent.futures.process", self._wait_for_the_machine)
        patches.when_imported("multiprocessing.dummy", self._change_dummy)
        patches.when_imported("multiprocessing.pool", self._change_pool)
        patches.when_imported("asyncio.selector_events", self._change_loops)
        patches.when_imported("socket", self._change_sockets)
        patches.when_imported("socketserver", self._change_servers)
        waiting = tuple(getattr(clock, name) for name in ("monotonic", "sleep"))
        patches.when_imported("sched", lambda module: patches.set(module.scheduler.__init__, "__defaults__", waiting))

    def _is_for_a_script(self) -> bool:
        return self._turns.is_mine() and called_by_a_script()

    def _chosen(self, module: ModuleType, own: Mapping[str, Any]) -> dict[str, Callable[..., object]]:
        """Return functions that call a script's `own` for a script, and the module's for everyone else."""

        def chosen(name: str, theirs: Callable[..., object]) -> Callable[..., object]:
            return lambda *given, **named: (own[name] if self._is_for_a_script() else theirs)(*given, **named)

        return {name: chosen(name, getattr(module, name)) for name in own}

    def _change(self, module: ModuleType) -> None:
        for original, stand_in in self._stand_ins.items():
            if vars(module).get(original.__name__) is original:
                self._patches.set(module, original.__name__, stand_in)

    def _change_dummy(self, module: ModuleType) -> None:
        """Change multiprocessing.dummy, whose processes are threads."""
        own = {name: kind for kinds in self._modules.own.values() for name, kind in kinds.items()}
        names = {**vars(module), "Thread": own["Thread"], "threading": self._modules.threading}
        own |= {"Process": rebuilt(module.DummyProcess, names), "JoinableQueue": own["Queue"]}
        own = {name: kind for name, kind in own.items() if name in vars(module)}
        for name, kind in self._chosen(module, own).items():
            self._patches.set(module, name, kind)

    def _change_pool(self, module: ModuleType) -> None:
        """Change multiprocessing.pool, whose ThreadPool tells its threads of changes through a pipe."""
        turns, kinds = self._turns, self._modules.in_scripts()
        changes = type("SimpleQueue", (kinds["queue"].SimpleQueue,), {"_reader": property(lambda self: self)})
        names = {**vars(module), **kinds, "time": self._clock}
        names["get_context"] = lambda: SimpleNamespace(SimpleQueue=changes)
        names["wait"] = lambda ready, timeout=None: turns.until(lambda: not ready[0].empty(), timeout)
        for name in POOL:
            names[name] = rebuilt(getattr(module, name), names)

        def new(cls: type, *arguments: object, **options: object) -> object:
            if not self._is_for_a_script():
                return object.__new__(cls)
            return names["ThreadPool"](*arguments, **options)

        self._patches.set(module, "ThreadPool", type("ThreadPool", (module.ThreadPool,), {"__new__": new}))

    def _change_loops(self, module: ModuleType) -> None:
        """Put the event loops of asyncio.selector_events that a script makes on its clock."""
        original: Callable[..., None] = module.BaseSelectorEventLoop.__init__
        turns, outside = self._turns, self._outside

        def init(loop: asyncio.BaseEventLoop, selector: selectors.BaseSelector | None = None) -> None:
            if not self._is_for_a_script():
                return original(loop, selector)
            loop.time = lambda: turns.now_ns() / NS_PER_S  # type: ignore[method-assign]
            return original(loop, selector or outside.of_loops())

        self._patches.set(module.BaseSelectorEventLoop, "__init__", init)

    def _change_servers(self, module: ModuleType) -> None:
        """Let a script's other threads run while one serves, as a web page does."""
        original, own = vars(module)["_ServerSelector"], self._outside.selectors.PollSelector
        self._patches.set(module, "_ServerSelector", lambda: (own if self._is_for_a_script() else original)())

    def _change_sockets(self, module: ModuleType) -> None:
        """Let a script's other threads run while one waits for data on a socket; its time-out is simulated."""
        turns = self._turns

        def waiting(original: Callable[..., object]) -> Callable[..., object]:
            def receive(connection: socket.socket, *arguments: object, **options: object) -> object:
                def has_data(wait_s: float = 0.0) -> bool:
                    return bool(select.select([connection], [], [], wait_s)[0])

                timeout_s = connection.gettimeout()
                in_turns = turns.running and timeout_s != 0 and self._is_for_a_script()
                if in_turns and not turns.until(has_data, timeout_s, has_data, patient=True):
                    raise TimeoutError("timed out")
                return original(connection, *arguments, **options)

            return receive

        for name in ("accept", "recv", "recv_into", "recvfrom"):
            self._patches.set(module.socket, name, waiting(getattr(module.socket, name)))

    def _leave_ends_unsaid(self, module: ModuleType) -> None:
        """Keep a pool or an event loop from logging the end of the flight, an exception in its workers."""
        logger = module.LOGGER if hasattr(module, "LOGGER") else module.logger
        logger.addFilter(_is_no_end)
        self._patches.undo(lambda: logger.removeFilter(_is_no_end))

    def _wait_for_the_machine(self, module: ModuleType) -> None:
        """Wait for the futures of processes in the machine's time, in which they compute."""
        condition = threading.Condition

        class Future(concurrent.futures.Future[object]):
            def __init__(self) -> None:
                super().__init__()
                self._condition = condition()

        self._patches.set(module, "_base", changed(module._base, Future=Future))


class OutsideEvents:
    """The modules `select` and `selectors` for scripts; `clock` is their module `time`.

    Time-outs are simulated. Data on sockets and pipes arrive in the machine's time: they are waited for when nothing
    else can continue, for as long as the time-out says.
    """

    def __init__(self, turns: Turns, clock: ModuleType) -> None:
        self._turns, self._clock = turns, clock
        self._stood_ns, self._turns_since = 0, 0
        wait = self.wait

        def selector(kind: Any, patient: bool = True) -> type:
            def waiting(own: Any, timeout: float | None = None) -> Any:
                return wait(lambda wait_s: kind.select(own, wait_s), timeout, patient)

            return type(kind.__name__, (kind,), {"select": waiting})

        def select_for(readable: Any, writable: Any, exceptional: Any, timeout: float | None = None, /) -> Any:
            files = readable, writable, exceptional
            return wait(lambda wait_s: select.select(*files, wait_s), timeout, any(files))

        def poll() -> SimpleNamespace:
            polled = select.poll()

            def waiting(timeout_ms: float | None = None) -> Any:
                timeout_s = None if timeout_ms is None or timeout_ms < 0 else timeout_ms / 1e3
                return wait(lambda wait_s: polled.poll(None if wait_s is None else wait_s * 1e3), timeout_s, True)

            registry = {name: getattr(polled, name) for name in ("register", "modify", "unregister")}
            return SimpleNamespace(poll=waiting, **registry)

        kinds = ("SelectSelector", "PollSelector", "EpollSelector", "DefaultSelector")
        self.selectors = changed(selectors, **{name: selector(getattr(selectors, name)) for name in kinds})
        self.select = changed(select, select=select_for, poll=poll)
        self.of_loops = selector(selectors.DefaultSelector, patient=False)

    def in_scripts(self) -> dict[str, ModuleType]:
        return {"select": self.select, "selectors": self.selectors}

    def wait(self, look: Callable[[float | None], Any], timeout_s: float | None, patient: bool) -> Any:
        """Return what `look`, which takes the seconds to wait, finds ready; nothing after the time-out (Turn)."""
        if not self._turns.simulated or not self._turns.is_mine():
            return look(timeout_s)
        found: Any = ()

        def happened() -> bool:
            nonlocal found
            found = look(0.0)
            return any(found)

        if timeout_s is not None and timeout_s <= 0:
            now_ns = self._turns.now_ns()
            self._turns_since = self._turns_since + 1 if now_ns == self._stood_ns else 0
            if self._turns_since > FREE_TURNS:
                self._clock.monotonic()  # which costs time
            self._stood_ns = self._turns.now_ns()
            self._turns.wait_until(self._stood_ns)
            happened()
        else:
            self._turns.until(happened, timeout_s, look, patient)
        return found


def _is_no_end(record: logging.LogRecord) -> bool:
    """Return whether a log record is about anything but the end of the flight."""
    return not (record.exc_info and isinstance(record.exc_info[1], FlightOver))


def end_pools() -> None:
    """Let executors finish that nobody has shut down, as Python does at its end."""
    if (pools := sys.modules.get("concurrent.futures.thread")) is not None:
        pools._python_exit()
        vars(pools)["_shutdown"] = False
