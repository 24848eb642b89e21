"""The parts of `uavaccel fly` one by one: its process, its server, what a script's programs inherit."""

from __future__ import annotations

import io
import json
import os
import random
import signal
import subprocess
import sys
import sysconfig
import threading
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest

from uavaccel.clock import VirtualClock
from uavaccel.errors import UserError
from uavaccel.fly import environment, process, simulated, wall
from uavaccel.fly.log import MESSAGES, DifferenceError, MessageLog
from uavaccel.fly.modules import Patches, importing, named_module, of_a_script
from uavaccel.fly.options import DIFFERENCE, SUMMARY, FlightOptions
from uavaccel.fly.script import FlightOver, ScriptResult, run_script, unraisable
from uavaccel.wire.rpc import Future, RpcError

# --- the process -----------------------------------------------------------------------------------------------------


class Flight:
    """Draws what a script could draw, and ends as it is told."""

    def __init__(self, outcome: ScriptResult) -> None:
        self._outcome = outcome
        self.drawn: tuple[float, float] | None = None
        self.ended = False

    def run(self) -> ScriptResult:
        self.drawn = random.random(), float(np.random.random())  # noqa: NPY002  what scripts use
        return self._outcome

    def end(self) -> None:
        self.ended = True

    def summary(self) -> Any:
        return {"simulated_s": 4.0, "position_m": None}


