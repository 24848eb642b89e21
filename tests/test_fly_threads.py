"""Threads under `uavaccel fly`: small programs do on the simulated clock what they do on Python's own threads.

The programs of `PROGRAMS` run both ways, and must say the same. What Python leaves to chance, the simulated clock
decides: the tests after them, and test_fly_reference, hold its order, its times, and what becomes of a script that
waits for nobody.
"""

from __future__ import annotations

import _thread
import asyncio
import itertools
import logging
import multiprocessing
import multiprocessing.dummy
import multiprocessing.pool
import os
import queue
import re
import sched
import select
import selectors
import socket
import socketserver
import subprocess
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, FIRST_EXCEPTION, ThreadPoolExecutor, as_completed
from concurrent.futures import wait as wait_for_futures
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from uavaccel.clock import VirtualClock, time_module
from uavaccel.errors import UserError, naming
from uavaccel.fly.modules import Patches
from uavaccel.fly.script import FlightOver, hide_frames_everywhere
from uavaccel.fly.simulated import READING_NS
from uavaccel.fly.threads import OutsideEvents, SharedModules, ThreadModules
from uavaccel.fly.turns import BUSY, Turns
from uavaccel.units import NS_PER_S

pytestmark = pytest.mark.timeout(120)  # what waits wrongly waits for ever
UNIT_S = 0.2  # long enough for a busy machine to get every thread to its place
LATER_S = 60.0  # a time-out that does not pass
Program = Callable[[Any], None]
PROGRAMS: dict[str, Program] = {}


def program(declared: Program) -> Program:
    PROGRAMS[declared.__name__] = declared
    return declared


class Script:
    """What a program has: modules, a clock, and `said`, where it notes what it meets."""

    def __init__(self, modules: dict[str, Any], sleep: Callable[[float], None], now_s: Callable[[], float]) -> None:
        self.threading, self.queue, self.thread = (modules[name] for name in ("threading", "queue", "_thread"))
        self.select, self.selectors = modules["select"], modules["selectors"]
        self.sleep, self.now_s = sleep, now_s
        self.said: list[Any] = []
        self.shared = SimpleNamespace(pool=multiprocessing.pool.ThreadPool, dummy=multiprocessing.dummy)

    def units(self, count: float) -> float:
        self.sleep(count * UNIT_S)
        return count

    def say(self, *what: Any) -> None:
        self.said.append(what)

    def ask(self, *calls: Callable[[], Any]) -> None:
        """Note what each call returns, or the exception that it raises."""
        for call in calls:
            try:
                answer = call()
            except Exception as error:
                answer = type(error).__name__, re.sub(" at 0x[0-9a-f]+", "", str(error))
            self.said.append(answer)

    def start(self, *targets: Callable[[], Any], **how: Any) -> list[threading.Thread]:
        threads = [self.threading.Thread(target=target, **how) for target in targets]
        for thread in threads:
            thread.start()
        return threads

    def run(self, *targets: Callable[[], Any]) -> None:
        for thread in self.start(*targets):
            thread.join()


# --- programs ------------------------------------------------------------------------------------------------------


@program
def locks(s: Script) -> None:
    for lock in (s.threading.Lock(), s.thread.allocate_lock()):
        take = lock.acquire
        s.ask(
            lock.locked, take, lock.locked, partial(take, False), partial(take, timeout=0.01), partial(take, timeout=0)
        )
        s.ask(partial(take, False, 1.0), partial(take, timeout=-2), lock.release, lock.release, lock.__enter__)
        s.ask(partial(lock.__exit__, None, None, None), lock.locked)


@program
def locks_that_may_be_taken_again(s: Script) -> None:
    lock = s.threading.RLock()
    s.ask(lock.acquire, lock.acquire, lock.release)
    s.run(lambda: s.ask(partial(lock.acquire, False), partial(lock.acquire, timeout=0.01), lock.release))
    s.ask(lock.release, lock.release, partial(lock.acquire, False, 1.0))
    s.run(lambda: s.ask(lock.acquire, lock.acquire, lock.release, lock.release))


