"""Processes that end with the one that started them, at whatever moment that was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from tests.processes import left_after, state_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing happens")

CHILD = """
import signal, sys
from uavaccel.processes.lifetime import work_for_parent
work_for_parent(int(sys.argv[1]))
work_for_parent(int(sys.argv[1]))
print("bound", flush=True)
signal.pause()
"""
PARENT = """
import os, signal, subprocess, sys
child = subprocess.Popen([sys.executable, "-c", sys.argv[1], str(os.getpid())], stdout=subprocess.PIPE)
print(child.pid, child.stdout.readline().decode(), flush=True)
signal.pause()
"""


def test_a_process_whose_parent_is_killed_ends() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, CHILD], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline().split()[0])
        os.kill(child, signal.SIGINT)
        assert left_after([child], 0.0) == {child}
        parent.kill()
    assert not left_after([child], 60.0)


def test_one_whose_parent_was_killed_before_ends_at_once() -> None:
    """It has another parent by then, which may live for ever."""
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    for started_by in (gone.pid, os.getppid()):
        command = [sys.executable, "-c", CHILD, str(started_by)]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=False, timeout=60)
        assert (done.returncode, done.stdout) == (-signal.SIGKILL, b"")


GUARDED = """
import signal, subprocess, sys, threading
from uavaccel.processes import stalls
stalls.POLL_S = 1 / 64
if sys.argv[1] == "waits":
    stalls.GUARD_POLLS = 1 << 30
stopped = subprocess.Popen([sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)"])
stalls.guard_children(lambda line: print(line, flush=True))
stalls.guard_children(lambda line: print("twice", flush=True))
print(stopped.pid, flush=True)
if sys.argv[1] != "ends":
    stopped.wait()
else:
    while not stalls.is_stopped(stopped.pid):
        pass
"""


@pytest.mark.wall_clock
@pytest.mark.parametrize("how", ["looks", "waits", "ends"])
def test_a_stopped_child_is_ended_after_some_looks(how: str) -> None:
    """Only the first is worth a line: otherwise the command ends as well."""
    command = [sys.executable, "-c", GUARDED, how]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as program:
        assert program.stdout is not None
        child = int(program.stdout.readline())
        if how == "waits":
            while state_of(child) != "T":
                pass
            program.send_signal(signal.SIGINT)
        said = program.stdout.read()
    assert not left_after([child], 60.0)
    assert program.returncode == (-signal.SIGINT if how == "waits" else 0)
    if how == "looks":
        assert said.startswith(f"process {child} (")
        assert said.endswith(") was stopped, and was ended since it did not go on\n")
    assert said.count("\n") == (how == "looks")
