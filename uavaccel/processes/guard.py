"""Stopped processes below a command: they are ended, which whoever waits for them notices as he does any other end.

A process that was stopped ends neither by itself nor with its parent, so without this its command would wait for ever.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from textwrap import shorten
from types import FrameType

from uavaccel.processes.stalls import POLL_S, command_of, is_stopped, with_children

STOPPED_POLLS = 8  # more than those have patience for who wait for an answer, and can say more about it
_GUARDING: set[int] = set()


def guard_children(say: Callable[[str], object]) -> None:
    """From now on end processes below this one that stay stopped, and `say` a line about each; on Linux only.

    At Ctrl-C, and at the end of this process, those that are stopped are ended at once. Call it in the main
    thread; a second call does nothing.
    """
    if os.getpid() in _GUARDING:
        return
    _GUARDING.add(os.getpid())
    threading.Thread(target=_look, args=(say,), daemon=True, name="guard").start()
    atexit.register(end_stopped)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)


def end_stopped() -> None:
    """End every process below this one that is stopped."""
    for pid in _stopped():
        _kill(pid)


def _stopped() -> list[int]:
    return [pid for pid in with_children(os.getpid())[1:] if is_stopped(pid)]


def _interrupt(number: int, frame: FrameType | None) -> None:
    end_stopped()
    signal.default_int_handler(number, frame)


def _look(say: Callable[[str], object]) -> None:
    polls: dict[int, int] = {}
    while not threading.Event().wait(POLL_S):
        polls = {pid: polls.get(pid, 0) + 1 for pid in _stopped()}
        for pid in (poll for poll, count in polls.items() if count == STOPPED_POLLS):
            command = shorten(command_of(pid), 100, placeholder=" ...")
            _kill(pid)
            say(f"process {pid} ({command}) was stopped, and was ended since it did not go on")


def _kill(pid: int) -> None:
    with suppress(OSError):  # it has ended, or is another's
        os.kill(pid, signal.SIGKILL)
