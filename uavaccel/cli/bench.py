"""`uavaccel bench`: measures this machine, prints the measurements, and with --out writes them to a file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from uavaccel.bench import images as bench_images
from uavaccel.bench import speed as bench
from uavaccel.bench.batch import BatchSize, bench_batch
from uavaccel.bench.kernels import bench_kernels
from uavaccel.bench.machine import check_machine
from uavaccel.cli.checks import check_file, check_number
from uavaccel.cli.terminal import console
from uavaccel.clock import calendar_time
from uavaccel.errors import UsageError, UserError
from uavaccel.limits import MOST_SECONDS
from uavaccel.manifest import describe_run

RENDERERS = ("shared", "own", "auto")
Bench = Callable[[], Iterator[bench.Measurement]]
BENCHES: dict[str, Bench] = {
    "hot-loop": bench.bench_hot_loop,
    "tcsc": bench.bench_tcsc,
    "virtual": bench.bench_virtual,
    "camera": bench_images.bench_camera,
    "image": bench_images.bench_image,
    "dvs": bench_images.bench_dvs,
    "event-camera": bench_images.bench_event_camera,
    "batch": bench_batch,
    "kernels": bench_kernels,
}


def run_benches(names: list[str], soak_s: float, out: Path | None, batch: BatchSize) -> None:
    """Run the named benches (all if none). Raises UsageError for an unknown name, UserError if `out` exists."""
    unknown = [name for name in names if name not in BENCHES]
    if unknown:
        raise UsageError(f"no bench {unknown[0]!r}; there are {', '.join(BENCHES)}")
    if out is not None:
        check_file(out)
    check_number("--soak-s", soak_s, 0.0, MOST_SECONDS)
    if batch.renderer not in RENDERERS:
        raise UserError(f"--renderer {batch.renderer}: must be {', '.join(RENDERERS)}")
    benches: dict[str, Bench] = {**BENCHES, "batch": partial(bench_batch, batch)}
    machine = check_machine()
    console.print(f"machine check: {machine['verdict']}")
    measurements = [each for name in names or BENCHES for each in _measured(benches[name])]
    if soak_s:
        measurements += _measured(partial(bench.bench_soak, soak_s))
    if out is not None:
        manifest = describe_run(["bench", *names], 0, calendar_time()) | {"host_check": machine}
        kept = {"measurements": [each._asdict() for each in measurements], "manifest": manifest}
        out.write_text(json.dumps(kept, indent=2) + "\n")


def _measured(work: Bench) -> Iterator[bench.Measurement]:
    """Print and yield each measurement; where this machine cannot make one, print why."""
    try:
        for measurement in work():
            value = f"{measurement.value:,.2f} {measurement.unit}"
            bound = "" if measurement.bound is None else f"of {measurement.bound:,.2f}"
            console.print(f"{measurement.name:38}  {value:22}  {bound:18}  {measurement.note}".rstrip())
            yield measurement
    except UserError as error:
        console.print(f"left out: {error}")
