"""The commands that show and export runs and policies: view, watch, export. They import what they need when run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from uavaccel.cli.options import Case, Trust, check_host
from uavaccel.cli.terminal import LINES, console
from uavaccel.errors import UsageError


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
    from uavaccel.watch.beside import show

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
    from uavaccel.suites.own_code import trusting

    with trusting(trust):
        export_source(source, onnx, csv, parquet, mcap, minari, case)


def export_source(
    source: str,
    onnx: Path | None = None,
    csv: Path | None = None,
    parquet: Path | None = None,
    mcap: Path | None = None,
    minari: Path | None = None,
    case: str | None = None,
) -> None:
    """Write what was asked for. Raises UserError with one clear line."""
    from uavaccel.suites.registry import open_run

    if onnx is csv is parquet is mcap is minari is None:
        raise UsageError(
            "export: say what to write: --onnx FILE of a policy; --csv, --parquet, --mcap or --minari FOLDER of a run"
        )
    if case is not None and mcap is None:
        raise UsageError("--case: goes with --mcap; the other formats take all games of a run")
    if onnx is not None:
        from uavaccel.rl.agents import policy_folder
        from uavaccel.rl.onnx_file import write_onnx
        from uavaccel.rl.policy import load_policy

        about = write_onnx(load_policy(policy_folder(source)), onnx)
        headings = about.get("headings_deg")
        actions = f"headings of {headings} degrees" if headings else f"shares of {json.loads(about['action'])}"
        console.print(f"{onnx}: seen: {about['seen']}; actions: {actions}")
    written: list[Iterable[Path]] = []
    if csv is not None or parquet is not None:
        from uavaccel.suites.tables import write_tables

        tables = ((csv, "csv"), (parquet, "parquet"))
        written += [write_tables(open_run(source), folder, kind) for folder, kind in tables if folder is not None]
    if mcap is not None:
        from uavaccel.export.mcap_file import write_mcap

        written.append(write_mcap(open_run(source), mcap, case))
    for path in chain.from_iterable(written):
        console.print(str(path))
    if minari is not None:
        from uavaccel.export.minari_dataset import write_minari

        for done, games in write_minari(open_run(source), minari):
            if done * LINES // games > (done - 1) * LINES // games:
                console.print(f"{done}/{games} games")
        console.print(str(minari))
