"""What the benches count, not how fast anything is: pictures of the event camera, memory of processes."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

from tests.opengl import needs_opengl
from uavaccel.bench.images import LookingLane
from uavaccel.bench.memory import proportional_mib


@needs_opengl
@pytest.mark.parametrize(("rate_hz", "pictures"), [(None, 3), (10.0, 12), (100.0, 100)])
def test_pictures_are_those_that_the_event_camera_sees(rate_hz: float | None, pictures: int) -> None:
    environment = LookingLane(dvs_rate_hz=rate_hz)
    environment.reset(seed=0)
    environment.step(2)
    assert environment.pictures == pictures  # at 10 Hz two samples of the three fall between them
    environment.close()


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_memory_is_what_the_processes_hold() -> None:
    before = proportional_mib([os.getpid()])
    held = np.ones(400 * 2**20, np.uint8)
    after = proportional_mib([os.getpid()])
    assert before is not None
    assert after is not None
    assert 300 < after - before < 500  # other processes share this one's libraries, and come and go
    assert held.all()
    assert proportional_mib([2**22 + 1]) is None  # no such process
