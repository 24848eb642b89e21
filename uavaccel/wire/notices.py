"""What a server says on its terminal about calls that have less effect than their callers may think: each once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

MOST = 200  # kinds that are told apart: names and texts come from clients
LONGEST = 300  # characters of a text


class Notices:
    """Lines that are said once. `say` shows a line."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say
        self._said: set[str] = set()

    def once(self, line: str) -> None:
        """Say it, unless it was said before."""
        if line not in self._said:
            self._said.add(line)
            self.say(line)


class Refusals:
    """By method and reason, how often a call was refused; `tell` gets a line the first time."""

    def __init__(self) -> None:
        self.tell: Callable[[str], None] = lambda line: None
        self._count: Counter[tuple[str, str]] = Counter()

    def add(self, method: str, reason: str) -> None:
        """The method, whose name may be a client's invention, was refused for this reason."""
        key = printable(method), printable(reason)
        if key not in self._count and len(self._count) >= MOST:
            key = "other calls", "were refused"
        self._count[key] += 1
        if self._count[key] == 1:
            self.tell(" ".join(key))

    def lines(self) -> list[str]:
        """What was refused, and how often, most often first."""
        return [f"{count} x {method} {reason}" for (method, reason), count in self._count.most_common()]


def printable(text: str) -> str:
    """A client's text on one line, without what would steer a terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:LONGEST])
