"""The commands that show and export runs and policies: view, watch, export. They import what they need when run."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaccel.cli.options import Case, Trust, check_host
from uavaccel.cli.terminal import LINES, console, working
from uavaccel.errors import UsageError, UserError

if TYPE_CHECKING:
    from uavaccel.draw.film import Film
    from uavaccel.records import RunDirectory


def view(
    source: Annotated[
        str, typer.Argument(help="Run directory of dp2, evaluate or train, or a policy's folder.")
    ] = "default",
    case: Case = None,
    out: Annotated[Path | None, typer.Option(help="Folder; by default view/ in the run directory.")] = None,
    trust: Trust = False,
) -> None:
    """Show a game: an MP4 of camera, DVS, map, the view from behind and a policy's decisions, and a contact sheet."""
    from uavaccel.own_code import trusting

    with trusting(trust):
        view_game(source, case, out)


def view_game(source: str, case: str | None, out: Path | None) -> None:
    """Write CASE.mp4 and CASE.png into `out`, by default the folder view/ of the run, and print their paths.

    `source` is a run directory that keeps images or can fly its games again, or a policy: "default", its folder, a
    training's run directory. Without `case`: the run's most interesting game, a policy's first evaluation lane.
    Raises UserError if there is no such game.
    """
    from uavaccel.files import inside
    from uavaccel.rl.agents import DEFAULT, policy_folder
    from uavaccel.rl.policy import MANIFEST
    from uavaccel.sim.camera.gl import describe_renderer
    from uavaccel.suites.registry import open_run

    describe_renderer()  # where nothing can draw, this says so
    folder = Path("runs") if source == DEFAULT else Path(source)
    with working("the game"):
        if (policy_folder(source) / MANIFEST).is_file():
            name, film = _film_of_policy(source, case or "lane-000000")
        else:
            name, film = film_of_game(open_run(source), case)
    movie, sheet = (
        inside(out, f"{name}.{kind}") if out else inside(folder, f"view/{name}.{kind}") for kind in ("mp4", "png")
    )
    write_film(film, movie, sheet)


def film_of_game(run: RunDirectory, case: str | None) -> tuple[str, Film]:
    """Return a game's name and film, by default of the most interesting. Raises UserError where there are no images."""
    from uavaccel.suites.flight import film_of
    from uavaccel.suites.registry import suite_of
    from uavaccel.suites.suite import choose_row

    suite = suite_of(run)
    report = suite.report(run)
    row = choose_row(suite, report, case)
    flight = suite.flight(report, row)
    if not len(flight.images):
        raise UserError(f"{run.path}: a run of {suite.name} keeps no images to show")
    return str(row["case"]), film_of(flight)


def _film_of_policy(policy: str, case: str) -> tuple[str, Film]:
    from uavaccel.config import validate
    from uavaccel.rl.config import LANE
    from uavaccel.suites.evaluate import EvaluateConfig, completed
    from uavaccel.suites.evaluate_again import flight_of_agent
    from uavaccel.suites.flight import film_of

    lane = re.fullmatch(r"lane-(\d+)", case)
    if not lane:
        raise UserError(f"--case {case}: must be an evaluation lane, as lane-000007")
    config = validate(EvaluateConfig, completed({"agent": policy, "task": {"timing": "lockstep"}}), "view")
    if config.env_id == LANE:
        config.task.wire_lane(int(lane[1]))  # refuses one that there is not
    return case, film_of(flight_of_agent(config, int(lane[1])))


def write_film(film: Film, movie: Path, sheet: Path) -> None:
    """Write a film, with a bar of its frames on a terminal, and its contact sheet, and print their paths."""
    from uavaccel.draw.film import write_contact_sheet, write_video

    with working(movie.name, len(film)) as written:
        console.print(str(write_video(film, movie, written=written)))
    console.print(str(write_contact_sheet(film, sheet)))


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
    from uavaccel.own_code import trusting
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
    from uavaccel.own_code import trusting
    from uavaccel.suites.registry import open_run

    if onnx is csv is parquet is mcap is minari is None:
        raise UsageError(
            "export: say what to write: --onnx FILE of a policy; --csv, --parquet, --mcap or --minari FOLDER of a run"
        )
    if case is not None and mcap is None:
        raise UsageError("--case: goes with --mcap; the other formats take all games of a run")
    with trusting(trust):
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