@program
def conditions(s: Script) -> None:
    for lock, holds in ((None, 3), (s.threading.Lock(), 1), (s.threading.RLock(), 2)):
        condition = s.threading.Condition(lock)
        told: list[int] = []
        s.ask(condition.notify, condition.notify_all, condition.wait, condition.release)

        def tell(condition: Any = condition, told: list[int] = told) -> None:
            with condition:
                told.append(1)
                condition.notify()

        waits = (condition.wait, partial(condition.wait_for, lambda told=told: len(told) == 2))
        for wait in waits:  # which gives back all that is held
            for _ in range(holds):
                condition.acquire()
            [thread] = s.start(tell)
            s.ask(partial(wait, timeout=LATER_S), partial(len, told))
            for _ in range(holds):
                condition.release()
            thread.join()
            s.ask(condition.release)
        with condition:
            s.ask(partial(condition.wait, 0.01), partial(condition.wait, 0), partial(condition.wait, -1))
            s.ask(partial(condition.wait_for, lambda: 0, 0.01), partial(condition.wait_for, lambda: 7))
        s.ask(partial(condition.acquire, False), condition.release)


@program
def semaphores(s: Script) -> None:
    for kind in (s.threading.Semaphore, s.threading.BoundedSemaphore):
        places = kind(2)
        take, give = places.acquire, places.release
        s.ask(take, take, partial(take, False), partial(take, False, 1.0), partial(take, timeout=0.01))
        [thread] = s.start(partial(s.ask, partial(take, timeout=LATER_S)))
        s.ask(give)
        thread.join()
        s.ask(give, give, partial(give, 0), give, partial(kind, -1))


@program
def barriers(s: Script) -> None:
    barrier = s.threading.Barrier(3, lambda: s.say("open"), timeout=LATER_S)
    places: list[int] = []
    s.run(*[lambda: places.append(barrier.wait())] * 3)
    s.say(sorted(places), barrier.parties, barrier.n_waiting, barrier.broken)
    s.ask(partial(barrier.wait, 0.01), barrier.wait, lambda: barrier.broken, barrier.reset, lambda: barrier.broken)
    [thread] = s.start(lambda: s.ask(barrier.wait))
    s.units(1)
    s.ask(barrier.abort)
    thread.join()
    s.ask(barrier.wait)


@program
def timers(s: Script) -> None:
    timer = s.threading.Timer(UNIT_S, lambda *a, **k: s.say(a, k), ("a", 2), {"key": 3})
    other = s.threading.Timer(UNIT_S, s.say, ("never",))
    timer.start()
    other.start()
    other.cancel()
    s.ask(timer.finished.is_set, partial(timer.finished.wait, LATER_S), timer.join, timer.is_alive)
    s.ask(other.join, other.finished.is_set, timer.start)


@program
def threads(s: Script) -> None:
    own = s.threading.local()
    own.value = "first"
    inside: list[Any] = []
    thread = s.threading.Thread(target=lambda: inside.extend((vars(own), s.threading.current_thread().name)), name="T")
    s.ask(thread.is_alive, thread.join, lambda: (thread.name, thread.ident, thread.daemon), thread.start, thread.join)
    s.ask(lambda: inside, thread.is_alive, thread.start, lambda: setattr(thread, "daemon", True))

    def inner() -> None:
        s.ask(s.threading.current_thread().join, lambda: s.threading.current_thread().daemon)
        s.ask(lambda: s.threading.Thread().daemon, lambda: s.threading.current_thread().is_alive())

    for daemon in (False, True, None):
        [thread] = s.start(inner, daemon=daemon)
        thread.join()
        s.say(thread.daemon, thread.is_alive())
    [thread] = s.start(partial(s.units, 3))
    s.ask(
        partial(thread.join, 0.01), thread.is_alive, thread.join, thread.is_alive, thread.join, partial(thread.join, -1)
    )

    class Own(s.threading.Thread):  # type: ignore[name-defined]
        def __init__(self, number: int) -> None:
            super().__init__(daemon=True)
            self.number = number

        def run(self) -> None:
            s.say("own", self.number)

    own_thread = Own(5)
    own_thread.start()
    own_thread.join()


