"""The owner of wall time: the only module that imports `time`, and the only one that sleeps.

A `WallClock` is either the machine's monotonic clock or a simulated one that costs nothing to wait on. A `Pacer`
says how many ticks of simulated time are due at a wall time.
"""

from __future__ import annotations

import ctypes
import datetime
import select
import selectors
import sys
import time
from collections.abc import Callable, Sequence
from fractions import Fraction
from types import ModuleType
from typing import Any, Protocol, Self, SupportsIndex

from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S, ceil_div, exact

SPIN_NS = 100_000  # a sleep ends this much early and spins: the kernel wakes a process late
SLOWEST = Fraction(1, 1_000_000)  # ClockSpeed: a simulated second in eleven days
_PR_SET_TIMERSLACK = 29


class WallClock(Protocol):
    """Wall time in nanoseconds."""

    def now_ns(self) -> int: ...

    def sleep_until(self, deadline_ns: int) -> None: ...

    def charge(self, duration_ns: int) -> None:
        """Account for modelled work; a real clock ignores it, since the work itself took the time."""
        ...


class MonotonicClock:
    """The machine's monotonic clock, shared by all processes of the host."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        while (left := deadline_ns - time.monotonic_ns()) > 0:
            if left > SPIN_NS:
                time.sleep((left - SPIN_NS) / NS_PER_S)

    def charge(self, duration_ns: int) -> None:
        pass


class VirtualClock:
    """A simulated wall clock: waiting jumps, work is charged."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until(self, deadline_ns: int) -> None:
        self._now_ns = max(self._now_ns, deadline_ns)

    def charge(self, duration_ns: int) -> None:
        self._now_ns += duration_ns


class Pacer:
    """How many ticks are due at a wall time: `tick0 + floor((wall - wall0) * clock_speed / tick_ns)`.

    Exact: `ticks_due(wall_due(n)) == n` for every n. With floats a virtual clock could spin for ever.
    """

    def __init__(self, clock_speed: float | Fraction, tick_ns: int) -> None:
        self.tick_ns = tick_ns
        self._wall0_ns = 0
        self._tick0 = 0
        self._set_rate(positive_clock_speed(clock_speed))

    def _set_rate(self, clock_speed: Fraction) -> None:
        self.clock_speed = clock_speed
        self._numerator, denominator = clock_speed.as_integer_ratio()
        self._tick_wall = self.tick_ns * denominator  # wall ns of `numerator` ticks

    def set_clock_speed(self, clock_speed: float | Fraction, wall_ns: int) -> None:
        """Go on at another speed from `wall_ns`: the tick last due then is due at that moment.

        Raises UserError unless the speed is a finite number above 0.
        """
        rate = positive_clock_speed(clock_speed)
        self.anchor(wall_ns, self.ticks_due(wall_ns))
        self._set_rate(rate)

    def anchor(self, wall_ns: int, tick: int) -> None:
        """Let `tick` be due at `wall_ns`."""
        self._wall0_ns, self._tick0 = wall_ns, tick

    @property
    def anchored(self) -> tuple[int, int]:
        """Wall time in ns and tick of the last `anchor`."""
        return self._wall0_ns, self._tick0

    def ticks_due(self, wall_ns: int) -> int:
        """Return the last tick due at `wall_ns`."""
        return self._tick0 + (wall_ns - self._wall0_ns) * self._numerator // self._tick_wall

    def wall_due(self, tick: int) -> int:
        """Return the first nanosecond of wall time at which `tick` is due."""
        return self._wall0_ns + ceil_div((tick - self._tick0) * self._tick_wall, self._numerator)


def positive_clock_speed(clock_speed: float | Fraction) -> Fraction:
    """Return the exact decimal that was written. Raises UserError unless it is a finite number of SLOWEST or more."""
    try:
        speed = Fraction(0) if isinstance(clock_speed, str | bool) else exact(clock_speed)
    except ValueError:
        speed = Fraction(0)
    if speed < SLOWEST:
        raise UserError(
            f"clock_speed must be a finite number above 0, for example 1, 1.5 or 100, and at least "
            f"{float(SLOWEST):g}; not {clock_speed!r}"
        )
    return speed


def wait_for_sockets(
    selector: selectors.DefaultSelector, deadline_ns: int | None
) -> Sequence[tuple[selectors.SelectorKey, int]]:
    """Return what is readable, as soon as anything is, or nothing at the deadline (monotonic ns; None: wait for ever).

    `selector` is selectors.DefaultSelector(). A deadline in the past only looks. select() sleeps to the microsecond,
    where epoll rounds up to a millisecond.
    """
    if deadline_ns is None:
        return list(selector.select(None))
    left_ns = deadline_ns - time.monotonic_ns()
    if left_ns > 0:
        select.select([selector.fileno()], [], [], left_ns / NS_PER_S)
    return list(selector.select(0))


