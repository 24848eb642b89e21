"""Scripts with threads against a second scheduler, written here, over random programs: who goes on when, with what."""

from __future__ import annotations

from collections.abc import Callable, Generator
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.test_fly import client_of
from uavaccel.fly.log import MessageLog
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.simulated import SimulatedFlight
from uavaccel.fly.threads import ThreadModules

PROGRAMS, THREADS, DEEDS, STEP_MS = 60, 4, 12, 8
QUEUES = ("Queue", "LifoQueue", "PriorityQueue", "SimpleQueue")
NAMES = ("sleep", "take", "take", "give", "acquire", "release", "get", "put", "wait", "set", "clear", "join", "fly")
Deed = tuple[str, float | None, int]
"""What a thread does, for how many ms at most it waits, None: for ever, and a number: what is put, who is joined."""
Waiting = Generator[tuple[float, Callable[[], bool]], None, Any]
"""Until when at most a thread of the reference waits, and for what."""


class Reference:
    """A thread runs until it waits; of those that may go on first, the one that has waited longest does."""

    def __init__(self, kind: str, size: float, programs: list[list[Deed]], speed: float) -> None:
        self.kind, self.size, self.speed = kind, size, speed
        self.now, self.said, self.left = 0.0, list[Any](), {*range(1, THREADS)}
        self.held, self.places, self.items, self.is_set = False, 1, list[int](), False
        self.free, self.filled, self.emptied, self.event = (list[object]() for _ in range(4))  # who waits to be told
        threads = (self.thread(number, program) for number, program in enumerate(programs))
        waiting: list[tuple[float, Callable[[], bool], Waiting]] = [(0.0, bool, thread) for thread in threads]
        while waiting:
            due = [self.now if at > self.now and happened() else at for at, happened, _ in waiting]
            place = due.index(min(due))
            self.now = self.now if due[place] == inf else due[place]
            *_, thread = waiting.pop(place)
            if (wait := next(thread, None)) is not None:
                waiting.append((*wait, thread))

    def thread(self, number: int, program: list[Deed]) -> Waiting:
        for name, ms, what in program:
            try:
                answer = getattr(self, name)(inf if ms is None else self.now + ms, what)
                if isinstance(answer, Generator):
                    answer = yield from answer
            except RuntimeError:
                answer = "RuntimeError"
            self.said.append((self.now, number, name, answer))
        self.left.discard(number)
        while number == 0 and self.left:  # the script's first thread
            try:
                yield from self.until(lambda: not self.left, inf)
            except RuntimeError:
                self.said.append(self.now)

    def until(self, happened: Callable[[], bool], at: float) -> Waiting:
        if not happened():
            yield at, happened
            if not happened() and self.now < at:
                raise RuntimeError("this would wait for ever")
        return happened()

    def told(self, waiters: list[object], until: float) -> Waiting:
        """Wait to be told; the first that waits is told first."""
        waiters.append(mine := object())
        try:
            return (yield from self.until(lambda: mine not in waiters, until))
        finally:
            waiters[:] = [each for each in waiters if each is not mine]

    def once(self, ready: Callable[[], bool], waiters: list[object], until: float) -> Waiting:
        while not ready():
            if self.now >= until:
                return False
            yield from self.told(waiters, until)
        return True

    def sleep(self, until: float, _: int) -> Waiting:
        yield until, bool

    def take(self, until: float, _: int) -> Waiting:
        if free := (yield from self.until(lambda: not self.held, until)):
            self.held = True
        return free

    def give(self, *_: float) -> None:
        if not self.held:
            raise RuntimeError("release unlocked lock")
        self.held = False

    def acquire(self, until: float, _: int) -> Waiting:
        if free := (yield from self.once(lambda: self.places > 0, self.free, until)):
            self.places -= 1
        return free

    def release(self, *_: float) -> None:
        self.places += 1
        del self.free[:1]

    def get(self, until: float, _: int) -> Waiting:
        if not (yield from self.once(lambda: bool(self.items), self.filled, until)):
            return "Empty"
        del self.emptied[:1]
        if self.kind == "PriorityQueue":
            self.items.sort()
        return self.items.pop(-1 if self.kind == "LifoQueue" else 0)

    def put(self, until: float, what: int) -> Waiting:
        if not (yield from self.once(lambda: len(self.items) < self.size, self.emptied, until)):
            return "Full"
        self.items.append(what)
        del self.filled[:1]

    def wait(self, until: float, _: int) -> Waiting:
        return self.is_set or (self.now < until and (yield from self.told(self.event, until)))

    def set(self, *_: float) -> None:
        self.is_set = True
        self.event.clear()

    def clear(self, *_: float) -> None:
        self.is_set = False

    def join(self, until: float, whom: int) -> Waiting:
        yield from self.until(lambda: whom not in self.left, until)

    def fly(self, until: float, _: int) -> Waiting:
        """Fly for a simulated time that ends at nobody else's time, then sleep to one that is."""
        yield self.now + (until - self.now - 2) / self.speed, bool
        yield self.now + 2 / self.speed, bool


