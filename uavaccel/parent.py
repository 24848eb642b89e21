"""A process that ends with the one that started it, even where that was killed and could tell nobody."""

from __future__ import annotations

import os
import select
import signal
import threading


def end_with_parent() -> None:
    """From now on this process is killed as soon as its parent is gone (Linux; elsewhere nothing happens).

    Whatever it does then cannot be wanted any more, and no handler of its own may hold it up.
    """
    parent = os.getppid()
    if not hasattr(os, "pidfd_open"):
        return
    try:
        descriptor = os.pidfd_open(parent)
    except OSError:  # it has gone already
        os.kill(os.getpid(), signal.SIGKILL)
        return
    if os.getppid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
    threading.Thread(target=_wait_and_end, args=(descriptor,), daemon=True, name="end with parent").start()


def _wait_and_end(parent: int) -> None:
    waiting = select.poll()
    waiting.register(parent, select.POLLIN)
    waiting.poll()
    os.kill(os.getpid(), signal.SIGKILL)
