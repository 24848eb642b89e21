"""The console on which all commands print: plain text, as it is, on lines that are not wrapped; and tables on it."""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING

from rich import table as rich_table
from rich.console import Console

if TYPE_CHECKING:
    from uavaccel.draw.page import Table

console = Console(highlight=False, markup=False, soft_wrap=True)
COLUMN_GAP = 2  # characters between the columns of a table, as wide as rich pads them
TABLE_WIDTH = 170  # where the output is no terminal


def show_table(table: Table) -> None:
    """Print the columns of a table that fit into the terminal uncut, and say how many more the report has.

    In a file there is room for all.
    """
    width = console.width if console.is_terminal else TABLE_WIDTH
    fit = columns_within(table, width)
    lines = rich_table.Table(*table.header[:fit], box=None, pad_edge=False)
    for row in table.rows:
        lines.add_row(*row[:fit])
    Console(highlight=False, width=width).print(lines)
    if left := len(table.header) - fit:
        console.print(f"{left} more column{'s' if left > 1 else ''} in the report")


def columns_within(table: Table, width: int) -> int:
    """Return how many columns, from the left and at least one, fit into `width` characters.

    A column is as wide as its widest cell, or the longest word of its header, which may be broken into lines.
    """
    widths = [
        max(map(len, [*name.split(), *cells, ""])) + COLUMN_GAP
        for name, *cells in zip(table.header, *table.rows, strict=True)
    ]
    return max(sum(end - COLUMN_GAP <= width for end in accumulate(widths)), 1)
