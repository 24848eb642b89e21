"""The options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uavaccel.cli.completion import one_of

_COMMANDS = one_of("adsc", "tcsc")

Clock = Annotated[list[float] | None, typer.Option("--clock", help="ClockSpeed; repeat for several.")]
Commands = Annotated[
    list[str] | None,
    typer.Option("--command", help="adsc or tcsc; repeat for both.", autocompletion=_COMMANDS),
]
Timing = Annotated[
    str | None,
    typer.Option(
        help="wall (measured), virtual (modelled) or lockstep (no latency).",
        autocompletion=one_of("wall", "virtual", "lockstep"),
    ),
]
Profile = Annotated[
    str | None, typer.Option(help="native or airsim.", autocompletion=one_of("native", "airsim"))
]
Seed = Annotated[int | None, typer.Option(help="Seed of every drawn number.")]
Out = Annotated[Path | None, typer.Option(help="New run directory; by default one in runs/.")]
Resume = Annotated[bool, typer.Option("--resume", help="Resume the run in --out with its own configuration.")]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Run the own code that a run's folder names, and remember that it may run."),
]
OneClock = Annotated[float | None, typer.Option("--clock", help="ClockSpeed.")]
OneCommand = Annotated[str | None, typer.Option("--command", help="adsc or tcsc.", autocompletion=_COMMANDS)]
Jobs = Annotated[int, typer.Option(help="Number of processes; more than 1 not in wall.")]
Engine = Annotated[
    str,
    typer.Option(
        help="What runs the --jobs: loky, ray or dask; never for wall games.",
        autocompletion=one_of("loky", "ray", "dask"),
    ),
]
Watch = Annotated[
    bool,
    typer.Option("--watch", help="Open a page in the browser that shows the flight; it changes no flight."),
]
WatchAt = Annotated[
    str | None,
    typer.Option(
        "--watch-at",
        help="The same at HOST, :PORT or HOST:PORT; by default 127.0.0.1:8080, or the next free port.",
    ),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Print what would be flown, and fly nothing.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", help="dotted.key=value for the configuration; repeatable.")
]
