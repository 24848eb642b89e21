"""Wall clocks, the exact map between wall time and ticks, and how long a run took on this machine."""

from __future__ import annotations

import datetime
import pickle
import select
import selectors
import socket
import time
from collections.abc import Iterator
from copy import deepcopy
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from uavaccel.clock import (
    MonotonicClock,
    Pacer,
    VirtualClock,
    calendar_time,
    datetime_module,
    positive_clock_speed,
    time_module,
    timer_grain_ns,
    wait_for_sockets,
)
from uavaccel.draw.page import in_words
from uavaccel.errors import UserError
from uavaccel.suites import experiment
from uavaccel.suites.experiment import cumulative_wall_s, over_all_starts, pace_of, timed

TICKS_NS = (2_000_000, 3_000_000)
LARGEST = 10**15  # nanoseconds: twelve days

decimal_speeds = st.decimals("0.001", "1000", places=3).map(float)
ratios = st.fractions("0.01", 1000, max_denominator=100).map(float)
speeds = st.sampled_from([1.5, 0.1, 0.3333333, 100, 0.1 + 0.2]) | decimal_speeds | ratios | st.floats(0.001, 1000)
instants = st.integers(0, LARGEST)


@st.composite
def pacers(draw: st.DrawFn) -> Pacer:
    pacer = Pacer(draw(speeds), draw(st.sampled_from(TICKS_NS)))
    pacer.anchor(draw(instants), draw(st.integers(0, 10**9)))
    return pacer


@given(pacers(), st.integers(0, 10**9))
@example(Pacer(1.5, 2_000_000), 1)
@example(Pacer(0.1, 2_000_000), 10**9)
@example(Pacer(1 / 3, 2_000_000), 999_999_999)
@example(Pacer(100, 3_000_000), 7)
def test_a_tick_is_due_exactly_when_it_is_due(pacer: Pacer, ticks: int) -> None:
    wall_ns, anchored = pacer.anchored
    assert (pacer.ticks_due(wall_ns), pacer.wall_due(anchored)) == (anchored, wall_ns)
    tick = pacer.ticks_due(pacer.wall_due(0)) + ticks
    due = pacer.wall_due(tick)
    assert pacer.ticks_due(due) == tick
    assert pacer.ticks_due(due - 1) == tick - 1


@given(pacers(), instants, st.integers(0, 10**9))
def test_ticks_follow_the_formula_and_never_go_back(pacer: Pacer, wall_ns: int, later_ns: int) -> None:
    anchor_wall, anchor_tick = pacer.wall_due(0), pacer.ticks_due(pacer.wall_due(0))
    elapsed = wall_ns - anchor_wall
    due = pacer.ticks_due(wall_ns)
    assert due <= pacer.ticks_due(wall_ns + later_ns)
    exact = anchor_tick + Fraction(elapsed) * pacer.clock_speed / pacer.tick_ns
    assert abs(due - exact) <= 1 + pacer.clock_speed / pacer.tick_ns  # wall_due(0) is rounded to a nanosecond


def test_a_speed_is_the_decimal_that_was_written() -> None:
    """1.5 is 1.5 (AirSim makes 1 of it), and a tenth is a tenth: not one tick is lost in a day."""
    assert Pacer(1.5, 2_000_000).ticks_due(4_000_000) == 3
    a_day_ns = 86_400 * 10**9
    assert Pacer(0.1, 2_000_000).ticks_due(a_day_ns) == a_day_ns // 20_000_000
    assert Pacer(0.1, 2_000_000).wall_due(4_320_000) == a_day_ns
    assert positive_clock_speed(np.float64(0.1)) == Fraction(1, 10)


def test_a_new_speed_goes_on_from_where_the_old_one_came_to() -> None:
    """Nothing is to be anchored by hand, and what was due by then stays so."""
    pacer = Pacer(1, 2_000_000)
    pacer.anchor(1_000_000, 7)
    pacer.set_clock_speed(10, 6_000_000)
    assert pacer.clock_speed == 10
    assert (pacer.ticks_due(6_000_000), pacer.wall_due(9)) == (9, 6_000_000)
    assert pacer.ticks_due(6_000_000 + 1_000_000) == 9 + 5
    with pytest.raises(UserError, match="clock_speed"):
        pacer.set_clock_speed(0, 7_000_000)
    assert pacer.ticks_due(7_000_000) == 9 + 5, "a refused speed changes nothing"


