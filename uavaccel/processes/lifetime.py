"""Processes that end with their parent, even where that is killed."""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable

END_WITH_PARENT = "end with parent"  # name of the watching thread
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
    if descriptor is not None:
        arguments = descriptor, last
        threading.Thread(target=_wait_and_end, args=arguments, daemon=True, name=END_WITH_PARENT).start()


def _wait_and_end(parent: int, last: Callable[[], object]) -> None:
    waiting = select.poll()
    waiting.register(parent, select.POLLIN)
    waiting.poll()
    _end(last)


def _end(last: Callable[[], object]) -> None:
    try:
        last()
    finally:
        os.kill(os.getpid(), signal.SIGKILL)
