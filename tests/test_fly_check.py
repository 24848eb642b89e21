"""`uavaccel fly --check`: the second flight is another one, and is held against the first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uavaccel.fly import runs
from uavaccel.fly.messages import DifferenceError
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.runs import FlightResult, check
from uavaccel.fly.trajectory import equal, largest_difference_m, write_trajectory

TIMES_NS = np.array([0, 50_000_000, 100_000_000])


def write(folder: Path, north_m: float) -> Path:
    """Three samples, the second one that far north."""
    folder.mkdir(exist_ok=True)
    rows = np.zeros((3, 10))
    rows[1, 0] = north_m
    write_trajectory(folder, TIMES_NS, rows)
    return folder


@pytest.mark.parametrize(("second_m", "differs"), [(1.0, False), (1.0 + 1e-15, True), (2.0, True)])
def test_the_second_flight_is_held_against_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, second_m: float, differs: bool
) -> None:
    first = write(tmp_path / "first", 1.0)
    asked = FlightOptions(Path("script.py"), (), tmp_path / "again")
    flown: list[tuple[FlightOptions, bool]] = []

    def fly(options: FlightOptions, quiet: bool = False) -> FlightResult:
        flown.append((options, quiet))
        write(options.folder, second_m)
        return FlightResult(0, {"finished": True})

    monkeypatch.setattr(runs, "fly", fly)
    if differs:
        with pytest.raises(DifferenceError, match="the messages of both flights are equal, but the trajectories"):
            check(asked, first)
    else:
        assert check(asked, first).status == 0
    assert flown == [(replace(asked, reference=first), True)]


def test_flights_that_flew_nothing_are_equal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "fly", lambda options, quiet: FlightResult(0, {"finished": True}))
    assert check(FlightOptions(Path("script.py"), (), tmp_path / "again"), tmp_path / "first").status == 0


def test_trajectories_are_equal_to_the_byte_and_far_apart_in_metres(tmp_path: Path) -> None:
    one, same, other = (write(tmp_path / name, north) for name, north in (("1", 1.0), ("2", 1.0), ("3", 3.5)))
    assert equal(one, same)
    assert not equal(one, other)
    assert largest_difference_m(one, same) == 0.0
    assert largest_difference_m(one, other) == largest_difference_m(other, one) == 2.5
