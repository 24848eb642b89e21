"""What `uavaccel fly` makes of its flights: comparisons, exit statuses, what it prints, and its film."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.golden import assert_as_recorded
from uavaccel.errors import UserError
from uavaccel.fly import command
from uavaccel.fly.command import FlightResult, FlyRequest, _interrupt, _wait, check, fly_script
from uavaccel.fly.log import DifferenceError, filming, write_trajectory
from uavaccel.fly.options import DIFFERENCE, SUMMARY, FlightOptions, FlightSummary, found_settings

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

    def check(self, options: FlightOptions, first: Path) -> FlightResult:
        return self.fly(replace(options, reference=first))


@pytest.fixture
def asked(tmp_path: Path) -> FlyRequest:
    (tmp_path / "script.py").write_text("")
    flight = FlightOptions(tmp_path / "script.py", (), Path())
    return FlyRequest(flight, find_settings=False, out=tmp_path / "out")


SLEPT: FlightSummary = {**FLOWN, "slept_s": 1.0}
TWO, CHECK = {"clocks": (1.0, 2.0)}, {"check": True}
RUNS: dict[str, tuple[dict[str, Any], list[FlightResult]]] = {  # what is asked for, and how each flight ends
    "clocks are compared with the first": (
        {"clocks": (2.0, 50.0, 1.5)},
        [FlightResult(0, FLOWN), FlightResult(3, FLOWN), FlightResult(1, {**FLOWN, "simulated_s": 4.0, "wall_s": 2.0})],
    ),
    "the first sleeps": (TWO, [FlightResult(0, SLEPT), FlightResult(0, FLOWN)]),
    "the second sleeps": (TWO, [FlightResult(0, FLOWN), FlightResult(0, SLEPT)]),
    "neither flies": (TWO, [FlightResult(0, NOWHERE)] * 2),
    "the first flies nothing": (TWO, [FlightResult(0, NOWHERE), FlightResult(0, FLOWN)]),
    "the first has no end": (TWO, [FlightResult(1, None)]),
    "the first is interrupted": (TWO, [FlightResult(130, {**FLOWN, "finished": False})]),
    "a status of the script's own": (TWO, [FlightResult(130, FLOWN), FlightResult(0, FLOWN)]),
    "one": ({"clocks": (5.0,)}, [FlightResult(0, FLOWN)]),
    "one that thinks": ({}, [FlightResult(4, {**FLOWN, "think_s": 0.0025})]),
    "one that --until stops": ({}, [FlightResult(0, {**NOWHERE, "finished": False})]),
    "one that is interrupted": ({}, [FlightResult(130, {**NOWHERE, "finished": False})]),
    "one without an end": ({}, [FlightResult(2, None)]),
    "equal flights": (CHECK, [FlightResult(0, FLOWN)] * 2),
    "equal flights that end with a status": (CHECK, [FlightResult(3, FLOWN)] * 2),
    "equal flights that crash": (CHECK, [FlightResult(1, CRASHED)] * 2),
    "equal flights whose errors name an address": (
        CHECK,
        [FlightResult(1, {**FLOWN, "error": f"TypeError: <object at {place}>"}) for place in ("0x1f", "0x2e")],
    ),
    "flights that end differently": (CHECK, [FlightResult(1, CRASHED), FlightResult(0, FLOWN)]),
    "flights that crash differently": (
        CHECK,
        [FlightResult(1, CRASHED), FlightResult(1, {**FLOWN, "error": "ValueError: none"})],
    ),
    "no call": (CHECK, [FlightResult(0, IDLE)]),
    "no call, and a status": (CHECK, [FlightResult(3, LOST)]),
    "no call, and a crash": (CHECK, [FlightResult(1, BROKEN)]),
    "no call before --until": (CHECK, [FlightResult(0, STOPPED)]),
    "flights that differ": (CHECK, [FlightResult(0, FLOWN), FlightResult(0, FLOWN, differs=True)]),
    "a second flight without an end": (CHECK, [FlightResult(0, FLOWN), FlightResult(5, None)]),
    "a second flight that is interrupted": (CHECK, [FlightResult(0, FLOWN), FlightResult(130, {"finished": False})]),
    "a check that is interrupted": (CHECK, [FlightResult(130, {**FLOWN, "finished": False})]),
}


def test_what_is_flown_and_said_is_as_recorded(
    asked: FlyRequest, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Trajectories lie 0, 0.25 and 1.5 m east; only the first flight makes a film."""
    text, flight = list[str](), replace(asked.flight, film=True, seed=3)
    for number, (name, (keys, results)) in enumerate(RUNS.items()):
        flights = Flights(*zip(results, (0.0, 0.25, 1.5), strict=False))
        monkeypatch.setattr(command, "fly", flights.fly)
        monkeypatch.setattr(command, "check", flights.check)
        try:
            status = fly_script(replace(asked, out=asked.flight.script.parent / f"{number}/out", flight=flight, **keys))
            end = f"status {status}"
        except UserError as error:
            end = f"refused: {error}"
        text += ["", f"## {name}", *capsys.readouterr().out.splitlines(), end]
        for options, quiet in flights.asked:
            how = ", film" * options.film + ", quiet" * quiet
            beside = f", beside {options.reference.name}" if options.reference else ""
            text.append(f"- {options.folder.name} at {options.clock_speed}, seed {options.seed}{how}{beside}")
    assert_as_recorded("fly_command", "\n".join(text) + "\n")