@pytest.fixture
def fly(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Flies such a script; returns the flight, what its process made of it, and its summary."""

    def flown(outcome: ScriptResult, **options: Any) -> tuple[Flight, Any, dict[str, Any]]:
        flight, made = Flight(outcome), []

        def make(*how: Any) -> Flight:
            made.append(how)
            return flight

        monkeypatch.setattr(simulated, "SimulatedFlight", make)
        monkeypatch.setattr("signal.signal", lambda *_: None)
        (tmp_path / "script.py").write_text("")
        status = process.fly(FlightOptions(tmp_path / "script.py", (), tmp_path, **options))
        assert status == outcome.status
        assert flight.ended
        return flight, made[0], json.loads((tmp_path / SUMMARY).read_text())

    return flown


@pytest.mark.parametrize("seed", [0, None])
def test_a_seed_is_that_of_both_global_generators_and_nought_is_one(fly: Any, seed: int | None) -> None:
    before = random.getstate(), np.random.get_state()  # noqa: NPY002
    random.seed(3)
    np.random.seed(3)  # noqa: NPY002
    try:
        flight, *_ = fly(ScriptResult(0, True, 0.5), seed=seed)
    finally:
        random.setstate(before[0])
        np.random.set_state(before[1])  # noqa: NPY002
    given = 3 if seed is None else seed
    assert flight.drawn == (random.Random(given).random(), np.random.RandomState(given).random_sample())


def test_a_seed_is_that_of_pytorch_too(monkeypatch: pytest.MonkeyPatch) -> None:
    before, seeds = (random.getstate(), np.random.get_state()), list[int]()  # noqa: NPY002
    monkeypatch.setitem(sys.modules, "torch", named_module("torch", manual_seed=seeds.append))
    with Patches() as patches:
        process._seed(7, patches)
    random.setstate(before[0])
    np.random.set_state(before[1])  # noqa: NPY002
    assert seeds == [7]


@pytest.mark.parametrize(
    ("end", "seed", "status", "said"),
    [
        (DifferenceError("they differ"), 3, 1, "they differ\n"),
        (DifferenceError("they differ"), None, 1, f"they differ{process.HINT}\n"),
        (UserError("flight.json: no room"), None, 1, "error: flight.json: no room\n"),
        (KeyboardInterrupt(), None, 130, "interrupted\n"),
    ],
)
def test_a_flight_that_cannot_be_kept_ends_its_process_with_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
    end: BaseException, seed: int | None, status: int, said: str,
) -> None:  # fmt: skip
    """A difference is left in a file for the process that asked for it."""
    options = FlightOptions(tmp_path / "script.py", (), tmp_path, seed=seed)

    def fly(asked: FlightOptions) -> int:
        assert asked == options
        raise end

    monkeypatch.setattr(process, "fly", fly)
    monkeypatch.setattr(process, "end_with_parent", lambda parent, last: None)
    monkeypatch.setattr(sys, "argv", ["process", options.to_json(), "1"])
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    with pytest.raises(SystemExit) as ended:
        process.main()
    assert ended.value.code == status
    assert capfd.readouterr().err == f"uavaccel: {said}"
    left = [file.read_text() for file in tmp_path.iterdir() if file.name == DIFFERENCE]
    assert left == ([said] if isinstance(end, DifferenceError) else [])


def test_the_option_for_clock_speed_precedes_the_settings(fly: Any, tmp_path: Path) -> None:
    for in_settings, asked, flown in ((None, None, 1.0), (None, 20.0, 20.0), (5.0, None, 5.0), (5.0, 0.5, 0.5)):
        given = {"SettingsVersion": 1.2, "ClockSpeed": in_settings or 1.0}
        (tmp_path / "settings.json").write_text(json.dumps(given))
        settings = None if in_settings is None else tmp_path / "settings.json"
        outcome = ScriptResult(0, True, 0.5)
        _, (_, read, clock_speed, _), kept = fly(outcome, settings=settings, clock_speed=asked, scene="lane")
        assert (clock_speed, kept["clock_speed"], kept["scene"]) == (flown, flown, "lane")
        assert (read is None) == (in_settings is None)
        expected = {"status": 0, "finished": True, "wall_s": 0.5, "simulated_s": 4.0, "position_m": None, "calls": 0}
        assert {name: kept[name] for name in expected} == expected


@pytest.mark.parametrize(
    ("outcome", "differs"),
    [
        (ScriptResult(0, True, 0.5), True),
        (ScriptResult(0, False, 0.5), True),  # stopped by --until
        (ScriptResult(130, True, 0.5), True),  # its own status
        (ScriptResult(130, False, 0.5), False),
    ],
)
def test_only_an_interrupted_flight_may_end_before_its_reference(
    fly: Any, tmp_path: Path, outcome: ScriptResult, differs: bool
) -> None:
    (reference := tmp_path / "first").mkdir()
    (reference / MESSAGES).write_text("{}\n")
    if differs:
        with pytest.raises(DifferenceError, match="has ended"):
            fly(outcome, reference=reference)
    else:
        *_, kept = fly(outcome, reference=reference)
        assert (kept["status"], kept["finished"]) == (130, False)


def test_calls_and_answers_are_logged_with_their_times(tmp_path: Path) -> None:
    log = MessageLog(tmp_path)
    assert [log.call(30, 10, "ping", []), log.call(60, None, "move", [1.5, "x"])] == [1, 2]
    log.answer(1, 40, None, True)
    log.answer(2, 70, "refused", None)
    log.close()
    assert [json.loads(line) for line in (tmp_path / MESSAGES).read_text().splitlines()] == [
        {"call": 1, "wall_ns": 30, "time_ns": 10, "method": "ping", "params": []},
        {"call": 2, "wall_ns": 60, "time_ns": None, "method": "move", "params": [1.5, "x"]},
        {"answer": 1, "wall_ns": 40, "result": True},
        {"answer": 2, "wall_ns": 70, "error": "refused"},
    ]
    assert log.calls == 2


def test_in_wall_time_an_answer_is_logged_when_it_has_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not when it is asked for, and of every client from the flight's beginning.

    A flight that is over, or whose server has gone, takes no call.
    """
    clock, over = VirtualClock(), threading.Event()

    def arrive(future: Future) -> None:
        clock.charge(5)
        future.answer("no" if future.method == "refused" else None, future.method)

    server: Any = SimpleNamespace(call_async=lambda method, *params: Future(method, arrive))
    opened = Mock(return_value=server)
    monkeypatch.setattr(wall, "SocketConnection", opened)
    monkeypatch.setattr(wall, "MonotonicClock", lambda: clock)
    log, watch = MessageLog(tmp_path), SimpleNamespace(lost="", is_lost_soon=lambda: True)
    clock.charge(1000)
    connections = []
    for timeout_s in (1.0, 0.5):
        connections.append(wall.LoggedConnection(7, timeout_s, log, cast(Any, watch), over, begun_ns=1000))
        clock.charge(15)
    connection, later = connections
    assert [each.args for each in opened.mock_calls] == [("127.0.0.1", 7, 1.0), ("127.0.0.1", 7, 0.5)]
    sent, told = connection.call_async("ping", 1.5), list[Future]()
    sent.attach_callback(told.append)
    clock.charge(10)
    assert (sent.get(), told) == ("ping", [sent])
    with pytest.raises(RpcError, match="no"):
        later.call("refused")
    server.call_async = lambda *call: (_ for _ in ()).throw(ConnectionError())
    with pytest.raises(FlightOver):
        connection.call_async("late")
    over.set()
    with pytest.raises(FlightOver):
        sent.wait(sent)
    log.close()
    assert [json.loads(line) for line in (tmp_path / MESSAGES).read_text().splitlines()] == [
        {"call": 1, "wall_ns": 30, "time_ns": None, "method": "ping", "params": [1.5]},
        {"answer": 1, "wall_ns": 45, "result": "ping"},
        {"call": 2, "wall_ns": 45, "time_ns": None, "method": "refused", "params": []},
        {"answer": 2, "wall_ns": 50, "error": "no"},
        {"call": 3, "wall_ns": 50, "time_ns": None, "method": "late", "params": []},
    ]


@pytest.mark.parametrize("text", [
    *("sys.exit()", "sys.exit(7)", "sys.exit('no more')", "raise SystemExit(True)", "def fall(): int('x')\nfall()"),
    "print(__name__, __file__, sys.argv, sys.path[0], file=sys.stderr)", "os.chdir('/')\nimport beside\n1 / 0",
])  # fmt: skip
def test_a_script_runs_as_python_runs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    """Started from elsewhere, wherever it goes then."""
    (tmp_path / "beside.py").touch()
    (tmp_path / "script.py").write_text(f"import os, sys\n{text}\n")
    (elsewhere := tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(elsewhere)
    monkeypatch.setattr(sys, "argv", ["pytest"])
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    monkeypatch.setitem(sys.modules, "__main__", sys.modules["__main__"])
    monkeypatch.delitem(sys.modules, "beside", raising=False)
    python = subprocess.run([sys.executable, "../script.py", "a", "b c"], capture_output=True, text=True, check=False)
    outlived: list[bool] = []
    try:
        result = run_script(Path("../script.py"), ("a", "b c"), lambda: outlived.append(True))
    finally:
        sys.modules.pop("beside", None)
    assert (outlived, result.finished) == ([True], True)
    assert (result.status, capsys.readouterr().err) == (python.returncode, python.stderr)


@pytest.mark.parametrize("error", [FlightOver, ValueError])
def test_what_a_destructor_raises_is_told_but_for_the_end_of_the_flight(
    error: type[BaseException], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Last:
        def __del__(self) -> None:
            raise error

    monkeypatch.setattr(sys, "unraisablehook", unraisable)
    Last()
    assert ("ValueError" in capsys.readouterr().err) == (error is ValueError)


# --- a server of its own ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("settings", [None, Path("own.json")])
def test_a_flight_in_wall_time_starts_a_server_and_passes_on_warnings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], settings: Path | None
) -> None:
    said = b"listening on 127.0.0.1:8123: scene lane, profile airsim, ClockSpeed 2.5\nSimpleFlight hovers\n"
    said += b"warning: the machine does not keep up\nrequested 2.5x\nstopped; achieved 2.4x\n  moveOnPath: refused\n"
    started: list[Any] = []

    class LateWords(io.BytesIO):
        """The last ones come after the end."""

        def read1(self, size: int | None = -1) -> bytes:
            if self.tell():
                threading.Event().wait(0.05)
            return super().read1(len(said) - 30)

    server = SimpleNamespace(stdout=LateWords(said), send_signal=lambda number: started.append(number.name))
    watch = SimpleNamespace(end=lambda: started.append("no longer watched"))

    def start(*command: str, **options: Any) -> Any:
        started.append(command)
        return nullcontext(server)

    monkeypatch.setattr(wall, "start_python", start)
    monkeypatch.setattr(wall, "Watch", lambda *_: watch)
    monkeypatch.setattr(wall, "end_within", lambda *_: started.append("ended"))
    options = FlightOptions(Path("script.py"), (), tmp_path, "wall", profile="airsim", scene="lane", clock_speed=9.0)
    with wall.serving(options, 2.5, settings) as (port, _):
        assert port == 8123
    (_, _, *arguments), *ends = started
    assert ends == ["no longer watched", "SIGINT", "ended"]
    asked = ["serve", "--port", "0", "--clock", "2.5", "--profile", "airsim", "--scene", "lane"]
    asked += ["--recordings", str(tmp_path / "recordings")]
    assert arguments == [*asked, *(["--settings", "own.json"] if settings else [])]
    assert capsys.readouterr().err.splitlines() == [
        "uavaccel: warning: the machine does not keep up",
        "uavaccel: stopped; achieved 2.4x",
        "uavaccel:   moveOnPath: refused",
    ]


# --- a script's programs ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("own", "port"), [(None, None), ("mine", 8123), (os.pathsep.join(["mine", "yours"]), 1)])
def test_a_scripts_programs_find_our_client_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own: str | None, port: int | None
) -> None:
    monkeypatch.delenv(environment.PORT, raising=False)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    if own is not None:
        monkeypatch.setenv("PYTHONPATH", own)
    before, path = dict(os.environ), list(sys.path)
    with environment.client_for_children(tmp_path, port):
        first, *others = os.environ["PYTHONPATH"].split(os.pathsep)
        assert others == (own.split(os.pathsep) if own else [])
        assert [file.name for file in Path(first).iterdir()] == ["sitecustomize.py"]
        assert os.environ[environment.PORT] == ("" if port is None else str(port))
        assert sys.path == path
    assert (dict(os.environ), sys.path) == (before, path)
    with environment.client_for_children(None, port):
        assert (dict(os.environ), sys.path) == (before, path)


