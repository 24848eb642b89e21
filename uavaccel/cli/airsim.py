"""The commands for AirSim's clients and scripts: serve, fly.

Each calls a plain function, which it imports when it runs.
"""

from __future__ import annotations

from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from uavaccel.cli.options import Profile, Scene, Timing, Watch, option
from uavaccel.errors import UsageError
from uavaccel.fly.options import THINK_S

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
    from uavaccel.watch.beside import PageAddress, page_beside
    from uavaccel.wire.service import ServeOptions
    from uavaccel.wire.service import serve as serve_clients

    with page_beside(PageAddress() if watch else None, waits=False):
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
    think: Annotated[
        float | None,
        option(
            "S",
            "Wall seconds that the script thinks before each call; "
            f"default: {THINK_S['virtual']:g} in virtual, {THINK_S['lockstep']:g} in lockstep.",
            min=0.0,
        ),
    ] = None,
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
    from uavaccel.watch.beside import PageAddress, page_beside

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
    page = partial(page_beside, PageAddress()) if watch else None
    raise typer.Exit(fly_script(FlyRequest(flight, parse_clocks(clock), check, not no_settings, out, page)))


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
