"""What `uavaccel fly` makes of its flights: comparisons, exit statuses, what it prints, and its film."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from uavaccel.errors import UserError
from uavaccel.fly import command, film, runs
from uavaccel.fly.command import FlyRequest, fly_script
from uavaccel.fly.messages import DifferenceError
from uavaccel.fly.options import FlightOptions, FlightSummary, found_settings
from uavaccel.fly.runs import FlightResult, _wait, check
from uavaccel.fly.trajectory import write_trajectory

FLOWN: FlightSummary = {
    "simulated_s": 8.0, "wall_s": 0.5, "position_m": [1.0, -2.0, -10.126], "calls": 7, "finished": True,
    "slept_s": 0.0, "think_s": 0.0,
}  # fmt: skip
NOWHERE: FlightSummary = {**FLOWN, "position_m": None}
CRASHED: FlightSummary = {**FLOWN, "error": "KeyError: 'pose'"}
IDLE: Any = {**FLOWN, "calls": 0}
LOST: Any = {**IDLE, "position_m": None}
BROKEN: Any = {**CRASHED, **IDLE}
STOPPED: Any = {**IDLE, "finished": False}
CHECKED = "checked: flown twice, 7 calls and the trajectory are equal to the byte"


class Flights:
    """Answers each flight with the next result, whose trajectory lies so far east, and keeps what was asked for."""

    def __init__(self, *results: tuple[FlightResult, float]) -> None:
        self._results = iter(results)
        self.asked: list[tuple[FlightOptions, bool]] = []

    def fly(self, options: FlightOptions, quiet: bool = False) -> FlightResult:
        self.asked.append((options, quiet))
        result, east_m = next(self._results)
        options.folder.mkdir(parents=True)
        rows = np.zeros((2, 10))
        rows[:, 1] = east_m
        write_trajectory(options.folder, np.array([0, 50_000_000]), rows)
        return result


@pytest.fixture
def asked(tmp_path: Path) -> FlyRequest:
    (tmp_path / "script.py").write_text("")
    flight = FlightOptions(tmp_path / "script.py", (), Path())
    return FlyRequest(flight, find_settings=False, out=tmp_path / "out")


def flown(monkeypatch: pytest.MonkeyPatch, request: FlyRequest, *results: tuple[FlightResult, float]) -> Any:
    """The exit status, and the flights."""
    flights = Flights(*results)
    monkeypatch.setattr(command, "fly", flights.fly)
    monkeypatch.setattr(command, "check", lambda options, first: flights.fly(replace(options, reference=first)))
    return fly_script(request), flights.asked


def test_flights_at_several_clock_speeds_are_compared_with_the_first(
    asked: FlyRequest, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = [
        (FlightResult(0, FLOWN), 0.0),
        (FlightResult(3, FLOWN), 0.25),
        (FlightResult(1, {**FLOWN, "simulated_s": 4.0, "wall_s": 2.0}), 1.5),
    ]
    request = replace(asked, clocks=(2.0, 50.0, 1.5))
    status, flights = flown(monkeypatch, request, *results)
    assert status == 3
    assert capsys.readouterr().out.splitlines() == [
        "clock 2: 8.00 simulated s in 0.50 s, 16 per wall second",
        "clock 50: 8.00 simulated s in 0.50 s, 16 per wall second, at most 0.250 m from 2x at equal times",
        "clock 1.5: 4.00 simulated s in 2.00 s, 2 per wall second, at most 1.500 m from 2x at equal times",
    ]
    assert [options.folder.name for options, _ in flights] == ["clock-2", "clock-50", "clock-1.5"]
    assert [options.clock_speed for options, _ in flights] == [2.0, 50.0, 1.5]
    assert [quiet for _, quiet in flights] == [False, True, True]


@pytest.mark.parametrize(
    ("results", "lines", "status"),
    [
        ([FlightResult(0, {**FLOWN, "slept_s": 1.0}), FlightResult(0, FLOWN)], 3, 0),  # a line on its sleeps
        ([FlightResult(0, FLOWN), FlightResult(0, {**FLOWN, "slept_s": 1.0})], 3, 0),
        ([FlightResult(0, NOWHERE), FlightResult(0, NOWHERE)], 2, 0),
        ([FlightResult(1, None)], 0, 1),  # not flown to an end: no further one
        ([FlightResult(130, {**FLOWN, "finished": False})], 0, 130),
        ([FlightResult(130, FLOWN), FlightResult(0, FLOWN)], 2, 130),  # the script's own status
    ],
)
def test_no_clock_speed_is_flown_after_a_flight_without_an_end(
    asked: FlyRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    results: list[FlightResult],
    lines: int,
    status: int,
) -> None:
    request = replace(asked, clocks=(1.0, 2.0))
    told, flights = flown(monkeypatch, request, *((result, 0.0) for result in results))
    said = capsys.readouterr().out.splitlines()
    assert (told, len(said), len(flights)) == (status, lines, len(results))
    assert any("the script sleeps" in line for line in said) == (lines == 3)
    assert any("at equal times" in line for line in said) == (lines > 0 and results[0].summary != NOWHERE)


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (FlightResult(0, FLOWN), "8.00 simulated s in 0.50 s, 16 per wall second; 7 calls; at 1.00 -2.00 -10.13 m"),
        (
            FlightResult(4, {**FLOWN, "think_s": 0.0025}),
            "8.00 simulated s in 0.50 s, 16 per wall second; 7 calls, 2.5 ms of thinking before each; "
            "at 1.00 -2.00 -10.13 m",
        ),
        (FlightResult(0, {**NOWHERE, "finished": False}), "stopped by --until; no client connected, nothing was flown"),
        (FlightResult(130, {**NOWHERE, "finished": False}), "interrupted; no client connected, nothing was flown"),
        (FlightResult(2, None), ""),
    ],
)  # fmt: skip
def test_a_flight_is_told_in_a_line_and_its_status_is_the_scripts(
    asked: FlyRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    result: FlightResult,
    said: str,
) -> None:
    status, [(options, quiet)] = flown(monkeypatch, replace(asked, clocks=(5.0,)), (result, 0.0))
    assert (status, capsys.readouterr().out.strip()) == (result.status, said)
    assert (options.clock_speed, options.folder, quiet) == (5.0, asked.out, False)


@pytest.mark.parametrize(
    ("first", "again", "status", "last"),
    [
        (FlightResult(0, FLOWN), FlightResult(0, FLOWN), 0, "checked: flown twice, 7 calls and the trajectory are"),
        (FlightResult(3, FLOWN), FlightResult(3, FLOWN), 3, f"{CHECKED}; both times the script ended with exit status"),
        (FlightResult(1, CRASHED), FlightResult(1, CRASHED), 1, f"{CHECKED}; both times the script ended with KeyErr"),
        (FlightResult(0, IDLE), None, 0, "not checked: the script ended with exit status 0 before any call"),
        (FlightResult(3, LOST), None, 3, "not checked: the script ended with exit status 3 be"),
        (FlightResult(1, BROKEN), None, 1, "not checked: the script ended with KeyError: 'pose' before "),
        (FlightResult(0, STOPPED), None, 0, "not checked: the script was stopped by --until befo"),
        (FlightResult(0, FLOWN), FlightResult(0, FLOWN, differs=True), 1, "8.00 simulated s"),
        (FlightResult(0, FLOWN), FlightResult(5, None), 5, "not checked"),
        (FlightResult(0, FLOWN), FlightResult(130, {"finished": False}), 130, "not checked"),
        (FlightResult(130, {**FLOWN, "finished": False}), None, 130, "interrupted; 8.00"),
    ],
)
def test_a_check_flies_again_without_a_film_and_beside_the_first(
    asked: FlyRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    first: FlightResult,
    again: FlightResult | None,
    status: int,
    last: str,
) -> None:
    request = replace(asked, check=True, flight=replace(asked.flight, film=True, seed=3))
    results = [(each, 0.0) for each in (first, again) if each is not None]
    told, flights = flown(monkeypatch, request, *results)
    assert told == status
    assert capsys.readouterr().out.splitlines()[-1].startswith(last)
    assert [options.film for options, _ in flights] == [True, False][: len(results)]
    assert {options.seed for options, _ in flights} == {3}
    for options, _ in flights[1:]:
        assert (options.reference, options.folder.name) == (asked.out, "again")


@pytest.mark.parametrize("again", [FlightResult(0, FLOWN), FlightResult(1, {**FLOWN, "error": "ValueError: none"})])
def test_flights_whose_scripts_end_differently_are_told_apart(
    asked: FlyRequest, monkeypatch: pytest.MonkeyPatch, again: FlightResult
) -> None:
    with pytest.raises(UserError, match=f"the first flight's script ended with KeyError: 'pose', .* {again.ending}"):
        flown(monkeypatch, replace(asked, check=True), (FlightResult(1, CRASHED), 0.0), (again, 0.0))


def test_a_first_flight_without_a_client_is_compared_with_none(
    asked: FlyRequest, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = [(FlightResult(0, summary), 0.0) for summary in (NOWHERE, FLOWN)]
    assert flown(monkeypatch, replace(asked, clocks=(1.0, 2.0)), *results)[0] == 0
    assert capsys.readouterr().out.splitlines() == [
        "clock 1: no client connected, nothing was flown",
        "clock 2: 8.00 simulated s in 0.50 s, 16 per wall second",
    ]


@pytest.mark.parametrize(("second_m", "differs"), [(1.0, False), (1.0 + 1e-15, True), (2.0, True)])
def test_the_second_flight_is_held_against_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, second_m: float, differs: bool
) -> None:
    (first := tmp_path / "first").mkdir()
    write_trajectory(first, np.arange(3), np.ones((3, 10)))
    asked = FlightOptions(Path("script.py"), (), tmp_path / "again")
    flown: list[tuple[FlightOptions, bool]] = []

    def fly(options: FlightOptions, quiet: bool = False) -> FlightResult:
        flown.append((options, quiet))
        options.folder.mkdir()
        write_trajectory(options.folder, np.arange(3), np.full((3, 10), second_m))
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


def test_settings_beside_the_script_come_before_those_of_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home, script = tmp_path / "home", tmp_path / "scripts" / "script.py"
    monkeypatch.setenv("HOME", str(home))
    beside, own = script.parent / "settings.json", home / "Documents" / "AirSim" / "settings.json"
    assert found_settings(script) is None
    for path in (own, beside):
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps({"ClockSpeed": 2}))
        assert found_settings(script) == path
    beside.write_text("{}")
    assert found_settings(script) == own
    beside.write_text("\ufeff" + json.dumps({"Vehicles": {}}))
    assert found_settings(script) == beside


def test_a_request_of_a_flight_travels_whole(tmp_path: Path) -> None:
    options = FlightOptions(
        Path("a.py"), ("-x", "1"), tmp_path, "lockstep", "airsim", "lane", 2.5, Path("s.json"), 0.25, 7, 9.5,
        ("w", "esc"), True, Path("first"), Path("scratch"), True,
    )  # fmt: skip
    assert FlightOptions.from_json(options.to_json()) == options
    few = FlightOptions(Path("a.py"), (), tmp_path)
    assert FlightOptions.from_json(few.to_json()) == few


@pytest.mark.parametrize(
    ("timing", "given_s", "thinks_s"),
    [
        ("virtual", None, 0.001),
        ("virtual", 0.0, 0.0),
        ("virtual", 0.5, 0.5),
        ("lockstep", None, 0.0),
        ("lockstep", 0.25, 0.25),
        ("wall", None, 0.0),
    ],
)
def test_thinking_time_is_the_options_or_the_timings(timing: str, given_s: float | None, thinks_s: float) -> None:
    assert FlightOptions(Path("a.py"), (), Path(), timing, think_s=given_s).thinks_s == thinks_s


def test_a_folder_is_taken_that_is_new_or_empty(asked: FlyRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    assert asked.out is not None
    asked.out.mkdir()
    monkeypatch.setattr(command, "fly", lambda options: FlightResult(7, None))
    assert fly_script(asked) == 7
    (asked.out / "flight.json").write_text("{}")
    with pytest.raises(UserError, match=r"out: is there already; choose another --out"):
        fly_script(asked)


@pytest.mark.parametrize(("ended", "status"), [(0, 0), (3, 3), (-9, 137), (-15, 143)])
def test_a_process_ended_by_a_signal_has_a_shells_status(ended: int, status: int) -> None:
    process: Any = SimpleNamespace(pid=0, poll=lambda: ended, wait=lambda *_: ended)
    assert _wait(process, None) == status


# --- the film --------------------------------------------------------------------------------------------------------


def test_a_frame_of_the_film_says_when_where_and_how_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(cv2, "putText", lambda frame, text, *how: said.append(text))
    picture = np.zeros((360, 640, 3), np.uint8)
    picture[..., 0], picture[0, 0, 1] = 200, 50
    state = SimpleNamespace(time_ns=1_500_000_000, position_m=(1.0, -2.0, -3.5), linear_velocity_m_s=(3.0, 0.0, -4.0))
    camera = SimpleNamespace(colour=lambda data: picture)
    world = SimpleNamespace(camera=lambda width, height: camera, data=None)
    simulation: Any = SimpleNamespace(world=world, kinematics=lambda: state)
    frame = film._frame(simulation)
    assert frame.shape == (384, 640, 3)
    assert frame[0, 0].tolist() == [0, 50, 200]
    assert frame[359, 639].tolist() == [0, 0, 200]
    assert not frame[360:].any()
    assert said == ["   1.50 s   1.0 -2.0 -3.5 m NED   5.0 m/s"]


def test_the_film_runs_as_the_flight_did(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Twelve frames a second, of 640 x 360 pixels and a band of 24: 41 ticks of 2 ms are the nearest to a twelfth."""
    made: list[Any] = []
    ended: list[bool] = []

    @contextmanager
    def movie(path: Path, size: tuple[int, int], frames_per_s: int) -> Iterator[Any]:
        made.append((path, size, frames_per_s))
        yield made.append

    class World:
        def watch(self, every: int, look: Any) -> Any:
            made.append(every)
            look(None)
            return lambda: ended.append(True)

    monkeypatch.setattr(film, "movie", movie)
    monkeypatch.setattr(film, "_frame", lambda simulation: "a frame")
    simulation: Any = SimpleNamespace(profile=SimpleNamespace(tick_ns=2_000_000))
    world: Any = World()
    with film.filming(simulation, world, tmp_path):
        assert not ended
    assert made == [(tmp_path / "film.mp4", (640, 384), 12), 41, "a frame"]
    assert ended == [True]
