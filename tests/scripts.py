"""A folder with a script that `uavaccel fly` flies: by its command line in a process of its own, or in this process."""

from __future__ import annotations

import os
import signal
import sys
import textwrap
import threading
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.processes import command_line, descendants
from uavaccel.cli.main import main
from uavaccel.fly import process
from uavaccel.fly.options import FlightOptions

ROOT = Path(__file__).parents[1]
PATIENCE_S = 240.0  # after which a flight that does not end is a failure


class Flown(NamedTuple):
    """What a flight has said, and its exit status."""

    returncode: int
    stdout: str
    stderr: str


def end_flights() -> None:
    """Kill the scripts' processes that this one has started."""
    for pid in descendants(os.getpid()):
        if "uavaccel.fly.process" in command_line(pid):
            os.kill(pid, signal.SIGKILL)


def nobody() -> int:
    """A pipe that nobody reads any more."""
    reading, writing = os.pipe()
    os.close(reading)
    return writing


class Folder:
    """A folder with a script, and a home without settings."""

    def __init__(self, path: Path, patch: pytest.MonkeyPatch, said: pytest.CaptureFixture[str]) -> None:
        self.path, self.home, self._patch, self._said = path, path / "home", patch, said
        self.home.mkdir()

    def write(self, text: str, name: str = "script.py") -> Path:
        (self.path / name).write_text(textwrap.dedent(text))
        return self.path / name

    def fly(self, text: str, *options: str, answers: str = "", to: str = "") -> Flown:
        """Fly a script's text; `options` before it, and "--" between them and its own arguments.

        It reads `answers`, and prints to a file, where one is named, or to "nobody".
        """
        own = options.index("--") if "--" in options else len(options)
        words = [*options[:own], str(self.write(text)), *options[own:]]
        self._patch.setattr(sys, "argv", ["uavaccel", "fly", *words])
        self._patch.setenv("HOME", str(self.home))
        self._patch.chdir(ROOT)
        late = threading.Timer(PATIENCE_S, end_flights)
        late.start()
        kept = os.dup(0), os.dup(1)
        (typed := self.path / "typed").write_text(answers)
        with typed.open() as file:
            os.dup2(file.fileno(), 0)
        if to:
            printed = nobody() if to == "nobody" else os.open(to, os.O_WRONLY)
            os.dup2(printed, 1)
            os.close(printed)
        try:
            with pytest.raises(SystemExit) as ended:
                main()
        finally:
            late.cancel()
            for descriptor, before in enumerate(kept):
                os.dup2(before, descriptor)
                os.close(before)
        assert isinstance(ended.value.code, int)
        return Flown(ended.value.code, *self._said.readouterr())

    def fly_here(self, text: str, **options: Any) -> Flown:
        """Fly a script's text in this process, in lockstep unless told otherwise, and keep the flight in `out`."""
        script, out = self.write(text), self.path / "out"
        out.mkdir()
        status = fly_here(FlightOptions(script, (), out, **{"timing": "lockstep", **options}))
        return Flown(status, *self._said.readouterr())


def fly_here(options: FlightOptions) -> int:
    """Fly a script in this process, which has loaded what it needs; its exit status."""
    handlers = {kind: signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR2)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["script.py"])
        patch.setattr(sys, "path", ["", *sys.path])
        patch.setitem(sys.modules, "__main__", sys.modules["__main__"])
        patch.setattr(threading, "excepthook", threading.__excepthook__)
        try:
            return process.fly(options)
        finally:
            for kind, handler in handlers.items():
                signal.signal(kind, handler)
