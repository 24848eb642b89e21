"""A process that ends with the one that started it, even where that was killed and could tell nobody."""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable

END_WITH_PARENT = "end with parent"  # the thread that looks at it
_BOUND: set[int] = set()


def work_for_parent(parent: int) -> None:
    """As `end_with_parent`, and Ctrl-C is the parent's to handle. For the main thread; a second time it does nothing.

    This module imports nothing heavy, so that a process may call it before it imports what is.
    """
    if os.getpid() not in _BOUND:
        _BOUND.add(os.getpid())
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        end_with_parent(parent)


def end_with_parent(parent: int, last: Callable[[], object] = lambda: None) -> None:
    """From now on this process is killed as soon as its parent is gone (Linux; elsewhere nothing happens).

    Whatever it does then cannot be wanted any more, and no handler of its own may hold it up; `last` is done before.
    `parent` is the process that started it, which may be gone by now: who is asked for it then has got another one.
    """
    if not hasattr(os, "pidfd_open"):
        return
    try:
        descriptor = os.pidfd_open(parent)
    except OSError:  # it has gone already
        _end(last)
        return
    if os.getppid() != parent:
        _end(last)
    threading.Thread(target=_wait_and_end, args=(descriptor, last), daemon=True, name=END_WITH_PARENT).start()
    return


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
