"""Scripts of `uavaccel fly` line by line: what each answers, prints and takes, as recorded in tests/data/scripts.txt.

A script is a heading, options of its flight, and lines; below each line stands what came of it, written anew with
RECORD=1: the value or the exception, what has been printed, and by how many ms the script's clock has moved; below the
last one also what is kept of the flight. What stands in for something else is gone when the flight has ended.
"""

from __future__ import annotations

import builtins
import io
import json
import logging
import os
import random
import re
import signal
import sys
import threading
from collections.abc import Iterator
from importlib import import_module
from inspect import getattr_static
from pathlib import Path
from typing import Any

import matplotlib.pyplot
import numpy as np
import pytest

from tests.test_flights import assert_scenario_as_recorded, ms, scenarios
from uavaccel.clock import VirtualClock
from uavaccel.fly import process, simulated
from uavaccel.fly.keys import ROOTS, parse_keys
from uavaccel.fly.modules import client_modules
from uavaccel.fly.options import SUMMARY, FlightOptions
from uavaccel.fly.script import FlightOver, checked_output

FILE = Path(__file__).parent / "data/scripts.txt"
SCRIPTS = {scenario.heading: scenario for scenario in scenarios(FILE)}
KEPT = ("status", "finished", "error", "calls", "script_s", "slept_s", "simulated_s", "refused")
CHANGED = (
    *("atexit", "builtins", "cv2", "gymnasium", "matplotlib", "matplotlib.pyplot", "numpy"),
    *("numpy.random.bit_generator", "random", "socket", "socketserver", "select", "selectors", "queue", "threading"),
    *("time", "_thread", "asyncio.base_events", "asyncio.log", "asyncio.selector_events", "concurrent.futures._base"),
    *("concurrent.futures.process", "concurrent.futures.thread", "multiprocessing.dummy", "multiprocessing.pool"),
)
CLASSES = {"random": "Random", "socket": "socket", "asyncio.selector_events": "BaseSelectorEventLoop"}


class Stage:
    """Where a script plays its lines; `said` is what came of each."""

    def __init__(self, lines: list[str], printed: pytest.CaptureFixture[str]) -> None:
        self.lines, self.said, self._printed = lines, list[str](), printed
        self.clock = VirtualClock()

    def play(self, names: dict[str, Any]) -> None:
        over: FlightOver | None = None
        for line in self.lines:
            begun_ns = self.clock.now_ns()
            try:
                answer, over = self._do(line[2:], names), None
            except (Exception, SystemExit, FlightOver) as error:
                answer, over = f"{type(error).__name__}: {error}", error if isinstance(error, FlightOver) else None
            self._note(answer, begun_ns)
        if over is not None:
            raise over

    def _do(self, line: str, names: dict[str, Any]) -> str:
        try:
            code = compile(line, names["__file__"], "eval")
        except SyntaxError:
            exec(compile(line, names["__file__"], "exec"), names)
            return ""
        return repr(eval(code, names))

    def _note(self, answer: str, begun_ns: int) -> None:
        sys.stdout.flush()
        printed = [f"{name} {text!r}" for name, text in zip("12", self._printed.readouterr(), strict=True) if text]
        passed_ns = self.clock.now_ns() - begun_ns
        told = filter(None, [answer, *printed, f"+{ms(passed_ns)} ms" if passed_ns else ""])
        self.said.append(re.sub(r" at 0x[0-9a-f]+", "", "; ".join(told)) or "-")


def surroundings() -> dict[str, Any]:
    """What flights change in this process."""
    found: dict[str, Any] = {}
    for name in CHANGED:
        module = import_module(name)
        kind = getattr(module, CLASSES.get(name, ""), None)
        parts = {key for key, value in vars(module).items() if getattr(value, "__name__", "") == f"{name}.{key}"}
        parts |= {"_backend_mod"}  # of pyplot, a new one at each choice
        found |= {f"{name}.{key}": id(value) for key, value in vars(module).items() if key not in parts}
        found |= {f"{name}, {key}": id(getattr_static(kind, key)) for key in dir(kind)} if kind else {}
    found |= {f"environment {name}": value for name, value in os.environ.items()}
    roots = {name.partition(".")[0] for name in client_modules()} | {*ROOTS, "gym", "shimmy"}
    found |= {f"module {name}": id(sys.modules[name]) for name in [*sys.modules] if name.partition(".")[0] in roots}
    loggers = {name: [*logging.getLogger(name).filters] for name in ("concurrent.futures", "asyncio")}
    scheduler = import_module("sched").scheduler.__init__.__defaults__
    traceback = import_module("traceback").TracebackException.__init__
    found |= {"import": builtins.__import__, "finders": [*sys.meta_path], "loggers": loggers, "scheduler": scheduler}
    return found | {"traceback": traceback, "output": sys.stdout, "alarm": signal.getsignal(signal.SIGALRM)}


@pytest.fixture
def process_as_before() -> Iterator[None]:
    """A flight with a seed seeds the generators of this process, and it ignores late refusals."""
    drawn = random.getstate(), np.random.get_state()  # noqa: NPY002
    handled = signal.getsignal(signal.SIGUSR2)
    yield
    signal.signal(signal.SIGUSR2, handled)
    random.setstate(drawn[0])
    np.random.set_state(drawn[1])  # noqa: NPY002


@pytest.mark.usefixtures("process_as_before")
@pytest.mark.parametrize("heading", SCRIPTS)
def test_a_script_is_as_recorded(
    heading: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    scenario = SCRIPTS[heading]
    stage = Stage(scenario.calls, capfd)

    class Clock(VirtualClock):
        def __init__(self) -> None:
            super().__init__()
            stage.clock = self

    monkeypatch.setattr(builtins, "play", stage.play, raising=False)
    monkeypatch.setattr(simulated, "VirtualClock", Clock)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    matplotlib.pyplot.switch_backend("agg")
    monkeypatch.setattr(sys, "stdin", io.StringIO("typed\n"))
    monkeypatch.setattr(sys, "argv", ["script.py"])
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    monkeypatch.setitem(sys.modules, "__main__", sys.modules["__main__"])
    for name in [each for each in sys.modules if each.partition(".")[0] in ROOTS]:  # of other tests' scripts
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(threading, "excepthook", lambda event: print(event.thread.name, repr(event.exc_value)))
    (script := tmp_path / "script.py").write_text("play(globals())")
    asked = {"timing": "lockstep", **scenario.options}
    asked["keys"] = parse_keys(asked.get("keys"))
    before = surroundings()
    with checked_output():
        process.fly(FlightOptions(script, ("--words", "two words"), tmp_path, **asked))
    after = surroundings()
    assert sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name)) == []
    kept = json.loads((tmp_path / SUMMARY).read_text())
    stage.said[-1] += "".join([f"; {name} {kept[name]}" for name in KEPT if kept.get(name)])
    stage.said[-1] += "".join(f"; then {text!r}" for text in capfd.readouterr() if text)
    answers = iter(stage.said)
    assert_scenario_as_recorded(FILE, scenario, lambda line: next(answers))
