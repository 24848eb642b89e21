"""What clients make the server hold: unfinished messages, pictures in the making, answers that they do not read.

There is one budget for all of them together. Who holds most of it goes first when it is overdrawn.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

MOST_HELD_BYTES = 1 << 28
MAX_ANSWER_BYTES = 1 << 26  # of one answer
READ_FIRST_BYTES = 1 << 23  # a client with so much to read is asked for nothing more, until it has read

Client = TypeVar("Client", bound=Hashable)


class Held(Generic[Client]):
    """Bytes by client."""

    def __init__(self) -> None:
        self._bytes: dict[Client, int] = {}
        self._total = 0

    def note(self, client: Client, held_bytes: int) -> None:
        """It holds so much now."""
        self._total += held_bytes - self._bytes.pop(client, 0)
        if held_bytes:
            self._bytes[client] = held_bytes

    def overdrawn_by(self) -> tuple[Client, int] | None:
        """Who holds most, and how much, where all hold too much together."""
        if self._total <= MOST_HELD_BYTES:
            return None
        most = max(self._bytes, key=self._bytes.__getitem__)
        return most, self._bytes[most]
