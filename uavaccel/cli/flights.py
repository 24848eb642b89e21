"""The commands that fly scripts, show flights and write them for other programs: serve, fly, watch, export."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import nullcontext
from difflib import get_close_matches
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaccel.cli.options import Profile, Scene, Timing, Trust, Watch, given_options, option
from uavaccel.cli.terminal import LINES, console, working
from uavaccel.errors import UsageError, UserError
from uavaccel.fly.options import THINK_S

if TYPE_CHECKING:
    from uavaccel.records import RunDirectory

THINKS = (
    "Wall seconds that the script thinks before each call; "
    f"default: {THINK_S['virtual']:g} in virtual, {THINK_S['lockstep']:g} in lockstep."
)
LIKE = 0.8  # of letters that two options have in common, from which on one may be the other mistyped


def serve(
    settings: Annotated[Path | None, option("FILE", "AirSim's settings.json.")] = None,
    clock: Annotated[float | None, option("X", "ClockSpeed; default: the settings', or 1.")] = None,
    port: Annotated[int | None, option("N", "Port; default: the settings', or 41451; 0: any free one.")] = None,
    host: Annotated[str | None, option("ADDRESS", "Address to listen on; default: this machine alone.")] = None,
    profile: Profile = "native",
    scene: Scene = "blocks",
    recordings: Annotated[
        Path | None, option("FOLDER", "Folder for startRecording; default: the settings', or ~/Documents/AirSim.")
    ] = None,
    watch: Watch = False,
) -> None:
    """Serve a simulated drone to AirSim's clients until Ctrl-C."""
    from uavaccel.watch.beside import page_beside
    from uavaccel.wire.service import ServeOptions
    from uavaccel.wire.service import serve as serve_clients

    with page_beside(waits=False) if watch else nullcontext():
        serve_clients(ServeOptions(settings, clock, port, host, profile, scene, recordings))


def fly(
    context: typer.Context,
    script: Annotated[Path, typer.Argument(metavar="SCRIPT", help="An AirSim script in Python.")],
    arguments: Annotated[
        list[str] | None,
        typer.Argument(metavar="ARGUMENTS", help="The script's own; what follows -- is passed on unread."),
    ] = None,
    clock: Annotated[str | None, option("X,...", "ClockSpeed, or several: 1,10,100; default: the settings'.")] = None,
    timing: Timing = "virtual",
    check: Annotated[
        bool, option(None, "Fly twice; messages and trajectories must be equal to the byte.", "--check")
    ] = False,
    until: Annotated[float | None, option("S", "Stop after these simulated seconds, pauses included.", min=0.0)] = None,
    think: Annotated[float | None, option("S", THINKS, min=0.0)] = None,
    seed: Annotated[int | None, option("N", "Random seed of Python, NumPy, PyTorch and Gymnasium.")] = None,
    keys: Annotated[str | None, option("KEY,...", "Keys to press one after the other, as in w,w,space,q.")] = None,
    settings: Annotated[
        Path | None, option("FILE", "AirSim's settings.json; default: that beside the script or in ~/Documents/AirSim.")
    ] = None,
    no_settings: Annotated[bool, option(None, "Do not look for a settings.json.", "--no-settings")] = False,
    profile: Profile = "native",
    scene: Scene = "blocks",
    out: Annotated[Path | None, option("FOLDER", "New folder for the trajectory and the messages.")] = None,
    film: Annotated[bool, option(None, "Film the front camera's view, into --out.", "--film")] = False,
    watch: Watch = False,
) -> None:
    """Fly an unmodified AirSim script on a simulated clock.

    That is fast, needs no window, and repeats to the byte. Options come before the script, its own arguments after it.
    """
    from uavaccel.fly.command import FlyRequest, fly_script, parse_clocks
    from uavaccel.fly.keys import parse_keys
    from uavaccel.fly.options import FlightOptions
    from uavaccel.watch.beside import page_beside

    flight = FlightOptions(
        script,
        _own(script, arguments or [], [option for each in context.command.params for option in each.opts]),
        folder=Path(),
        timing=timing,
        profile=profile,
        scene=scene,
        settings=settings,
        think_s=think,
        seed=seed,
        until_s=until,
        keys=parse_keys(keys),
        film=film,
    )
    asked = FlyRequest(flight, parse_clocks(clock), check, not no_settings, out, page_beside if watch else None)
    raise typer.Exit(fly_script(asked))


