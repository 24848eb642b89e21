"""What a server says on its terminal about calls that have less effect than their callers may think: each once."""

from __future__ import annotations

from collections.abc import Callable


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
