"""Latencies of a simulated wall clock, sampled from the tables of wire/latency by a counter-based generator."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavaccel.kernels.operands import Operand
from uavaccel.sim.parts import part
from uavaccel.vision.noise import LATENCY, words

MOVE, PAUSE, CONTINUE, CONTINUE_FOR, STATE, IMAGE, CALL = range(7)  # channels
CHANNELS = ("move", "pause", "continue", "continue_for", "state", "image", "call")
WAITS = 6  # no wait yet, and one for each of wire/latency's WAITS_MS
REQUEST, REPLY = 0, len(CHANNELS) * WAITS  # first table of each direction
ISSUE = 2 * REPLY
TIMER, FRAME = ISSUE + 1, ISSUE + 2
TABLES = ISSUE + 3
_STEP_53 = 2.0**-53


class Latencies(NamedTuple):
    """The distributions of latencies, the same for all lanes."""

    quantiles: Operand
    """(Q,) float64: cumulative probabilities from 0 to 1."""
    tables_us: Operand
    """(TABLES, Q) float64: quantiles of requests by channel and wait, of replies likewise, of ISSUE, TIMER, FRAME."""
    between_ns: Operand
    """(WAITS - 2,) float64: bounds between classes of waits."""
    faults: Operand
    """(3,) float64: cumulative probabilities of the delays; all 0 without faults."""
    delays_ns: Operand
    """(4,) int64: delays of faulty messages; the last is 0, of all others."""


@part
def uniform(seed: int, number: int) -> float:
    """Return the number-th random number of a seed, uniform in [0, 1)."""
    a, b, _, _ = words(seed, number, LATENCY, 0)
    high, low = np.int64(a) >> 5, np.int64(b) >> 6
    return (high * 67108864.0 + low) * _STEP_53


@part
def sampled_ns(latencies: Latencies, table: int, share: float) -> int:
    """Return the quantile of a table at a cumulative probability `share`, rounded to nanoseconds."""
    at, us = latencies.quantiles, latencies.tables_us
    last = at.shape[0] - 1
    if us[table, last] == 0.0:
        return 0
    place = 0
    while place < last - 1 and share >= at[place + 1]:
        place += 1
    slope = (us[table, place + 1] - us[table, place]) / (at[place + 1] - at[place])
    return round(1e3 * (slope * (share - at[place]) + us[table, place]))


@part
def fault_ns(latencies: Latencies, share: float) -> int:
    """Return the delay of a message by faults, at a cumulative probability `share`."""
    place = 0
    while place < 3 and share >= latencies.faults[place]:
        place += 1
    return int(latencies.delays_ns[place])


@part
def wait_class(latencies: Latencies, wait_ns: int) -> int:
    """Return the class of tables to use after a command or continue-for that took `wait_ns`."""
    place = 0
    while place < WAITS - 2 and latencies.between_ns[place] < wait_ns:
        place += 1
    return place + 1