def test_a_virtual_clock_jumps_the_machines_sleeps_long_enough() -> None:
    """Neither goes back; the machine's ignores charges."""
    virtual = VirtualClock(100)
    virtual.sleep_until(50)
    assert virtual.now_ns() == 100
    virtual.sleep_until(10**18)
    virtual.charge(5)
    assert virtual.now_ns() == 10**18 + 5
    clock = MonotonicClock()
    start = clock.now_ns()
    clock.charge(10**15)
    clock.sleep_until(start - 1)
    for sleep_ns in (10_000, 2_000_000):  # one spins, one sleeps
        deadline = clock.now_ns() + sleep_ns
        clock.sleep_until(deadline)
        assert clock.now_ns() >= deadline
    assert clock.now_ns() < start + 10**15
    assert calendar_time()[4] == "-"


def test_the_grain_is_how_late_sleeps_of_100_us_end(monkeypatch: pytest.MonkeyPatch) -> None:
    told, slept_s = iter((0, 100_700, 200_000, 300_300)), list[float]()
    monkeypatch.setattr("uavaccel.clock.time", SimpleNamespace(monotonic_ns=told.__next__, sleep=slept_s.append))
    assert (timer_grain_ns(2), slept_s) == ([300, 700], [1e-4, 1e-4])


def test_sockets_are_waited_for_until_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, told_s = MonotonicClock(), list[float]()
    here, there = socket.socketpair()
    with here, there, selectors.DefaultSelector() as selector:
        selector.register(here, selectors.EVENT_READ, "here")
        with monkeypatch.context() as patch:
            patch.setattr(select, "select", lambda *given: told_s.append(given[3]))
            assert not wait_for_sockets(selector, clock.now_ns() + 900 * 10**9)
        assert 600 < told_s[0] <= 900, "less what the machine has taken"
        there.send(b"x")
        for any_deadline in (None, 0, clock.now_ns() + 10**12):
            assert [key.data for key, _ in wait_for_sockets(selector, any_deadline)] == ["here"]


NOW_NS = 79_200_500_000_000  # 22:00:00.5 on 1 January 1970


