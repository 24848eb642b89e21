"""Draws the pages' mermaid sequence diagrams as SVG when the site is built, so that a reader's browser fetches nothing.

Of mermaid's language it knows what the pages use: `participant A as NAME`, `A->>B: TEXT`, `Note over A,B: TEXT`, `loop
TEXT` and `end`. Anything else raises ValueError, which fails the build.
"""

from __future__ import annotations

import re
from html import escape

COLUMN, LINE, HEAD, MARGIN = (85, 42, 44, 44)  # pixels: between participants, between messages, of names, at the sides
LETTER = 6.2  # pixels of a character, about
PARTICIPANT = re.compile(r"participant (\w+) as (\S+)")
MESSAGE = re.compile(r"(\w+)->>(\w+): (.+)")
NOTE = re.compile(r"Note over (\w+)(?:,(\w+))?: (.+)")
LOOP = re.compile(r"loop (.+)")
ARROW = (
    '<defs><marker id="arrow" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    '<path d="M0,0 L8,4 L0,8 z" fill="currentColor"/></marker></defs>'
)


def figure(code: str, label: str) -> str:
    """HTML with the drawing of a diagram's source; `label` is its name for screen readers."""
    drawing = Drawing()
    for line in filter(None, map(str.strip, code.splitlines())):
        drawing.add(line)
    return f'<div class="sequence" tabindex="0" role="region" aria-label="{escape(label)}">{drawing.svg(label)}</div>'


class Drawing:
    """A diagram, drawn line by line from top to bottom."""

    def __init__(self) -> None:
        self._x: dict[str, int] = {}
        self._names: list[str] = []
        self._parts: list[str] = []
        self._loops: list[tuple[int, str]] = []
        self._y = HEAD + LINE

    def add(self, line: str) -> None:
        """Draw one line of source. Raises ValueError where it is not known."""
        if found := PARTICIPANT.fullmatch(line):
            self._x[found[1]] = MARGIN + COLUMN * len(self._names)
            self._names.append(found[2])
        elif found := MESSAGE.fullmatch(line):
            self._message(self._x[found[1]], self._x[found[2]], found[3])
        elif found := NOTE.fullmatch(line):
            self._note(self._x[found[1]], self._x[found[2] or found[1]], found[3])
        elif found := LOOP.fullmatch(line):
            self._loops.append((self._y - LINE // 2, found[1]))
            self._y += LINE // 2
        elif line == "end":
            self._close_loop()
        elif line != "sequenceDiagram":
            raise ValueError(f"mermaid: docs/site/sequence.py does not draw {line!r}")

    def _message(self, start: int, end: int, text: str) -> None:
        self._text((start + end) // 2, self._y - 6, text)
        self._parts.append(f'<path d="M{start},{self._y} H{end}" marker-end="url(#arrow)"/>')
        self._y += LINE

    def _note(self, start: int, end: int, text: str) -> None:
        width = max(abs(end - start) + 40, int(LETTER * len(text)) + 16)
        middle = self._within((start + end) // 2, width)
        self._parts.append(
            f'<rect class="note" x="{middle - width // 2}" y="{self._y - 24}" width="{width}" height="28"/>'
        )
        self._text(middle, self._y - 6, text)
        self._y += LINE

    def _close_loop(self) -> None:
        top, text = self._loops.pop()
        size = f'width="{self._width - 4}" height="{self._y - top - LINE // 2}"'
        self._parts.append(f'<rect class="loop" x="2" y="{top}" {size}/>')
        self._text(2, top + 16, f"loop: {text}")
        self._y += LINE // 2

    def _text(self, x: int, y: int, text: str) -> None:
        """Centred at x, or as near to it as the drawing's sides leave room."""
        x = self._within(x, int(LETTER * len(text)) + 8)
        self._parts.append(f'<text x="{x}" y="{y}" text-anchor="middle">{escape(text)}</text>')

    def _within(self, middle: int, width: int) -> int:
        return max(width // 2, min(middle, self._width - width // 2))

    @property
    def _width(self) -> int:
        return 2 * MARGIN + COLUMN * (len(self._names) - 1)

    def svg(self, label: str) -> str:
        """The whole drawing, in the colours of the page."""
        parts, self._parts = self._parts, []
        for x, name in zip(self._x.values(), self._names, strict=True):
            self._parts.append(f'<path class="life" d="M{x},{HEAD} V{self._y}"/>')
            self._parts.append(f'<rect class="name" x="{x - 41}" y="2" width="82" height="{HEAD - 4}"/>')
            folder, slash, file = name.rpartition("/")
            self._text(x, 19, folder + slash)
            self._text(x, 34, file)
        return (
            f'<svg role="img" aria-label="{escape(label)}" viewBox="0 0 {self._width} {self._y}" width="{self._width}"'
            f' height="{self._y}">{ARROW}{"".join(self._parts + parts)}</svg>'
        )