def test_the_second_flight_is_held_against_the_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To the byte, where both flew; a flight that a script's end or an interruption cut short is none."""
    first, asked = tmp_path / "first", FlightOptions(Path("script.py"), (), tmp_path / "again")
    flown: list[tuple[FlightOptions, bool]] = []
    ended = FlightResult(0, {"finished": True})

    def fly(options: FlightOptions, quiet: bool = False) -> FlightResult:
        flown.append((options, quiet))
        return ended

    monkeypatch.setattr(command, "fly", fly)
    assert check(asked, first).status == 0, "neither flew"
    for folder, place_m in ((first, 1.0), (asked.folder, 1.0)):
        folder.mkdir()
        write_trajectory(folder, np.arange(3), np.full((3, 10), place_m))
    assert check(asked, first).status == 0
    for place_m in (1.0 + 1e-15, 2.0):
        write_trajectory(asked.folder, np.arange(3), np.full((3, 10), place_m))
        with pytest.raises(DifferenceError, match="the messages of both flights are equal, but the trajectories"):
            check(asked, first)
    ended = FlightResult(130, {"finished": False})
    assert check(asked, first).interrupted
    assert flown == [(replace(asked, reference=first), True)] * 5


def test_settings_beside_the_script_come_before_those_of_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are AirSim's by one of their keys; another program's are passed over."""
    home, script = tmp_path / "home", tmp_path / "scripts" / "script.py"
    monkeypatch.setenv("HOME", str(home))
    beside, own = script.parent / "settings.json", home / "Documents" / "AirSim" / "settings.json"
    assert found_settings(script) is None
    for path in (own, beside):
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps({"ClockSpeed": 2}))
        assert found_settings(script) == path
    for text in ('{"SettingsVersion": 1.2}', '{"ClockSpeed": 5, "theme": "dark"}', '\ufeff{"Vehicles": {}}'):
        beside.write_text(text)
        assert found_settings(script) == beside
    for text in ('{"theme": "dark"}', "{}", '["ClockSpeed"]', "{"):
        beside.write_text(text)
        assert found_settings(script) == own


def test_settings_that_are_found_are_named_and_flown(
    asked: FlyRequest, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flights = Flights((FlightResult(0, NOWHERE), 0.0))
    monkeypatch.setattr(command, "fly", flights.fly)
    (beside := asked.flight.script.parent / "settings.json").write_text(json.dumps({"ClockSpeed": 3}))
    assert fly_script(replace(asked, find_settings=True)) == 0
    named = f"settings: {beside} (--no-settings flies without, --settings with others)"
    assert capsys.readouterr().out.splitlines()[0] == named
    [(flown, _)] = flights.asked
    assert (flown.settings, flown.settings_found) == (beside, True)


def test_a_request_of_a_flight_travels_whole(tmp_path: Path) -> None:
    options = FlightOptions(
        Path("a.py"), ("-x", "1"), tmp_path, "lockstep", "airsim", "lane", 2.5, Path("s.json"), 0.25, 7, 9.5,
        ("w", "esc"), True, Path("first"), Path("scratch"), True,
    )  # fmt: skip
    assert FlightOptions.from_json(options.to_json()) == options
    few = FlightOptions(Path("a.py"), (), tmp_path)
    assert FlightOptions.from_json(few.to_json()) == few


def test_thinking_time_is_the_options_or_the_timings() -> None:
    for timing, own_s in (("virtual", 0.001), ("lockstep", 0.0), ("wall", 0.0)):
        for given_s in (None, 0.0, 0.5):
            options = FlightOptions(Path("a.py"), (), Path(), timing, think_s=given_s)
            assert options.thinks_s == (own_s if given_s is None else given_s)


def test_a_folder_is_taken_that_is_new_or_empty(asked: FlyRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    assert asked.out is not None
    asked.out.mkdir()
    monkeypatch.setattr(command, "fly", lambda options: FlightResult(7, None))
    assert fly_script(asked) == 7
    (asked.out / "flight.json").write_text("{}")
    with pytest.raises(UserError, match=r"out: is there already; choose another --out"):
        fly_script(asked)


def test_a_flight_is_told_by_its_own_files_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever an earlier one in the same folder has left."""
    options = FlightOptions(tmp_path / "script.py", (), tmp_path)
    for name in (SUMMARY, DIFFERENCE):
        (tmp_path / name).write_text("{}")
    ended = SimpleNamespace(pid=0, poll=lambda: 0, kill=lambda: None)
    monkeypatch.setattr(command, "start_python", lambda *_, **__: nullcontext(ended))
    assert command.fly(options) == FlightResult(0, None)

    def differ() -> int:
        (tmp_path / DIFFERENCE).write_text("at call 1")
        return 1

    ended.poll = differ
    assert command.fly(options) == FlightResult(1, None, differs=True)
    assert "the script ended its process by itself; its flight was not kept" in capsys.readouterr().err


