"""Processes that stand still are told from those that work, or for which others work."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from tests.processes import descendants, state_of
from uavaccel.processes import lifetime
from uavaccel.processes.stalls import IDLE_POLLS, STOPPED_POLLS, StallDetector, cpu_time_s

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
WORKS, WAITS = "while True: pass", "import signal; print(flush=True); signal.pause()"
PARENT = f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {WORKS!r}]); print(flush=True); input()"

Start = Callable[[str], int]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts programs, and ends them."""
    with ExitStack() as stack:

        def started(program: str) -> int:
            process = subprocess.Popen(
                [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
            )
            stack.callback(process.communicate)
            stack.callback(os.killpg, process.pid, signal.SIGKILL)
            if program != WORKS:  # it is there, and does nothing any more
                assert process.stdout is not None
                process.stdout.readline()
                while state_of(process.pid) != "S":
                    pass
            return process.pid

        yield started


def work_a_little(pid: int) -> None:
    """Until the system has counted more of it."""
    before = cpu_time_s(pid)
    while cpu_time_s(pid) == before:
        pass


def test_one_that_waits_for_ever_stands_still_after_some_looks(start: Start) -> None:
    pid, stalls = start(WAITS), StallDetector()
    found = [stalls.poll([pid]) for _ in range(IDLE_POLLS + 1)]  # before the first, it may have worked
    assert found == [[]] * IDLE_POLLS + [[pid]]


def test_one_that_works_does_not_until_it_is_stopped(start: Start) -> None:
    pid, stalls = start(WORKS), StallDetector()
    for _ in range(2 * IDLE_POLLS):
        work_a_little(pid)
        assert stalls.poll([pid]) == []
    os.kill(pid, signal.SIGSTOP)
    while state_of(pid) != "T":
        pass
    found = [stalls.poll([pid]) for _ in range(STOPPED_POLLS)]
    assert found == [[]] * (STOPPED_POLLS - 1) + [[pid]]


def test_the_work_of_a_child_counts(start: Start) -> None:
    parent, stalls = start(PARENT), StallDetector()
    (child,) = descendants(parent)
    for _ in range(2 * IDLE_POLLS):
        work_a_little(child)
        assert stalls.poll([parent]) == []


def test_who_is_not_waited_for_any_more_begins_anew(start: Start) -> None:
    pid, stalls = start(WAITS), StallDetector()
    for _ in range(IDLE_POLLS):
        assert stalls.poll([pid]) == []
    assert stalls.poll([]) == []
    assert stalls.poll([pid]) == []


class Found:
    """A process that successive looks find so: "T" stopped, "S" not, or ended with a status."""

    def __init__(self, *found: str | int) -> None:
        self.pid, self.killed = 7, False
        self._found = list(found)

    def poll(self) -> int | None:
        return self._found[0] if isinstance(self._found[0], int) else None

    def is_stopped(self, pid: int) -> bool:
        assert pid == self.pid
        return self._found.pop(0) == "T"

    def kill(self) -> None:
        self.killed = True


@pytest.mark.parametrize(
    ("found", "over"),
    [("T" * 16, 0), ("T" * 17, 1), ("T" * 16 + "S" + "T" * 16, 0), ("T" * 3 + "S" + "T" * 17, 1), ("TS" * 20, 0)],
)
def test_patience_is_over_after_four_seconds_without_a_break(
    found: str, over: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Looks are a quarter of a second apart; whoever is stopped now and then is waited for."""
    process: Any = Found(*found)
    monkeypatch.setattr(lifetime, "is_stopped", process.is_stopped)
    patience = lifetime.Patience(process)
    answers = [patience.is_over() for _ in found]
    assert answers == [False] * (len(found) - over) + [True] * over


@pytest.mark.parametrize(
    ("found", "lost"),
    [
        (["S", "S", 3], "the server ended with status 3"),
        (["S", 0], "the server ended with status 0"),
        (["T", "S", -9], "the server was ended by SIGKILL"),
        (["S", *"T" * 17], "the server was stopped"),
    ],
)
def test_a_watch_kills_what_stays_stopped_and_tells_once(
    found: list[str | int], lost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    process: Any = Found(*found)
    told: list[str] = []
    monkeypatch.setattr(lifetime, "is_stopped", process.is_stopped)
    monkeypatch.setattr(lifetime, "POLL_S", 1 / 1024)
    monkeypatch.setattr(lifetime, "STOPPED_S", 16 / 1024)
    watch = lifetime.Watch(process, "the server", lambda: told.append("gone"))
    watch._thread.join()
    assert (watch.lost, told, process.killed) == (lost, ["gone"], True)
    assert watch.is_lost_soon()
