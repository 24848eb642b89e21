"""Processes that end with the one that started them, at whatever moment that was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from tests.processes import left_after

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


def test_a_process_whose_parent_is_killed_ends_and_heeds_no_ctrl_c() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, CHILD], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline().split()[0])
        os.kill(child, signal.SIGINT)
        assert left_after([child], 0.0) == {child}
        parent.kill()
    assert not left_after([child], 60.0)


def test_one_whose_parent_was_killed_before_it_could_look_ends_at_once() -> None:
    """It has another parent by then, which may live for ever."""
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    for started_by in (gone.pid, os.getppid()):
        command = [sys.executable, "-c", CHILD, str(started_by)]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=False, timeout=60)
        assert (done.returncode, done.stdout) == (-signal.SIGKILL, b"")
