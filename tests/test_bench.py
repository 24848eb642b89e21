"""What the benches count, not how fast anything is: pictures of the event camera, memory of processes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.opengl import needs_opengl
from uavaccel.bench import speed
from uavaccel.bench.batch import proportional_mib
from uavaccel.bench.images import frames_seen
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.wire.session import VirtualSession


@needs_opengl
@pytest.mark.parametrize(("rate_hz", "pictures"), [(None, 3), (10.0, 12), (100.0, 100)])
def test_pictures_are_those_that_the_event_camera_sees(rate_hz: float | None, pictures: int) -> None:
    environment = ObstacleLane(dvs_rate_hz=rate_hz)
    environment.reset(seed=0)
    environment.step(2)
    assert frames_seen(environment) == pictures  # at 10 Hz two samples of the three fall between them
    environment.close()


def test_the_hot_loop_is_held_against_bare_steps_in_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 000 ticks in 2, 4, 8 s and bare steps in half of that, as if the machine grew slower and slower."""
    took_s = iter([2.0, 1.0, 4.0, 2.0, 8.0, 4.0])
    monkeypatch.setattr(speed, "REPEATS", 3)
    monkeypatch.setattr(speed, "STEPS", 100)
    monkeypatch.setattr(speed, "elapsed_s", lambda work: (work(), next(took_s))[1])
    loop, ratio = speed.bench_hot_loop()
    assert (loop.value, loop.bound, ratio.value) == (25.0, 50.0, 0.5)
    assert not list(took_s)


def test_a_commands_speed_is_simulated_time_over_wall_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sixteen commands, as if they took a second together; and a round trip two of them."""
    monkeypatch.setattr(speed, "WallSession", VirtualSession)
    monkeypatch.setattr(speed, "REPEATS", 1)
    monkeypatch.setattr(speed, "PINGS", 1)
    monkeypatch.setattr(speed, "elapsed_s", lambda work: (work(), 1.0)[1])
    found = {each.name: each for each in speed.bench_tcsc()}
    assert found["round trip of a call"].value == 1e6
    for t_move_s in (1.0, 0.1):
        tcsc, over, adsc = (
            found[f"{name}, T_move {t_move_s:g} s"] for name in ("TCSC", "TCSC over its bound", "ADSC")
        )
        assert tcsc.value == adsc.value == pytest.approx(16 * t_move_s)
        calls = int(tcsc.note.split(" + ")[1].split(" calls")[0])
        assert calls == 2  # the command, and the continue-for, whose reply is the state
        assert tcsc.bound == pytest.approx(t_move_s / (t_move_s / 100 + calls))
        assert over.value == pytest.approx(tcsc.value / (tcsc.bound or 0.0))
        assert adsc.bound == 100.0


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