def flown(flight: SimulatedFlight, kind: str, size: float, programs: list[list[Deed]], speed: float) -> list[Any]:
    """Return what the threads of a script say."""
    turns, client, said = flight._turns, client_of(flight), list[Any]()
    modules: Any = ThreadModules(turns).in_scripts()
    threading, queue = modules["threading"], modules["queue"]
    lock, places, event = threading.Lock(), threading.Semaphore(1), threading.Event()
    items = getattr(queue, kind)(*() if size == inf else (size,))
    begun_ns = turns.now_ns()

    def fly(s: float, _: int) -> None:
        client.moveByVelocityAsync(0, 0, 0, s - 0.002).join()
        flight.pass_time(0.002 / speed)

    acts: dict[str, Callable[[Any, int], Any]] = {
        "sleep": lambda s, _: flight.pass_time(s), "fly": fly, "wait": lambda s, _: event.wait(s),
        "take": lambda s, _: lock.acquire(timeout=-1 if s is None else s),
        "give": lambda _, what: (lock.release, lock.__exit__)[what % 2](),
        "acquire": lambda s, _: places.acquire(timeout=s), "release": lambda *_: places.release(),
        "get": lambda s, _: items.get(timeout=s), "put": lambda s, what: items.put(what, timeout=s),
        "set": lambda *_: event.set(), "clear": lambda *_: event.clear(), "join": lambda s, whom: threads[whom].join(s),
    }  # fmt: skip

    def run(number: int) -> None:
        for name, ms, what in programs[number]:
            try:
                answer = acts[name](None if ms is None else ms / 1000, what)
            except Exception as error:
                answer = type(error).__name__
            said.append(((turns.now_ns() - begun_ns) / 1e6, number, name, answer))

    threads = [threading.Thread(target=run, args=(number,)) for number in range(THREADS)]
    for thread in threads[1:]:
        thread.start()
    run(0)
    while turns.running:
        try:
            turns.until(lambda: not turns.running)
        except RuntimeError:
            said.append((turns.now_ns() - begun_ns) / 1e6)
    return said


def drawn(generator: np.random.Generator) -> list[list[Deed]]:
    """Draw what each thread does; only the last one flies."""

    def deed(number: int) -> Deed:
        name, ms = NAMES[generator.integers(len(NAMES))], STEP_MS * int(generator.integers(15))
        if name in ("sleep", "fly"):
            return name if number == THREADS - 1 else "sleep", ms + STEP_MS, 0
        others = [each for each in range(1, THREADS) if each != number]
        return name, ms if generator.integers(12) else None, int(generator.choice(others if name == "join" else 99))

    return [[deed(number) for _ in range(DEEDS)] for number in range(THREADS)]


@pytest.mark.timeout(120)  # what waits wrongly waits for ever
@pytest.mark.parametrize("speed", [1.0, 0.5])
def test_threads_go_on_when_and_with_what_a_second_scheduler_says(speed: float, tmp_path: Path) -> None:
    log = MessageLog(tmp_path)
    flight = SimulatedFlight(FlightOptions(Path("script.py"), (), tmp_path, timing="lockstep"), None, speed, log)
    client_of(flight).enableApiControl(True)
    for seed in range(PROGRAMS):
        generator, kind = np.random.default_rng(seed), QUEUES[seed % len(QUEUES)]
        size = inf if kind == "SimpleQueue" else int(generator.integers(1, 3))
        given = kind, size, drawn(generator), speed
        assert (flown(flight, *given), seed) == (Reference(*given).said, seed)
    log.close()
