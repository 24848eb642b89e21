"""The commands that show and export runs and policies: view, watch, export. They import what they need when run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uavaccel.cli.options import Case, Trust, check_host


def view(
    source: Annotated[
        str, typer.Argument(help="Run directory of dp2, evaluate or train, or a policy's folder.")
    ] = "default",
    case: Case = None,
    out: Annotated[Path | None, typer.Option(help="Folder; by default view/ in the run directory.")] = None,
    trust: Trust = False,
) -> None:
    """Show a game: an MP4 of camera, DVS, map, the view from behind and a policy's decisions, and a contact sheet."""
    from uavaccel.cli.view import view_game
    from uavaccel.suites.own_code import trusting

    with trusting(trust):
        view_game(source, case, out)


def watch(
    run: Annotated[
        Path | None,
        typer.Argument(
            help="Run directory of dp1, dp2 or evaluate, or the --out of fly; without it ADSC and TCSC fly a square."
        ),
    ] = None,
    case: Case = None,
    game: Annotated[int | None, typer.Option(min=0, help="The same by its line in rows.jsonl, from 0.")] = None,
    clock: Annotated[float, typer.Option(min=0.01, max=1000.0, help="ClockSpeed of the square.")] = 50.0,
    think: Annotated[
        float, typer.Option(min=0.0, max=10.0, help="Wall seconds that the client thinks before each command.")
    ] = 0.012,
    seed: Annotated[int, typer.Option(min=0, help="Of the square's latencies.")] = 0,
    host: Annotated[str, typer.Option(help="Address of the page, by default for this machine alone.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="The first that is free from here on.")] = 8080,
    trust: Trust = False,
) -> None:
    """Watch a flight in the browser: the drone in its scene, clocks, camera and events; pause, step, replay."""
    from uavaccel.suites.own_code import trusting
    from uavaccel.watch.show import show

    check_host(host)
    with trusting(trust):
        show(run, case, game, (clock, think, seed), host, port)


def export(
    source: Annotated[str, typer.Argument(help="A policy's folder or default, for --onnx; else a run directory.")],
    onnx: Annotated[Path | None, typer.Option(help="ONNX file for the policy with its pre-processing.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Folder for the run's rows and samples as CSV.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Folder for the same as Parquet.")] = None,
    mcap: Annotated[
        Path | None, typer.Option(help="Folder for the run's games as MCAP, or an .mcap file for one game.")
    ] = None,
    minari: Annotated[
        Path | None, typer.Option(help="Folder, named NAME-vN, for an evaluation as a Minari dataset.")
    ] = None,
    case: Annotated[str | None, typer.Option(help="The only game for --mcap, as rows.jsonl names it.")] = None,
    trust: Trust = False,
) -> None:
    """Write a policy as ONNX; a run as tables, as MCAP logs for Foxglove, or as a Minari dataset."""
    from uavaccel.cli.export import export as export_source
    from uavaccel.suites.own_code import trusting

    with trusting(trust):
        export_source(source, onnx, csv, parquet, mcap, minari, case)