@program
def threads_of_the_lowest_kind(s: Script) -> None:
    done = s.thread.allocate_lock()
    done.acquire()

    def work(a: int, b: int = 0) -> None:
        s.say(a, b)
        done.release()

    s.ask(lambda: type(s.thread.start_new_thread(work, (1,), {"b": 2})), done.acquire)
    s.ask(lambda: type(s.thread.start_new_thread(work, (3,))), done.acquire)


@program
def queues(s: Script) -> None:
    for kind in ("Queue", "LifoQueue", "PriorityQueue", "SimpleQueue"):
        items = getattr(s.queue, kind)()
        for item in (2, 3, 1):
            items.put(item)
        s.ask(items.qsize, items.get, items.get, items.get_nowait, items.empty, items.get_nowait)
        s.ask(partial(items.get, timeout=0.01), partial(items.get, timeout=-1), partial(items.get, False))
        [thread] = s.start(partial(s.ask, partial(items.get, timeout=LATER_S)))
        items.put("late")
        thread.join()
    full = s.queue.Queue(maxsize=1)
    s.ask(partial(full.put, "two"), full.full, partial(full.put_nowait, "three"))

    def work() -> None:
        full.get()
        full.task_done()

    [thread] = s.start(work)
    s.ask(full.join, full.task_done)
    thread.join()


def unless_two(s: Script, units: float) -> float:
    s.units(units)
    if units == 2:
        raise ValueError("two")
    return units


@program
def executors(s: Script) -> None:
    wait = partial(unless_two, s)
    with ThreadPoolExecutor(3) as pool:
        s.ask(lambda: list(pool.map(wait, (3, 1, 4))), lambda: list(pool.map(wait, (1, 2, 3))))
        futures = [pool.submit(wait, units) for units in (6, 0, 3)]
        s.say([future.result() for future in as_completed(futures)])
        slow = pool.submit(wait, 8)
        s.ask(
            partial(slow.result, 0.01), lambda: list(as_completed([slow], 0.01)), slow.running, slow.cancel, slow.result
        )


@program
def waits_for_futures(s: Script) -> None:
    wait = partial(unless_two, s)
    with ThreadPoolExecutor(3) as pool:
        failed = pool.submit(wait, 2)
        failed.add_done_callback(lambda future: s.say("callback", future is failed))
        s.ask(failed.result, lambda: type(failed.exception()), failed.done)
        for when, units in ((FIRST_COMPLETED, (6, 1)), (FIRST_EXCEPTION, (6, 2)), ("ALL_COMPLETED", (1, 3))):
            done, rest = wait_for_futures([pool.submit(wait, each) for each in units], return_when=when)
            s.say(len(done), len(rest))
    s.ask(partial(pool.submit, abs, 1))
    pool = ThreadPoolExecutor(1, initializer=s.say, initargs=("begun",))
    begun = pool.submit(wait, 4)
    waiting = [pool.submit(wait, 0) for _ in range(2)]
    s.units(1)
    s.ask(waiting[0].cancel, partial(pool.shutdown, wait=True, cancel_futures=True), begun.result)
    s.say([each.cancelled() for each in waiting])
    broken = ThreadPoolExecutor(1, initializer=lambda: 1 / 0)
    s.ask(lambda: type(broken.submit(abs, 1).exception()).__name__)


def quotient(s: Script, units: float) -> float:
    s.units(units)
    return 6 / (units - 2)


@program
def pools(s: Script) -> None:
    wait = partial(quotient, s)
    with s.shared.pool(processes=3, initializer=s.say, initargs=("begun",)) as pool:
        s.ask(partial(pool.map, wait, (5, 1, 3)), lambda: list(pool.imap(wait, (5, 1, 3))))
        s.ask(lambda: list(pool.imap_unordered(wait, (5, 1, 3))), partial(pool.starmap, pow, [(2, 3), (3, 2)]))
        s.ask(
            partial(pool.apply, int, ("11",), {"base": 2}), partial(pool.map, wait, (1, 2)), partial(pool.map, abs, [])
        )


