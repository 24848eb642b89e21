"""The commands that show and export runs and policies: watch, export. They import what they need when run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from uavaccel.cli.options import Trust, option
from uavaccel.cli.terminal import LINES, console, working
from uavaccel.errors import UsageError


def watch(
    run: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN",
            help="A run directory, fly's --out, a policy's folder or default; without it ADSC and TCSC fly a square.",
        ),
    ] = None,
    film: Annotated[Path | None, option("FILE", "Write an MP4, and a contact sheet beside it; open no page.")] = None,
    case: Annotated[
        str | None,
        option("NAME", "The flight, as rows.jsonl names it, or a policy's lane; default: the fastest, or the best."),
    ] = None,
    game: Annotated[int | None, option("N", "The flight by its line in rows.jsonl, from 0.", min=0)] = None,
    clock: Annotated[float, option("X", "ClockSpeed of the square.", min=0.01, max=1000.0)] = 50.0,
    think: Annotated[
        float, option("S", "Wall seconds of thinking before each command of the square.", min=0.0, max=10.0)
    ] = 0.012,
    seed: Annotated[int, option("N", "Random seed of the square.", min=0)] = 0,
    host: Annotated[str, option("ADDRESS", "Address of the page.")] = "127.0.0.1",
    port: Annotated[int, option("N", "Port of the page, or the first free one above.", min=1, max=65535)] = 8080,
    trust: Trust = False,
) -> None:
    """Watch a flight in the browser, or write its film.

    The page shows the drone in its scene, clocks, camera and events; pause, step, replay. The film shows camera,
    events, map, the view from behind and what a policy decided.
    """
    from uavaccel.fly.trajectory import FILE_NAME as TRAJECTORY
    from uavaccel.own_code import trusting
    from uavaccel.watch.beside import show

    with trusting(trust):
        if film is None:
            show(run, case, game, (clock, think, seed), host, port)
        elif run is None:
            raise UsageError("--film: name what to film: a run, or a policy, as in uavaccel watch default --film FILE")
        elif film.suffix != ".mp4":
            raise UsageError(f"--film {film}: must end in .mp4")
        elif Path(run, TRAJECTORY).is_file():
            raise UsageError(f"--film: {run} has no images; fly the script with uavaccel fly --out FOLDER --film")
        else:
            from uavaccel.suites.flight import film_game

            for path in film_game(run, case, game, film, working):
                console.print(str(path))


def export(
    source: Annotated[
        str, typer.Argument(metavar="SOURCE", help="With --onnx a policy's folder, or default; else a run directory.")
    ],
    onnx: Annotated[Path | None, option("FILE", "Write the policy with its pre-processing as ONNX.")] = None,
    csv: Annotated[Path | None, option("FOLDER", "Write the run's rows and samples as CSV.")] = None,
    parquet: Annotated[Path | None, option("FOLDER", "Write the same as Parquet.")] = None,
    mcap: Annotated[
        Path | None, option("FOLDER", "Write flights as MCAP; one alone into FOLDER or a file.mcap.")
    ] = None,
    minari: Annotated[Path | None, option("FOLDER", "Write an evaluation as a Minari dataset, into NAME-vN.")] = None,
    case: Annotated[str | None, option("NAME", "For --mcap: one flight alone, as rows.jsonl names it.")] = None,
    trust: Trust = False,
) -> None:
    """Write a policy as ONNX; a run as tables, MCAP or a Minari dataset."""
    from uavaccel.own_code import trusting
    from uavaccel.resources import require
    from uavaccel.suites.registry import open_run

    if onnx is csv is parquet is mcap is minari is None:
        raise UsageError(
            "export: say what to write: --onnx FILE of a policy; --csv, --parquet, --mcap or --minari FOLDER of a run"
        )
    if case is not None and mcap is None:
        raise UsageError("--case: goes with --mcap; the other formats take all games of a run")
    with trusting(trust):
        if onnx is not None:
            require("torch", "--onnx", "onnx", "PyTorch")
            from uavaccel.rl.agents import policy_folder
            from uavaccel.rl.onnx_file import write_onnx
            from uavaccel.rl.policy import load_policy

            about = write_onnx(load_policy(policy_folder(source)), onnx)
            headings = about.get("headings_deg")
            actions = f"headings of {headings} degrees" if headings else f"shares of {json.loads(about['action'])}"
            console.print(f"{onnx}: seen: {about['seen']}; actions: {actions}")
        written: list[Iterable[Path]] = []
        if csv is not None or parquet is not None:
            from uavaccel.suites.report import write_tables

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
