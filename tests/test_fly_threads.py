"""Threads of a script on a simulated clock: in order of time, one at a time, and never stuck."""

import concurrent.futures
import multiprocessing
import multiprocessing.pool
import threading
from collections.abc import Iterator
from functools import partial
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from uavaccel.clock import VirtualClock, time_module
from uavaccel.fly.executors import let_executors_take_turns
from uavaccel.fly.patches import Patches
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
        **modules, turns=turns, kinds=kinds, clock=clock, running=running, written=written, sleep=sleep, start=start
    )


@pytest.fixture
def pools(script: Any) -> Iterator[Any]:
    """The same, where Python's pools take turns too; `wait` is a call that takes as long as it is told."""
    with Patches() as patches:
        clock = time_module(script.clock.now_ns, script.sleep)
        let_executors_take_turns(patches, script.turns, script.kinds, clock)

        def wait(given_s: float) -> float:
            script.sleep(given_s)
            return given_s

        script.wait, script.ThreadPool = wait, multiprocessing.pool.ThreadPool
        yield script


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


def outcome(call: Any) -> Any:
    """What a call returns, or the error that it raises."""
    try:
        return call()
    except (RuntimeError, ValueError) as error:
        return type(error), str(error)


def outcomes(kinds: Any) -> list[Any]:
    """What a script meets that uses locks in ways that are wrong, rare or nested."""
    found: list[Any] = []
    for lock, holds in ((kinds.Lock(), 1), (kinds.RLock(), 3)):  # all of which a wait gives back
        condition = kinds.Condition(lock)
        told: list[int] = []
        found += [outcome(call) for call in (condition.notify, condition.notify_all, condition.wait, lock.release)]

        def tell(condition: Any = condition, told: list[int] = told) -> None:
            with condition:
                told.append(1)
                condition.notify()

        for wait in (condition.wait, partial(condition.wait_for, lambda told=told: len(told) == 2)):
            thread = kinds.Thread(target=tell)
            for _ in range(holds):
                lock.acquire()
            thread.start()
            found += [outcome(lambda wait=wait: wait(timeout=20.0)), len(told)]
            for _ in range(holds):
                lock.release()
            thread.join()
            found.append(outcome(lock.release))
        with condition:
            found += [condition.wait(0.01), condition.wait_for(lambda: 0, 0.01), condition.wait_for(lambda: 7)]
    for kind in (kinds.Semaphore, kinds.BoundedSemaphore):
        places = kind(2)
        take, give = places.acquire, places.release
        calls = [take, take, partial(take, False), partial(take, False, 1.0), partial(take, timeout=0.01)]
        calls += [give, give, partial(give, 0), give, partial(kind, -1)]
        found += [outcome(call) for call in calls]
    return found


def test_locks_answer_as_the_standard_librarys_do(script: Any) -> None:
    assert outcomes(script.threading) == outcomes(threading)


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


def test_a_forked_process_waits_by_its_own_clock_beyond_the_flights_end() -> None:
    turns, own = Turns(VirtualClock(), limit_ns=3 * NS_PER_S), VirtualClock(5 * NS_PER_S)
    event = ThreadClasses(turns).modules()["threading"].Event()
    turns.announce(7 * NS_PER_S)  # a thread that the new process does not have
    turns.forked(own)
    assert event.wait(4.0) is False
    assert own.now_ns() == 9 * NS_PER_S


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


@pytest.mark.parametrize(
    ("kind", "given"),
    [("Queue", [2, 3, 1]), ("SimpleQueue", [2, 3, 1]), ("LifoQueue", [1, 3, 2]), ("PriorityQueue", [1, 2, 3])],
)
def test_queues_give_the_first_the_last_or_the_least(script: Any, kind: str, given: list[int]) -> None:
    items = getattr(script.queue, kind)()
    for item in (2, 3, 1):
        items.put(item)
    assert [items.get() for _ in range(3)] == given
    with pytest.raises(script.queue.Empty):
        items.get(block=False)
    assert seconds(script) == 0.0


def test_what_is_tried_without_waiting_takes_no_time(script: Any) -> None:
    lock, again, places = script.threading.Lock(), script.threading.RLock(), script.threading.Semaphore(2)
    full, event = script.queue.Queue(maxsize=1), script.threading.Event()
    full.put("one")
    tried: list[Any] = [lock.acquire(), lock.acquire(timeout=0), lock.acquire(blocking=False), lock.locked()]
    tried += [places.acquire(blocking=False) for _ in range(3)] + [event.wait(0), event.wait(-1.0)]
    assert tried == [True, False, False, True, True, True, False, False, False]
    for put in (lambda: full.put("two", block=False), lambda: full.put_nowait("two")):
        with pytest.raises(script.queue.Full):
            put()
    again.acquire()
    script.start(lambda: script.written.append(again.acquire(blocking=False)))[0].join()
    assert script.written == [False]
    lock.release()
    with pytest.raises(RuntimeError, match="unlocked"):
        lock.release()
    assert seconds(script) == 0.0


def test_who_waits_for_a_thread_waits_no_longer_than_told(script: Any) -> None:
    [thread] = script.start(lambda: script.sleep(2.0))
    for timeout_s, alive, then_s in ((0.5, True, 0.5), (None, False, 2.0), (1.0, False, 2.0)):
        thread.join(timeout_s)
        assert (thread.is_alive(), seconds(script)) == (alive, then_s)