@pytest.fixture
def east(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The machine's local time is five and a half hours ahead of UTC."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "EAST-5:30")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.usefixtures("east")
def test_another_clocks_time_is_told_in_utc_and_where_the_machine_is() -> None:
    slept: list[float] = []
    module = time_module(lambda: NOW_NS, slept.append)
    assert module.clock() == module.time()
    for name in ("time", "monotonic", "perf_counter", "process_time", "thread_time"):
        assert (getattr(module, name)(), getattr(module, f"{name}_ns")()) == (79_200.5, NOW_NS)
    assert (module.clock_gettime(1), module.clock_gettime_ns(1)) == (79_200.5, NOW_NS)
    module.sleep(0.25)
    assert slept == [0.25]
    assert module.gmtime()[:6] == (1970, 1, 1, 22, 0, 0)
    assert module.gmtime(60)[:6] == (1970, 1, 1, 0, 1, 0)
    assert module.localtime()[:6] == (1970, 1, 2, 3, 30, 0)
    assert module.localtime(60)[:6] == (1970, 1, 1, 5, 31, 0)
    assert (module.ctime(), module.ctime(60)) == ("Fri Jan  2 03:30:00 1970", "Thu Jan  1 05:31:00 1970")
    assert (module.asctime(), module.asctime(module.gmtime(60))) == (module.ctime(), "Thu Jan  1 00:01:00 1970")
    assert (module.strftime("%d %H:%M"), module.strftime("%H:%M", module.gmtime(60))) == ("02 03:30", "00:01")
    assert module.mktime(module.localtime()) == 79_200.0, "what tells no present is the machine's own"


@pytest.mark.usefixtures("east")
def test_another_clocks_dates_are_in_utc_and_where_the_machine_is() -> None:
    module = datetime_module(lambda: NOW_NS)
    there = module.datetime(1970, 1, 2, 3, 30, 0, 500_000)
    assert module.datetime.now() == module.datetime.today() == there
    assert module.datetime.utcnow() == module.datetime(1970, 1, 1, 22, 0, 0, 500_000)
    west = datetime.timezone(datetime.timedelta(hours=-3))
    assert module.datetime.now(west).isoformat() == "1970-01-01T19:00:00.500000-03:00"
    assert module.date.today() == module.date(1970, 1, 2)
    assert isinstance(there, datetime.datetime)
    assert module.timedelta is datetime.timedelta


def test_dates_of_another_clock_and_of_libraries_share_classes() -> None:
    module = datetime_module(lambda: NOW_NS)

    class Holiday(module.date):  # type: ignore[name-defined]
        pass

    plain, theirs = datetime.datetime(1970, 1, 2), module.datetime(1970, 1, 2)
    for moment in (plain, theirs, pd.Timestamp(plain)):
        for kind in (module.datetime, module.date, datetime.datetime, datetime.date):
            assert isinstance(moment, kind)
            assert issubclass(type(moment), kind)
        assert not isinstance(moment, Holiday)
        assert moment == plain == theirs == moment
        assert moment - theirs == datetime.timedelta(0)
        assert pickle.loads(pickle.dumps(moment)) == deepcopy(moment) == plain
    assert isinstance(plain.date(), module.date)
    assert not isinstance(module.date(1970, 1, 2), Holiday)
    assert not isinstance(plain.date(), module.datetime)
    assert not isinstance(3, module.date)
    assert not issubclass(datetime.date, module.datetime)
    assert pickle.loads(pickle.dumps(module.date(1970, 1, 2))) == plain.date()
    assert isinstance(deepcopy(Holiday(1970, 1, 2)), Holiday)


# --- time of a run ----------------------------------------------------------------------------------------------------


def timings(*readings_s: float | None) -> list[dict[str, float]]:
    """Entries with these readings of a stopwatch, none where it was not read."""
    return [{"host_wall_s": 99.0} | ({} if each is None else {"wall_s": each}) for each in readings_s]


def test_times_go_on_where_a_stopwatch_starts_again() -> None:
    """Resumed twice; of phases, before its second start the run had simulated for 2 s and learned for 4 s."""
    assert cumulative_wall_s([]) == cumulative_wall_s(timings(None)) == []
    assert cumulative_wall_s(timings(1.0, 3.0, 3.0)) == [1.0, 3.0, 3.0]
    assert cumulative_wall_s(timings(1.0, None, 3.0, 2.0, 5.0, 0.5)) == [1.0, 3.0, 5.0, 8.0, 8.5]
    readings = [{"simulation": 1.0, "learning": 2.0}, {"simulation": 2.0, "learning": 4.0}]
    again = [{"simulation": 0.5, "learning": 1.0}, {"simulation": 1.0, "learning": 4.5}]
    assert (over_all_starts([]), over_all_starts(readings)) == ({}, readings[-1])
    assert over_all_starts([*readings, *again]) == {"simulation": 3.0, "learning": 8.5}


def test_a_runs_pace_is_simulated_time_over_wall_time() -> None:
    assert pace_of(timings(6.0, 2.0), 400.0) == "flying took 8.0 s of wall clock, 50 simulated s per wall s"
    assert pace_of(timings(None), 300.0) == ""
    learning = [{**entry, "learner_s": {}} for entry in timings(8.0)]
    assert pace_of(learning, 80.0) == "flying and learning took 8.0 s of wall clock, 10 simulated s per wall s"


def test_a_duration_is_told_in_seconds_minutes_or_hours() -> None:
    told = {0.04: "0.0 s", 59.96: "60.0 s", 599.9: "599.9 s", 600.0: "10 min", 5399.0: "90 min", 5400.0: "1.5 h"}
    assert {seconds: in_words(seconds) for seconds in told} == told


def test_work_is_timed_by_the_machines_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    clock: Any = SimpleNamespace(read_ns=5_000_000_000, now_ns=lambda: clock.read_ns)

    def work() -> str:
        clock.read_ns += 1_750_000_000
        return "done"

    monkeypatch.setattr(experiment, "MonotonicClock", lambda: clock)
    monkeypatch.setattr("os.getloadavg", lambda: (0.5, 7.0, 8.0))
    assert timed(work) == ("done", {"host_wall_s": 1.75, "load": 0.5})
