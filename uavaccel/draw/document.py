"""A report as a list of blocks, written as Markdown or as one self-contained HTML page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TypeVar

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; color: #222;
  background: #FFF; overflow-wrap: break-word }
h1, h2 { line-height: 1.2 } figure { margin: 1.5rem 0 } img, video { max-width: 100%; height: auto }
.paper { display: none }
figcaption { color: #555; font-size: 90% } summary { cursor: pointer; color: #0072B2 }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums }
th, td { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid #E3E3E3; vertical-align: top }
thead th { vertical-align: bottom } tbody th { font-weight: normal }
tbody td, tbody th { white-space: nowrap }
tbody .long { white-space: normal; overflow-wrap: anywhere; min-width: 14rem }
th:first-child, td:first-child { text-align: left }
pre { background: #F6F6F6; padding: .8rem; overflow-x: auto; font-size: 12px }
.scrolls { overflow-x: auto; margin: 1rem 0 }
.enlarge { display: block; padding: 0; border: 0; background: none; cursor: zoom-in }
dialog { width: 100vw; height: 100vh; max-width: none; max-height: none; padding: 0; border: 0; box-sizing: border-box }
dialog[open] { display: flex; flex-direction: column } dialog div { overflow: auto; cursor: zoom-out }
dialog img { width: 100%; min-width: 60rem; max-width: none; display: block }
dialog button { font: inherit; align-self: end; margin: .4rem; padding: .2rem .8rem }
@media (max-width: 40rem) { body { margin: 1rem auto; padding: 0 .8rem } h1 { font-size: 1.4rem } }
@media print {
  body { font-size: 10pt; max-width: none; margin: 0 } h2, thead { break-after: avoid }
  figure, tr { break-inside: avoid } figure { margin: .8rem 0 } figure img { max-height: 38vh; width: auto }
  h2:has(+ details:not([open])) { display: none }
  .scrolls, pre { overflow: visible } tbody td, tbody th, pre { white-space: pre-wrap }
  table { font-size: 8pt } th, td { padding: .1rem .3rem } tbody .long { min-width: 0 }
  details:not([open]), video { display: none } .paper { display: block }
}
"""

SCRIPT = """
const dialog = document.createElement("dialog"), pane = document.createElement("div");
const close = document.createElement("button");
close.textContent = "Close";
pane.tabIndex = 0;  // scrolled with the arrow keys
dialog.ariaLabel = "Figure, enlarged";
dialog.append(close, pane);
dialog.addEventListener("click", () => dialog.close());  // Esc closes it too, and focus returns to the picture
document.body.append(dialog);
for (const image of document.querySelectorAll("figure img:not(.paper)")) {
  const button = document.createElement("button");
  button.className = "enlarge";
  button.ariaLabel = "Enlarge: " + image.alt;
  image.replaceWith(button);
  button.append(image);
  button.addEventListener("click", () => {
    pane.replaceChildren(image.cloneNode());
    dialog.showModal();
  });
}
"""


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
    """Rows of plain text below a header. In HTML the table is collapsed behind the name `folded`, if that is given."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: str = ""

    @classmethod
    def of(
        cls, entries: Sequence[Entry], *columns: tuple[str, Callable[[Entry], str]], folded: str = ""
    ) -> Table:
        """Return a table with a row for each entry; a column is its header and a function from an entry to its text."""
        header = [name for name, _ in columns]
        return cls(header, [tuple(text(entry) for _, text in columns) for entry in entries], folded)


@dataclass(frozen=True)
class Picture:
    """A PNG file and the caption below it."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Movie:
    """An MP4 file, the PNG that stands for it on paper and in Markdown, and the caption below it."""

    path: Path
    sheet: Path
    caption: str


@dataclass(frozen=True)
class Listing:
    """Preformatted text, such as YAML. In HTML it is collapsed behind the name `folded`, if that is given."""

    text: str
    folded: str = ""


LONG, LONG_CLASS = 32, ' class="long"'  # characters above which a table's cell is broken into lines

Block = Heading | Paragraph | Table | Picture | Movie | Listing
Known = TypeVar("Known")


def or_dash(value: Known | None, form: Callable[[Known], str]) -> str:
    """Return a value as the text of a table's cell, or "-" where it is None."""
    return "-" if value is None else form(value)


def to_markdown(title: str, blocks: Sequence[Block], folder: Path) -> str:
    """Return the report as Markdown; pictures are linked relative to `folder`, in which the file will lie."""
    return "\n\n".join([f"# {title}", *(_markdown(block, folder) for block in blocks)]) + "\n"


def to_html(title: str, blocks: Sequence[Block]) -> str:
    """Return the report as one HTML page that embeds its style, script and pictures and needs no network."""
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
        case Movie(path, sheet, caption):
            film = path.relative_to(folder).as_posix()
            return f"{_markdown(Picture(sheet, caption), folder)}\n\n[{path.name}]({film})"
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
            image = f'<img alt="{escape(caption)}" src="{_data_url(path, "image/png")}">'
            return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"
        case Movie(path, sheet, caption):
            film = f'<video controls aria-label="{escape(caption)}" src="{_data_url(path, "video/mp4")}"></video>'
            image = f'<img class="paper" alt="{escape(caption)}" src="{_data_url(sheet, "image/png")}">'
            return f"<figure>{film}{image}<figcaption>{escape(caption)}</figcaption></figure>"
        case Listing(text, folded):
            return _folded(f'<pre tabindex="0">{escape(text)}</pre>', folded)


def _data_url(path: Path, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"


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
    """The first cell is the row's header; short cells are not broken into lines."""
    cells = [f"{LONG_CLASS if len(cell) > LONG else ''}>{escape(cell)}" for cell in row]
    return f'<tr><th scope="row"{cells[0]}</th>{"".join(f"<td{cell}</td>" for cell in cells[1:])}</tr>'


def _folded(html: str, name: str) -> str:
    """Collapse a part of the page behind a name to click, if it has one."""
    return f"<details><summary>{escape(name)}</summary>\n{html}</details>" if name else html


def _escape_markdown(text: str) -> str:
    for character in "\\|*_<":
        text = text.replace(character, "\\" + character)
    return text
