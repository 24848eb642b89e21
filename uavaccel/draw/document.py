"""The blocks of a page for reports in the old shape."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from uavaccel.draw import page
from uavaccel.draw.page import Block as Block
from uavaccel.draw.page import Heading as Heading
from uavaccel.draw.page import Listing as Listing
from uavaccel.draw.page import Movie as Movie
from uavaccel.draw.page import Paragraph as Paragraph
from uavaccel.draw.page import Picture as Picture
from uavaccel.draw.page import to_html as to_html
from uavaccel.draw.page import to_markdown as to_markdown

Entry = TypeVar("Entry")
Known = TypeVar("Known")


class Table(page.Table):
    """A table whose columns are functions from an entry to its text."""

    @classmethod
    def of(  # type: ignore[override]
        cls, entries: Sequence[Entry], *columns: tuple[str, Callable[[Entry], str]], folded: str = ""
    ) -> Table:
        """Return a table with a row for each entry; a column is its header and a function from an entry to its text."""
        header = [name for name, _ in columns]
        return cls(header, [tuple(text(entry) for _, text in columns) for entry in entries], folded)


def or_dash(value: Known | None, form: Callable[[Known], str]) -> str:
    """Return a value as the text of a table's cell, or "-" where it is None."""
    return "-" if value is None else form(value)
