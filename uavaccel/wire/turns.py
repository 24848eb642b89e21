"""Whose requests are served next: who would have been served least comes first, so that nobody waits for a crowd.

Weighted fair queueing (Demers, Keshav, Shenker, SIGCOMM 1989); how long a request takes is learned from those before
it of its method. Who begins to ask has no claim on time that is past.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Container
from typing import Generic, Protocol, TypeVar


class Served(Protocol):
    """A client in the queue."""

    served_ns: int
    """Wall time that has been spent on it, or would have been if it had always asked."""
    has_turn: bool


Client = TypeVar("Client", bound=Served)


class Turns(Generic[Client]):
    """The clients that ask for something; `expected_ns` says how long what one asks for next will take."""

    def __init__(self, expected_ns: Callable[[Client], int]) -> None:
        self._expected_ns = expected_ns
        self._queue: list[tuple[int, int, Client]] = []
        self._last: Client | None = None
        self._number = 0

    def __bool__(self) -> bool:
        return bool(self._queue)

    def __len__(self) -> int:
        return len(self._queue)

    def add(self, client: Client, begins: bool = True) -> None:
        """It asks, begins to ask or goes on; nothing happens if it is waiting for its turn already."""
        if client.has_turn:
            return
        client.has_turn = True
        if begins:
            client.served_ns = max(client.served_ns, self._least_ns())
        self._number += 1
        heapq.heappush(self._queue, (client.served_ns + self._expected_ns(client), self._number, client))

    def next(self) -> Client:
        """Whose turn it is; it has to be added again for another."""
        while True:
            end_ns, number, client = self._queue[0]
            now_expected_ns = client.served_ns + self._expected_ns(client)
            if now_expected_ns <= end_ns:
                break
            heapq.heapreplace(self._queue, (now_expected_ns, number, client))  # such calls took longer since
        heapq.heappop(self._queue)
        client.has_turn = False
        self._last = client
        return client

    def _least_ns(self) -> int:
        """What those have been served who wait, the least of them; or the last who did."""
        if self._queue:
            return min(client.served_ns for _, _, client in self._queue)
        return self._last.served_ns if self._last is not None else 0


class Costs:
    """What calls, and pieces of results, take: about the mean of late, which one that was held up changes little."""

    def __init__(self, methods: Container[str]) -> None:
        self._methods = methods
        self._expected_ns: dict[tuple[str, bool], int] = {}

    def expected_ns(self, method: str, piece: bool) -> int:
        return self._expected_ns.get((method, piece), 0)

    def took(self, method: str, piece: bool, wall_ns: int) -> None:
        """A call has taken so long, or a `piece` of its result."""
        if method in self._methods:  # names come from clients
            before_ns = self._expected_ns.get((method, piece), wall_ns)
            self._expected_ns[method, piece] = (3 * before_ns + min(wall_ns, 2 * before_ns + 1)) // 4
