"""The process of a session's server, as the session sees it: started, looked after, ended whatever state it is in."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from uavaccel.clock import MonotonicClock
from uavaccel.standstill import cpu_time_s
from uavaccel.units import NS_PER_S

START_S, IDLE_START_S = 600.0, 60.0  # to compile the hot loop on a loaded machine; of that without any work
IDLE_S = 2.5  # silence of a server that does not compute: it is stopped, or waits for ever
BUSY_S = 60.0  # silence of one that computes: its first picture, drawn in software on a loaded machine
END_S = 3.0  # to end by itself
LOOK_NS = 1_000_000_000  # of silence, after which a server is asked whether it is there
STALL_NS = 100_000_000  # one that is there answers that sooner


class ServerGoneError(ConnectionError):
    """The server of a session has ended, or does not answer any more."""


class WatchedServer:
    """A process of uavaccel.wire.server_process, on `port`. Raises ServerGoneError if it does not get to listening."""

    def __init__(self, options: dict[str, object]) -> None:
        self._clock = MonotonicClock()
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "uavaccel.wire.server_process",
                json.dumps({**options, "parent": os.getpid()}),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={"LP_NUM_THREADS": "0", **os.environ},  # in software, it draws on its own core too
            start_new_session=True,  # Ctrl-C is for the client, which then ends the server
        )
        self.answered()
        try:
            self.port: int = json.loads(self._first_line())["port"]
        except BaseException:
            self.end()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.returncode

    def answered(self) -> None:
        """What it is asked next is a new question: its silence begins anew."""
        self._heard_ns = self._worked_ns = self._clock.now_ns()
        self._cpu_s = cpu_time_s(self._process.pid)

    def check(self, idle_s: float = IDLE_S, busy_s: float = BUSY_S) -> None:
        """Raise ServerGoneError if it has ended, or has been silent for `idle_s` without work, or `busy_s` with.

        To be asked about once a second while an answer is overdue.
        """
        status = self._process.poll()
        if status is not None:
            raise ServerGoneError(f"the server's process ended with status {status}")
        now_ns, cpu_s = self._clock.now_ns(), cpu_time_s(self._process.pid)
        if cpu_s != self._cpu_s:
            self._cpu_s, self._worked_ns = cpu_s, now_ns
        idle, silent = (now_ns - since for since in (self._worked_ns, self._heard_ns))
        if idle > idle_s * NS_PER_S or silent > busy_s * NS_PER_S:
            self._process.kill()  # it would not end by itself
            raise ServerGoneError(f"the server's process did not answer for {silent / NS_PER_S:.1f} s")

    def _first_line(self) -> bytes:
        stdout = self._process.stdout
        assert stdout is not None
        while not select.select([stdout], [], [], 1.0)[0]:
            self.check(IDLE_START_S, START_S)
        line = stdout.readline()
        if not line:
            raise ServerGoneError(
                f"the server's process ended with status {self._process.wait()} before it listened"
            )
        return line

    def memory_mib(self) -> float:
        """Resident memory (Linux)."""
        pages = int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def end(self) -> None:
        """It ends with its standard input; one that does not is killed, which a stopped one cannot escape."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._process.wait(timeout=END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Silence:
    """What a client makes of a server that says nothing: it may be busy flying, or gone.

    `ask` sends it a question and returns what says whether that was answered.
    """

    def __init__(self, server: WatchedServer, ask: Callable[[], Callable[[], bool]]) -> None:
        self._server, self._ask = server, ask
        self._clock = MonotonicClock()
        self._answered: Callable[[], bool] | None = None
        self._asked_ns = 0
        self._counted_ns = 0

    def goes_on(self) -> None:
        """To be called after every LOOK_NS of it: asks, then looks at the process. Raises ServerGoneError."""
        if self._answered is not None:
            self._server.check()
            return
        self._server.answered()
        self._answered, self._asked_ns = self._ask(), self._clock.now_ns()

    def broken_ns(self, due_ns: Sequence[int]) -> int:
        """To be called when something came: for how long the server had not answered; 0 if it only flew.

        `due_ns` are the instants at which the answers that came were due. No wall time is counted twice.
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
