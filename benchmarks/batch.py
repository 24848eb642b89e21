"""Benchmarks of a batch of lanes: commands and images per second beside a bare rendering loop, and memory."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from benchmarks.speed import Measurement, elapsed_s
from uavaccel.envs.batch import MOST_TILES, EnvironmentBatch
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.resources import asset
from uavaccel.sim.camera.view import View
from uavaccel.sim.lane.layout import sample_layout
from uavaccel.sim.lane.scene import apply_layout
from uavaccel.sim.rendering.tiles import Tiles


def proportional_mib(process_ids: Iterable[int]) -> float | None:
    """Return the proportional set size of processes in MiB, shared memory counted once; None where it is not known."""
    try:
        rollups = [Path(f"/proc/{process_id}/smaps_rollup").read_text(encoding="ascii") for process_id in process_ids]
    except OSError:
        return None
    return sum(int(kib) for text in rollups for kib in re.findall(r"^Pss: +(\d+) kB", text, re.M)) / 1024


WARM_UP = 3
TILE_ROUNDS = 30
COMMANDS, COMMANDS_OF_PICTURES = 30, 5  # per lane, in the two measurements
MANY_PICTURES = {"t_move_s": 0.1, "t_sample_s": 0.002}  # 50 images per command: next to no physics


class BatchSize(NamedTuple):
    """The batches to measure: numbers of lanes; processes, tiles and renderer as EnvironmentBatch takes them."""

    lanes: tuple[int, ...] = (8,)
    processes: int | None = None
    tiles: int | None = None
    renderer: str = "shared"


def bench_batch(size: BatchSize | None = None) -> Iterator[Measurement]:
    """Measure images per second of the batch and of the bare loop, and commands of 1 s with three frames each."""
    size = size or BatchSize()
    for lanes in size.lanes:
        bare, renderer = bare_tiles(min(size.tiles or lanes, MOST_TILES))
        commands_per_s, note, _ = _fly(size, lanes, COMMANDS_OF_PICTURES, MANY_PICTURES)
        per_s = commands_per_s * round(MANY_PICTURES["t_move_s"] / MANY_PICTURES["t_sample_s"])
        yield Measurement(f"{lanes} lanes: pictures", per_s, "frames/s", bare, f"{note}, {renderer}")
        yield Measurement(f"{lanes} lanes: over the bare loop", per_s / bare, "", note="aim 0.8 on a GPU")
        per_s, note, memory_mib = _fly(size, lanes, COMMANDS, {})
        yield Measurement(f"{lanes} lanes: commands", per_s, "commands/s", None, f"{note}, {renderer}")
        if memory_mib is not None:
            note = "proportional set size of all processes, this one included"
            yield Measurement(f"{lanes} lanes: memory", memory_mib, "MiB", None, note)


def _fly(size: BatchSize, lanes: int, commands: int, task: dict[str, float]) -> tuple[float, str, float | None]:
    """Return commands per second of all lanes, a note of processes, tiles and renderer, and the memory in MiB."""
    random = np.random.default_rng(0)
    batch = EnvironmentBatch(ObstacleLane, lanes, size.processes, size.renderer, size.tiles, **task)  # type: ignore[arg-type]

    def fly(count: int) -> None:
        for _ in range(count):
            batch.step_async(random.integers(1, 4, lanes))
            batch.step_wait()

    try:
        batch.reset(seed=0)
        fly(WARM_UP)
        took_s = elapsed_s(lambda: fly(commands))
        renderer = [] if batch.service is None else [batch.service.process.pid]
        memory_mib = proportional_mib([os.getpid(), *batch.process_ids, *renderer])
        note = f"{batch.processes} processes, {batch.tiles} tiles, {size.renderer} renderer"
        return commands * lanes / took_s, note, memory_mib
    finally:
        batch.close()


def bare_tiles(count: int) -> tuple[float, str]:
    """Return frames per second of a loop that renders `count` scenes of the lane and reads them back; the renderer."""
    model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    data = mujoco.MjData(model)
    apply_layout(model, data, sample_layout(seed=0))
    tiles = Tiles(model, count)
    scenes = []
    for place in range(count):
        data.qpos[0] = 140.0 * place / count  # along the lane: many obstacles in view, and few
        scenes.append(View(model).update(data))

    def loop() -> None:
        for _ in range(TILE_ROUNDS):
            for place, scene in enumerate(scenes):
                tiles.render(0, place, scene)
            with tiles.read(0, count):
                pass

    loop()
    per_s = TILE_ROUNDS * count / elapsed_s(loop)
    tiles.close()
    return per_s, tiles.renderer.name
