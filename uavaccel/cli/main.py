"""The command line: its commands, and how it ends.

Exit status: 0 done; 1 one clear line on standard error; 2 wrong usage; 130 interrupted,
by Ctrl-C or SIGTERM.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

import typer

from uavaccel.cli.airsim_commands import fly, serve
from uavaccel.cli.experiment_commands import evaluate, run, train
from uavaccel.cli.machine_commands import advise, bench, calibrate, doctor
from uavaccel.cli.result_commands import export, report, view, watch
from uavaccel.cli.starter_commands import init, schema
from uavaccel.errors import mistake_of

COMMANDS: list[Callable[..., None]] = [
    *(run, report, view, watch, calibrate, advise, train, evaluate),
    *(export, bench, serve, fly, init, schema, doctor),
]
"""In the order of `uavaccel --help`."""

app = typer.Typer(
    name="uavaccel",
    help="Fast, time-controlled quadrotor simulation, and what the acceleration costs.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in COMMANDS:  # what follows a script is its own
    app.command(context_settings={"allow_interspersed_args": command is not fly})(command)


def main() -> None:
    """Entry point: a user's mistake is one line, never a traceback."""
    _open_closed_streams()
    signal.signal(signal.SIGTERM, _as_ctrl_c)
    try:
        status = app(sys.argv[1:] or ["--help"], prog_name="uavaccel", standalone_mode=False)
        sys.stdout.flush()
    except (KeyboardInterrupt, typer.Abort):
        status = _complain("interrupted", 130)
    except typer.Exit as error:
        status = error.exit_code
    except BrokenPipeError:  # nobody reads what is printed any more, as behind `| head`
        status = 0
    except SystemExit as end:  # how the command line's own library ends a completion, and at such a pipe
        status = 0 if isinstance(end.__context__, BrokenPipeError) else end.code
    except Exception as error:
        status = _status_of(error)
    _leave_unread_output()
    sys.exit(status if isinstance(status, int) else 0)


def _as_ctrl_c(number: int, frame: FrameType | None) -> None:
    """SIGTERM, with which batch systems end a job, is heeded as Ctrl-C is, also where a shell has that ignored."""
    heeded = signal.getsignal(signal.SIGINT)
    (heeded if callable(heeded) else signal.default_int_handler)(signal.SIGINT, frame)


def _status_of(error: Exception) -> int:
    """Print the one line of a mistake; its exit status. Raises the error where it is none of the user's."""
    if hasattr(error, "format_message"):  # one of the command line's own
        return _complain(error.format_message(), 2)
    mistake = mistake_of(error)
    if mistake is None:
        raise error
    return _complain(str(mistake), mistake.exit_status)


def _complain(message: str, status: int) -> int:
    line = " ".join(message.split("\n"))
    with contextlib.suppress(OSError):
        print(f"uavaccel: error: {line}" if status != 130 else f"uavaccel: {line}", file=sys.stderr)
    return status


def _open_closed_streams() -> None:
    """A stream that was closed before we began leaves its number to the next file: into which all would be printed."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)
            if descriptor != number:
                os.dup2(descriptor, number)
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w"))


def _leave_unread_output() -> None:
    """What cannot be printed is dropped here, else the interpreter would complain of it at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
