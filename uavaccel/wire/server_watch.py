"""The server process as its session sees it: starts it, watches whether it responds, and ends it in any state."""

from __future__ import annotations

import json
import os
import select
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

from uavaccel.clock import MonotonicClock
from uavaccel.processes.lifetime import end_within, single_core_rendering, start_python
from uavaccel.processes.stalls import STOPPED_POLLS, cpu_time_s, is_stopped
from uavaccel.units import NS_PER_S

START_S, IDLE_START_S = 600.0, 60.0  # to compile the hot loop; of that without using any CPU
IDLE_S = 2.5  # a server that is silent for longer and uses no CPU has been stopped, or waits for ever
BUSY_S = 60.0  # longest silence of a busy server: its first picture, drawn in software on a loaded machine
END_S = 3.0
SILENCE_POLL_NS = 1_000_000_000  # silence after which the server is pinged
STALL_NS = 100_000_000  # a responsive server answers a ping sooner


class ServerGoneError(ConnectionError):
    """The server of a session has ended, or has stopped responding."""


class WatchedServer:
    """A process of uavaccel.wire.server_process, listening on `port`. Raises ServerGoneError if it never listens."""

    def __init__(self, options: dict[str, object]) -> None:
        self._clock = MonotonicClock()
        self._process = start_python(
            *("-m", "uavaccel.wire.server_process", json.dumps({**options, "parent": os.getpid()})),
            environment=single_core_rendering(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self.answered()
        try:
            self.port: int = json.loads(self._first_line())["port"]
        except BaseException:
            self._process.kill()  # it does not heed the end of its standard input before it listens
            self.end()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.returncode

    def answered(self) -> None:
        """Count its silence from now on."""
        self._stopped_looks = 0
        self._heard_ns = self._worked_ns = self._clock.now_ns()
        self._cpu_s = cpu_time_s(self._process.pid)

    def check(self, idle_s: float = IDLE_S, busy_s: float = BUSY_S) -> None:
        """Raise ServerGoneError if it has ended, or has been silent for `busy_s`, or for `idle_s` without using CPU.

        So it does, whatever these are, for one that a signal has stopped at more than STOPPED_POLLS calls in a row. To
        be called about once a second while an answer is overdue.
        """
        status = self._process.poll()
        if status is not None:
            raise ServerGoneError(f"the server's process ended with status {status}")
        now_ns, cpu_s = self._clock.now_ns(), cpu_time_s(self._process.pid)
        if cpu_s != self._cpu_s:
            self._cpu_s, self._worked_ns = cpu_s, now_ns
        self._stopped_looks = self._stopped_looks + 1 if is_stopped(self._process.pid) else 0
        idle, silent = (now_ns - since for since in (self._worked_ns, self._heard_ns))
        stopped = self._stopped_looks > STOPPED_POLLS
        if stopped or idle > idle_s * NS_PER_S or silent > busy_s * NS_PER_S:
            self._process.kill()  # it would not end by itself
            raise ServerGoneError(f"the server's process did not answer for {silent / NS_PER_S:.1f} s")

    def _first_line(self) -> bytes:
        stdout = self._process.stdout
        assert stdout is not None
        while not select.select([stdout], [], [], 1.0)[0]:
            self.check(IDLE_START_S, START_S)
        line = stdout.readline()
        if not line:
            raise ServerGoneError(f"the server's process ended with status {self._process.wait()} before it listened")
        return line

    def memory_mib(self) -> float:
        """Return the process's resident memory (Linux only)."""
        pages = int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def end(self) -> None:
        """End it by closing its standard input, or by force."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        end_within(self._process, END_S)


class ServerSilence:
    """Decides whether a silent server is busy flying or gone.

    `ask` sends it a ping, and returns a function that says whether that has been answered.
    """

    def __init__(self, server: WatchedServer, ask: Callable[[], Callable[[], bool]]) -> None:
        self._server, self._ask = server, ask
        self._clock = MonotonicClock()
        self._answered: Callable[[], bool] | None = None
        self._asked_ns = 0
        self._counted_ns = 0

    def goes_on(self) -> None:
        """Call after every SILENCE_POLL_NS of silence: pings, then checks the process. Raises ServerGoneError."""
        if self._answered is not None:
            self._server.check()
            return
        self._server.answered()
        self._answered, self._asked_ns = self._ask(), self._clock.now_ns()

    def broken_ns(self, due_ns: Sequence[int]) -> int:
        """To be called when answers arrive: for how long the server had not responded, 0 if it only flew.

        `due_ns` are the times at which these answers were due. No wall time is counted twice.
        """
        since = list(due_ns)
        if self._answered is not None and self._answered():
            self._answered = None
            since.append(self._asked_ns)
        if not since:
            return 0
        now_ns = self._clock.now_ns()
        silent_ns = now_ns - max(min(since), self._counted_ns)
        if silent_ns <= STALL_NS:
            return 0
        self._counted_ns = now_ns
        return silent_ns