def _own(script: Path, arguments: list[str], options: list[str]) -> tuple[str, ...]:
    """Return the script's own arguments: all that follow `--`, and before it what is none of our `options`.

    Raises UsageError for one of ours, and for one that looks like a mistyped one, unless the script has that word.
    """
    end = arguments.index("--") if "--" in arguments else len(arguments)
    for word in (argument.partition("=")[0] for argument in arguments[:end] if argument.startswith("--")):
        for ours in get_close_matches(word, options, n=1, cutoff=LIKE):
            if word == ours or not (script.is_file() and word.encode() in script.read_bytes()):
                meant = word if word == ours else f"{word} (did you mean {ours}?)"
                raise UsageError(f"{meant}: comes before the script; what the script itself takes follows --")
    return (*arguments[:end], *arguments[end + 1 :])


def watch(
    context: typer.Context,
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
    from uavaccel.fly.log import FILM, TRAJECTORY
    from uavaccel.own_code import trusting
    from uavaccel.watch.beside import show

    if case is not None and game is not None:
        raise UsageError("--case, --game: each names the flight; give one of them")
    for name in given_options(context):
        if name in ("--clock", "--think", "--seed") and run is not None:
            raise UsageError(f"{name}: is of the square, which is flown without RUN")
        if name in ("--host", "--port") and film is not None:
            raise UsageError(f"{name}: is of the page, and --film opens none")
    with trusting(trust):
        if film is None:
            show(run, case, game, (clock, think, seed), host, port)
        elif run is None:
            raise UsageError("--film: name what to film: a run, or a policy, as in uavaccel watch default --film FILE")
        elif film.suffix != ".mp4":
            raise UsageError(f"--film {film}: must end in .mp4")
        elif Path(run, TRAJECTORY).is_file():
            more = "fly the script with uavaccel fly --out FOLDER --film"
            more = f"its film is {Path(run, FILM)}" if Path(run, FILM).is_file() else more
            raise UsageError(f"--film: {run} has no images; {more}")
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
            from uavaccel.rl.onnx_file import input_names, write_onnx
            from uavaccel.rl.policy import load_policy

            about = write_onnx(policy := load_policy(policy_folder(source)), onnx)
            headings = about.get("headings_deg")
            actions = f"headings of {headings} degrees" if headings else f"shares of {json.loads(about['action'])}"
            seen = "; ".join(f"{name}: {about[name]}" for name in input_names(policy.config.task))
            console.print(f"{onnx}: {seen}; actions: {actions}")
        written: list[Iterable[Path]] = []
        if csv is not None or parquet is not None:
            from uavaccel.suites.report import write_tables

            tables = ((parquet, "parquet"), (csv, "csv"))  # a missing pyarrow first
            written += [write_tables(_run_in(source), folder, kind) for folder, kind in tables if folder is not None]
        if mcap is not None:
            from uavaccel.export import write_mcap

            written.append(write_mcap(_run_in(source), mcap, case))
        with working("the files"):
            for path in chain.from_iterable(written):
                console.print(str(path))
        if minari is not None:
            from uavaccel.export import write_minari

            for done, games in write_minari(_run_in(source), minari):
                if done * LINES // games > (done - 1) * LINES // games:
                    console.print(f"{done}/{games} games")
            console.print(str(minari))


def _run_in(source: str) -> RunDirectory:
    """Return the run in a folder. Raises UserError for none, and says what a flight's is good for."""
    from uavaccel.fly.log import TABLE, TRAJECTORY
    from uavaccel.suites.registry import open_run

    folder = Path(source)
    flights = [*folder.glob(TRAJECTORY), *folder.glob(f"*/{TRAJECTORY}")]
    if flights and not (folder / "config.yaml").is_file():
        use = f"its table is {flights[0].with_name(TABLE)}, and `uavaccel watch {flights[0].parent}` shows it"
        raise UserError(f"{source}: is of `uavaccel fly`, and no run: {use}")
    return open_run(source)
