"""Threads of a script on a simulated clock: in order of time, one at a time, and never stuck."""

import threading
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from uavaccel.clock import VirtualClock
from uavaccel.fly.script import FlightOver
from uavaccel.fly.threads import ThreadClasses
from uavaccel.fly.turns import Turns
from uavaccel.units import NS_PER_S


@pytest.fixture
def script() -> Any:
    """What a script with threads has: its modules, its clock, and what it writes down."""
    clock = VirtualClock()
    turns = Turns(clock)
    kinds = ThreadClasses(turns)
    modules, running = kinds.modules(), kinds.running
    written: list[Any] = []

    def sleep(seconds: float) -> None:
        turns.wait_until(clock.now_ns() + round(seconds * NS_PER_S))

    def start(*targets: Any) -> list[Any]:
        threads = [modules["threading"].Thread(target=target) for target in targets]
        for thread in threads:
            thread.start()
        return threads

    return SimpleNamespace(
        **modules, turns=turns, clock=clock, running=running, written=written, sleep=sleep, start=start
    )


def seconds(script: Any) -> float:
    return round(script.clock.now_ns() / NS_PER_S, 2)


def test_they_run_in_order_of_the_time_for_which_they_wait(script: Any) -> None:
    def beat(name: str, period_s: float) -> None:
        for _ in range(3):
            script.sleep(period_s)
            script.written.append((name, seconds(script)))

    threads = script.start(lambda: beat("slow", 0.5), lambda: beat("fast", 0.2))
    for thread in threads:
        thread.join()
    assert script.written == [
        ("fast", 0.2), ("fast", 0.4), ("slow", 0.5), ("fast", 0.6), ("slow", 1.0), ("slow", 1.5),
    ]  # fmt: skip
    assert not script.running
    assert not any(thread.is_alive() for thread in threads)


def test_a_lock_lets_one_in_at_a_time(script: Any) -> None:
    lock = script.threading.Lock()

    def work(name: int) -> None:
        with lock:
            script.sleep(1.0)
            script.written.append((name, seconds(script)))

    for thread in script.start(*(lambda name=name: work(name) for name in range(3))):
        thread.join()
    names, times = zip(*script.written, strict=True)
    assert names == (0, 1, 2)
    assert times == (1.0, 2.0, 3.0)
    assert lock.acquire(timeout=0.1)
    assert not lock.acquire(blocking=False)
    assert not lock.acquire(timeout=0.5)


def test_events_conditions_and_queues_wake_who_waits(script: Any) -> None:
    event, full = script.threading.Event(), script.queue.Queue(maxsize=2)
    condition = script.threading.Condition()

    def produce() -> None:
        event.wait()
        for item in range(5):
            full.put(item)
        with condition:
            condition.notify_all()

    [thread] = script.start(produce)
    assert event.wait(0.3) is False
    with pytest.raises(script.queue.Empty):
        full.get(timeout=0.1)
    event.set()
    assert [full.get() for _ in range(3)] == [0, 1, 2]
    with condition:
        assert condition.wait(5.0)
    thread.join()
    assert [full.get_nowait(), full.get_nowait(), full.empty()] == [3, 4, True]


def test_a_lock_that_may_be_taken_again_is_free_once_it_was_given_back_as_often(script: Any) -> None:
    lock = script.threading.RLock()

    def take(name: str) -> None:
        with lock:
            script.written.append((name, seconds(script)))

    with lock:
        with lock:
            [thread] = script.start(lambda: take("other"))
            script.sleep(1.0)
        script.sleep(1.0)
        script.written.append(("mine", seconds(script)))
    thread.join()
    assert script.written == [("mine", 2.0), ("other", 2.0)]
    with pytest.raises(RuntimeError, match="un-acquired"):
        lock.release()


