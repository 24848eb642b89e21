"""Processes forked from one that has loaded what all of them need: modules and machine code are read once, not N times.

`Forks` is the parent's side: a program that it starts loads, calls `fork_each`, and reports how each fork ended. Linux
alone has what this needs (`CAN_FORK`).
"""

from __future__ import annotations

import gc
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from typing import NoReturn

from uavaccel.processes.lifetime import Process
from uavaccel.processes.stalls import is_stopped

CAN_FORK = sys.platform == "linux" and hasattr(os, "pidfd_open")
# A process with threads cannot be forked safely, and those of OpenBLAS begin when NumPy is imported.
WITHOUT_THREADS = {"OPENBLAS_NUM_THREADS": "1"}
REPORT_S = 3.0  # by when a fork's end has been reported


class Forks:
    """The `count` processes that `template` forks, which reports about them in the pipe `reports`."""

    def __init__(self, template: Process, count: int, reports: int) -> None:
        self.template = template
        self.pids = [template.pid] * count  # until they are known: whoever kills one too early kills all
        self.statuses: list[int | None] = [None] * count
        self._reports, self._unread = reports, b""

    def each(self) -> list[Fork]:
        return [Fork(self, number) for number in range(len(self.pids))]

    def read_reports(self, timeout_s: float | None = 0.0) -> bool:
        """Read what has been reported, waiting for it up to `timeout_s`; returns whether anything was."""
        if self._reports < 0 or not _is_readable(self._reports, timeout_s):
            return False
        content = os.read(self._reports, 1 << 16)
        *lines, self._unread = (self._unread + content).split(b"\n")
        for line in lines:
            report = json.loads(line)
            if "pids" in report:
                self.pids = report["pids"]
            else:
                self.statuses[report["number"]] = report["status"]
        if not content:
            self._end()
        return True

    def close(self) -> None:
        """Wait for the end of the template, which ends with the last fork."""
        while self._reports >= 0:
            self.expect_report()

    def expect_report(self) -> None:
        """Wait for a report that is due; end a template that does not send it, such as one that was stopped."""
        if is_stopped(self.template.pid) or not self.read_reports(REPORT_S):
            self.template.kill()
            self.read_reports(None)

    def status(self, number: int) -> int | None:
        """Return how a fork ended, as far as it has been reported; None while it runs."""
        if self._reports < 0 and self.statuses[number] is None and _ends_within(self.pids[number], 0.0):
            self.statuses[number] = self.template.wait()
        return self.statuses[number]

    def _end(self) -> None:
        """The template has ended: before its time if a fork's status is missing, which is then that of the template."""
        os.close(self._reports)
        self._reports = -1
        self.template.wait()


class Fork:
    """One of the processes of `Forks`, as subprocess.Popen has it."""

    def __init__(self, forks: Forks, number: int) -> None:
        self._forks, self._number = forks, number

    @property
    def pid(self) -> int:
        self._forks.read_reports()
        return self._forks.pids[self._number]

    def poll(self) -> int | None:
        """Return the status with which it ended, negative for a signal; None while it runs."""
        while self._forks.read_reports():
            pass
        return self._forks.status(self._number)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end and return the status. Raises subprocess.TimeoutExpired after `timeout` seconds."""
        pid = self.pid
        known = timeout is not None or pid != self._forks.template.pid
        if self.poll() is None and known and not _ends_within(pid, timeout):
            raise subprocess.TimeoutExpired("fork", timeout or 0.0)
        while (status := self.poll()) is None:
            self._forks.expect_report()
        return status

    def kill(self) -> None:
        self._send(signal.SIGKILL)

    def terminate(self) -> None:
        self._send(signal.SIGTERM)

    def _send(self, number: signal.Signals) -> None:
        if self.poll() is None:  # its id is its own until the template, which has not waited for it, ends
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)


def _ends_within(pid: int, seconds: float | None) -> bool:
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return _is_readable(descriptor, seconds)
    finally:
        os.close(descriptor)


def _is_readable(descriptor: int, timeout_s: float | None) -> bool:
    poll = select.poll()  # `select` takes no descriptor above 1 023
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(None if timeout_s is None else timeout_s * 1e3))


def fork_each(descriptors: Sequence[Collection[int]], reports: int, run: Callable[[int], None]) -> None:
    """Fork a process for each of `descriptors`, which calls `run` with its number and ends; return when all have ended.

    Each keeps its own file descriptors open and closes the others', as this process does with all: otherwise nobody
    would see the end of a pipe. Ids and ends of the forks are written to the pipe `reports`.
    """
    gc.freeze()  # the collector would write to every page that the forks share
    held = set().union(*descriptors)
    pids: list[int] = []
    for number, own in enumerate(descriptors):
        pid = os.fork()
        if pid == 0:
            _close(held - set(own) | {reports})
            _run(run, number)
        pids.append(pid)
    _close(held)
    _report(reports, pids=pids)
    running = {os.pidfd_open(pid): number for number, pid in enumerate(pids)}
    poll = select.poll()
    for descriptor in running:
        poll.register(descriptor, select.POLLIN)
    while running:
        for descriptor, _ in poll.poll():
            poll.unregister(descriptor)
            _report(reports, number=running.pop(descriptor), status=_status(descriptor))


def _close(descriptors: Iterable[int]) -> None:
    for descriptor in descriptors:
        os.close(descriptor)


def _run(run: Callable[[int], None], number: int) -> NoReturn:
    """Call `run` and end this process without what its template would do at its end."""
    status = 1
    try:
        run(number)
        status = 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _status(descriptor: int) -> int:
    """Return how a fork ended, as Popen.returncode says it, and leave it a zombie: nobody else shall get its id."""
    ended = os.waitid(os.P_PIDFD, descriptor, os.WEXITED | os.WNOWAIT)
    assert ended is not None
    return ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status


def _report(reports: int, **report: object) -> None:
    with suppress(BrokenPipeError):  # nobody listens any more
        os.write(reports, json.dumps(report).encode() + b"\n")
