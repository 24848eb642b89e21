"""The commands that measure or examine this machine: calibrate, advise, bench, doctor.

Each calls a plain function, which it imports when it runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def calibrate(
    out: Annotated[Path, typer.Option(help="YAML file to write.")] = Path("latency.yaml"),
    commands: Annotated[int, typer.Option(help="Approximate number of commands of each kind to fly.")] = 1500,
    profile: Annotated[str, typer.Option(help="native or airsim.")] = "native",
    check: Annotated[
        bool, typer.Option("--check", help="Fly the same games on both clocks and compare; write nothing.")
    ] = False,
    latency: Annotated[
        Path | None, typer.Option(help="For --check: the model; by default the shipped one.")
    ] = None,
    games: Annotated[int, typer.Option(help="For --check: games of each kind.")] = 20,
) -> None:
    """Measure this machine's message latencies for the virtual timing to draw from, or check a model of them."""
    from uavaccel.cli.calibrate import show_agreement, write_calibration

    if check:
        show_agreement(latency, profile, games)
    else:
        write_calibration(out, commands, profile)


def advise(
    t_move: Annotated[float, typer.Option("--t-move", help="Duration of a command in seconds.")] = 1.0,
    error: Annotated[float, typer.Option(help="Largest error of a trajectory in metres.")] = 0.1,
    rounds: Annotated[int, typer.Option(help="Rounds of the square path.")] = 4,
    latency: Annotated[
        Path | None, typer.Option(help="Latency model, as `calibrate` writes it; by default the shipped one.")
    ] = None,
    profile: Annotated[str, typer.Option(help="native or airsim.")] = "native",
) -> None:
    """Say up to which ClockSpeed ADSC stays within an error, and what TCSC would gain."""
    from uavaccel.cli.advise import show_advice

    show_advice(t_move, error, rounds, latency, profile)


def bench(
    names: Annotated[list[str] | None, typer.Argument(help="Names of benchmarks; by default all.")] = None,
    soak_s: Annotated[
        float, typer.Option("--soak-s", help="Also load a server for this many seconds.")
    ] = 0.0,
    out: Annotated[Path | None, typer.Option(help="JSON file for the measurements.")] = None,
    lanes: Annotated[
        list[int] | None, typer.Option(min=1, help="For `batch`: number of lanes, by default 8; repeatable.")
    ] = None,
    processes: Annotated[
        int | None, typer.Option(min=1, help="For `batch`: number of processes, by default one per core.")
    ] = None,
    tiles: Annotated[
        int | None, typer.Option(min=1, help="For `batch`: pictures drawn at once, by default one per lane.")
    ] = None,
    renderer: Annotated[str, typer.Option(help="For `batch`: shared, own or auto.")] = "shared",
) -> None:
    """Measure this machine: hot loop, round trips, TCSC, rendering."""
    from uavaccel.bench.batch import BatchSize
    from uavaccel.cli.bench import run_benches

    run_benches(names or [], soak_s, out, BatchSize(tuple(lanes or [8]), processes, tiles, renderer))


def doctor() -> None:
    """Examine this machine: versions, timers, hot loop, renderer."""
    from uavaccel.cli.doctor import examine

    examine()
