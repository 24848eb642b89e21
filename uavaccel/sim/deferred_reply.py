"""A reply that is due later than its call: the simulation does not wait, but resolves the reply in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class DeferredReply:
    """The pending reply of a command's `join`, or of a continue-for."""

    def __init__(self) -> None:
        self.value: object = None
        self.encode: Callable[[Any], object] = lambda value: value  # to the form of the wire
        self.due_wall_ns: int | None = None
        self.on_due: Callable[[DeferredReply], None] | None = None

    def resolve(self, value: object, wall_ns: int) -> None:
        """Set the value, and the wall time before which the reply may not be sent."""
        self.value, self.due_wall_ns = value, wall_ns
        if self.on_due is not None:
            self.on_due(self)
