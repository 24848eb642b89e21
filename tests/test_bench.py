"""What the benchmarks count and hold against what, of times that are given here; not how fast anything is."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import benchmarks.__main__ as bench
from benchmarks import batch, images, speed
from benchmarks.speed import Measurement
from tests.opengl import needs_opengl
from tests.running import typed
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError
from uavaccel.wire.session import VirtualSession

Found = dict[str, Measurement]


def by_name(measured: Iterator[Measurement]) -> Found:
    return {each.name: each for each in measured}


def numbers(each: Measurement) -> tuple[float, float | None]:
    return each.value, each.bound


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Sets names of a module; `took_s` are the seconds that its measurements seem to take, one after the other."""

    def give(module: ModuleType, *took_s: float, **values: Any) -> None:
        if took_s:
            seconds = iter(took_s * 10)
            values["elapsed_s"] = lambda work: (work(), next(seconds))[1]
        for name, value in values.items():
            monkeypatch.setattr(module, name, value)

    return give


# --- the command ------------------------------------------------------------------------------------------------------


def test_benches_run_in_order_and_one_that_cannot_is_left_out(given: Callable[..., None], tmp_path: Path) -> None:
    ran: list[Any] = []

    def measured(name: str, *how: Any) -> Iterator[Measurement]:
        ran.append((name, *how))
        if name == "broken":
            raise UserError("no card")
        yield Measurement(name, 1234.5, "per s", None if how else 2000.0, "noted")

    def told(line: str) -> list[str]:
        return [" ".join(words.split()) for words in typed(line).splitlines()[1:]]

    known = {"first": lambda: measured("first"), "broken": lambda: measured("broken"), "batch": None}
    given(bench, BENCHES=known, check_machine=lambda: {"verdict": "noisy"})
    given(batch, bench_batch=lambda *size: measured("batch", *size))
    given(speed, bench_soak=lambda seconds: measured("soak", seconds))
    out, line = tmp_path / "bench.json", "first 1,234.50 per s of 2,000.00 noted"
    options = f"--out {out} --lanes 4 --lanes 16 --processes 2"
    assert told(f"bench batch first {options}")[-1] == line
    assert ran == [("batch", [4, 16], 2), ("first",)]
    kept = json.loads(out.read_text())
    assert [each["name"] for each in kept["measurements"]] == ["batch", "first"]
    expected = {"name": "first", "value": 1234.5, "unit": "per s", "bound": 2000.0, "note": "noted"}
    assert kept["measurements"][1] == expected
    assert kept["manifest"]["host_check"] == {"verdict": "noisy"}
    assert kept["manifest"]["command_line"] == ["bench", "batch", "first"]
    assert "--soak-s" in typed("bench --help"), "of the benchmarks, not of the command that calls them"
    ran.clear()
    both = ["batch 1,234.50 per s noted", "soak 1,234.50 per s noted"]
    assert told("bench --soak-s 2.5") == [line, "left out: no card", *both]
    assert ran == [("first",), ("broken",), ("batch", [8], None), ("soak", 2.5)]


# --- flight -----------------------------------------------------------------------------------------------------------


def test_the_hot_loop_is_held_against_bare_steps_in_turns(given: Callable[..., None]) -> None:
    """As if the machine grew slower and slower, and bare steps took half the time."""
    given(speed, 2.0, 1.0, 4.0, 2.0, 8.0, 4.0, REPEATS=3, STEPS=100)
    loop, ratio = speed.bench_hot_loop()
    assert (*numbers(loop), ratio.value) == (25.0, 50.0, 0.5)


def test_a_commands_speed_is_simulated_time_over_wall_time(given: Callable[..., None]) -> None:
    """Sixteen commands, as if they took a second together, and so did a round trip; a lockstep game of 96 s too."""
    asked: list[tuple[Any, ...]] = []
    flown: list[float] = []
    measure, fly = speed._speedup, speed._fly_square

    def fly_and_tell(client: Any, *how: Any) -> None:
        fly(client, *how)
        flown.append(client.speed()["simulated_ns"])

    given(speed, 1.0, WallSession=VirtualSession, REPEATS=1, PINGS=1, _fly_square=fly_and_tell)

    def measure_and_tell(session: Any, *how: Any) -> float:
        asked.append(how)
        return measure(session, *how)

    given(speed, _speedup=measure_and_tell)
    found = by_name(speed.bench_tcsc())
    both = [(command, t_move_s, t_move_s) for t_move_s in (1.0, 0.1) for command in ("tcsc", "adsc")]
    assert asked == [*both, ("tcsc", 1.0, 0.05)]
    assert found["round trip of a call"].value == 1e6
    for t_move_s in (1.0, 0.1):
        names = (f"{name}, T_move {t_move_s:g} s" for name in ("TCSC", "TCSC over its bound", "ADSC"))
        tcsc, over, adsc = (found[name] for name in names)
        bound = t_move_s / (t_move_s / 100 + 2)  # calls: the command, and the continue-for, whose reply is the state
        assert "2 calls" in tcsc.note
        assert numbers(tcsc) == pytest.approx((16 * t_move_s, bound))
        assert over.value == pytest.approx(16 * t_move_s / bound)
        assert numbers(adsc) == pytest.approx((16 * t_move_s, 100.0))
    flown.clear()
    assert [each.value for each in speed.bench_virtual()] == [96.0, 96.0]
    assert flown == [96 * 10**9] * 2


def test_a_soak_calls_at_its_rate_and_watches_memory(given: Callable[..., None]) -> None:
    memory = iter([90.0, 80.0, *range(50, 68)])  # the first two of twenty readings are of the start
    slept: list[int] = []
    asked: list[int] = []
    client = SimpleNamespace(
        run=lambda: None, kinematics=lambda: asked.append(1), speed=lambda: {"real_time_factor": 99.0}
    )
    server = SimpleNamespace(pid=7)
    session = nullcontext(SimpleNamespace(server=server, start_game=lambda *_: client))
    clock = SimpleNamespace(now_ns=lambda: 7, sleep_until=slept.append)
    given(speed, WallSession=lambda *_: session, MonotonicClock=lambda: clock, resident_mib=lambda _: next(memory))
    assert [numbers(each) for each in speed.bench_soak(20.0, 5.0)] == [(99.0, 100.0), (67, 50)]
    assert len(asked) == 100
    assert slept == [7 + 200_000_000 * number for number in range(100)]


# --- batches ----------------------------------------------------------------------------------------------------------


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
        both, one = batch.proportional_mib(processes), batch.proportional_mib(processes[:1])
        parent.communicate()  # its end of input ends them
    assert 64 < (both or 0) < 96
    assert 32 < (one or 0) < 64
    assert batch.proportional_mib([2**22 + 1]) is None  # no such process


@needs_opengl
@pytest.mark.parametrize(("rate_hz", "pictures"), [(None, 3), (10.0, 12), (100.0, 100)])
def test_pictures_are_those_that_the_event_camera_sees(rate_hz: float | None, pictures: int) -> None:
    environment = ObstacleLane(dvs_rate_hz=rate_hz)
    environment.reset(seed=0)
    environment.step(2)
    assert images.count_frames(environment) == pictures  # at 10 Hz two samples of the three fall between them
    environment.close()