def test_who_has_waited_for_a_condition_holds_its_lock_again_whether_it_came_or_not(script: Any) -> None:
    condition, ripe = script.threading.Condition(), []

    def take(name: str) -> None:
        with condition:
            script.written.append((name, seconds(script)))
            ripe.append(name)
            condition.notify()

    with condition:
        assert condition.wait(1.0) is False
        threads = script.start(lambda: take("after the time-out"))
        script.sleep(1.0)
        script.written.append(("mine", seconds(script)))
        assert condition.wait_for(lambda: ripe, 5.0) == ["after the time-out"]
        threads += script.start(lambda: take("after the condition"))
        script.sleep(1.0)
        script.written.append(("mine", seconds(script)))
    for thread in threads:
        thread.join()
    assert script.written == [
        ("mine", 2.0), ("after the time-out", 2.0), ("mine", 3.0), ("after the condition", 3.0),
    ]  # fmt: skip


def test_who_meets_at_a_barrier_goes_on_when_all_have_come_and_not_for_ever(script: Any) -> None:
    barrier = script.threading.Barrier(3, lambda: script.written.append("open"), timeout=2.0)

    def come(after_s: float) -> None:
        script.sleep(after_s)
        place = barrier.wait()
        script.written.append((place, seconds(script)))

    for thread in script.start(lambda: come(0.5), lambda: come(1.5), lambda: come(1.0)):
        thread.join()
    assert script.written[0] == "open"
    assert sorted(script.written[1:]) == [(0, 1.5), (1, 1.5), (2, 1.5)]
    with pytest.raises(threading.BrokenBarrierError):
        barrier.wait()
    assert seconds(script) == 3.5


def test_a_timer_is_told_what_to_call_with_and_says_when_it_has(script: Any) -> None:
    def call(*told: Any, **named: Any) -> None:
        script.written.append((told, named, seconds(script)))

    timer = script.threading.Timer(1.5, call, ("a", 2), {"key": 3})
    timer.start()
    assert timer.finished.wait(1.0) is False
    assert timer.finished.wait(1.0) is True
    assert script.written == [(("a", 2), {"key": 3}, 1.5)]


# --- Python's pools ------------------------------------------------------------------------------------------------


def test_a_pool_gives_values_in_the_order_of_its_calls_or_as_they_end(pools: Any) -> None:
    told = []
    with pools.ThreadPool(3) as pool:
        for give in (pool.imap, pool.imap_unordered):
            told.append([(value, seconds(pools)) for value in give(pools.wait, (3, 1, 2))])
        assert pool.map(pools.wait, (0.2, 0.1)) == [0.2, 0.1]
        assert pool.starmap(pow, [(2, 3), (3, 2)]) == [8, 9]
        assert pool.apply(int, ("11",), {"base": 2}) == 3
    assert told == [[(3, 3.0), (1, 3.0), (2, 3.0)], [(1, 4.0), (2, 5.0), (3, 6.0)]]
    assert seconds(pools) == 6.2


def test_a_pool_makes_as_many_calls_at_once_as_it_has_threads_each_begun_as_told(pools: Any) -> None:
    with pools.ThreadPool(2, pools.written.append, ("begun",)) as pool:
        pool.map(pools.wait, (1, 1, 1))
    assert (seconds(pools), pools.written) == (2.0, ["begun", "begun"])


def test_a_result_of_a_pool_is_told_once_when_its_last_call_has_ended(pools: Any) -> None:
    told: list[Any] = []

    def tell(value: Any) -> None:
        told.append((value, seconds(pools)))

    with pools.ThreadPool(2) as pool:
        result = pool.map_async(pools.wait, (0.5, 1.5), callback=tell, error_callback=told.append)
        with pytest.raises(multiprocessing.TimeoutError):
            result.get(timeout=1.0)
        with pytest.raises(ValueError, match="not ready"):
            result.successful()
        result.wait(0.25)
        assert (seconds(pools), result.ready(), told) == (1.25, False, [])
        assert (result.get(), result.successful(), told) == ([0.5, 1.5], True, [([0.5, 1.5], 1.5)])
        single = pool.apply_async(pools.wait, (0.5,), callback=tell)
        assert (single.get(), told[1:]) == (0.5, [(0.5, 2.0)])


def test_a_result_of_which_one_call_has_failed_has_failed(pools: Any) -> None:
    told: list[Any] = []
    with pools.ThreadPool(2) as pool:
        result = pool.map_async(lambda x: 1 / x, (1, 0, 2), callback=told.append, error_callback=told.append)
        with pytest.raises(ZeroDivisionError):
            result.get()
        assert (result.ready(), result.successful()) == (True, False)
    assert [type(each) for each in told] == [ZeroDivisionError]


@pytest.mark.parametrize(("end", "ended"), [("close", [1.0, 2.0, 3.0]), ("terminate", [1.0])])
def test_a_pool_that_is_closed_makes_its_calls_and_one_that_is_terminated_only_those_begun(
    pools: Any, end: str, ended: list[float]
) -> None:
    pool = pools.ThreadPool(1)
    for _ in range(3):
        pool.apply_async(lambda: pools.written.append(seconds(pools)) if pools.wait(1) else None)
    pools.sleep(0.5)
    getattr(pool, end)()
    assert seconds(pools) == 0.5
    pool.join()
    assert pools.written == ended


def test_an_executor_waits_in_the_scripts_time(pools: Any) -> None:
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        futures = [pool.submit(pools.wait, given_s) for given_s in (2, 1)]
        with pytest.raises(concurrent.futures.TimeoutError):
            futures[0].result(timeout=0.5)
        done, rest = concurrent.futures.wait(futures, return_when=concurrent.futures.FIRST_COMPLETED)
        assert (done, rest, seconds(pools)) == ({futures[1]}, {futures[0]}, 1.0)
    assert seconds(pools) == 2.0


# --- timers, exceptions ---------------------------------------------------------------------------------------------


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
