"""`uavaccel serve` as a user meets it: a process, its lines, its end."""

import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.serving import client_of
from tests.simulating import simulate
from uavaccel.clock import VirtualClock
from uavaccel.errors import UserError
from uavaccel.wire.api import Api
from uavaccel.wire.recorder import FILE_NAME
from uavaccel.wire.service import PERIOD_NS, ServeOptions, ServerReport, address_of, api_of, stopped_by_signals
from uavaccel.wire.settings import Settings

pytestmark = pytest.mark.wall_clock

ROOT = Path(__file__).parents[1]


def test_it_serves_settings_names_what_it_does_not_know_and_a_signal_ends_it(tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    path.write_text('{"ApiServerPort": 41452, "ClockSpeed": 20, "ViewMode": "Fpv", "Vehicles": {"Drone1": {}}}')
    options = ["--port", "0", "--settings", str(path), "--recordings", str(tmp_path / "there"), "--watch"]
    command = [sys.executable, "-m", "uavaccel", "serve", *options]
    with (
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process,
        ExitStack() as stack,
    ):
        stack.callback(process.kill)
        busy = "warning: the machine does not keep up"  # with its other work
        lines = (line.removesuffix("\n") for line in process.stdout or () if not line.startswith(busy))
        assert next(lines).startswith("watch at http://127.0.0.1:")
        told = re.fullmatch(r"listening on [\d.]+:(\d+): scene blocks, profile native, ClockSpeed 20", next(lines))
        assert told is not None
        assert told[1] != "41452", "the option is 0: any that is free"
        client = stack.enter_context(client_of(int(told[1])))
        client.confirmConnection()
        assert next(lines) == "Drone1 hovers 10 m up; the clock runs and API control is off, as in AirSim; Ctrl-C stops"
        assert next(lines) == f"{path}: without effect here: ViewMode"
        assert not client.simIsPause()
        client.enableApiControl(True)
        client.startRecording()
        [recording] = (tmp_path / "there").glob(f"*/{FILE_NAME}")
        assert next(lines) == f"recording to {recording}"
        client.moveByVelocityAsync(1, 0, 0, 1).join()
        for _ in range(3):
            client.client.call_async("moveNowhere", 1).join()  # says nothing of its error, as AirSim's
        client.client.call_async("moveByVelocity", "fast", 0, 0, 1, 0, {}).join()
        client.client.call_async("move\x1b[2J\n").join()
        assert next(lines) == "warning: moveNowhere is not known here"
        assert next(lines) == "warning: moveByVelocity was refused: vx must be a number, not str"
        assert next(lines) == "warning: move?[2J? is not known here"
        os.kill(process.pid, signal.SIGINT)
        stopped, first, *others = lines
        assert process.wait() == 0
    assert stopped.startswith("stopped; requested 20x, achieved ")
    assert (first, len(others)) == ("  3 x moveNowhere is not known here", 2)
    assert len(recording.read_text().splitlines()) > 20  # closed with what had not been written yet


def test_ctrl_c_and_the_end_of_a_terminal_stop_it_and_are_handed_back() -> None:
    stopped: list[bool] = []
    server: Any = SimpleNamespace(stop=lambda: stopped.append(True))
    before = [signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)]
    with stopped_by_signals(server):
        for kind in (signal.SIGINT, signal.SIGTERM):
            signal.raise_signal(kind)
    assert stopped == [True, True]
    assert [signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)] == before


def test_it_listens_beyond_this_machine_only_if_told_so_here() -> None:
    everywhere = Settings.model_validate({"LocalHostIp": "0.0.0.0"})
    with pytest.raises(UserError, match=r"add --host 0\.0\.0\.0"):
        address_of(ServeOptions(), everywhere)
    assert address_of(ServeOptions(), Settings()) == "127.0.0.1"
    assert address_of(ServeOptions(host="0.0.0.0"), Settings()) == "0.0.0.0"
    assert address_of(ServeOptions(host="127.0.0.2"), everywhere) == "127.0.0.2"


UNEVEN = {"Recording": {"RecordInterval": 0.0501}}  # which the physics step does not divide


def test_options_go_before_settings_which_reach_the_simulation(tmp_path: Path) -> None:
    (a_file := tmp_path / "file").touch()
    given = {"ClockSpeed": 5, "Recording": {"Folder": str(a_file), "RecordInterval": 0.2}, "Wind": {"X": 2}}
    settings = Settings.model_validate(given)
    with pytest.raises(UserError, match=r"Recording\.Folder = .*file: is no folder"):
        api_of(ServeOptions(), settings)
    with pytest.raises(UserError, match=r"^my\.json: Recording.Record"):
        api_of(ServeOptions(Path("my.json")), Settings.model_validate(UNEVEN))
    with pytest.raises(UserError, match=r"--recordings .*file: is no folder"):
        api_of(ServeOptions(recordings=a_file), Settings())
    for clock_speed, flown in ((None, 5.0), (2.0, 2.0)):
        simulation = api_of(ServeOptions(recordings=tmp_path, clock_speed=clock_speed), settings).simulation
        assert (float(simulation.clock_speed), simulation.profile.recorder_ticks) == (flown, 100)
        assert simulation.world.lead.state["wind"].tolist() == [2.0, 0.0, 0.0]


class AirSimServer(SimpleNamespace):
    """What a ServerReport looks at: a clock that the test moves and a simulation at 10x."""

    def __init__(self) -> None:
        self.simulation = simulate(10.0)
        super().__init__(clock=VirtualClock(), api=Api(self.simulation, render=False))

    def pass_time(self, wall_ns: int, lost_ns: int = 0) -> None:
        self.clock.charge(wall_ns)
        self.simulation.advance_to(self.clock.now_ns())
        self.simulation.speed.lost_wall_ns += lost_ns


def test_speeds_are_added_up_over_resets(capsys: pytest.CaptureFixture[str]) -> None:
    server = AirSimServer()
    report = ServerReport(server)  # type: ignore[arg-type]
    server.pass_time(100_000_000)
    server.simulation.reset(server.clock.now_ns())
    report.each_turn()
    server.simulation.set_clock_speed(20, server.clock.now_ns())
    server.pass_time(300_000_000)
    report.each_turn()
    server.simulation.reset(server.clock.now_ns())
    report.each_turn()
    server.pass_time(400_000_000)
    assert capsys.readouterr().out == "", "no period is over"
    report.finish()
    assert capsys.readouterr().out == "stopped; requested 20x, achieved 18.75x over 0.8 s\n"


def test_lost_time_is_told_when_it_has_doubled_and_a_failure_once(capsys: pytest.CaptureFixture[str]) -> None:
    server = AirSimServer()
    report = ServerReport(server)  # type: ignore[arg-type]

    def period(lost_ns: int) -> str:
        server.pass_time(PERIOD_NS, lost_ns)
        report.each_turn()
        return capsys.readouterr().out

    assert period(PERIOD_NS // 250) == (""), "less than half a percent"
    assert period(PERIOD_NS // 100).startswith("warning: the machine does not keep up; requested 10x, achieved 10.00x")
    assert period(PERIOD_NS // 100) == ""
    assert "of wall time lost" in period(PERIOD_NS // 10)
    server.simulation.failure = "mjWARN_BADQPOS"
    assert period(0) == "warning: the flight cannot go on (mjWARN_BADQPOS); a reset starts anew\n"
    assert period(0) == ""
    server.simulation.failure = None
    assert period(0) == ""
    server.simulation.failure = "mjWARN_BADQPOS"
    assert "cannot go on" in period(0)
