"""What looks at what was flown or learnt: report, view, export.

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


def export(
    source: Annotated[
        str, typer.Argument(help="A policy's folder or default, for --onnx; else a run directory.")
    ],
    onnx: Annotated[
        Path | None, typer.Option(help="ONNX file of the policy with its pre-processing.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Folder for the run's rows and samples as CSV.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Folder for the same as Parquet.")] = None,
    mcap: Annotated[
        Path | None, typer.Option(help="Folder for the run's games as MCAP, or an .mcap file for one game.")
    ] = None,
    minari: Annotated[
        Path | None, typer.Option(help="Folder, named NAME-vN, for an evaluation as a Minari dataset.")
    ] = None,
    case: Annotated[
        str | None, typer.Option(help="The only game for --mcap, as rows.jsonl names it.")
    ] = None,
) -> None:
    """Write a policy as ONNX; a run as tables, as MCAP logs for Foxglove, or as a Minari dataset."""
    from uavaccel.cli.export import export as export_source

    export_source(source, onnx, csv, parquet, mcap, minari, case)