def test_a_process_ended_by_a_signal_has_a_shells_status_and_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    for ended, status in ((0, 0), (3, 3), (-9, 137), (-11, 139)):
        process: Any = SimpleNamespace(pid=0, poll=lambda ended=ended: ended)
        assert _wait(process, None) == status
    killed, crashed = capsys.readouterr().err.splitlines()
    assert killed == "uavaccel: error: the script's process was ended by SIGKILL"
    assert crashed.endswith("was ended by SIGSEGV")


def test_a_process_that_stays_stopped_is_killed_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    killed, polls, patience = list[bool](), iter([None, None, None, -9]), iter([False, True, True])
    monkeypatch.setattr(command, "Patience", lambda _: SimpleNamespace(is_over=patience.__next__))
    process: Any = SimpleNamespace(poll=polls.__next__, wait=lambda seconds: None, kill=lambda: killed.append(True))
    assert _wait(process, None) == 137
    assert killed == [True]
    said = "uavaccel: error: the script's process was stopped, and killed since it did not go on\n"
    assert capsys.readouterr().err == said


class Waited:
    """A process whose waits end with a status, not in time, or with another Ctrl-C."""

    def __init__(self, *ends: int | type[BaseException] | None) -> None:
        self.ends, self.sent = [*ends], list[str]()
        self.kill = lambda: self.sent.append("kill")

    def wait(self, seconds: float | None = None) -> int:
        end = self.ends.pop(0)
        if isinstance(end, int):
            return end
        raise subprocess.TimeoutExpired("script", seconds or 0.0) if end is None else end

    def send_signal(self, number: signal.Signals) -> None:
        self.sent.append(number.name)


@pytest.mark.parametrize(("ends", "heard", "status", "sent"), [
    ([7], None, 7, []),
    ([None, 7], None, 7, ["SIGINT"]),
    ([None, 7], False, 7, ["SIGINT"]),
    ([None, 7], True, 7, []),
    ([None, None, -9], True, 130, ["kill"]),
    ([None, KeyboardInterrupt, -9], False, 130, ["SIGINT", "kill"]),
])  # fmt: skip
def test_a_script_that_has_not_heard_of_ctrl_c_is_told(
    ends: Any, heard: bool | None, status: int, sent: list[str], tmp_path: Path
) -> None:
    if heard:
        (tmp_path / "seen").touch()
    process: Any = Waited(*ends)
    assert _interrupt(process, None if heard is None else tmp_path / "seen") == status
    assert (process.sent, process.ends) == (sent, [])


# --- the film --------------------------------------------------------------------------------------------------------


def test_the_film_runs_as_the_flight_did(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Twelve frames a second, of 640 x 360 pixels and a band of 24: 41 ticks of 2 ms are the nearest to a twelfth."""
    made, ended, said = list[Any](), list[bool](), list[str]()

    @contextmanager
    def movie(path: Path, size: tuple[int, int], frames_per_s: int) -> Iterator[Any]:
        made.append((path, size, frames_per_s))
        yield made.append

    def watch(every: int, look: Any) -> Any:
        made.append(every)
        look(None)
        return lambda: ended.append(True)

    monkeypatch.setattr("uavaccel.draw.film.movie", movie)
    monkeypatch.setattr(cv2, "putText", lambda frame, text, *how: said.append(text))
    picture = np.zeros((360, 640, 3), np.uint8)
    picture[..., 0], picture[0, 0, 1] = 200, 50
    state = SimpleNamespace(time_ns=1_500_000_000, position_m=(1.0, -2.0, -3.5), linear_velocity_m_s=(3.0, 0.0, -4.0))
    camera = SimpleNamespace(colour=lambda data: picture)
    world = SimpleNamespace(camera=lambda width, height: camera, data=None, watch=watch)
    profile = SimpleNamespace(tick_ns=2_000_000)
    simulation: Any = SimpleNamespace(world=world, kinematics=lambda: state, profile=profile)
    with filming(simulation, tmp_path):
        assert not ended
    first, every, frame = made
    assert (first, every, ended) == ((tmp_path / "film.mp4", (640, 384), 12), 41, [True])
    assert (frame.shape, frame[0, 0].tolist(), frame[359, 639].tolist()) == ((384, 640, 3), [0, 50, 200], [0, 0, 200])
    assert not frame[360:].any()
    assert said == ["   1.50 s   1.0 -2.0 -3.5 m NED   5.0 m/s"]
