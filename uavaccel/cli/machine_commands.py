"""The commands that measure or examine this machine: calibrate, advise, bench, doctor.

Each calls a plain function, which it imports when it runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def calibrate(
    out: Annotated[Path, typer.Option(help="YAML file to write.")] = Path("latency.yaml"),
    commands: Annotated[int, typer.Option(help="Commands of each kind to fly, about.")] = 1500,
    profile: Annotated[str, typer.Option(help="native or airsim.")] = "native",
    check: Annotated[
        bool, typer.Option("--check", help="Fly the same games on both clocks, and compare; writes nothing.")
    ] = False,
    latency: Annotated[Path | None, typer.Option(help="Of --check: the model; else the shipped one.")] = None,
    games: Annotated[int, typer.Option(help="Of --check: games of each kind.")] = 20,
) -> None:
    """Measure this machine's message latencies for the virtual timing to draw from, or check a model of them."""
    from uavaccel.cli.calibrate import show_agreement, write_calibration

    if check:
        show_agreement(latency, profile, games)
    else:
        write_calibration(out, commands, profile)


def advise(
    t_move: Annotated[float, typer.Option("--t-move", help="Seconds of a command.")] = 1.0,
    error: Annotated[float, typer.Option(help="Metres that a trajectory may be off.")] = 0.1,
    rounds: Annotated[int, typer.Option(help="Rounds of the square path.")] = 4,
    latency: Annotated[
        Path | None, typer.Option(help="Latency model; `calibrate` writes one. Without it the shipped one.")
    ] = None,
    profile: Annotated[str, typer.Option(help="native or airsim.")] = "native",
) -> None:
    """Say how fast ADSC may fly within an error, and what TCSC would gain."""
    from uavaccel.cli.advise import show_advice

    show_advice(t_move, error, rounds, latency, profile)


def bench(
    names: Annotated[list[str] | None, typer.Argument(help="Which; all if none is named.")] = None,
    soak_s: Annotated[float, typer.Option("--soak-s", help="Also load a server for so many seconds.")] = 0.0,
    out: Annotated[Path | None, typer.Option(help="JSON file to keep the measurements in.")] = None,
    lanes: Annotated[
        list[int] | None, typer.Option(min=1, help="Of `batch`: so many lanes, 8 otherwise; repeatable.")
    ] = None,
    processes: Annotated[
        int | None, typer.Option(min=1, help="Of `batch`: over so many processes; otherwise the cores.")
    ] = None,
    tiles: Annotated[
        int | None, typer.Option(min=1, help="Of `batch`: pictures drawn at once; otherwise the lanes.")
    ] = None,
    renderer: Annotated[str, typer.Option(help="Of `batch`: shared, own or auto.")] = "shared",
) -> None:
    """Measure this machine: hot loop, round trips, TCSC, rendering."""
    from uavaccel.bench.batch import BatchSize
    from uavaccel.cli.bench import run_benches

    run_benches(names or [], soak_s, out, BatchSize(tuple(lanes or [8]), processes, tiles, renderer))


def doctor() -> None:
    """Look at this machine: versions, timers, hot loop, who draws the images."""
    from uavaccel.cli.doctor import examine

    examine()
