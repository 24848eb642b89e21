"""Processes that end with their parent, even where that is killed, and the removal of what killed ones leave behind."""

from __future__ import annotations

import os
import re
import select
import shutil
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

END_WITH_PARENT = "end with parent"  # name of the watching thread
SHARED_MEMORY = Path("/dev/shm")
OF_JOBLIB = re.compile(r"(?:sem\.loky-|joblib_memmapping_folder_)(\d+)[-_]")
_BOUND: set[int] = set()


def work_for_parent(parent: int) -> None:
    """End with the parent, and leave Ctrl-C to it. Call it in the main thread; a second call does nothing.

    This module imports nothing heavy, so that a process can call it before it imports what takes seconds.
    """
    if os.getpid() not in _BOUND:
        _BOUND.add(os.getpid())
        signal.signal(signal.SIGINT, signal.SIG_IGN)
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
    if descriptor is None:
        return
    waiting = select.poll()
    waiting.register(descriptor, select.POLLIN)

    def wait() -> None:
        waiting.poll()
        _end(last)

    threading.Thread(target=wait, daemon=True, name=END_WITH_PARENT).start()


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
