"""A reply that is not due yet: nobody waits inside the simulation, whoever asked is answered when the time has come."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class DeferredReply:
    """A reply that is not yet due: `join` of a command, or a continue-for."""

    def __init__(self) -> None:
        self.value: object = None
        self.encode: Callable[[Any], object] = lambda value: value  # as the wire wants it
        self.due_wall_ns: int | None = None
        self.on_due: Callable[[DeferredReply], None] | None = None

    def resolve(self, value: object, wall_ns: int) -> None:
        """Fix the reply and the wall time before which it may not leave."""
        self.value, self.due_wall_ns = value, wall_ns
        if self.on_due is not None:
            self.on_due(self)
