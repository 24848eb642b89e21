"""The entry point of the command line: its commands, its errors and its exit status.

Exit status: 0 for success; 1 for a mistake in the input, with one line on standard error; 2 for wrong usage; 130 if
interrupted by Ctrl-C or SIGTERM.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from uavaccel import __version__
from uavaccel.cli.experiments import evaluate, run, train
from uavaccel.cli.flights import export, fly, serve, watch
from uavaccel.cli.machine import advise, bench, calibrate, certify, doctor, init, measure
from uavaccel.errors import UsageError, UserError, mistake_of
from uavaccel.processes.lifetime import collect_rarely, lost_interrupts_repeated
from uavaccel.processes.stalls import guard_children

PANELS: dict[str, tuple[Callable[..., None], ...]] = {
    "Learn": (init, train, evaluate, watch, export),
    "AirSim": (fly, serve),
    "Experiments": (run,),
    "Machine": (doctor,),
}
"""In the order of `uavaccel --help`."""
TIMING = "timing"
MOVED = {
    "report": "run --report RUN_DIR",
    "view": "watch RUN --film FILE",
    "schema": "init --schema SUITE",
    "advise": f"{TIMING} advise",
    "calibrate": f"{TIMING} calibrate",
}
OF_OTHERS = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}


class Surface(TyperGroup):
    """The commands, listed by panel; one that has moved says where to."""

    def list_commands(self, ctx: Any) -> list[str]:
        return [name for name, command in self.commands.items() if not command.hidden]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        listed: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command: Any = self.commands[name]
            listed.setdefault(command.rich_help_panel, []).append((f"{name:8}", command.short_help))
        for panel, lines in listed.items():
            formatter.write_heading(panel)
            with formatter.indentation():
                formatter.write_dl(lines)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args[0] in MOVED:
            raise UsageError(f"{args[0]}: is now uavaccel {MOVED[args[0]]}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:  # of which Typer makes a status alone
            raise typer.Abort from None


def _add(command: Callable[..., None], group: typer.Typer, settings: dict[str, Any] | None = None, **how: Any) -> None:
    """Add a command; the first line of its docstring is what lists of commands say of it."""
    group.command(short_help=(command.__doc__ or "").partition("\n")[0], context_settings=settings, **how)(command)


PLAIN: dict[str, Any] = {"pretty_exceptions_enable": False, "rich_markup_mode": None}
app = typer.Typer(cls=Surface, context_settings={"help_option_names": ["-h", "--help"]}, **PLAIN)
for panel, commands in PANELS.items():
    for command in commands:  # what follows a script are its own arguments
        _add(command, app, {"allow_interspersed_args": command is not fly}, rich_help_panel=panel)
_add(bench, app, OF_OTHERS, hidden=True)
timing = typer.Typer(**PLAIN)
for command in (advise, calibrate, measure, certify):
    _add(command, timing)
ABOUT_TIMING = "Latency of messages: calibrate, advise; policies: measure, certify."
app.add_typer(timing, name=TIMING, help=ABOUT_TIMING, short_help=ABOUT_TIMING, rich_help_panel="Machine")


def _print_version(asked: bool) -> None:
    if asked:
        print(f"uavaccel {__version__}")
        raise typer.Exit


@app.callback()
def surface(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Fast, time-controlled quadrotor simulation, and what the acceleration costs."""


@lost_interrupts_repeated()
def main(before: Sequence[str] = ()) -> None:
    """Run the command line, `before` and what was typed; a mistake is printed as one line, never as a traceback."""
    collect_rarely()
    words = [*before, *sys.argv[1:]]
    _open_closed_streams()
    signal.signal(signal.SIGTERM, _as_ctrl_c)
    guard_children(lambda line: _complain(f"warning: {line}"))
    try:
        threads = os.environ.get("NUMBA_NUM_THREADS", "1")
        if threads.removeprefix("-").isdecimal() and int(threads) < 1:  # numba leaves alone what is no number
            raise UserError(f"NUMBA_NUM_THREADS={threads}: must be at least 1; leave it unset for one per core")
        _refuse_empty(words)
        asks = words in ([], [TIMING])  # a group alone
        status = app([*words, "--help"] if asks else words, prog_name="uavaccel", standalone_mode=False)
        sys.stdout.flush()
    except (KeyboardInterrupt, typer.Abort):
        status = _complain("interrupted")
    except typer.Exit as error:
        status = error.exit_code
    except BrokenPipeError:  # nobody reads the output any more, as in `| head`
        status = 0
    except SystemExit as end:  # raised by the command line's library after a completion, and at such a pipe
        status = 0 if isinstance(end.__context__, BrokenPipeError) else end.code
    except Exception as error:
        status = _status_of(error)
    try:
        sys.stdout.flush()
    except OSError:  # output that cannot be printed, of which the interpreter would complain at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(status if isinstance(status, int) else 0)


def _refuse_empty(words: list[str]) -> None:
    """Raise UsageError for an empty word, which would be taken for the working directory; a script has its own."""
    for before, word in zip(["", *words], words, strict=False):
        if before.endswith(".py"):
            return
        option = before if not word else word[:-1]
        if not word or (word.startswith("--") and word.endswith("=")):
            raise UsageError(f"{option or 'the command'}: is followed by an empty text; leave it out, or say what")


def _as_ctrl_c(number: int, frame: FrameType | None) -> None:
    """Handle SIGTERM, by which batch systems end a job, like Ctrl-C, even if the shell has that ignored."""
    handler = signal.getsignal(signal.SIGINT)
    (handler if callable(handler) else signal.default_int_handler)(signal.SIGINT, frame)


def _status_of(error: Any) -> int:
    """Print the line of a user's mistake, and return its exit status. Raises any other error."""
    if hasattr(error, "format_message"):  # of the command line's library
        said = error.format_message()
        if hasattr(error.__cause__, "errors"):  # pydantic's, of an option's value
            first = error.__cause__.errors()[0]
            said = f"{error.param.opts[0]} {first['input']}: {first['msg'].removeprefix('Input ').partition(',')[0]}"
        return _complain(said, 2)
    if (mistake := mistake_of(error)) is None:
        raise error
    return _complain(str(mistake), mistake.exit_status)


def _complain(message: str, status: int = 130) -> int:
    """Print one line on standard error, which may be closed, and return the status; that of no error is 130."""
    line = " ".join(message.split("\n"))
    with contextlib.suppress(OSError):
        print(f"uavaccel: {'error: ' if status != 130 else ''}{line}", file=sys.stderr, flush=True)
    return status


def _open_closed_streams() -> None:
    """Open standard streams that were closed: the next file would get their numbers, and all output with them."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)
            if descriptor != number:
                os.dup2(descriptor, number)
            os.set_inheritable(number, True)  # to this program's processes
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w"))
