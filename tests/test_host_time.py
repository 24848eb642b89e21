"""How long a run took on this machine, over all of its starts, in numbers and in words."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from uavaccel.suites import host_time
from uavaccel.suites.host_time import cumulative_wall_s, in_words, over_all_starts, pace_of, timed


def timings(*readings_s: float | None) -> list[dict[str, float]]:
    """Entries with these readings of a stopwatch, none where it was not read."""
    return [{"host_wall_s": 99.0} | ({} if each is None else {"wall_s": each}) for each in readings_s]


@pytest.mark.parametrize(("readings_s", "over_all_s"), [
    ([], []),
    ([None], []),
    ([1.0, 3.0, 3.0], [1.0, 3.0, 3.0]),
    ([1.0, None, 3.0, 2.0, 5.0, 0.5], [1.0, 3.0, 5.0, 8.0, 8.5]),  # it was resumed twice
])  # fmt: skip
def test_wall_time_goes_on_where_a_stopwatch_starts_again(
    readings_s: list[float | None], over_all_s: list[float]
) -> None:
    assert cumulative_wall_s(timings(*readings_s)) == over_all_s


def test_phases_of_all_starts_are_summed() -> None:
    """Before its second start the run had simulated for 2 s and learned for 4 s."""
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

    monkeypatch.setattr(host_time, "MonotonicClock", lambda: clock)
    monkeypatch.setattr("os.getloadavg", lambda: (0.5, 7.0, 8.0))
    assert timed(work) == ("done", {"host_wall_s": 1.75, "load": 0.5})