def test_who_waited_first_is_woken_first_and_no_more_than_are_to_be(script: Any) -> None:
    condition, places = script.threading.Condition(), script.threading.Semaphore(0)

    def wait(name: int) -> None:
        with condition:
            script.written.append((name, condition.wait(3.0), seconds(script)))

    def take(name: str) -> None:
        script.written.append((name, places.acquire(timeout=3.0), seconds(script)))

    threads = script.start(*(lambda name=name: wait(name) for name in range(3)))
    script.sleep(1.0)
    with condition:
        condition.notify()
    script.sleep(1.0)
    with condition:
        condition.notify()
    for thread in threads:
        thread.join()
    assert script.written == [(0, True, 1.0), (1, True, 2.0), (2, False, 3.0)]
    script.written.clear()
    threads = script.start(*(lambda name=name: take(name) for name in "abc"))
    script.sleep(1.0)
    places.release(2)
    for thread in threads:
        thread.join()
    assert script.written == [("a", True, 4.0), ("b", True, 4.0), ("c", False, 6.0)]
    with condition:
        assert condition.wait_for(lambda: False, 0.5) is False
    assert seconds(script) == 6.5


def test_a_queue_holds_as_much_as_it_may_and_is_done_when_its_tasks_are(script: Any) -> None:
    tasks = script.queue.Queue(maxsize=1)

    def work() -> None:
        for _ in range(2):
            script.sleep(1.0)
            tasks.get()
            script.sleep(1.0)
            tasks.task_done()

    [thread] = script.start(work)
    tasks.put("one")
    with pytest.raises(script.queue.Full):
        tasks.put("two", timeout=0.5)
    tasks.put("two")
    script.written.append(seconds(script))
    tasks.join()
    script.written.append(seconds(script))
    thread.join()
    assert script.written == [1.0, 4.0]
    simple, bounded = script.queue.SimpleQueue(), script.threading.BoundedSemaphore()
    with pytest.raises(script.queue.Empty):
        simple.get(timeout=1.0)
    assert (bounded.acquire(), bounded.acquire(timeout=1.0)) == (True, False)
    assert seconds(script) == 6.0


def test_who_waits_for_nobody_is_told() -> None:
    """Whatever else the process did before the script, such as a library's thread that waits for its own work."""
    done = threading.Event()
    threading.Thread(target=done.wait, daemon=True).start()
    turns = Turns(VirtualClock())
    modules = ThreadClasses(turns).modules()
    with pytest.raises(RuntimeError, match="would wait for ever"):
        modules["threading"].Event().wait()
    done.set()


def test_what_waits_without_end_ends_with_the_flight() -> None:
    clock = VirtualClock()
    event = ThreadClasses(Turns(clock, limit_ns=3 * NS_PER_S)).modules()["threading"].Event()
    assert event.wait(1.0) is False
    with pytest.raises(FlightOver):
        event.wait()
    assert clock.now_ns() == 3 * NS_PER_S


def test_who_all_wait_for_each_other_are_told(script: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threading, "excepthook", lambda event: script.written.append(str(event.exc_value)))
    [thread] = script.start(script.threading.Event().wait)
    with pytest.raises(RuntimeError, match="would wait for ever"):
        script.threading.Event().wait()
    thread.join()
    assert ["would wait for ever" in text for text in script.written] == [True]


def test_who_waits_wakes_at_that_moment_and_is_not_looked_after_before(script: Any) -> None:
    """A pool's idle workers would cost a look a millisecond."""
    event = script.threading.Event()

    def wait() -> None:
        event.wait()
        script.written.append(script.clock.now_ns())

    [thread] = script.start(wait)
    script.sleep(3600.0)
    waited = script.turns._order
    event.set()
    thread.join()
    assert script.written == [3600 * NS_PER_S]
    assert waited < 10


def test_a_timer_calls_unless_cancelled(script: Any) -> None:
    timers = [script.threading.Timer(period_s, script.written.append, (period_s,)) for period_s in (1.0, 2.0)]
    for timer in timers:
        timer.start()
    timers[1].cancel()
    script.sleep(3.0)
    assert script.written == [1.0]


def test_an_exception_ends_its_thread_alone(script: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threading, "excepthook", lambda event: script.written.append(event.exc_value))

    def fall() -> None:
        raise ValueError("down")

    [thread] = script.start(fall)
    thread.join()
    assert [str(error) for error in script.written] == ["down"]
    assert script.turns.is_mine()


def test_the_rest_of_the_modules_is_pythons(script: Any) -> None:
    assert isinstance(script.threading, ModuleType)
    assert script.threading.current_thread() is threading.main_thread()
    assert isinstance(script.threading.Thread(), threading.Thread)