def test_a_scripts_programs_fly_in_its_flight_whatever_address_they_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaccel.airsim.connection.SocketConnection", opened := Mock())
    monkeypatch.setenv(environment.PORT, "8123")
    environment._connect("10.0.0.1", 41451, 2.5)
    opened.assert_called_once_with("127.0.0.1", 8123, 2.5)


def test_a_refusal_after_the_flight_is_ignored() -> None:
    """A pool's next process may still be refused while the flight is written."""
    handled = signal.getsignal(signal.SIGUSR2)
    try:
        with environment.ended_by_refusals(lambda: 0):
            os.kill(os.getpid(), signal.SIGUSR2)
            assert signal.getitimer(signal.ITIMER_REAL)[1] == environment.POLL_S
        os.kill(os.getpid(), signal.SIGUSR2)  # which would end this process
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    finally:
        signal.signal(signal.SIGUSR2, handled)


def test_what_has_moved_since_a_refusal_does_not_wait_for_it() -> None:
    """It waits where it stands, for PATIENT_POLLS, in Python's own modules, and nothing is called meanwhile."""

    def at(place: int, module: str = "multiprocessing.pool") -> Any:
        return SimpleNamespace(f_globals={"__name__": module}, f_lasti=place)

    calls, (waiting, moving, own) = [0], (at(1), at(2), at(3, "script"))
    many = environment.PATIENT_POLLS + 1
    with environment.ended_by_refusals(lambda: calls[0]):
        poll: Any = signal.getsignal(signal.SIGALRM)
        frames = [at(place) for place in range(2 * many)]
        for frame in [*frames, *[own] * many, *[waiting] * (many - 1), own, *[waiting] * (many - 1), moving, moving]:
            poll(0, frame)
        for calls[0] in range(2 * many):
            poll(0, waiting)
        for _ in range(many - 2):
            poll(0, waiting)
        with pytest.raises(UserError, match="the script waits for it"):
            poll(0, waiting)


