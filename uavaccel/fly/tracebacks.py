"""Tracebacks as a script's user expects them: of the script and its libraries, not of what lets it fly."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from uavaccel.errors import UserError
from uavaccel.fly.patches import Patches

_OURS = str(Path(__file__).parent)


def hide_ours(error: BaseException | None) -> None:
    """Take this package's frames, such as those of its import hook, out of an exception and what it came from.

    The first frame stays: that of whoever shows it.
    """
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        hide_frames(error.__traceback__)
        if error.__cause__ is not None:
            hide_ours(error.__cause__)
        error = error.__context__


def hide_frames(trace: TracebackType | None) -> None:
    """Take them out of a traceback, behind its first frame."""
    while trace is not None:
        while trace.tb_next is not None and trace.tb_next.tb_frame.f_code.co_filename.startswith(_OURS):
            trace.tb_next = trace.tb_next.tb_next
        trace = trace.tb_next


def hide_frames_everywhere(patches: Patches) -> None:
    """Let what a script prints of an exception itself, or logs, be without them too; a UserError is its line alone."""
    kind = traceback.TracebackException
    original: Callable[..., None] = kind.__init__

    def init(
        self: traceback.TracebackException,
        exc_type: type[BaseException],
        exc_value: BaseException,
        exc_traceback: TracebackType | None,
        **options: object,
    ) -> None:
        hide_frames(exc_traceback)
        if isinstance(exc_value, UserError):
            exc_traceback = None
        original(self, exc_type, exc_value, exc_traceback, **options)

    patches.set(kind, "__init__", init)
