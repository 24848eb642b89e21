"""What the benches count, not how fast anything is: pictures of the event camera, memory of processes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.opengl import needs_opengl
from uavaccel.bench.images import frames_seen
from uavaccel.bench.memory import proportional_mib
from uavaccel.envs.obstacle_lane import ObstacleLane


@needs_opengl
@pytest.mark.parametrize(("rate_hz", "pictures"), [(None, 3), (10.0, 12), (100.0, 100)])
def test_pictures_are_those_that_the_event_camera_sees(rate_hz: float | None, pictures: int) -> None:
    environment = ObstacleLane(dvs_rate_hz=rate_hz)
    environment.reset(seed=0)
    environment.step(2)
    assert frames_seen(environment) == pictures  # at 10 Hz two samples of the three fall between them
    environment.close()


HOLDS_64_MIB_TWICE = """
import os
held = b"x" * 2**26
child = os.fork()
if child:
    print(child, flush=True)
os.read(0, 1)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_memory_that_processes_share_counts_once() -> None:
    piped = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", HOLDS_64_MIB_TWICE], stdin=piped, stdout=piped) as parent:
        assert parent.stdout is not None
        processes = [parent.pid, int(parent.stdout.readline())]
        both, one = proportional_mib(processes), proportional_mib(processes[:1])
        parent.communicate()  # its end of input ends them
    assert both is not None
    assert one is not None
    assert 64 < both < 96
    assert 32 < one < 64
    assert proportional_mib([2**22 + 1]) is None  # no such process
