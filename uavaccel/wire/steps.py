"""A result that is made piece by piece, so that others need not wait for the whole of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any


class Steps:
    """A list in the making. What makes a piece may raise."""

    def __init__(self, pieces: Iterator[Any]) -> None:
        self._pieces = pieces
        self.made: list[Any] = []

    def advance(self) -> bool:
        """Make one more piece; False when there is none left."""
        for piece in self._pieces:
            self.made.append(piece)
            return True
        return False
