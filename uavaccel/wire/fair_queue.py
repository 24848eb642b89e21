"""Fair queueing of clients: the one that would have been served least comes next.

After Demers, Keshav and Shenker (SIGCOMM 1989). How long a request takes is estimated from earlier requests of its
method. A client that was idle has no claim on past time.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Container
from typing import Generic, Protocol, TypeVar


class QueuedClient(Protocol):
    """A client in the queue."""

    served_ns: int
    """Wall time spent on the client; its idle time counts as if it had been served fairly."""
    has_turn: bool


Client = TypeVar("Client", bound=QueuedClient)


class FairQueue(Generic[Client]):
    """The queue of clients with a request; `expected_ns` estimates how long a client's next request takes."""

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
        """Queue a client, which `begins` to send requests or continues; no effect if it is queued already."""
        if client.has_turn:
            return
        client.has_turn = True
        if begins:
            client.served_ns = max(client.served_ns, self._least_ns())
        self._number += 1
        heapq.heappush(self._queue, (client.served_ns + self._expected_ns(client), self._number, client))

    def next(self) -> Client:
        """Take the next client out of the queue."""
        while True:
            end_ns, number, client = self._queue[0]
            now_expected_ns = client.served_ns + self._expected_ns(client)
            if now_expected_ns <= end_ns:
                break
            heapq.heapreplace(self._queue, (now_expected_ns, number, client))  # the estimate has grown since
        heapq.heappop(self._queue)
        client.has_turn = False
        self._last = client
        return client

    def _least_ns(self) -> int:
        """Return the least service among the queued clients; that of the last one served if none is queued."""
        if self._queue:
            return min(client.served_ns for _, _, client in self._queue)
        return self._last.served_ns if self._last is not None else 0


class DurationEstimates:
    """Estimates how long calls, and items of results, take: a recent mean that a single delay changes little."""

    def __init__(self, methods: Container[str]) -> None:
        self._methods = methods
        self._expected_ns: dict[tuple[str, bool], int] = {}

    def expected_ns(self, method: str, piece: bool) -> int:
        return self._expected_ns.get((method, piece), 0)

    def took(self, method: str, piece: bool, wall_ns: int) -> None:
        """Learn from the duration of a call, or of a `piece` of its result."""
        if method in self._methods:  # names come from clients
            before_ns = self._expected_ns.get((method, piece), wall_ns)
            self._expected_ns[method, piece] = (3 * before_ns + min(wall_ns, 2 * before_ns + 1)) // 4
