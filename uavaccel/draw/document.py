"""A report as a list of blocks, written as Markdown or as one self-contained HTML page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TypeVar

from uavaccel.draw.page_look import SCRIPT, STYLE

Entry = TypeVar("Entry")


@dataclass(frozen=True)
class Heading:
    """A section's title."""

    text: str


@dataclass(frozen=True)
class Paragraph:
    """Plain text; it may hold any character."""

    text: str


@dataclass(frozen=True)
class Table:
    """Rows of plain text below a header; `folded` names what one clicks to unfold it in HTML."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: str = ""

    @classmethod
    def of(cls, entries: Sequence[Entry], *columns: tuple[str, Callable[[Entry], str]]) -> Table:
        """A row for each entry: each column is its header and the text that it has of an entry."""
        header = [name for name, _ in columns]
        return cls(header, [[text(entry) for _, text in columns] for entry in entries])


@dataclass(frozen=True)
class Picture:
    """A PNG and the caption below it."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Listing:
    """Text kept as it is, such as YAML; `folded` names what one clicks to unfold it in HTML."""

    text: str
    folded: str = ""


LONG, LONG_CLASS = 32, ' class="long"'  # characters of a table's cell: longer ones are broken into lines

Block = Heading | Paragraph | Table | Picture | Listing
Known = TypeVar("Known")


def or_dash(value: Known | None, form: Callable[[Known], str]) -> str:
    """A table's cell: the value in that form, or "-" where there is none."""
    return "-" if value is None else form(value)


def to_markdown(title: str, blocks: Sequence[Block], folder: Path) -> str:
    """Markdown of the report; pictures are linked relative to `folder`, where the file will lie."""
    return "\n\n".join([f"# {title}", *(_markdown(block, folder) for block in blocks)]) + "\n"


def to_html(title: str, blocks: Sequence[Block]) -> str:
    """One HTML page with its style, script and pictures inside, which needs no other file and no network."""
    body = "\n".join([f"<h1>{escape(title)}</h1>", *map(_html, blocks)])
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style>"
    )
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n<body><main>\n{body}\n</main>\n'
        f"<script>{SCRIPT}</script></body></html>\n"
    )


def _markdown(block: Block, folder: Path) -> str:
    match block:
        case Heading(text):
            return f"## {text}"
        case Paragraph(text):
            return _escape_markdown(text)
        case Table(header, rows):
            lines = [header, ["---"] * len(header), *rows]
            return "\n".join("| " + " | ".join(map(_escape_markdown, line)) + " |" for line in lines)
        case Picture(path, caption):
            return f"![{path.stem}]({path.relative_to(folder).as_posix()})\n\n{_escape_markdown(caption)}"
        case Listing(text, _):
            return f"```\n{text.rstrip()}\n```"


def _html(block: Block) -> str:
    match block:
        case Heading(text):
            return f"<h2>{escape(text)}</h2>"
        case Paragraph(text):
            return f"<p>{escape(text)}</p>"
        case Table():
            return _html_table(block)
        case Picture(path, caption):
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            image = f'<img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
            return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"
        case Listing(text, folded):
            return _folded(f'<pre tabindex="0">{escape(text)}</pre>', folded)


def _html_table(table: Table) -> str:
    names = [escape(cell) for cell in table.header if cell]
    header = "".join(f'<th scope="col">{escape(cell)}</th>' if cell else "<td></td>" for cell in table.header)
    head = f"<thead><tr>{header}</tr></thead>\n" if names else ""
    body = "\n".join(_html_row(row) for row in table.rows)
    label = f"Table: {', '.join(names) or escape(table.folded)}"
    html = f"<table>{head}<tbody>{body}</tbody></table>"
    return _folded(
        f'<div class="scrolls" tabindex="0" role="region" aria-label="{label}">{html}</div>', table.folded
    )


def _html_row(row: Sequence[str]) -> str:
    """Its first cell names it; short cells are not broken into lines."""
    cells = [f"{LONG_CLASS if len(cell) > LONG else ''}>{escape(cell)}" for cell in row]
    return f'<tr><th scope="row"{cells[0]}</th>{"".join(f"<td{cell}</td>" for cell in cells[1:])}</tr>'


def _folded(html: str, name: str) -> str:
    """The part of the page behind a name that one clicks, if it has one."""
    return f"<details><summary>{escape(name)}</summary>\n{html}</details>" if name else html


def _escape_markdown(text: str) -> str:
    for character in "\\|*_<":
        text = text.replace(character, "\\" + character)
    return text
