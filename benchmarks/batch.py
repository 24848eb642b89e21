"""Benchmarks of a batch of lanes: commands and images per second, and memory."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.speed import Measurement, elapsed_s
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.obstacle_lane import ObstacleLane


def proportional_mib(process_ids: Iterable[int]) -> float | None:
    """Return the proportional set size of processes in MiB, shared memory counted once; None where it is not known."""
    try:
        rollups = [Path(f"/proc/{process_id}/smaps_rollup").read_text(encoding="ascii") for process_id in process_ids]
    except OSError:
        return None
    return sum(int(kib) for text in rollups for kib in re.findall(r"^Pss: +(\d+) kB", text, re.M)) / 1024


WARM_UP = 3
COMMANDS, COMMANDS_OF_PICTURES = 30, 5  # per lane, in the two measurements
MANY_PICTURES = {"t_move_s": 0.1, "t_sample_s": 0.002}  # 50 images per command: next to no physics


def bench_batch(lanes: Sequence[int] = (8,), processes: int | None = None) -> Iterator[Measurement]:
    """Measure images per second of batches of so many lanes, and commands of 1 s with three frames each."""
    for count in lanes:
        commands_per_s, note, _ = _fly(count, processes, COMMANDS_OF_PICTURES, MANY_PICTURES)
        per_s = commands_per_s * round(MANY_PICTURES["t_move_s"] / MANY_PICTURES["t_sample_s"])
        yield Measurement(f"{count} lanes: pictures", per_s, "frames/s", None, note)
        per_s, note, memory_mib = _fly(count, processes, COMMANDS, {})
        yield Measurement(f"{count} lanes: commands", per_s, "commands/s", None, note)
        if memory_mib is not None:
            note = "proportional set size of all processes, this one included"
            yield Measurement(f"{count} lanes: memory", memory_mib, "MiB", None, note)


def _fly(lanes: int, processes: int | None, commands: int, task: dict[str, float]) -> tuple[float, str, float | None]:
    """Return commands per second of all lanes, a note of the processes, and the memory in MiB."""
    random = np.random.default_rng(0)
    batch = EnvironmentBatch(ObstacleLane, lanes, processes, **task)  # type: ignore[arg-type]

    def fly(count: int) -> None:
        for _ in range(count):
            batch.step_async(random.integers(1, 4, lanes))
            batch.step_wait()

    try:
        batch.reset(seed=0)
        fly(WARM_UP)
        took_s = elapsed_s(lambda: fly(commands))
        memory_mib = proportional_mib([os.getpid(), *batch.process_ids])
        return commands * lanes / took_s, f"{batch.processes} processes", memory_mib
    finally:
        batch.close()
