"""Processes that stand still are told from those that work, or for which others work."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from tests.processes import descendants, state_of
from uavaccel.processes.stalls import LOOKS, STOPPED_LOOKS, StallDetector, cpu_time_s

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
WORKS, WAITS = "while True: pass", "import signal; print(flush=True); signal.pause()"
PARENT = (
    f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {WORKS!r}]); print(flush=True); input()"
)

Start = Callable[[str], int]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts programs, and ends them."""
    with ExitStack() as stack:

        def started(program: str) -> int:
            process = subprocess.Popen(
                [sys.executable, "-c", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
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
    found = [stalls.look([pid]) for _ in range(LOOKS + 1)]  # before the first, it may have worked
    assert found == [[]] * LOOKS + [[pid]]


def test_one_that_works_does_not_until_it_is_stopped(start: Start) -> None:
    pid, stalls = start(WORKS), StallDetector()
    for _ in range(2 * LOOKS):
        work_a_little(pid)
        assert stalls.look([pid]) == []
    os.kill(pid, signal.SIGSTOP)
    while state_of(pid) != "T":
        pass
    found = [stalls.look([pid]) for _ in range(STOPPED_LOOKS)]
    assert found == [[]] * (STOPPED_LOOKS - 1) + [[pid]]


def test_the_work_of_a_helper_and_of_a_child_counts(start: Start) -> None:
    waiting, helper, stalls = start(WAITS), start(WORKS), StallDetector()
    for _ in range(2 * LOOKS):
        work_a_little(helper)
        assert stalls.look([waiting], helper) == []
    assert stalls.look([waiting], start(WAITS), looks=3) == []
    parent = start(PARENT)
    (child,) = descendants(parent)
    for _ in range(2 * LOOKS):
        work_a_little(child)
        assert stalls.look([parent]) == []


def test_who_is_not_waited_for_any_more_begins_anew(start: Start) -> None:
    pid, stalls = start(WAITS), StallDetector()
    for _ in range(LOOKS):
        assert stalls.look([pid]) == []
    assert stalls.look([]) == []
    assert stalls.look([pid]) == []
