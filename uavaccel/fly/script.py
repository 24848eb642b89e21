"""Runs a script as `python script.py` does: with its name, arguments, folder and tracebacks."""

from __future__ import annotations

import atexit
import gc
import io
import os
import sys
import traceback
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import CodeType, ModuleType, TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.files import read_bounded
from uavaccel.fly.modules import Patches, called_by_a_script, of_a_script
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:
    from typing_extensions import Buffer

_OURS = str(Path(__file__).parent)
INTERRUPTED = 130  # exit status
ARRAY_AS_NUMBER = "only 0-dimensional arrays can be converted"  # since NumPy 2.4
ADVICE = "NumPy before 2.4 still takes an array of one element for a number: pip install 'numpy<2.4'"


def hide_ours(error: BaseException | None) -> None:
    """Remove this package's frames, such as its import hook's, from an exception and its causes; a UserError has none.

    The first frame stays: it belongs to whoever prints the exception.
    """
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        hide_frames(error.__traceback__)
        if isinstance(error, UserError):
            error.__cause__, error.__suppress_context__ = None, True
        if error.__cause__ is not None:
            hide_ours(error.__cause__)
        error = error.__context__


def hide_frames(trace: TracebackType | None) -> None:
    """Remove this package's frames from a traceback, except its first frame."""
    while trace is not None:
        while trace.tb_next is not None and trace.tb_next.tb_frame.f_code.co_filename.startswith(_OURS):
            trace.tb_next = trace.tb_next.tb_next
        trace = trace.tb_next


def hide_frames_everywhere(patches: Patches) -> None:
    """Remove them from tracebacks that the script itself prints or logs, too; of a UserError only its line is left."""
    kind = traceback.TracebackException
    original: Callable[..., None] = kind.__init__

    def init(self: Any, exc_type: Any, exc_value: Any, exc_traceback: TracebackType | None, **options: Any) -> None:
        hide_ours(exc_value)
        shown = None if isinstance(exc_value, UserError) else exc_traceback
        original(self, exc_type, exc_value, shown, **options)

    patches.set(kind, "__init__", init)


class FlightOver(BaseException):
    """Ends the script at the end of its flight; a BaseException, which its `except Exception` does not catch.

    Every call raises it from then on. The process of a script that catches it again and again is ended by `end`, which
    first writes what was flown.
    """

    MOST = 1000
    raised = 0
    end: Callable[[float], None] = staticmethod(lambda wall_s: os._exit(1))
    clock, begun_ns = MonotonicClock(), 0  # of the script

    def __init__(self) -> None:
        FlightOver.raised += 1
        if FlightOver.raised > self.MOST:
            FlightOver.raised = 0  # of what ends it
            flush_output()
            print("uavaccel: the script catches every exception and does not end; it is ended here", file=sys.stderr)
            FlightOver.end((self.clock.now_ns() - self.begun_ns) / NS_PER_S)


def unraisable(event: sys.UnraisableHookArgs) -> None:
    """A sys.unraisablehook that ignores the end of the flight in destructors."""
    if not isinstance(event.exc_value, FlightOver):
        sys.__unraisablehook__(event)


class ScriptResult(NamedTuple):
    """How a script ended: its exit status, whether it finished by itself, and the machine's wall time that it took.

    `error` is the exception that ended it, in one line, if one did.
    """

    status: int
    finished: bool
    wall_s: float
    error: str | None = None


def run_script(path: Path, arguments: tuple[str, ...], outlive: Callable[[], None] = lambda: None) -> ScriptResult:
    """Run the file as `__main__`, then call `outlive` to wait for its threads; prints the tracebacks of exceptions.

    Raises UserError if the file cannot be read or is not Python.
    """
    code, clock, error = compiled(path), FlightOver.clock, None
    begun_ns = FlightOver.begun_ns = clock.now_ns()
    with _still_flying_at_exit():
        try:
            (status, error), finished = _run(code, path, arguments), True
            outlive()
        except FlightOver:
            status, finished = 0, False
        except KeyboardInterrupt:
            status, finished = INTERRUPTED, False
    return ScriptResult(status, finished, (clock.now_ns() - begun_ns) / NS_PER_S, error)


