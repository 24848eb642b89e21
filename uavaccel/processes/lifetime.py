"""Child processes from both sides: their parent starts, watches and ends them; they end with it, even a killed one.

What killed ones leave behind is removed by the next. Nothing heavy is imported here, so that a process can bind itself
to its parent before it imports what takes seconds.
"""

from __future__ import annotations

import gc
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from uavaccel.processes.stalls import is_stopped

if TYPE_CHECKING:
    from uavaccel.processes.forks import Fork

Process = subprocess.Popen[bytes]
POLL_S = 0.25
STOPPED_S = 4.0  # a process that has been stopped for longer is not waited for
REPEAT_S = 0.05  # longer than a destructor takes
END_WITH_PARENT = "end with parent"  # name of the watching thread
SHARED_MEMORY = Path("/dev/shm")
OF_JOBLIB = re.compile(r"(?:sem\.loky-|joblib_memmapping_folder_)(\d+)[-_]")
_BOUND: set[int] = set()


def start_python(
    *arguments: str,
    environment: Mapping[str, str] | None = None,
    stdin: int | None = None,
    stdout: int | None = None,
    pass_fds: Sequence[int] = (),
    own_session: bool = True,
) -> Process:
    """Start this Python with `arguments`, such as "-m", a module and its options, and additions to the environment.

    In a session of its own it does not receive the terminal's Ctrl-C: this process handles it, and ends the child.
    """
    return subprocess.Popen(
        [sys.executable, *arguments],
        env={**os.environ, **(environment or {})},
        stdin=stdin,
        stdout=stdout,
        pass_fds=pass_fds,
        start_new_session=own_session,
    )


def single_core_rendering() -> dict[str, str]:
    """Return the variables by which Mesa draws on its caller's core; the user's own setting comes first."""
    return {"LP_NUM_THREADS": os.environ.get("LP_NUM_THREADS", "0")}


def end_within(process: Process | Fork, seconds: float) -> None:
    """Wait for a process that is about to end; kill it after `seconds`, and at once where it is stopped."""
    if is_stopped(process.pid):
        process.kill()
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def describe_end(status: int) -> str:
    """Return how a process with this return code ended, in words."""
    if status >= 0:
        return f"ended with status {status}"
    try:
        return f"was ended by {signal.Signals(-status).name}"
    except ValueError:
        return f"was ended by signal {-status}"


class Patience:
    """Counts for how long a process has been stopped."""

    def __init__(self, process: Process) -> None:
        self._process, self._polls = process, 0

    def is_over(self) -> bool:
        """Return whether it has been stopped for more than STOPPED_S; to be asked once every POLL_S."""
        self._polls = self._polls + 1 if is_stopped(self._process.pid) else 0
        return self._polls * POLL_S > STOPPED_S


class Watch:
    """A thread that watches a process: kills it once it stays stopped, and calls `tell` when it has gone.

    `lost` is empty while it runs, and then says what happened to it.
    """

    def __init__(self, process: Process, name: str, tell: Callable[[], None]) -> None:
        self.lost = ""
        self._process, self._name, self._tell = process, name, tell
        self._over, self._found = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True, name="watch")
        self._thread.start()

    def is_lost_soon(self) -> bool:
        """Return whether the process has gone, or is found to have gone within a second."""
        return self._found.wait(4 * POLL_S)

    def end(self) -> None:
        """Stop watching: from now on the process may end."""
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        patience = Patience(self._process)
        while not self._over.wait(POLL_S):
            status = self._process.poll()
            if status is None and not patience.is_over():
                continue
            self._process.kill()
            self.lost = f"{self._name} {'was stopped' if status is None else describe_end(status)}"
            self._found.set()
            return self._tell()
        return None


@contextmanager
def lost_interrupts_repeated() -> Iterator[None]:
    """Within this, a Ctrl-C or SIGTERM that meets a destructor or a weak reference's callback comes again after it.

    What these raise, KeyboardInterrupt included, Python prints, and goes on.
    """

    def repeat(lost: sys.UnraisableHookArgs) -> None:
        if lost.exc_type is KeyboardInterrupt:
            threading.Timer(REPEAT_S, os.kill, (os.getpid(), signal.SIGTERM)).start()
        else:
            before(lost)

    before, sys.unraisablehook = sys.unraisablehook, repeat
    try:
        yield
    finally:
        sys.unraisablehook = before


@contextmanager
def interrupts_kept_from_children() -> Iterator[None]:
    """Keep Ctrl-C from the processes that this thread, and threads begun by it, start, until `work_for_parent`."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # whose start would end this in Python 3.11
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def work_for_parent(parent: int) -> None:
    """End with the parent, and leave Ctrl-C to it. Call it in the main thread; a second call does nothing."""
    if os.getpid() not in _BOUND:
        _BOUND.add(os.getpid())
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if hasattr(signal, "pthread_sigmask"):  # for the processes that it starts
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        end_with_parent(parent)


def end_with_parent(parent: int, last: Callable[[], object] = lambda: None) -> None:
    """From now on, kill this process as soon as its parent has ended (on Linux; elsewhere nothing happens).

    It is killed, as its work is no longer needed, and no handler may delay it; `last` is called before. `parent` is the
    id of the process that started it, which may have ended by now, so that `os.getppid` would tell another one.
    """
    end_with_process(descriptor_of_parent(parent, last), last)


def descriptor_of_parent(parent: int, last: Callable[[], object] = lambda: None) -> int | None:
    """Return a descriptor of the parent, for forks too; None on systems without. It ends as `end_with_parent` does."""
    if not hasattr(os, "pidfd_open"):
        return None
    try:
        descriptor = os.pidfd_open(parent)
    except OSError:  # it has gone already
        _end(last)
        return None
    if os.getppid() != parent:
        _end(last)
    return descriptor


def end_with_process(descriptor: int | None, last: Callable[[], object] = lambda: None) -> None:
    """From now on, kill this process as soon as the process of the descriptor has ended; `last` is called before."""
    collect_rarely()
    if descriptor is None:
        return
    waiting = select.poll()
    waiting.register(descriptor, select.POLLIN)

    def wait() -> None:
        waiting.poll()
        _end(last)

    threading.Thread(target=wait, daemon=True, name=END_WITH_PARENT).start()


def collect_rarely() -> None:
    """Look for garbage after 10 000 new objects, not 700: a program loads a million that stay, and a fifth sooner."""
    gc.set_threshold(10_000)


def _end(last: Callable[[], object]) -> None:
    try:
        last()
    finally:
        os.kill(os.getpid(), signal.SIGKILL)


def remove_orphaned_files(folder: Path = SHARED_MEMORY, named_by: re.Pattern[str] = OF_JOBLIB) -> None:
    """Remove this user's files in `folder` whose process has ended; nothing happens without such a folder.

    `named_by` matches the names of such files; its first group is the id of the process.
    """
    if not folder.is_dir():
        return
    for path in folder.iterdir():
        named = named_by.match(path.name)
        with suppress(OSError):  # another run clears it too
            if named is None or path.stat().st_uid != os.getuid() or _alive(int(named[1])):
                continue
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is another's
        pass
    return True
