"""A flight in wall time: a server in a process of its own, and the script with the machine's clock.

Messages and trajectory are measured, and never the same twice. The trajectory is the server's own recording: a script
that starts or stops recordings itself cuts it short.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uavaccel.airsim.connection import Connect, Future, SocketConnection
from uavaccel.clock import MonotonicClock, counted_time_module
from uavaccel.errors import UserError
from uavaccel.fly import shims
from uavaccel.fly.children import LOOPBACK, children_finding, forked_children
from uavaccel.fly.keys import key_modules
from uavaccel.fly.messages import MessageLog
from uavaccel.fly.modules import client_modules, importing
from uavaccel.fly.options import FlightOptions, FlightSummary
from uavaccel.fly.patches import Patches
from uavaccel.fly.script import FlightOver, Outcome, hide_frames_everywhere, run_script
from uavaccel.fly.sent import as_sent
from uavaccel.fly.trajectory import write_trajectory
from uavaccel.fly.watch import Watch
from uavaccel.units import NS_PER_S
from uavaccel.wire.rpc import Received
from uavaccel.wire.settings import Settings

RECORDINGS = "recordings"
ANSWER_S = 60.0
_END_S = 3
_SERVE = """from uavaccel.parent import end_with_parent
end_with_parent({parent})
from uavaccel.cli.main import main
main()
"""


class LoggedConnection:
    """A connection over TCP whose messages are logged with the wall time since the flight's start.

    In a process that was forked off it is another one, whose messages are not. Raises FlightOver once the server has
    gone.
    """

    def __init__(self, port: int, timeout_s: float, log: MessageLog, watch: Watch) -> None:
        self._open = partial(SocketConnection, LOOPBACK, port, timeout_s)
        self._connection, self._pid = self._open(), os.getpid()
        self._log, self._clock, self._lock = log, MonotonicClock(), threading.Lock()
        self._watch = watch
        self._start_ns = self._clock.now_ns()

    def call(self, method: str, *params: object) -> Received:
        future = self.call_async(method, *params)
        return future.get()

    def call_async(self, method: str, *params: object) -> Future:
        if os.getpid() != self._pid:
            self._connection, self._pid, self._log = self._open(), os.getpid(), _Unheard()
        with self._lock:
            number = self._log.call(self._now_ns(), None, method, [as_sent(value) for value in params])
        with self._ending():
            sent = self._connection.call_async(method, *params)

        def wait(future: Future) -> None:
            with self._ending():
                sent.join()
            with self._lock:
                self._log.answer(number, self._now_ns(), sent.error, sent.result)
            future.answer(sent.error, sent.result)

        return Future(method, wait)

    @contextmanager
    def _ending(self) -> Iterator[None]:
        """Let a call that finds the server gone end the flight."""
        if self._watch.lost:
            raise FlightOver
        try:
            yield
        except ConnectionError:
            if self._watch.is_lost_soon():
                raise FlightOver from None
            raise

    def close(self) -> None:
        self._connection.close()

    def _now_ns(self) -> int:
        return self._clock.now_ns() - self._start_ns


class _Unheard(MessageLog):
    """Of a process that was forked off."""

    def __init__(self) -> None:
        self.calls = 0

    def _write(self, row: Mapping[str, object]) -> None:
        pass


class WallFlight:
    """A script and a server, two processes on one clock."""

    def __init__(
        self, options: FlightOptions, settings: Settings | None, clock_speed: float, log: MessageLog
    ) -> None:
        self._options, self._clock_speed, self._log = options, clock_speed, log
        self._settings = None if settings is None else options.settings
        self._slept_s = 0.0

    def run(self) -> Outcome:
        """Run the script against a server, at most for `until_s`. Raises UserError."""
        options = self._options
        with serving(options, self._clock_speed, settings=self._settings) as served:
            recorder = SocketConnection(LOOPBACK, served.port, ANSWER_S)
            recorder.call("startRecording")

            def connect(host: str, port_of_airsim: int, timeout_s: float) -> LoggedConnection:
                return LoggedConnection(served.port, timeout_s, self._log, served.watch)

            with contextlib.ExitStack() as stack:
                self._prepare(stack, connect, served.port)
                stack.enter_context(stopping_after(options.until_s, self._clock_speed))
                outcome = run_script(options.script, options.arguments)
        if served.watch.lost:
            raise UserError(f"{served.watch.lost}; the script ends too")
        return outcome

    def _prepare(self, stack: contextlib.ExitStack, connect: Connect, port: int) -> None:
        """What the script, and what it starts, find until `stack` is left."""
        patches = stack.enter_context(Patches())
        clock = counted_time_module(self._slept)
        sleep, now_s = (getattr(clock, name) for name in ("sleep", "monotonic"))
        shims.supply(patches, sleep)
        hide_frames_everywhere(patches)
        patches.when_imported(
            "uavaccel.airsim.connection", lambda module: patches.set(module, "_connect", connect)
        )
        modules = client_modules() | shims.old_modules()
        stack.enter_context(importing(modules, {"time": clock}))
        stack.enter_context(key_modules(sleep, now_s))
        stack.enter_context(children_finding(self._options.scratch, port))
        stack.enter_context(forked_children(self._log.abandon))

    def _slept(self, seconds: float) -> None:
        self._slept_s += seconds

    def end(self) -> None:
        """Write what the server recorded."""
        self._time_ns, poses = recorded(self._options.folder)
        self._poses = poses
        speeds = (
            np.gradient(poses[:, :3], self._time_ns / NS_PER_S, axis=0)
            if len(poses) > 1
            else poses[:, :3] * 0
        )
        write_trajectory(self._options.folder, self._time_ns, np.hstack([poses, speeds]))

    def summary(self) -> FlightSummary:
        """How long, and where to: SI units, NED."""
        times = self._time_ns / NS_PER_S
        return {
            "simulated_s": float(times[-1] - times[0]) if len(times) else 0.0,
            "position_m": self._poses[-1, :3].tolist() if len(times) else None,
            "slept_s": self._slept_s,
            "think_s": 0.0,
        }


class Served(NamedTuple):
    """A server: where it listens, and who looks after it."""

    port: int
    watch: Watch


@contextmanager
def serving(
    options: FlightOptions, clock_speed: float, port: int = 0, settings: Path | None = None
) -> Iterator[Served]:
    """A server for one flight, on `port` or a free one. Raises UserError if it does not start.

    Where it ends, or is stopped, before the `with` block does, that raises FlightOver in the first thread.
    """
    arguments = ["serve", "--port", str(port), "--clock", f"{clock_speed:g}"]
    arguments += ["--profile", options.profile, "--scene", options.scene]
    arguments += ["--recordings", str(options.folder / RECORDINGS)]
    if settings:
        arguments += ["--settings", str(settings)]
    program = _SERVE.format(parent=os.getpid())
    command = [sys.executable, "-c", program, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as server:
        assert server.stdout is not None
        line = server.stdout.readline()
        if "listening on" not in line:
            raise UserError(f"the server did not start: {line.strip() or 'see above'}")
        teller = threading.Thread(target=_tell_warnings, args=(server.stdout,), daemon=True)
        teller.start()
        with _interrupted_by(signal.SIGUSR1) as interrupt:
            watch = Watch(server, "the server's process", interrupt)
            try:
                yield Served(
                    int(line.partition("listening on ")[2].partition(": scene")[0].rpartition(":")[2]), watch
                )
            finally:
                watch.end()
                _end(server)
                teller.join()


def _end(server: subprocess.Popen[str]) -> None:
    server.send_signal(signal.SIGINT)
    try:
        server.wait(_END_S)
    except subprocess.TimeoutExpired:
        server.kill()


@contextmanager
def _interrupted_by(number: int) -> Iterator[Callable[[], None]]:
    """What other threads call to raise FlightOver in the first one."""
    first = threading.main_thread().ident or 0
    before = signal.signal(number, _stop)
    try:
        yield lambda: signal.pthread_kill(first, number)
    finally:
        signal.signal(number, before)


def _stop(*_: object) -> None:
    raise FlightOver


def _tell_warnings(lines: Iterator[str]) -> None:
    for line in lines:
        if line.startswith(("warning", "  ", "stopped")):
            print(f"uavaccel: {line.rstrip()}", file=sys.stderr, flush=True)


def recorded(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """time_ns (n,) and pose (n, 7) of the server's recordings, in the order of their times."""
    rows = [
        line.split("\t")[1:9]
        for file in sorted((folder / RECORDINGS).rglob("airsim_rec.txt"))
        for line in file.read_text(encoding="utf-8").splitlines()[1:]
    ]
    table = np.array(rows, np.float64).reshape(-1, 8)
    return (table[:, 0] * 1e6).astype(np.int64), table[:, 1:]


@contextmanager
def stopping_after(simulated_s: float | None, clock_speed: float) -> Iterator[None]:
    """Raise FlightOver in the `with` block after so much wall time times ClockSpeed."""
    if simulated_s is None:
        yield
        return
    before = signal.signal(signal.SIGALRM, _stop)
    signal.setitimer(signal.ITIMER_REAL, simulated_s / clock_speed)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
