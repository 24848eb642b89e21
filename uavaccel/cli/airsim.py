"""The commands for AirSim's clients and scripts: serve, fly.

Each calls a plain function, which it imports when it runs.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from uavaccel.cli.options import Profile, Scene, Timing, Watch, check_host
from uavaccel.fly.options import THINK_S


def serve(
    settings: Annotated[Path | None, typer.Option(help="AirSim's settings.json.")] = None,
    clock: Annotated[float | None, typer.Option(help="ClockSpeed; by default that of the settings, or 1.")] = None,
    port: Annotated[
        int | None, typer.Option(help="By default that of the settings, or 41451; 0 for any free port.")
    ] = None,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; without it, never beyond this machine.")
    ] = None,
    profile: Profile = "native",
    scene: Scene = "blocks",
    recordings: Annotated[
        Path | None,
        typer.Option(help="Folder for startRecording; by default that of the settings, or ~/Documents/AirSim."),
    ] = None,
    watch: Watch = False,
) -> None:
    """Serve a free-running quadrotor to AirSim's clients until Ctrl-C."""
    from uavaccel.watch.beside import PageAddress, page_beside
    from uavaccel.wire.service import ServeOptions
    from uavaccel.wire.service import serve as serve_clients

    if host is not None:
        check_host(host)
    with page_beside(PageAddress() if watch else None, waits=False):
        serve_clients(ServeOptions(settings, clock, port, host, profile, scene, recordings))


def fly(
    script: Annotated[Path, typer.Argument(help="An AirSim script in Python.")],
    arguments: Annotated[list[str] | None, typer.Argument(help="The script's own arguments.")] = None,
    clock: Annotated[
        str | None, typer.Option(help="ClockSpeed, or several: 1,10,100; by default that of the settings.")
    ] = None,
    timing: Timing = "virtual",
    check: Annotated[
        bool, typer.Option("--check", help="Fly twice, and compare messages and trajectories byte for byte.")
    ] = False,
    until: Annotated[
        float | None, typer.Option(min=0.0, help="Stop the script after this many simulated seconds, including pauses.")
    ] = None,
    think: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Wall seconds that the script takes before each call; "
            f"by default {THINK_S['virtual']:g} in virtual, {THINK_S['lockstep']:g} in lockstep.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of Python's, NumPy's, PyTorch's and Gymnasium's generators.")
    ] = None,
    keys: Annotated[
        str | None, typer.Option(help="Keys that are pressed one after the other: w,w,space,q; by default none.")
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="AirSim's settings.json; by default the one beside the script, or in ~/Documents/AirSim."),
    ] = None,
    no_settings: Annotated[bool, typer.Option("--no-settings", help="Do not look for a settings.json.")] = False,
    profile: Profile = "native",
    scene: Scene = "blocks",
    out: Annotated[Path | None, typer.Option(help="New folder for the trajectory and the messages.")] = None,
    film: Annotated[bool, typer.Option("--film", help="Film the front camera's view, into --out.")] = False,
    watch: Watch = False,
) -> None:
    """Fly an unmodified AirSim script on a simulated clock: fast, headless, and reproducible.

    Options come before the script, the script's own arguments after it.
    """
    from uavaccel.fly.command import FlyRequest, fly_script, parse_clocks
    from uavaccel.fly.keyboard import parse_keys
    from uavaccel.fly.options import FlightOptions
    from uavaccel.watch.beside import PageAddress, page_beside

    flight = FlightOptions(
        script,
        tuple(arguments or ()),
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
