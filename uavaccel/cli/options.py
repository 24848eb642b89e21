"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Clock = Annotated[list[float] | None, typer.Option("--clock", help="ClockSpeed; repeat for several.")]
Commands = Annotated[list[str] | None, typer.Option("--command", help="adsc or tcsc; repeat for both.")]
Timing = Annotated[
    str | None, typer.Option(help="wall (measured), virtual (modelled) or lockstep (no latency).")
]
Profile = Annotated[str | None, typer.Option(help="native or airsim.")]
Seed = Annotated[int | None, typer.Option(help="Seed of every drawn number.")]
Out = Annotated[Path | None, typer.Option(help="Run directory to make; by default one in runs/.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with the run in --out, by its own configuration.")
]
OneClock = Annotated[float | None, typer.Option("--clock", help="ClockSpeed.")]
OneCommand = Annotated[str | None, typer.Option("--command", help="adsc or tcsc.")]
Jobs = Annotated[int, typer.Option(help="Processes; above 1 not with wall.")]
Engine = Annotated[str, typer.Option(help="What flies --jobs at once: loky, ray or dask; never wall games.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Say what would be flown, and fly nothing.")]
Overrides = Annotated[list[str] | None, typer.Option("--set", help="dotted.key=value of the configuration.")]
