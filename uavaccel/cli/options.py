"""The options that several commands share, each defined once; what the shell completes."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from uavaccel.resources import experiments
from uavaccel.suites.keys import KEYS


def one_of(*values: str) -> Callable[[str], list[str]]:
    """Return the completion of an option that takes one of these values: those that begin with what has been typed."""
    return lambda incomplete: [value for value in values if value.startswith(incomplete)]


def shipped(incomplete: str) -> list[str]:
    """Complete the name of an experiment that ships."""
    return one_of(*experiments())(incomplete)


def option(shown: str | None, about: str, *declarations: str, **bounds: float) -> Any:
    """Return an option, `shown` so in the help; where that is words with bars between, it takes these alone.

    The shell completes them. `bounds` are `min` and `max` of a number.
    """
    how: dict[str, Any] = {"metavar": shown, "help": about, **bounds}
    if shown is None or "|" not in shown:
        return typer.Option(*declarations, **how)
    words = shown.split("|")

    def known(given: Any) -> Any:
        for value in given if isinstance(given, list) else [given]:
            if value not in (None, *words):
                raise typer.BadParameter(f"{value}: must be {' or '.join(words)}")
        return given

    return typer.Option(*declarations, **how, autocompletion=one_of(*words), callback=known)


def given_options(context: typer.Context) -> list[str]:
    """Return the names of the options and arguments that were typed."""
    sources = {each.opts[0]: context.get_parameter_source(each.name or "") for each in context.command.params}
    return [name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE"]


Timing = Annotated[str, option(KEYS["timing"].shown, f"{KEYS['timing'].help}.")]
Profile = Annotated[str, option(KEYS["profile"].shown, f"{KEYS['profile'].help}.")]
Scene = Annotated[str, option("NAME", "A scene of assets/mjcf.")]
Latency = Annotated[Path | None, option("FILE", "Latencies, as calibrate writes them; default: those that ship.")]
OF_TRUST = option(None, "Run the code that a run's folder or --set names, and remember that it may run.", "--trust")
OF_WATCH = option(None, "Show the flight in this machine's browser; that changes no flight.", "--watch")
Trust = Annotated[bool, OF_TRUST]
Watch = Annotated[bool, OF_WATCH]
SETS = "Set any key of the configuration; repeat for several."


OF_A_REQUEST = (
    ("jobs", int, 1, option("N", "Processes that fly; must be 1 with --timing wall.")),
    ("engine", str, "loky", option("loky|ray|dask", "What starts the --jobs.")),
    ("out", Path | None, None, option("RUN_DIR", "New run directory; default: one in runs/.")),
    ("resume", bool, False, option(None, "Go on with the run in --out, by its own configuration.", "--resume")),
    ("trust", bool, False, OF_TRUST),
    ("dry_run", bool, False, option(None, "Say what would be flown; fly nothing.", "--dry-run")),
    ("overrides", list[str] | None, (), option("DOTTED.KEY=VALUE", SETS, "--set")),
    ("watch", bool, False, OF_WATCH),
)
"""The options of every command that flies an experiment: the field of its RunRequest, type, default, what is shown."""


def requests(
    *keys: str, several: tuple[str, ...] = (), games: str | None = None
) -> Callable[[Callable[..., None]], Any]:
    """Decorate a command that flies an experiment: its first parameter is a RunRequest of the options that are added.

    These are an option for each of `keys`, which `several` may repeat, and those of every run. `games` is what the help
    of --games says.
    """
    asked: list[tuple[str, Any, Any, Any]] = []
    for name in keys:
        key, again = KEYS[name], "; repeat for several" if name in several else ""
        kind: Any = list[key.kind] if again else key.kind  # type: ignore[name-defined]
        about = (name == "games" and games) or key.help
        asked.append((name, kind | None, None, option(key.shown, f"{about}{again}.", key.option)))
    options = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, shown])
        for name, kind, default, shown in (*asked, *OF_A_REQUEST)
    ]

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        def command(**given: Any) -> None:
            from uavaccel.suites.session import RunRequest

            asked = {option.name: given.pop(option.name) for option in options}
            function(RunRequest(None, {name: asked.pop(name) for name in keys}, **asked), **given)

        hints = get_type_hints(function, {**function.__globals__, "RunRequest": object}, include_extras=True)
        _, *own = signature(function).parameters.values()
        own = [each.replace(annotation=hints[each.name], kind=Parameter.KEYWORD_ONLY) for each in own]
        command.__name__, command.__doc__ = function.__name__, function.__doc__
        command.__signature__ = Signature([*own, *options])  # type: ignore[attr-defined]
        command.__annotations__ = {each.name: each.annotation for each in [*own, *options]}
        return command

    return decorate
