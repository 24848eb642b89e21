"""A folder with a script that `uavaccel fly` flies: the command line in this process, each flight in its own."""

from __future__ import annotations

import os
import signal
import sys
import textwrap
import threading
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.processes import command_line, descendants
from uavaccel.cli.main import main

ROOT = Path(__file__).parents[1]
PATIENCE_S = 240.0  # after which a flight that does not end is a failure


class Flown(NamedTuple):
    """What a command line has said, and its exit status."""

    returncode: int
    stdout: str
    stderr: str


def end_flights() -> None:
    """Kill the scripts' processes that this one has started."""
    for pid in descendants(os.getpid()):
        if "uavaccel.fly.process" in command_line(pid):
            os.kill(pid, signal.SIGKILL)


class Folder:
    """A folder with a script, and a home without settings."""

    def __init__(self, path: Path, patch: pytest.MonkeyPatch, said: pytest.CaptureFixture[str]) -> None:
        self.path, self.home, self._patch, self._said = path, path / "home", patch, said
        self.home.mkdir()

    def write(self, text: str, name: str = "script.py") -> Path:
        (self.path / name).write_text(textwrap.dedent(text))
        return self.path / name

    def fly(self, text: str, *options: str, answers: str = "") -> Flown:
        """Fly a script's text; `options` before it, and "--" between them and its own arguments."""
        own = options.index("--") if "--" in options else len(options)
        words = [*options[:own], str(self.write(text)), *options[own:]]
        self._patch.setattr(sys, "argv", ["uavaccel", "fly", *words])
        self._patch.setenv("HOME", str(self.home))
        self._patch.chdir(ROOT)
        late = threading.Timer(PATIENCE_S, end_flights)
        late.start()
        kept = os.dup(0)
        (typed := self.path / "typed").write_text(answers)
        with typed.open() as file:
            os.dup2(file.fileno(), 0)
        try:
            with pytest.raises(SystemExit) as ended:
                main()
        finally:
            late.cancel()
            os.dup2(kept, 0)
            os.close(kept)
        assert isinstance(ended.value.code, int)
        return Flown(ended.value.code, *self._said.readouterr())