def test_a_forked_process_logs_and_compares_nothing(tmp_path: Path) -> None:
    """Its parent writes the lines that it has a copy of."""
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
    (tmp_path / "first" / MESSAGES).write_text("another\n")
    log = MessageLog(tmp_path / "second", tmp_path / "first")
    log.abandon()
    log.call(0, 0, "ping", [])
    log.close()
    assert (tmp_path / "second" / MESSAGES).read_text() == ""


# --- modules and patches ---------------------------------------------------------------------------------------------


def test_a_script_is_what_no_library_is() -> None:
    installed = Path(sysconfig.get_path("purelib"))
    for file, mine in (
        ("/home/somebody/script.py", True),
        ("script.py", True),
        (str(Path(threading.__file__)), False),
        (str(installed / "numpy" / "__init__.py"), False),
        ("/home/somebody/.local/lib/python3.12/site-packages/numpy/__init__.py", False),  # the user's own
        (str(Path(wall.__file__)), False),
        (None, False),
    ):
        assert of_a_script({"__file__": file} if file else {}) is mine, file
    assert not of_a_script(None)


def test_patches_leave_everything_as_they_found_it() -> None:
    """Also what was not there, what a class inherits, and what has been replaced twice."""

    class Base:
        def named(self) -> str:
            return "base"

        @staticmethod
        def of_nobody() -> str:
            return "nobody's"

    class Derived(Base):
        pass

    module = named_module("some", there=1)
    with Patches() as patches:
        undone: list[str] = []
        patches.undo(lambda: undone.append("undone"))
        for value in (2, 3):
            patches.set(module, "there", value)
            patches.set(module, "missing", value)
        patches.set(Derived, "named", lambda self: "patched")
        patches.set(Base, "of_nobody", lambda self: "patched")
        assert (module.there, module.missing, Derived().named(), undone) == (3, 3, "patched", [])
    assert (module.there, hasattr(module, "missing"), Derived().named()) == (1, False, "base")
    assert Base().of_nobody() == "nobody's"
    assert undone == ["undone"]


def test_a_module_is_changed_on_import_or_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "imported_later.py").write_text("value = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    changed: list[str] = []

    def change(module: ModuleType) -> None:
        changed.append(f"{module.__name__}: {getattr(module, 'value', None)}")

    with Patches() as patches:
        patches.when_imported("json", change)
        for _ in range(2):
            patches.when_imported("imported_later", change)
        assert changed == ["json: None"]
        import imported_later  # type: ignore[import-not-found]

        assert imported_later.value == 1
        assert changed[1:] == ["imported_later: 1"] * 2
    sys.modules.pop("imported_later")


def test_a_script_is_given_what_stands_in_for_a_library_and_not_for_its_own_module() -> None:
    own, stand_in = {"__file__": "script.py", "__package__": "json"}, ModuleType("decoder")
    with importing({}, {"decoder": stand_in}):
        assert __import__("decoder", own) is stand_in
        assert __import__("decoder", own, None, ("x",), 1).__name__ == "json.decoder", "from .decoder import x"
        with pytest.raises(ImportError):
            __import__("decoder", {"__file__": threading.__file__})
