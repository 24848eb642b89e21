"""Calls that a server refused where their caller may never learn of it, counted, and each told once.

AirSim's `join` swallows the error of a command, so that a script can end well although nothing ever flew.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

COMMANDS = (
    "takeoff",
    "land",
    "goHome",
    "hover",
    "move",
    "rotate",
)  # how the names of asynchronous calls begin


class Refusals:
    """By method and reason, how often a call was refused; `tell` gets a line the first time."""

    def __init__(self) -> None:
        self.tell: Callable[[str], None] = lambda line: None
        self._count: Counter[tuple[str, str]] = Counter()

    def unknown(self, method: str) -> None:
        """A call of a method that there is not."""
        self._add(method, "is not known here")

    def command(self, method: str, error: str) -> None:
        """An error; it counts if the method is a command, which is joined without a look at its error."""
        if method.startswith(COMMANDS):
            self._add(method, f"was refused: {error}")

    def _add(self, method: str, reason: str) -> None:
        self._count[method, reason] += 1
        if self._count[method, reason] == 1:
            self.tell(f"{method} {reason}")

    def lines(self) -> list[str]:
        """What was refused, and how often, most often first."""
        return [
            f"{method} {reason} ({count} call{'s' if count > 1 else ''})"
            for (method, reason), count in self._count.most_common()
        ]
