"""Latencies of a simulated wall clock, drawn from wire/latency's tables by number: the same on the CPU and on a GPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavaccel.kernels.operands import Operand
from uavaccel.parts import part
from uavaccel.vision.noise import LATENCY, words

MOVE, PAUSE, CONTINUE, CONTINUE_FOR, STATE, IMAGE, CALL = range(7)  # channels
CHANNELS = ("move", "pause", "continue", "continue_for", "state", "image", "call")
WAITS = 6  # none yet, and one for each of wire/latency's WAITS_MS
REQUEST, REPLY = 0, len(CHANNELS) * WAITS  # first tables of each direction
ISSUE = 2 * REPLY
TIMER, FRAME = ISSUE + 1, ISSUE + 2
TABLES = ISSUE + 3
_STEP_53 = 2.0**-53


class Latencies(NamedTuple):
    """What latencies are drawn from, the same for all lanes."""

    quantiles: Operand
    """(Q,) float64 from 0 to 1."""
    tables_us: Operand
    """(TABLES, Q) float64: requests by channel and wait, replies likewise, ISSUE, TIMER, FRAME."""
    between_ns: Operand
    """(WAITS - 2,) float64: bounds of the waits."""
    faults: Operand
    """(3,) float64: shares of the messages held up by `delays_ns`, summed up; all 0 without faults."""
    delays_ns: Operand
    """(4,) int64, the last one 0."""


@part
def uniform(seed: int, number: int) -> float:
    """The number-th of a seed's numbers of [0, 1)."""
    a, b, _, _ = words(seed, number, LATENCY, 0)
    high, low = np.int64(a) >> 5, np.int64(b) >> 6
    return (high * 67108864.0 + low) * _STEP_53


@part
def drawn_ns(latencies: Latencies, table: int, share: float) -> int:
    """The latency at a share of a table's distribution, to the nanosecond."""
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
    """What a message is held up by."""
    place = 0
    while place < 3 and share >= latencies.faults[place]:
        place += 1
    return int(latencies.delays_ns[place])


@part
def wait_class(latencies: Latencies, wait_ns: int) -> int:
    """Which tables hold after a command, or a continue-for, that was waited for so long."""
    place = 0
    while place < WAITS - 2 and latencies.between_ns[place] < wait_ns:
        place += 1
    return place + 1
