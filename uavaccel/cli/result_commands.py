"""What looks at what was flown or learnt: report, view, watch, export.

Thin shells over plain functions, which are imported when a command runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    run_dirs: Annotated[list[Path], typer.Argument(help="Run directories.")],
) -> None:
    """Compute the metrics and draw the figures of finished runs again.

    Several trainings are also drawn side by side, in the first one's folder; so are several evaluations.
    """
    from uavaccel.cli.report import report_runs

    report_runs(run_dirs)


def view(
    source: Annotated[
        str, typer.Argument(help="Run directory of dp2, evaluate or train; a policy's folder.")
    ] = "default",
    case: Annotated[
        str | None, typer.Option(help="Which game, as rows.jsonl names it; by default the fastest, or best.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder; by default view/ in the run directory.")] = None,
    events: Annotated[
        Path | None,
        typer.Option(help="Instead, a file of the game's events: .h5 in DSEC's layout, or .npz."),
    ] = None,
    events_rate_hz: Annotated[
        float, typer.Option(min=0.1, help="Frames per simulated second of the camera that sees them.")
    ] = 100.0,
) -> None:
    """Show a game: an MP4 of camera, DVS, map, the view from behind and a policy's decisions, and a contact sheet."""
    from uavaccel.cli.view import view_events, view_game

    if events is not None:
        view_events(source, case, events, events_rate_hz)
    else:
        view_game(source, case, out)


def watch(
    run: Annotated[
        Path | None, typer.Argument(help="Run directory of dp1; without it ADSC and TCSC fly a square.")
    ] = None,
    case: Annotated[
        str | None, typer.Option(help="Which game, as rows.jsonl names it; by default the first.")
    ] = None,
    clock: Annotated[float, typer.Option(min=0.01, max=1000.0, help="ClockSpeed of the square.")] = 50.0,
    think: Annotated[
        float,
        typer.Option(min=0.0, max=10.0, help="Wall seconds that the client thinks before each command."),
    ] = 0.012,
    seed: Annotated[int, typer.Option(min=0, help="Of the square's latencies.")] = 0,
    host: Annotated[
        str, typer.Option(help="Address of the page; others than this machine see it if told.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="The first that is free from here on.")] = 8080,
) -> None:
    """Watch a flight in the browser: the drone in its scene, clocks, camera and events; pause, step, replay."""
    from uavaccel.cli.watch import WatchRequest
    from uavaccel.cli.watch import watch as open_page

    open_page(WatchRequest(run, case, clock, think, seed, host, port))


def export(
    source: Annotated[
        str, typer.Argument(help="A policy's folder or default, for --onnx; a run directory for tables.")
    ],
    onnx: Annotated[
        Path | None, typer.Option(help="ONNX file of the policy with its pre-processing.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Folder for the run's rows and samples as CSV.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Folder for the same as Parquet.")] = None,
) -> None:
    """Write a policy as ONNX, or a run as tables."""
    from uavaccel.cli.export import export as export_source

    export_source(source, onnx, csv, parquet)
