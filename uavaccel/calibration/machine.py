"""A check of whether this machine is quiet enough for measurements on its clock."""

from __future__ import annotations

import os

from uavaccel.clock import timer_grain_ns
from uavaccel.files import Plain
from uavaccel.machine import usable_cores

MAX_LOAD_PER_CORE = 0.5
MAX_TIMER_P90_US = 200.0


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
