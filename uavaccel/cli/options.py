"""The options that several commands share, each defined once; what the shell completes; checks of numbers and hosts."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from uavaccel.errors import UsageError, UserError
from uavaccel.resources import experiment_names
from uavaccel.suites.keys import KEYS

Complete = Callable[[str], list[str]]
"""The values that begin with what has been typed."""


def one_of(*values: str) -> Complete:
    """Return the completion of an option that takes one of these values."""
    return lambda incomplete: [value for value in values if value.startswith(incomplete)]


def experiments(incomplete: str) -> list[str]:
    """Complete the name of an experiment that ships."""
    return one_of(*experiment_names())(incomplete)


def _key(name: str, several: bool) -> Any:
    key = KEYS[name]
    repeats = "; repeat for several" if several else ""
    complete = one_of(*key.words) if key.words else None
    option = typer.Option(key.option, help=f"{key.help}{repeats}.", autocompletion=complete)
    return Annotated[list[key.kind] | None if several else key.kind | None, option]  # type: ignore[name-defined]


Timing = Annotated[str, typer.Option(help=f"{KEYS['timing'].help}.", autocompletion=one_of(*KEYS["timing"].words))]
Profile = Annotated[str, typer.Option(help=f"{KEYS['profile'].help}.", autocompletion=one_of(*KEYS["profile"].words))]
Scene = Annotated[str, typer.Option(help="A scene of assets/mjcf.")]
Case = Annotated[str | None, typer.Option(help="Name of the game in rows.jsonl; by default the fastest, or the best.")]
Latency = Annotated[
    Path | None, typer.Option(help="Latency model, as `calibrate` writes it; by default the shipped one.")
]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Run the own code that a run's folder or --set names, and remember that it may run."),
]
Watch = Annotated[
    bool,
    typer.Option("--watch", help="Open a page in this machine's browser that shows the flight; it changes no flight."),
]

_OF_A_REQUEST: dict[str, tuple[Any, object]] = {
    "jobs": (Annotated[int, typer.Option(help="Number of processes; more than 1 not in wall.")], 1),
    "engine": (
        Annotated[
            str,
            typer.Option(
                help="What runs the --jobs: loky, ray or dask; never for wall games.",
                autocompletion=one_of("loky", "ray", "dask"),
            ),
        ],
        "loky",
    ),
    "out": (Annotated[Path | None, typer.Option(help="New run directory; by default one in runs/.")], None),
    "resume": (
        Annotated[bool, typer.Option("--resume", help="Resume the run in --out with its own configuration.")],
        False,
    ),
    "trust": (Trust, False),
    "dry_run": (Annotated[bool, typer.Option("--dry-run", help="Print what would be flown, and fly nothing.")], False),
    "overrides": (
        Annotated[list[str] | None, typer.Option("--set", help="dotted.key=value for the configuration; repeatable.")],
        None,
    ),
    "watch": (Watch, False),
}
"""The options of every command that flies an experiment, by the fields of its RunRequest, with their defaults."""


def requests(*keys: str, several: tuple[str, ...] = (), jobs: bool = True) -> Callable[[Callable[..., None]], Any]:
    """Decorate a command that flies an experiment: its first parameter is a RunRequest of the options that are added.

    These are an option for each of `keys`, which `several` may repeat, and those of every run; without `jobs` one
    process flies.
    """
    options: dict[str, tuple[Any, object]] = {name: (_key(name, name in several), None) for name in keys}
    options |= {name: option for name, option in _OF_A_REQUEST.items() if jobs or name not in ("jobs", "engine")}

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        own = list(signature(function).parameters.values())[1:]
        hints = get_type_hints(function, {**function.__globals__, "RunRequest": object}, include_extras=True)

        def command(**given: Any) -> None:
            from uavaccel.suites.session import RunRequest

            asked = {name: given.pop(name) for name in options}
            asked["overrides"] = asked["overrides"] or ()
            request = RunRequest(None, {name: asked.pop(name) for name in keys}, **asked)
            function(request, **given)

        parameters = [each.replace(annotation=hints[each.name], kind=Parameter.KEYWORD_ONLY) for each in own]
        added = [
            Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for name, (annotation, default) in options.items()
        ]
        command.__name__, command.__doc__ = function.__name__, function.__doc__
        command.__signature__ = signature(function).replace(  # type: ignore[attr-defined]
            parameters=[*parameters, *added], return_annotation=None
        )
        command.__annotations__ = {each.name: each.annotation for each in [*parameters, *added]}
        return command

    return decorate


def check_number(option: str, value: float, least: float, most: float) -> None:
    """Raise UserError for a number outside of these bounds."""
    if not least <= value <= most:
        form = "g" if isinstance(value, float) else "d"
        raise UserError(f"{option} {value:{form}}: must be {least:{form}} to {most:{form}}")


def check_host(host: str) -> None:
    """Raise UsageError for an empty address, which sockets take for all addresses of this machine."""
    if not host.strip():
        raise UsageError("--host: is empty; name an address, as in --host 127.0.0.1")


def check_profile(profile: str) -> None:
    """Raise UserError for an unknown profile."""
    from uavaccel.sim.profile import PROFILES  # heavy

    if profile not in PROFILES:
        raise UserError(f"--profile {profile}: must be {' or '.join(PROFILES)}")
