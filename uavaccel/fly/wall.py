"""A flight in wall time: a server in its own process, and the script on the machine's clock.

Messages and trajectory are measured, and differ from flight to flight. The trajectory is the server's recording: a
script that starts or stops recordings itself cuts it short.
"""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from weakref import WeakSet

import numpy as np

from uavaccel.airsim.connection import SocketConnection, as_sent
from uavaccel.clock import MonotonicClock, counted_time_module
from uavaccel.errors import UserError
from uavaccel.fly.environment import script_environment
from uavaccel.fly.log import MessageLog, write_trajectory
from uavaccel.fly.options import FlightOptions, FlightSummary
from uavaccel.fly.script import FlightOver, ScriptResult, run_script
from uavaccel.processes.lifetime import Watch, end_within, start_python
from uavaccel.units import NS_PER_S
from uavaccel.wire.rpc import LOOPBACK, Future, Received
from uavaccel.wire.settings import Settings

RECORDINGS = "recordings"
ANSWER_S = 60.0
_END_S = 3
_SERVE = """from uavaccel.processes.lifetime import end_with_parent
end_with_parent({parent})
from uavaccel.cli.main import main
main()
"""


class LoggedConnection:
    """A connection over TCP that logs its messages with the wall time since `begun_ns`, when the flight began.

    A forked process, whose log is abandoned, opens a connection of its own. Calls raise FlightOver once the server has
    gone, or the flight is `over`.
    """

    def __init__(
        self, port: int, timeout_s: float, log: MessageLog, watch: Watch, over: threading.Event, begun_ns: int
    ) -> None:
        self._open = partial(SocketConnection, LOOPBACK, port, timeout_s)
        self._connection, self._pid = self._open(), os.getpid()
        self._log, self._clock, self._lock = log, MonotonicClock(), threading.Lock()
        self._watch, self._over, self._begun_ns = watch, over, begun_ns

    def call(self, method: str, *params: object) -> Received:
        return self.call_async(method, *params).get()

    def call_async(self, method: str, *params: object) -> Future:
        if os.getpid() != self._pid:
            self._connection, self._pid = self._open(), os.getpid()
        with self._lock:
            number = self._log.call(self._now_ns(), None, method, [as_sent(value) for value in params])
        with self._ending():
            sent = self._connection.call_async(method, *params)

        def arrive(sent: Future) -> None:
            with self._lock:
                if future.done:
                    return
                self._log.answer(number, self._now_ns(), sent.error, sent.result)
                future.answer(sent.error, sent.result, sent.late)
            future.tell()

        def wait(future: Future) -> None:
            with self._ending():
                sent.join()
            arrive(sent)  # which another thread may have read

        future = Future(method, wait)
        sent.attach_callback(arrive)
        return future

    @contextmanager
    def _ending(self) -> Iterator[None]:
        """End the flight if a call finds that it is over, or that the server has gone."""
        if self._watch.lost or self._over.is_set():
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
        return self._clock.now_ns() - self._begun_ns


class WallFlight:
    """Runs a script against a server: two processes on the machine's clock."""

    unflown_s = 0.0

    def __init__(self, options: FlightOptions, settings: Settings | None, clock_speed: float, log: MessageLog) -> None:
        self._options, self._clock_speed, self._log = options, clock_speed, log
        self._settings = None if settings is None else options.settings
        self._vehicle = (settings or Settings()).vehicle
        self._slept_s = 0.0
        self._over = threading.Event()
        self._watch: Watch | None = None
        self._stack = ExitStack()  # what is around the script

    def run(self) -> ScriptResult:
        """Run the script against a server, for `until_s` at most. Raises UserError."""
        options = self._options
        with self._stack as stack:
            port, watch = stack.enter_context(serving(options, self._clock_speed, self._settings))
            self._watch = watch
            recorder = SocketConnection(LOOPBACK, port, ANSWER_S)
            recorder.call("startRecording")

            begun_ns = MonotonicClock().now_ns()
            connections, held = WeakSet[LoggedConnection](), list[LoggedConnection]()

            def connect(host: str, port_of_airsim: int, timeout_s: float) -> LoggedConnection:
                made = LoggedConnection(port, timeout_s, self._log, watch, self._over, begun_ns)
                connections.add(made)
                return made

            clock = {"time": counted_time_module(self._slept)}
            stack.enter_context(script_environment(connect, clock, options, port, self._log.abandon))
            stack.enter_context(stopping_after(options.until_s, self._clock_speed, self._over))
            hold = partial(held.extend, connections)  # open for destructors, before which they would be collected
            return run_script(options.script, options.arguments, hold)

    def _slept(self, seconds: float) -> None:
        if self._over.is_set():
            raise FlightOver
        self._slept_s += seconds

    def end(self) -> None:
        """Write the trajectory that the server recorded. Raises UserError if the server has gone."""
        self._stack.close()  # it is open where the script did not let it end
        if self._watch is not None and self._watch.lost:
            raise UserError(f"{self._watch.lost}; the script ends too")
        self._time_ns, self._poses = recorded(self._options.folder, self._vehicle)
        poses = self._poses
        speeds = np.gradient(poses[:, :3], self._time_ns / NS_PER_S, axis=0) if len(poses) > 1 else poses[:, :3] * 0
        write_trajectory(self._options.folder, self._time_ns, np.hstack([poses, speeds]))

    def summary(self) -> FlightSummary:
        """Return the flight's durations and its last position: SI units, NED."""
        times = self._time_ns / NS_PER_S
        return {
            "simulated_s": float(times[-1] - times[0]) if len(times) else 0.0,
            "position_m": self._poses[-1, :3].tolist() if len(times) else None,
            "slept_s": self._slept_s,
            "think_s": 0.0,
        }


