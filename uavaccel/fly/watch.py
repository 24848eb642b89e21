"""A process that another one waits for: whether it was stopped, and in what words it ended."""

from __future__ import annotations

import signal
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

Process = subprocess.Popen[bytes] | subprocess.Popen[str]
LOOK_S = 0.25
STOPPED_S = 4.0  # a process that has been stopped for so long is not gone on with


def is_stopped(pid: int) -> bool:
    """Whether a process was stopped, by SIGSTOP or a terminal; False where the system does not say."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"
    except OSError:
        return False


def ended_how(status: int) -> str:
    """In words, what ended a process, by its return code."""
    if status >= 0:
        return f"ended with status {status}"
    try:
        return f"was ended by {signal.Signals(-status).name}"
    except ValueError:
        return f"was ended by signal {-status}"


class Patience:
    """With a process that stands still, for STOPPED_S of looks every LOOK_S."""

    def __init__(self, process: Process) -> None:
        self._process, self._looks = process, 0

    def is_over(self) -> bool:
        """To be asked about once in LOOK_S."""
        self._looks = self._looks + 1 if is_stopped(self._process.pid) else 0
        return self._looks * LOOK_S > STOPPED_S


class Watch:
    """Says when a process has gone that should be there, or was stopped; ends that. `lost` says how, in words."""

    def __init__(
        self, process: subprocess.Popen[bytes] | subprocess.Popen[str], name: str, tell: Callable[[], None]
    ) -> None:
        self.lost = ""
        self._process, self._name, self._tell = process, name, tell
        self._over, self._found = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True, name="watch")
        self._thread.start()

    def is_lost_soon(self) -> bool:
        """Whether it has gone, or is found so after a moment."""
        return self._found.wait(4 * LOOK_S)

    def end(self) -> None:
        """Its end is expected from now on."""
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        patience = Patience(self._process)
        while not self._over.wait(LOOK_S):
            status = self._process.poll()
            if status is None and not patience.is_over():
                continue
            self._process.kill()
            self.lost = f"{self._name} {'was stopped' if status is None else ended_how(status)}"
            self._found.set()
            return self._tell()
        return None
