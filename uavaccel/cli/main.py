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

import typer

from uavaccel.cli.airsim import fly, serve
from uavaccel.cli.experiments import evaluate, report, run, train
from uavaccel.cli.machine import advise, bench, calibrate, doctor, init, schema
from uavaccel.cli.results import export, view, watch
from uavaccel.errors import UsageError, UserError, mistake_of
from uavaccel.processes.stalls import guard_children

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
OF_OTHERS = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
for command in COMMANDS:  # what follows a script are its own arguments, and what follows bench those of the benchmarks
    app.command(context_settings=OF_OTHERS if command is bench else {"allow_interspersed_args": command is not fly})(
        command
    )


def main(before: Sequence[str] = ()) -> None:
    """Run the command line, `before` and what was typed; a mistake is printed as one line, never as a traceback."""
    words = [*before, *sys.argv[1:]]
    _open_closed_streams()
    signal.signal(signal.SIGTERM, _as_ctrl_c)
    guard_children(lambda line: _print(f"warning: {line}"))
    try:
        _check_threads()
        _refuse_empty(words)
        status = app(words or ["--help"], prog_name="uavaccel", standalone_mode=False)
        sys.stdout.flush()
    except (KeyboardInterrupt, typer.Abort):
        status = _complain("interrupted", 130)
    except typer.Exit as error:
        status = error.exit_code
    except BrokenPipeError:  # nobody reads the output any more, as in `| head`
        status = 0
    except SystemExit as end:  # raised by the command line's library after a completion, and at such a pipe
        status = 0 if isinstance(end.__context__, BrokenPipeError) else end.code
    except Exception as error:
        status = _status_of(error)
    _leave_unread_output()
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


def _status_of(error: Exception) -> int:
    """Print the line of a user's mistake, and return its exit status. Raises any other error."""
    if hasattr(error, "format_message"):  # an error of the command line's library
        return _complain(error.format_message(), 2)
    mistake = mistake_of(error)
    if mistake is None:
        raise error
    return _complain(str(mistake), mistake.exit_status)


def _complain(message: str, status: int) -> int:
    line = " ".join(message.split("\n"))
    _print(f"error: {line}" if status != 130 else line)
    return status


def _print(line: str) -> None:
    with contextlib.suppress(OSError):
        print(f"uavaccel: {line}", file=sys.stderr, flush=True)


def _check_threads() -> None:
    """Raise UserError for a number of threads at which numba could not be imported."""
    with contextlib.suppress(ValueError):  # numba leaves alone what is no number
        if int(given := os.environ.get("NUMBA_NUM_THREADS", "1")) < 1:
            raise UserError(f"NUMBA_NUM_THREADS={given}: must be at least 1; leave it unset for one per core")


def _open_closed_streams() -> None:
    """Open standard streams that were closed: the next file would get their numbers, and all output with them."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)
            if descriptor != number:
                os.dup2(descriptor, number)
            os.set_inheritable(number, True)  # to this program's processes
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w"))


def _leave_unread_output() -> None:
    """Drop output that cannot be printed; otherwise the interpreter would complain about it at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
