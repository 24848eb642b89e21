"""What the benches count, not how fast anything is: pictures of the event camera, memory of processes."""

from __future__ import annotations

import subprocess
import sys
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from tests.opengl import needs_opengl
from uavaccel.bench import batch, speed
from uavaccel.bench.batch import BatchSize, proportional_mib
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
    asked: list[tuple[Any, ...]] = []
    measure = speed._speedup

    def measure_and_tell(session: Any, *how: Any) -> float:
        asked.append(how)
        return measure(session, *how)

    monkeypatch.setattr(speed, "_speedup", measure_and_tell)
    found = {each.name: each for each in speed.bench_tcsc()}
    both = [(command, t_move_s, t_move_s) for t_move_s in (1.0, 0.1) for command in ("tcsc", "adsc")]
    assert asked == [*both, ("tcsc", 1.0, 0.05)]
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


def test_a_lockstep_game_of_96_seconds_counts_as_96_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[float] = []
    monkeypatch.setattr(speed, "REPEATS", 1)
    monkeypatch.setattr(speed, "elapsed_s", lambda work: (work(), 2.0)[1])
    fly = speed._fly_square

    def fly_and_tell(client: Any, *how: Any) -> None:
        fly(client, *how)
        flown.append(client.speed()["simulated_ns"])

    monkeypatch.setattr(speed, "_fly_square", fly_and_tell)
    assert [each.value for each in speed.bench_virtual()] == [48.0, 48.0]
    assert flown == [96 * 10**9] * 2


def test_a_soak_calls_at_its_rate_and_holds_memory_against_that_after_a_tenth(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    memory = iter([90.0, 80.0, *range(50, 68)])
    slept: list[int] = []
    asked: list[int] = []
    server = SimpleNamespace(memory_mib=lambda: next(memory))
    client = SimpleNamespace(
        run=lambda: None, kinematics=lambda: asked.append(1), speed=lambda: {"real_time_factor": 99.0}
    )
    session = SimpleNamespace(server=server, start_game=lambda *_: client)
    monkeypatch.setattr(speed, "WallSession", lambda *_: nullcontext(session))
    monkeypatch.setattr(
        speed, "MonotonicClock", lambda: SimpleNamespace(now_ns=lambda: 7, sleep_until=slept.append)
    )
    achieved, held = speed.bench_soak(20.0, 5.0)
    assert (achieved.value, achieved.bound) == (99.0, 100.0)
    assert (held.value, held.bound) == (67, 50)  # the first two of twenty readings are of the start
    assert len(asked) == 100
    assert slept == [7 + 200_000_000 * number for number in range(100)]


def test_a_batch_is_counted_in_commands_and_in_pictures_of_all_lanes(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if each measurement took half a second."""
    made: list[Any] = []

    class Lanes:
        service, processes, tiles, process_ids = None, 2, 4, ()

        def __init__(self, kind: Any, lanes: int, *how: Any, **task: float) -> None:
            self.commands, self.told = 0, (lanes, task)
            made.append(self)

        def step_async(self, actions: Any) -> None:
            assert len(actions) == self.told[0]
            self.commands += 1

        def step_wait(self) -> None: ...
        def reset(self, seed: int) -> None: ...
        def close(self) -> None: ...

    class Pictures:
        renderer = SimpleNamespace(name="nobody")
        drawn = 0

        def __init__(self, model: Any, count: int) -> None: ...
        def render(self, *_: Any) -> None:
            Pictures.drawn += 1

        def read(self, first: int, count: int) -> Any:
            return nullcontext()

        def close(self) -> None: ...

    monkeypatch.setattr(batch, "EnvironmentBatch", Lanes)
    monkeypatch.setattr(batch, "Tiles", Pictures)
    monkeypatch.setattr(batch, "elapsed_s", lambda work: (work(), 0.5)[1])
    found = {each.name: each for each in batch.bench_batch(BatchSize((8,), tiles=4))}
    assert Pictures.drawn == 2 * 30 * 4  # to warm up, and measured
    pictures, over = found["8 lanes: pictures"], found["8 lanes: over the bare loop"]
    assert (pictures.value, pictures.bound) == (5 * 8 * 50 / 0.5, 30 * 4 / 0.5)
    assert over.value == pytest.approx((pictures.value) / (pictures.bound or 0.0))
    assert found["8 lanes: commands"].value == 30 * 8 / 0.5
    assert [each.commands for each in made] == [3 + 5, 3 + 30]


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