@program
def results_of_pools(s: Script) -> None:
    wait = partial(quotient, s)
    with s.shared.pool(3) as pool:
        for units in ((4, 3), (1, 2)):
            told: list[Any] = []
            result = pool.map_async(
                wait, units, callback=told.append, error_callback=lambda e, t=told: t.append(type(e))
            )
            s.ask(partial(result.get, timeout=0.01), result.ready, result.successful, result.wait, result.ready)
            s.ask(result.successful, result.get, partial(list, told))
        s.ask(lambda: pool.apply_async(wait, (3,)).get(LATER_S), lambda: next(pool.imap(wait, [8])))


@program
def ends_of_pools(s: Script) -> None:
    for end, each in (("close", 1), ("terminate", 1)):
        ended: list[int] = []
        pool = s.shared.pool(1)
        s.ask(pool.join)
        for number in range(3):
            pool.apply_async(lambda number=number, ended=ended: (s.units(3), ended.append(number)))
        s.units(each)
        s.ask(getattr(pool, end), pool.join, partial(pool.apply, abs, (1,)))
        if end == "close":
            s.say(ended)
    s.ask(partial(s.shared.pool, 0))


@program
def processes_that_are_threads(s: Script) -> None:
    dummy = s.shared.dummy
    tasks = dummy.JoinableQueue()
    process = dummy.Process(target=lambda: (s.units(1), tasks.put(1)))
    s.ask(lambda: process.exitcode, process.start, process.is_alive, tasks.get, process.join, lambda: process.exitcode)
    lock = dummy.Lock()
    s.ask(lock.acquire, partial(lock.acquire, False), lock.release)
    with dummy.Pool(2) as pool:
        s.ask(partial(pool.map, abs, [-1, 2]))


@program
def event_loops(s: Script) -> None:
    async def after(units: float) -> float:
        await asyncio.sleep(units * UNIT_S)
        return units

    async def tasks() -> None:
        loop, items = asyncio.get_running_loop(), asyncio.Queue[int]()
        s.say(await asyncio.gather(after(3), after(1), after(2)))
        for each in asyncio.as_completed([after(5), after(0), after(2)]):
            s.say(await each)
        try:
            await asyncio.wait_for(asyncio.sleep(LATER_S), 0.01)
        except TimeoutError:
            s.say("time-out")
        s.say(await asyncio.to_thread(lambda: (s.units(1), "thread")[1]))
        s.say(await loop.run_in_executor(None, pow, 2, 5))
        [thread] = s.start(lambda: (s.units(1), loop.call_soon_threadsafe(items.put_nowait, 7)))
        s.say(await items.get())
        thread.join()
        with ThreadPoolExecutor(1) as pool:
            s.say(await loop.run_in_executor(pool, lambda: (s.units(1), "own")[1]))
        loop.call_later(UNIT_S, s.say, "later")
        await after(3)

    asyncio.run(tasks())


