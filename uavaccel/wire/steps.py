"""A result that is made piece by piece, so that others need not wait for the whole of it."""

from __future__ import annotations

from collections.abc import Iterator

from uavaccel.wire.rpc import bulk_bytes


class Steps:
    """A list in the making, and about how many bytes its packed pieces have. What makes a piece may raise."""

    def __init__(self, pieces: Iterator[object]) -> None:
        self._pieces = pieces
        self.made: list[object] = []
        self.held_bytes = 0

    def advance(self) -> bool:
        """Make one more piece; False when there is none left."""
        for piece in self._pieces:
            self.held_bytes += bulk_bytes(piece)
            self.made.append(piece)
            return True
        return False