@contextmanager
def serving(
    options: FlightOptions, clock_speed: float, settings: Path | None, port: int = 0
) -> Iterator[tuple[int, Watch]]:
    """Run a server for one flight, at `port` or a free one; its port, and the watch on its process.

    FlightOver is raised in the main thread if the server ends, or is stopped, within the `with` block. Raises UserError
    if it does not start.
    """
    arguments = ["serve", "--port", str(port), "--clock", f"{clock_speed:g}"]
    arguments += ["--profile", options.profile, "--scene", options.scene]
    arguments += ["--recordings", str(options.folder / RECORDINGS)]
    if settings:
        arguments += ["--settings", str(settings)]
    program = _SERVE.format(parent=os.getpid())
    with start_python("-c", program, *arguments, stdout=subprocess.PIPE) as server:
        assert server.stdout is not None
        lines = io.TextIOWrapper(server.stdout)
        line = lines.readline()
        if (told := re.search(r"listening on .*:(\d+): scene", line)) is None:
            raise UserError(f"the server did not start: {line.strip() or 'see above'}")

        def print_warnings() -> None:
            for each in lines:
                if each.startswith(("warning", "  ", "stopped")):
                    print(f"uavaccel: {each.rstrip()}", file=sys.stderr, flush=True)

        printer = threading.Thread(target=print_warnings, daemon=True)
        printer.start()
        with _stopped_by(signal.SIGUSR1):
            first = threading.main_thread().ident or 0
            watch = Watch(server, "the server's process", lambda: signal.pthread_kill(first, signal.SIGUSR1))
            try:
                yield int(told[1]), watch
            finally:
                watch.end()
                server.send_signal(signal.SIGINT)
                end_within(server, _END_S)
                printer.join()


@contextmanager
def _stopped_by(number: int, act: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Let a signal call `act` and raise FlightOver in the main thread."""

    def stop(*_: object) -> None:
        act()
        raise FlightOver

    before = signal.signal(number, stop)
    try:
        yield
    finally:
        signal.signal(number, before)


def recorded(folder: Path, vehicle: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a vehicle's samples in the server's recordings, by their times: time_ns (n,) and pose (n, 7)."""
    rows = [
        line.split("\t")[1:9]
        for file in sorted((folder / RECORDINGS).rglob("airsim_rec.txt"))
        for line in file.read_text(encoding="utf-8").splitlines()[1:]
        if line.startswith(f"{vehicle}\t")
    ]
    table = np.array(rows, np.float64).reshape(-1, 8)
    return (table[:, 0] * 1e6).astype(np.int64), table[:, 1:]


@contextmanager
def stopping_after(simulated_s: float | None, clock_speed: float, over: threading.Event) -> Iterator[None]:
    """Raise FlightOver in the `with` block, and set `over`, once wall time times ClockSpeed reaches `simulated_s`."""
    if simulated_s is None:
        yield
        return
    with _stopped_by(signal.SIGALRM, over.set):
        signal.setitimer(signal.ITIMER_REAL, simulated_s / clock_speed)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