@contextmanager
def _still_flying_at_exit() -> Iterator[None]:
    """At the end of the `with` block, call what the script has registered with `atexit`, and destroy what it holds.

    All of that may still fly.
    """
    register, unregister = atexit.register, atexit.unregister
    last: Callable[..., object] = _let_go
    acts = [partial(last, frozenset(sys.modules) - {"__main__"})]

    def register_for(function: Callable[..., object], /, *given: object, **named: object) -> Callable[..., object]:
        if not called_by_a_script(()):
            return register(function, *given, **named)
        acts.append(partial(function, *given, **named))
        return function

    def unregister_for(function: Callable[..., object]) -> None:
        acts[:] = [act for act in acts if act.func != function]
        unregister(function)

    with Patches() as patches:
        patches.set(atexit, "register", register_for)
        patches.set(atexit, "unregister", unregister_for)
        yield
    while acts:
        act = acts.pop()
        try:
            act()
        except (FlightOver, KeyboardInterrupt):
            pass
        except (Exception, SystemExit) as error:
            error.__traceback__ = error.__traceback__ and error.__traceback__.tb_next  # without this frame
            print(f"Exception ignored in atexit callback: {act.func!r}", file=sys.stderr)
            traceback.print_exception(error)


def _run(code: CodeType, path: Path, arguments: tuple[str, ...]) -> tuple[int, str | None]:
    main = ModuleType("__main__")
    main.__file__, main.__builtins__ = code.co_filename, __builtins__  # type: ignore[attr-defined]
    sys.modules["__main__"] = main
    sys.argv[:] = [str(path), *arguments]
    sys.path[0:1] = [str(path.resolve().parent)]
    try:
        exec(code, vars(main))
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return end.code or 0, None
        print(end.code, file=sys.stderr)
        return 1, None
    except UserError:
        raise
    except Exception as error:
        first = error.__traceback__
        while first is not None and first.tb_frame.f_code.co_filename != code.co_filename:
            first = first.tb_next
        error.__traceback__ = first or error.__traceback__  # from the script's first frame on
        traceback.print_exception(error)
        if isinstance(error, TypeError) and ARRAY_AS_NUMBER in str(error):
            print(f"uavaccel: {ADVICE}", file=sys.stderr)
        return 1, f"{type(error).__name__}: {error}".partition("\n")[0].removesuffix(": ")
    return 0, None


def _let_go(before: Collection[str]) -> None:
    """Destroy what the script and its modules hold, as Python does at its end, if any of it has a destructor.

    The modules `before` it are not its own.
    """
    modules = {name: module for name, module in sys.modules.items() if name not in before}
    loaded = {name: vars(module) for name, module in modules.items() if isinstance(module, ModuleType)}
    own = {name: namespace for name, namespace in loaded.items() if of_a_script(namespace)}
    has_destructors = any(map(_has_destructors, own.values()))
    for name in own if has_destructors else ():
        del sys.modules[name]
    sys.modules["__main__"] = ModuleType("__main__")
    if has_destructors:
        del modules, loaded, own
        gc.collect()


def _has_destructors(namespace: dict[str, object]) -> bool:
    return any(isinstance(value, type) and "__del__" in vars(value) for value in list(namespace.values()))


def compiled(path: Path) -> CodeType:
    """Compile the script. Raises UserError if it cannot be read or is not Python."""
    try:
        source = read_bounded(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return compile(source, str(path.absolute()), "exec")
    except (SyntaxError, ValueError) as error:
        line = f":{error.lineno}" if isinstance(error, SyntaxError) and error.lineno else ""
        raise UserError(f"{path}{line}: not Python: {error.args[0]}") from None


class _Output(io.FileIO):
    """Standard output for a script: a full disk is a UserError, and nobody who reads it any more the flight's end."""

    def write(self, data: Buffer, /) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            raise FlightOver from None
        except OSError as error:
            raise UserError(f"standard output: {error.strerror}") from None


@contextmanager
def checked_output() -> Iterator[None]:
    """Let what the `with` block prints go through such an output."""
    before = sys.stdout
    raw = io.BufferedWriter(_Output(before.fileno(), "wb", closefd=False))
    sys.stdout = io.TextIOWrapper(
        raw, before.encoding, before.errors, line_buffering=True, write_through="PYTHONUNBUFFERED" in os.environ
    )
    try:
        yield
    finally:
        flush_output()
        sys.stdout = before


def flush_output() -> None:
    """Flush what the script has printed before anything is printed about it."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, UserError, FlightOver):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
