"""A flight in wall time: a server in a process of its own, and the script with the machine's clock.

Messages and trajectory are measured, and never the same twice. The trajectory is the server's own recording: a script
that starts or stops recordings itself cuts it short.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from uavaccel.airsim.connection import Future, SocketConnection, connect_with
from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.fly import shims
from uavaccel.fly.messages import MessageLog
from uavaccel.fly.modules import client_modules, importing
from uavaccel.fly.old_gym import gym_modules
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.script import Enough, Outcome, run_script
from uavaccel.fly.sent import as_sent
from uavaccel.fly.trajectory import write_trajectory
from uavaccel.units import NS_PER_S
from uavaccel.wire.settings import Settings

RECORDINGS = "recordings"
LOOPBACK = "127.0.0.1"
ANSWER_S = 60.0
_END_S = 20


class LoggedConnection:
    """A connection over TCP whose messages are logged with the wall time since the flight's start."""

    def __init__(self, port: int, timeout_s: float, log: MessageLog) -> None:
        self._connection = SocketConnection(LOOPBACK, port, timeout_s)
        self._log, self._clock, self._lock = log, MonotonicClock(), threading.Lock()
        self._start_ns = self._clock.now_ns()

    def call(self, method: str, *params: Any) -> Any:
        future = self.call_async(method, *params)
        return future.get()

    def call_async(self, method: str, *params: Any) -> Future:
        with self._lock:
            number = self._log.call(self._now_ns(), None, method, as_sent(params))
        sent = self._connection.call_async(method, *params)

        def wait(future: Future) -> None:
            sent.join()
            with self._lock:
                self._log.answer(number, self._now_ns(), sent.error, sent.result)
            future.answer(sent.error, sent.result)

        return Future(method, wait)

    def close(self) -> None:
        self._connection.close()

    def _now_ns(self) -> int:
        return self._clock.now_ns() - self._start_ns


class WallFlight:
    """A script and a server, two processes on one clock."""

    def __init__(
        self, options: FlightOptions, settings: Settings, clock_speed: float, log: MessageLog
    ) -> None:
        self._options, self._clock_speed, self._log = options, clock_speed, log

    def run(self) -> Outcome:
        """Run the script against a server, at most for `until_s`. Raises UserError."""
        options = self._options
        clock = MonotonicClock()
        shims.supply(lambda seconds: clock.sleep_until(clock.now_ns() + round(seconds * NS_PER_S)))
        with serving(options, self._clock_speed) as port:
            recorder = SocketConnection(LOOPBACK, port, ANSWER_S)
            recorder.call("startRecording")

            def connect(host: str, port_of_airsim: int, timeout_s: float) -> LoggedConnection:
                return LoggedConnection(port, timeout_s, self._log)

            with (
                connect_with(connect),
                importing(client_modules() | gym_modules() | shims.old_modules(), {}),
                stopping_after(options.until_s, self._clock_speed),
            ):
                return run_script(options.script, options.arguments)

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

    def summary(self) -> dict[str, Any]:
        """How long, and where to: SI units, NED."""
        times = self._time_ns / NS_PER_S
        return {
            "simulated_s": float(times[-1] - times[0]) if len(times) else 0.0,
            "position_m": self._poses[-1, :3].tolist() if len(times) else None,
        }


@contextmanager
def serving(options: FlightOptions, clock_speed: float, port: int = 0) -> Iterator[int]:
    """A server for one flight; gives its port, `port` or a free one. Raises UserError if it does not start."""
    command = [sys.executable, "-m", "uavaccel", "serve", "--port", str(port), "--clock", f"{clock_speed:g}"]
    command += ["--profile", options.profile, "--scene", options.scene]
    command += ["--recordings", str(options.folder / RECORDINGS)]
    if options.settings:
        command += ["--settings", str(options.settings)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as server:
        assert server.stdout is not None
        line = server.stdout.readline()
        if "listening on" not in line:
            raise UserError(f"the server did not start: {line.strip() or 'see above'}")
        teller = threading.Thread(target=_tell_warnings, args=(server.stdout,), daemon=True)
        teller.start()
        try:
            yield int(line.partition("listening on ")[2].partition(": scene")[0].rpartition(":")[2])
        finally:
            server.send_signal(signal.SIGINT)
            try:
                server.wait(_END_S)
            except subprocess.TimeoutExpired:
                server.kill()
            teller.join()


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
    """Raise Enough in the `with` block after so much wall time times ClockSpeed."""

    def stop(*_: Any) -> None:
        raise Enough

    if simulated_s is None:
        yield
        return
    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, simulated_s / clock_speed)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
