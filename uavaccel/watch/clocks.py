"""The table of clocks at the top of the page's controls."""

from __future__ import annotations

import html
from collections.abc import Iterable
from typing import NamedTuple


class Line(NamedTuple):
    """What the table says of a drone; `height_m` is None where nothing is below it."""

    name: str
    time_s: float
    height_m: float | None
    state: str


NUMBER, WORDS = "text-align:right;white-space:nowrap", "padding-left:0.6em"  # the cells' styles


def clock_table(clock_speed: float, wall: str, lines: Iterable[Line], note: str = "") -> str:
    """ClockSpeed and wall clock, a line for each drone, and a note below them; HTML."""
    rows = "".join(map(_row, lines))
    below = f"<p style='margin:0.3em 0'>{html.escape(note)}</p>" if note else ""
    return (
        "<div class='clocks' style='padding:0 1em;font-variant-numeric:tabular-nums;font-size:0.85em'>"
        f"<p style='margin:0.3em 0'>ClockSpeed <b>{clock_speed:g}x</b> &nbsp; wall clock "
        f"<b>{wall}</b></p><table style='width:100%;line-height:1.5'>{rows}</table>{below}</div>"
    )


def _row(line: Line) -> str:
    height = "" if line.height_m is None else f"{line.height_m:.1f} m up"
    return (
        f"<tr><td><b>{html.escape(line.name)}</b></td><td style='{NUMBER}'>{line.time_s:.2f} s</td>"
        f"<td style='{NUMBER}'>{height}</td><td style='{WORDS}'>{html.escape(line.state)}</td></tr>"
    )
