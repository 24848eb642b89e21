"""Benchmarks of flight and commands on this machine, each measurement beside its bound.

All numbers are measured on the machine's clock; the two sides of a ratio are measured alternately, in the same run.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import NamedTuple

import mujoco
import numpy as np

from uavaccel.calibration.calibrate import TracingTransport
from uavaccel.clock import MonotonicClock
from uavaccel.commands import COMMANDS, VelocityGoal, velocities
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S
from uavaccel.wire.session import Client, Session, VirtualSession, WallSession

STEPS = 100_000
REPEATS = 5
PINGS = 2_000
CLOCK_SPEED = 100.0
ROUNDS = 4


class Measurement(NamedTuple):
    """A measured number; `bound` is the number that it is compared with, in the same unit."""

    name: str
    value: float
    unit: str
    bound: float | None = None
    note: str = ""


def elapsed_s(work: Callable[[], object]) -> float:
    """Return the wall time of one call."""
    clock = MonotonicClock()
    start_ns = clock.now_ns()
    work()
    return (clock.now_ns() - start_ns) / NS_PER_S


def bench_hot_loop() -> Iterator[Measurement]:
    """Measure autopilot, rotors, drag and physics against bare `mj_step` on the same model, on one core."""
    world = World("blocks", NATIVE)
    world.advance(STEPS)
    ours, bare = [], []
    for _ in range(REPEATS):
        world.reset()
        ours.append(STEPS / elapsed_s(lambda: world.advance(STEPS)))
        world.reset()
        bare.append(STEPS / elapsed_s(lambda: mujoco.mj_step(world.model, world.data, nstep=STEPS)))
    ratio = median(a / b for a, b in zip(ours, bare, strict=True))
    note = "bound: mj_step(nstep=100_000), same model"
    yield Measurement("hot loop", median(ours), "steps/s", median(bare), note)
    note = "median of the ratios of neighbouring runs; aim 0.75"
    yield Measurement("hot loop over mj_step", ratio, "", note=note)


def bench_tcsc() -> Iterator[Measurement]:
    """Measure round trips, and TCSC and ADSC on this machine's clock at ClockSpeed 100."""
    with WallSession("blocks", "native") as session:
        client = session.start_game(1.0, np.random.SeedSequence(0))
        round_trip_s = median(elapsed_s(lambda: client.call("ping")) for _ in range(PINGS))
        yield Measurement("round trip of a call", round_trip_s * 1e6, "us", note=f"median of {PINGS} pings")
        for t_move_s in (1.0, 0.1):
            calls = _calls_per_command(session, t_move_s)
            bound = t_move_s / (t_move_s / CLOCK_SPEED + calls * round_trip_s)
            speed = median(_speedup(session, "tcsc", t_move_s, t_move_s) for _ in range(REPEATS))
            note = f"{ROUNDS} rounds; bound: T/(T/k + {calls:g} calls x round trip)"
            yield Measurement(f"TCSC, T_move {t_move_s:g} s", speed, "x", bound, note)
            name = f"TCSC over its bound, T_move {t_move_s:g} s"
            yield Measurement(name, speed / bound, "", note="aim 0.95")
            adsc = median(_speedup(session, "adsc", t_move_s, t_move_s) for _ in range(REPEATS))
            yield Measurement(f"ADSC, T_move {t_move_s:g} s", adsc, "x", CLOCK_SPEED)
        sampled = median(_speedup(session, "tcsc", 1.0, 0.05) for _ in range(REPEATS))
        note = "the client samples, not the recorder"
        yield Measurement("TCSC, T_move 1 s, T_sample .05 s", sampled, "x", note=note)


def _calls_per_command(session: Session, t_move_s: float) -> float:
    """Return the number of messages that the client sends for a TCSC."""
    client = session.start_game(CLOCK_SPEED, np.random.SeedSequence(0))
    tracing = TracingTransport(client.transport)
    counted = Client(tracing, CLOCK_SPEED)
    commands = 10
    for _ in range(commands):
        for _ in COMMANDS["tcsc"].fly(counted, VelocityGoal((0.0, 0.0, 0.0)), t_move_s, t_move_s):
            pass
    return round(sum(event.kind == "call" for event in tracing.events) / commands)


def _speedup(session: Session, command_name: str, t_move_s: float, t_sample_s: float) -> float:
    """Return the simulated seconds of a square's commands over the wall time that they take."""
    client = session.start_game(CLOCK_SPEED, np.random.SeedSequence(0))
    COMMANDS[command_name].begin(client)
    commands_s = len(velocities("square", ROUNDS)) * t_move_s
    return commands_s / elapsed_s(lambda: _fly_square(client, command_name, ROUNDS, t_move_s, t_sample_s))


def bench_virtual() -> Iterator[Measurement]:
    """Measure how fast a simulated wall clock runs, in DP1's longest game and one process."""
    session = VirtualSession("blocks", "native")
    for name in sorted(COMMANDS):
        rates = []
        for _ in range(REPEATS):
            client = session.start_game(CLOCK_SPEED, np.random.SeedSequence(0))
            COMMANDS[name].begin(client)
            rates.append(96 / elapsed_s(lambda: _fly_square(client, name, 24, 1.0, 1.0)))  # noqa: B023  called at once
        yield Measurement(f"lockstep {name.upper()}, 24 rounds of 1 s", median(rates), "simulated s/s")


def _fly_square(client: Client, command_name: str, rounds: int, t_move_s: float, t_sample_s: float) -> None:
    for velocity in velocities("square", rounds):
        for _ in COMMANDS[command_name].fly(client, VelocityGoal(velocity), t_move_s, t_sample_s):
            pass


def resident_mib(process_id: int) -> float:
    """Return a process's resident memory (Linux only)."""
    pages = int(Path(f"/proc/{process_id}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def bench_soak(duration_s: float, calls_per_s: float = 200.0) -> Iterator[Measurement]:
    """Measure achieved speed and memory of a free-running server under a steady load of calls."""
    with WallSession("blocks", "native") as session:
        client = session.start_game(CLOCK_SPEED, np.random.SeedSequence(0))
        client.run()
        clock = MonotonicClock()
        start_ns, memory = clock.now_ns(), []
        for call in range(int(duration_s * calls_per_s)):
            clock.sleep_until(start_ns + round(call * NS_PER_S / calls_per_s))
            client.kinematics()
            if call % int(calls_per_s) == 0:
                memory.append(resident_mib(session.server.pid))
        yield Measurement("achieved speed", client.speed()["real_time_factor"], "x", CLOCK_SPEED)
        settled = memory[len(memory) // 10 :]
        note = "bound: after a tenth of the time"
        yield Measurement("server memory at the end", settled[-1], "MiB", settled[0], note)
