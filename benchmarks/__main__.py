"""`python -m benchmarks NAME...`: measures this machine, prints that, and with --out writes it to a file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from benchmarks import batch, images, kernels, speed
from uavaccel.calibration.doctor import check_machine
from uavaccel.cli.terminal import console
from uavaccel.clock import calendar_time
from uavaccel.config import MOST_SECONDS
from uavaccel.errors import UsageError, UserError
from uavaccel.files import check_new_file
from uavaccel.machine import describe_run

Bench = Callable[[], Iterator[speed.Measurement]]
BENCHES: dict[str, Bench] = {
    "hot-loop": speed.bench_hot_loop,
    "tcsc": speed.bench_tcsc,
    "virtual": speed.bench_virtual,
    "camera": images.bench_camera,
    "image": images.bench_image,
    "dvs": images.bench_dvs,
    "event-camera": images.bench_event_camera,
    "batch": batch.bench_batch,
    "kernels": kernels.bench_kernels,
}

app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None, add_completion=False)


@app.command()
def run(
    names: Annotated[list[str] | None, typer.Argument(help="Names of benchmarks; by default all.")] = None,
    soak_s: Annotated[
        float, typer.Option(min=0.0, max=MOST_SECONDS, help="Also load a server for this many seconds.")
    ] = 0.0,
    out: Annotated[Path | None, typer.Option(help="JSON file for the measurements.")] = None,
    lanes: Annotated[
        list[int] | None, typer.Option(min=1, help="For `batch`: number of lanes, by default 8; repeatable.")
    ] = None,
    processes: Annotated[
        int | None, typer.Option(min=1, help="For `batch`: number of processes, by default at most two per core.")
    ] = None,
) -> None:
    """Measure this machine: hot loop, round trips, TCSC, rendering, batches, kernels."""
    names = names or []
    if unknown := [name for name in names if name not in BENCHES]:
        raise UsageError(f"no bench {unknown[0]!r}; there are {', '.join(BENCHES)}")
    if out is not None:
        check_new_file(out)
    benches: dict[str, Bench] = {**BENCHES, "batch": partial(batch.bench_batch, lanes or [8], processes)}
    machine = check_machine()
    console.print(f"machine check: {machine['verdict']}")
    measurements = [each for name in names or BENCHES for each in _measured(benches[name])]
    if soak_s:
        measurements += _measured(partial(speed.bench_soak, soak_s))
    if out is not None:
        manifest = describe_run(["bench", *names], 0, calendar_time()) | {"host_check": machine}
        kept = {"measurements": [measurement._asdict() for measurement in measurements], "manifest": manifest}
        out.write_text(json.dumps(kept, indent=2) + "\n")


def _measured(work: Bench) -> Iterator[speed.Measurement]:
    """Print and yield each measurement; where this machine cannot make one, print why."""
    try:
        for measurement in work():
            value = f"{measurement.value:,.2f} {measurement.unit}"
            bound = "" if measurement.bound is None else f"of {measurement.bound:,.2f}"
            console.print(f"{measurement.name:38}  {value:22}  {bound:18}  {measurement.note}".rstrip())
            yield measurement
    except UserError as error:
        console.print(f"left out: {error}")


if __name__ == "__main__":
    from uavaccel.cli.main import main

    main(["bench"])
