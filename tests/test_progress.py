"""The time left of a run, on a clock that the test moves."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from uavaccel.cli import progress
from uavaccel.suites.suite import SimpleCase
from uavaccel.units import NS_PER_S


class Clock:
    now_s = 0.0

    def now_ns(self) -> int:
        return int(Clock.now_s * NS_PER_S)


def test_time_left_is_the_estimate_corrected_by_games_of_this_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten games, two at a time: two were flown before, four short ones and four long ones are to come."""
    monkeypatch.setattr(progress, "MonotonicClock", Clock)
    Clock.now_s = 1000.0
    cases = [SimpleCase(f"g{number}", "virtual", 20.0) for number in range(10)]
    expected_s = [30.0] * 6 + [150.0] * 4
    said = io.StringIO()
    console = Console(file=said, width=120)
    earlier = [{"case": "g0"}, {"case": "g1"}]
    shown = progress.Progress(cases, expected_s, 2, earlier, lambda _: "", console)
    # After the first of two that fly at once the rate is not known: 690 s are to come, as estimated.
    for case, passed_s in (("g2", 60.0), ("g3", 0.0), ("g4", 60.0), ("g5", 0.0)):
        Clock.now_s += passed_s
        shown.flown(cases[int(case[1:])], {"case": case})
    left = [line.rpartition(", ")[2] for line in said.getvalue().splitlines()]
    # Then 60 s of estimate took 60 s, 90 took 120, while one more was under way, and 120 took 120.
    assert left == ["12 min left", "11 min left", "14 min left", "10 min left"]