@program
def sockets(s: Script) -> None:
    """Who waits for data, or for who connects, leaves the others their turns; a time-out is the script's time."""
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket(type=socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(UNIT_S)

        def answer() -> None:
            s.units(1)
            with server.accept()[0] as accepted:
                s.say(accepted.recv(9))
                s.units(1)
                accepted.sendall(b"pong")

        [thread] = s.start(answer)
        with socket.create_connection(server.getsockname()) as connection:
            connection.sendall(b"ping")
            receiver.setblocking(False)
            s.ask(partial(receiver.recvfrom, 9))
            receiver.settimeout(UNIT_S)
            s.say(connection.recv_into(bytearray(9)))
            s.ask(partial(receiver.recvfrom, 9))
        thread.join()
    event = s.threading.Event()
    [thread] = s.start(event.wait)
    ours, theirs = socket.socketpair()
    with ours, theirs, subprocess.Popen(["sh", "-c", "sleep 0.1; echo pong"], stdout=theirs.fileno()):
        ours.settimeout(LATER_S)  # which another program's data are in time for
        s.ask(partial(ours.recv, 9))
        event.set()
        thread.join()


@program
def selects(s: Script) -> None:
    """Who waits until one of several files has data leaves the others their turns, too."""
    poll, selector = s.select.poll(), s.selectors.DefaultSelector()
    with socket.socket(type=socket.SOCK_DGRAM) as receiver, socket.socket(type=socket.SOCK_DGRAM) as sender:
        receiver.bind(("127.0.0.1", 0))
        sender.connect(receiver.getsockname())
        poll.register(receiver, select.POLLIN)
        selector.register(receiver, selectors.EVENT_READ)
        within = partial(s.select.select, [receiver], [], [])
        for wait in (within, poll.poll, selector.select):
            for timeout in (0, 0.01, LATER_S, None, *([-1] if wait == poll.poll else [])):
                later = timeout in (None, LATER_S, -1)
                [thread] = s.start(lambda: (s.units(1), sender.send(b"ping"))) if later else [None]
                s.say(any(wait(*() if timeout is None else (timeout,))))
                if thread is not None:
                    s.say(receiver.recv(9))
                    thread.join()
    for number in range(3):
        poll, selector = s.select.poll(), s.selectors.DefaultSelector()
        with subprocess.Popen(["sh", "-c", "sleep 0.1; echo pong"], stdout=subprocess.PIPE) as other:
            poll.register(other.stdout, select.POLLIN)
            selector.register(other.stdout, selectors.EVENT_READ)
            within = partial(s.select.select, [other.stdout], [], [])
            wait, timeout = [(within, LATER_S), (poll.poll, LATER_S * 1e3), (selector.select, LATER_S)][number]
            s.say([*map(len, wait(timeout))])
    read, write = os.pipe()

    def answer() -> None:
        s.select.select([read], [], [])
        s.say(os.read(read, 9))

    [thread] = s.start(answer)
    with subprocess.Popen(["sh", "-c", "sleep 0.1; echo pong"], stdout=subprocess.PIPE) as other:
        s.units(1)  # the thread waits first, for what comes of what this one waits for
        s.select.select([other.stdout], [], [])
        os.write(write, b"on")
        thread.join()
    os.close(read)
    os.close(write)


@program
def servers(s: Script) -> None:
    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            s.say(self.rfile.readline())

    with socketserver.TCPServer(("127.0.0.1", 0), Handler) as server:
        [thread] = s.start(server.serve_forever)
        s.units(1)
        with socket.create_connection(server.socket.getsockname()) as connection:
            connection.sendall(b"ping\n")
            s.say(connection.recv(9))
        server.shutdown()
        thread.join()
        s.say(thread.is_alive())


@program
def schedulers(s: Script) -> None:
    for scheduler in (sched.scheduler(), sched.scheduler(s.now_s, s.sleep)):
        scheduler.enter(3 * UNIT_S, 1, s.say, ("second",))
        scheduler.enter(UNIT_S, 1, s.say, ("first",))
        never = scheduler.enter(2 * UNIT_S, 1, s.say, ("never",))
        scheduler.cancel(never)
        scheduler.run()


# --- both ways -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def on_pythons_threads() -> dict[str, list[Any]]:
    """What the programs say on Python's own threads, all at the same time."""
    own = (threading, queue, _thread, select, selectors)
    modules = {module.__name__: module for module in own}

    def run(each: Program) -> list[Any]:
        script = Script(modules, time.sleep, time.monotonic)
        each(script)
        return script.said

    with ThreadPoolExecutor(len(PROGRAMS)) as pool:
        return dict(zip(PROGRAMS, pool.map(run, PROGRAMS.values()), strict=True))


@pytest.fixture
def script() -> Iterator[Any]:
    """A script on a simulated clock, whose `turns`, `clock` and `running` threads tests look at."""
    clock = VirtualClock()
    turns = Turns(clock)
    modules = ThreadModules(turns)

    def sleep(seconds: float) -> None:
        turns.wait_until(clock.now_ns() + round(seconds * NS_PER_S))

    def read_ns() -> int:
        clock.charge(READING_NS)
        return clock.now_ns()

    with Patches() as patches:
        own_time: Any = time_module(read_ns, sleep)
        outside = OutsideEvents(turns, own_time)
        SharedModules(patches, turns, modules, outside, own_time)
        made: Any = Script(modules.in_scripts() | outside.in_scripts(), sleep, own_time.monotonic)
        made.turns, made.clock, made.running = turns, clock, turns.running
        yield made


@pytest.mark.wall_clock
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_says_what_it_says_on_pythons_threads(
    script: Any, on_pythons_threads: dict[str, list[Any]], name: str
) -> None:
    PROGRAMS[name](script)
    assert script.said == on_pythons_threads[name]
    assert len(script.said) > 1


# --- the simulated clock -------------------------------------------------------------------------------------------


def seconds(script: Any) -> float:
    return round(script.clock.now_ns() / NS_PER_S, 3)


def test_pools_take_the_time_of_their_longest_calls(script: Any) -> None:
    def wait(given_s: float) -> float:
        script.sleep(given_s)
        return given_s

    told: list[Any] = []
    with script.shared.pool(3) as pool:
        for give in (pool.imap, pool.imap_unordered):
            told.append([(value, seconds(script)) for value in give(wait, (3, 1, 2))])
    with ThreadPoolExecutor(2) as executor:
        told.append(
            [(future.result(), seconds(script)) for future in as_completed(map(executor.submit, [wait] * 3, (2, 1, 4)))]
        )
    assert told == [
        [(3, 3.0), (1, 3.0), (2, 3.0)], [(1, 4.0), (2, 5.0), (3, 6.0)], [(1, 7.0), (2, 8.0), (4, 11.0)],
    ]  # fmt: skip


def test_a_thread_that_waits_is_not_looked_after_before_it_wakes(script: Any) -> None:
    """A pool's idle workers would cost a look a millisecond."""
    event = script.threading.Event()
    [thread] = script.start(lambda: (event.wait(), script.say(script.clock.now_ns())))
    script.sleep(3600.0)
    waited = script.turns._acts
    event.set()
    thread.join()
    assert script.said == [(3600 * NS_PER_S,)]
    assert waited < 10


def test_late_threads_run_in_the_order_of_their_times(script: Any) -> None:
    event = script.threading.Event()
    threads = script.start(lambda: (event.wait(), script.say("event")))
    for number, until_s in enumerate((2, 1, 2, 3)):
        threads += script.start(lambda number=number, s=until_s: (script.sleep(s), script.say(number, s)))
    script.sleep(0.0)
    script.clock.charge(3 * NS_PER_S)
    event.set()
    for thread in threads:
        thread.join()
    assert script.said == [(1, 1), (0, 2), (2, 2), ("event",), (3, 3)]


def test_a_librarys_pools_keep_pythons_threads(script: Any) -> None:
    from joblib import Parallel, delayed

    for _ in range(2):
        assert Parallel(n_jobs=2, backend="threading")(delayed(abs)(-number) for number in range(3)) == [0, 1, 2]
    assert (seconds(script), script.turns._acts) == (0.0, 0)


def test_an_exception_ends_its_thread_alone(script: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threading, "excepthook", lambda event: script.say(str(event.exc_value), event.thread.name))
    [thread] = script.start(lambda: 1 / 0, name="T")
    thread.join()
    assert script.said == [("division by zero", "T")]
    assert script.turns.is_mine()


@pytest.mark.parametrize(("end", "lines"), [(FlightOver(), 0), (ValueError("no"), 1), (None, 1)])
def test_pools_log_errors_but_not_the_end_of_the_flight(
    script: Any, caplog: pytest.LogCaptureFixture, end: BaseException | None, lines: int
) -> None:
    logging.getLogger("concurrent.futures").error("a worker has ended", exc_info=end)
    assert len(caplog.records) == lines


def test_of_a_users_mistake_in_a_thread_only_its_line_is_shown(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threading, "excepthook", threading.__excepthook__)
    modules: Any = ThreadModules(Turns(VirtualClock())).threading

    def connects() -> None:
        with naming(Path("log")):
            raise OSError(28, "No space left")

    thread = modules.Thread(target=connects, name="pilot")
    thread.start()
    thread.join()
    line = "uavaccel.errors.UserError: log: No space left; make room\n"
    assert capfd.readouterr().err == f"Exception in thread pilot:\n{line}"
    with Patches() as patches:
        hide_frames_everywhere(patches)
        try:
            try:
                connects()
            except UserError as error:
                raise ValueError("retry") from error
        except ValueError:
            assert traceback.format_exc().startswith(f"{line}\nThe above exception")


# --- waits without an end ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("others", [0, 1])
def test_who_waits_for_nobody_is_told(script: Any, monkeypatch: pytest.MonkeyPatch, others: int) -> None:
    """Whatever else the process did before, such as a library's thread that waits for its own work."""
    done = threading.Event()
    stranger = threading.Thread(target=done.wait, daemon=True)
    stranger.start()
    turns = Turns(VirtualClock())
    modules: Any = ThreadModules(turns).threading
    told: list[str] = []
    monkeypatch.setattr(threading, "excepthook", lambda event: told.append(str(event.exc_value)))
    threads = [modules.Thread(target=modules.Event().wait) for _ in range(others)]
    for thread in threads:
        thread.start()
    with pytest.raises(RuntimeError, match="would wait for ever"):
        modules.Event().wait()
    for thread in threads:
        thread.join()
    done.set()
    assert ["would wait for ever" in text for text in told] == [True] * others


def test_a_wait_without_an_end_ends_with_the_flight() -> None:
    clock = VirtualClock()
    event = ThreadModules(Turns(clock, limit_ns=3 * NS_PER_S)).threading.Event()
    assert event.wait(1.0) is False
    with pytest.raises(FlightOver):
        event.wait()
    assert clock.now_ns() == 3 * NS_PER_S


def test_a_thread_that_lets_no_other_one_run_is_told_of_once(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """It may wait for that one, as on Python's own threads.

    Who waits for an event waits for nobody's turn; a long sleep, too, takes the machine's time to fly.
    """
    monkeypatch.setattr("uavaccel.fly.turns.BUSY_S", 0.01)
    turns = Turns(VirtualClock(), limit_ns=3 * NS_PER_S)
    modules: Any = ThreadModules(turns).threading
    event, woken, said = modules.Event(), list[bool](), ""
    before = modules.Thread(target=int)
    before.start()
    before.join()
    while BUSY in [thread.name for thread in threading.enumerate()]:
        pass
    waits = modules.Thread(target=event.wait)
    waits.start()
    waits.join(1.0)
    time.sleep(0.1)
    assert not capfd.readouterr().err
    turns.flown_ns = itertools.count(1).__next__
    other = modules.Thread(target=woken.append, args=(True,))
    other.start()
    time.sleep(0.1)
    assert not capfd.readouterr().err
    turns.flown_ns = int
    while not said:
        said = capfd.readouterr().err
    assert re.fullmatch(
        r"uavaccel: warning: the script has computed for 0\.01 s, and its other .* --timing wall\n", said
    )
    assert not woken
    time.sleep(0.1)
    event.set()
    for thread in (other, waits):
        thread.join()
    assert woken
    assert not capfd.readouterr().err


def test_a_forked_process_waits_by_its_own_clock() -> None:
    """Beyond the flight's end, and without the threads that it does not have."""
    turns, own = Turns(VirtualClock(), limit_ns=3 * NS_PER_S), VirtualClock(5 * NS_PER_S)
    modules: Any = ThreadModules(turns).threading
    ran = list[bool]()
    modules.Thread(target=ran.append, args=(True,)).start()
    turns.forked(own)
    assert modules.Event().wait(4.0) is False
    assert (own.now_ns(), turns.running, ran) == (9 * NS_PER_S, [], [])
    looks: Any = {4.0: ["data"]}.get  # which arrive in the machine's time
    assert OutsideEvents(turns, time).wait(looks, 4.0, patient=False) == ["data"]
