"""What `uavaccel doctor` finds: whether this machine can simulate, measure and draw, and what it lacks."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import NamedTuple

from uavaccel.clock import calendar_time, timer_grain_ns
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.machine import describe_run, usable_cores

USER_ERROR = f"{UserError.__module__}.{UserError.__name__}"
TIMEOUT_S = 180.0  # a driver that hangs must not take the doctor with it
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri"  # not from sim.gl: importing MuJoCo may be what fails

MAX_LOAD_PER_CORE = 0.5
MAX_TIMER_P90_US = 200.0

# Both run in processes of their own: a library that is missing or crashes becomes a line of the report.
HOT_LOOP = """
import json
from uavaccel.clock import MonotonicClock
clock = MonotonicClock()
import mujoco, numba, numpy, pydantic
start_ns = clock.now_ns()
from uavaccel.sim.vehicle import hotloop
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
World("blocks", NATIVE).advance(1)
print(json.dumps({"cached": bool(hotloop.ENTRY_POINTS.fly.cache_hits), "seconds": (clock.now_ns() - start_ns) / 1e9}))
"""
RENDERER = """
import dataclasses, json
from uavaccel.sim.camera.gl import describe_renderer
print(json.dumps(dataclasses.asdict(describe_renderer())))
"""


class Finding(NamedTuple):
    """One line of the report; `problem` marks what the user might want to fix."""

    name: str
    text: str
    problem: bool = False


class ProbeError(Exception):
    """A probe without a result; the text says why in one line, but not what to do about it."""


def findings() -> Iterator[Finding]:
    """Yield all findings, the quick ones first."""
    run = describe_run(["doctor"], 0, calendar_time())
    versions = run["versions"]
    found = ", ".join(f"{name} {version or 'missing'}" for name, version in versions.items())
    yield Finding("versions", found, None in versions.values())
    yield Finding("host", f"{run['host']['platform']}, {run['host']['cpu_model']}")
    machine = check_machine()
    yield Finding("cores", f"{machine['cores']}, load {machine['load_1min']:.2f}")
    late = "a sleep ends {timer_late_median_us:.0f} us late (median), {timer_late_p90_us:.0f} us (90th percentile)"
    yield Finding("timers", late.format(**machine))
    yield Finding("timing", f"wall: {machine['verdict']}", machine["verdict"] != "quiet")
    yield hot_loop()
    yield renderer()


def hot_loop() -> Finding:
    """Return whether the simulator runs, and whether its compiled loop comes from numba's cache."""
    try:
        found = probe(HOT_LOOP)
    except (ProbeError, UserError) as error:
        return Finding("hot loop", f"does not run: {error}", True)
    if found["cached"]:
        return Finding("hot loop", f"ready in {found['seconds']:.1f} s, from numba's cache")
    return Finding("hot loop", f"compiled in {found['seconds']:.1f} s; numba's cache has it from now on")


def renderer() -> Finding:
    """Return which renderer would draw the camera's images."""
    try:
        found = probe(RENDERER)
    except UserError as error:
        return Finding("images", f"none: {error}", True)
    except ProbeError as error:
        return Finding("images", f"none: {error}; install {PACKAGES} (Debian)", True)
    where = ", software on the CPU, slow" if found["software"] else ""
    return Finding("images", f"{found['backend']}: {found['name']}{where}")


def probe(program: str) -> dict[str, Plain]:
    """Run a Python program, and return the JSON that it prints last.

    Raises the program's UserError, whose line says what to do, or ProbeError.
    """
    command = [sys.executable, "-c", program]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        raise ProbeError(f"no answer within {TIMEOUT_S:.0f} s") from None
    if done.returncode < 0:
        raise ProbeError(f"it crashed ({signal.Signals(-done.returncode).name})")
    if done.returncode:
        last = (done.stderr.strip() or f"it ended with status {done.returncode}").splitlines()[-1]
        kind, _, text = last.partition(": ")
        raise UserError(text) if kind == USER_ERROR else ProbeError(last)
    found: dict[str, Plain] = json.loads(done.stdout.splitlines()[-1])
    return found


def check_machine() -> dict[str, Plain]:
    """Return load, lateness of short sleeps, and a verdict in words, to be recorded beside measurements."""
    cores = usable_cores()
    late_us = [ns / 1e3 for ns in timer_grain_ns()]
    load, median_us, p90_us = os.getloadavg()[0], late_us[len(late_us) // 2], late_us[len(late_us) * 9 // 10]
    doubts = []
    if cores < 2:
        doubts.append("one core for client and server together")
    if load > MAX_LOAD_PER_CORE * cores:
        doubts.append(f"load {load:.2f} on {cores} cores")
    if p90_us > MAX_TIMER_P90_US:
        doubts.append(f"sleeps end {p90_us:.0f} us late (90th percentile)")
    verdict = f"noisy: {', '.join(doubts)}; measured latencies are pessimistic" if doubts else "quiet"
    return {
        "verdict": verdict,
        "cores": cores,
        "load_1min": load,
        "timer_late_median_us": median_us,
        "timer_late_p90_us": p90_us,
    }
