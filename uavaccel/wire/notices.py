"""Tells the server's user, once each, about calls that were refused or have less effect than in AirSim.

AirSim's `join` swallows the error of a command, so that a script can end well although nothing ever flew.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

MOST = 200  # kinds that are told apart: names and texts come from clients
LONGEST = 300  # characters of a text


class Notices:
    """Lines that are shown once each by `say`."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say
        self._said: set[str] = set()

    def once(self, line: str) -> None:
        """Show a line, unless it was shown before."""
        if line not in self._said:
            self._said.add(line)
            self.say(line)


class Refusals:
    """Counts refused calls by method and reason; `say` shows a line at the first of each."""

    def __init__(self) -> None:
        self.say: Callable[[str], None] = lambda line: None
        self._count: Counter[tuple[str, str]] = Counter()

    def add(self, method: str, reason: str) -> None:
        """Count a refusal; the method's name may be any text that a client sent."""
        key = printable(method), printable(reason)
        if key not in self._count and len(self._count) >= MOST:
            key = "other calls", "were refused"
        self._count[key] += 1
        if self._count[key] == 1:
            self.say(" ".join(key))

    def lines(self) -> list[str]:
        """Return one line per kind of refusal with its count, the most frequent first."""
        return [f"{count} x {method} {reason}" for (method, reason), count in self._count.most_common()]


def printable(text: str) -> str:
    """Return a client's text on one line, without control characters."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:LONGEST])