def request_fine_timers() -> None:
    """Let the kernel wake this process on time: Linux groups timers within 50 us unless told otherwise."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


def timer_grain_ns(samples: int = 50) -> list[int]:
    """Return how late short sleeps of 100 us end, sorted, in nanoseconds."""
    late = []
    for _ in range(samples):
        due = time.monotonic_ns() + 100_000
        time.sleep(100e-6)
        late.append(time.monotonic_ns() - due)
    return sorted(late)


def calendar_time() -> str:
    """Date and time of day in UTC, ISO 8601, for names and manifests; never for measuring."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def epoch_s() -> float:
    """Seconds since 1970, for files that are dated so; never for measuring."""
    return time.time()


def changed(module: ModuleType, **names: object) -> ModuleType:
    """Return a copy of a module with some of its names replaced."""
    copy = ModuleType(module.__name__, module.__doc__)
    vars(copy).update({name: value for name, value in vars(module).items() if not name.startswith("__")})
    vars(copy).update(names)
    return copy


def time_module(epoch_now_ns: Callable[[], int], sleep: Callable[[float], None]) -> ModuleType:
    """Return a stand-in for the module `time`, for programs that shall live on another clock.

    `epoch_now_ns` is read for every clock of the module, in ns since 1970 in UTC; `sleep` waits so many seconds.
    """
    module = changed(time)
    for name in ("time", "monotonic", "perf_counter", "process_time", "thread_time"):
        setattr(module, f"{name}_ns", lambda: epoch_now_ns())
        setattr(module, name, lambda: epoch_now_ns() / NS_PER_S)

    def seconds(given: float | None) -> float:
        return epoch_now_ns() / NS_PER_S if given is None else given

    def clock_gettime(clock: int) -> float:
        return seconds(None)

    vars(module).update(
        clock=lambda: module.perf_counter(),  # of Python before 3.8
        sleep=sleep,
        clock_gettime=clock_gettime,
        clock_gettime_ns=lambda clock: epoch_now_ns(),
        gmtime=lambda secs=None: time.gmtime(seconds(secs)),
        localtime=lambda secs=None: time.localtime(seconds(secs)),
        ctime=lambda secs=None: time.ctime(seconds(secs)),
        asctime=lambda t=None: time.asctime(time.localtime(seconds(None)) if t is None else t),
        strftime=lambda form, t=None: time.strftime(form, time.localtime(seconds(None)) if t is None else t),
    )
    return module


def counted_time_module(slept: Callable[[float], None]) -> ModuleType:
    """Return the machine's module `time`; `slept` is called with the seconds of each sleep."""

    def sleep(seconds: float) -> None:
        time.sleep(seconds)
        slept(seconds)

    return changed(time, sleep=sleep, clock=time.perf_counter)


class _StandIn(type):
    """The class of classes that stand in for their base, whose instances, which libraries make, are theirs too."""

    def __instancecheck__(cls, value: object) -> bool:
        return type.__instancecheck__(cls._stands_for(), value)

    def __subclasscheck__(cls, kind: type) -> bool:
        return type.__subclasscheck__(cls._stands_for(), kind)

    def _stands_for(cls) -> type:
        """Return the base of a stand-in; a program's class that is derived from a stand-in is itself."""
        base = cls.__base__
        return cls if base is None or isinstance(base, _StandIn) else base


def datetime_module(epoch_now_ns: Callable[[], int]) -> ModuleType:
    """Return a stand-in for the module `datetime` whose present is `epoch_now_ns`, in ns since 1970 in UTC."""

    class Date(datetime.date, metaclass=_StandIn):
        @classmethod
        def today(cls) -> Self:
            return cls.fromtimestamp(epoch_now_ns() / NS_PER_S)

    class DateTime(datetime.datetime, metaclass=_StandIn):
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> Self:
            return cls.fromtimestamp(epoch_now_ns() / NS_PER_S, tz)

        @classmethod
        def today(cls) -> Self:
            return cls.now()

        @classmethod
        def utcnow(cls) -> Self:
            return cls.now(datetime.UTC).replace(tzinfo=None)

    def stand_in(own: type, original: type[datetime.date]) -> None:
        def reduced(self: datetime.date, protocol: SupportsIndex) -> tuple[Any, ...]:
            """Pickle as what it stands for, which every program knows."""
            parts: Any = original.__reduce_ex__(self, protocol)
            return original if parts[0] is own else parts[0], *parts[1:]

        own.__name__, own.__qualname__, own.__module__ = original.__name__, original.__qualname__, "datetime"
        own.__reduce_ex__ = reduced  # type: ignore[assignment,method-assign]

    stand_in(Date, datetime.date)
    stand_in(DateTime, datetime.datetime)
    return changed(datetime, date=Date, datetime=DateTime)
