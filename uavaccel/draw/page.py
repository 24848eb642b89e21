"""A page as a list of blocks, written as Markdown and, by the template beside this, as one self-contained HTML."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Formatter
from typing import Any, TypeAlias

from uavaccel.files import Plain


def command_name(command: str) -> str:
    """Return a command as figures and tables write it: ADSC, TCSC."""
    return command.upper()


def counted(count: int | str, noun: str) -> str:
    """Return a count, or several of them as text, with their noun: 1 round, 24 rounds, 1, 2 rounds."""
    return f"{count} {noun}" if str(count) == "1" else f"{count} {noun}s"


def clock_label(clock_speed: float) -> str:
    """Return a ClockSpeed as figures and tables write it: 1x, 1.5x, 100x."""
    return f"{clock_speed:g}x"


def command_at_clock(game: Mapping[str, Plain]) -> str:
    """Return command and ClockSpeed of a row or a task, as in "TCSC at 5x"."""
    return f"{command_name(game['command'])} at {clock_label(game['clock_speed'])}"


def number(value: float, digits: int = 5) -> str:
    """Return a number as people write it, of so many significant digits: 671.88, 0.0012, 4.3e-6; only 0 is "0"."""
    if not math.isfinite(value) or abs(value) < 1e-4:
        return f"{value:.{digits}g}".replace("e-0", "e-")
    text = f"{value:.{max(digits - 1 - math.floor(math.log10(abs(value))), 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def metres(value: float) -> str:
    """Return metres of three significant digits, as errors range from micrometres to metres."""
    return number(value, 3)


def in_words(seconds: float) -> str:
    """Return a duration in seconds, minutes or hours."""
    if seconds < 600:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


Record: TypeAlias = Mapping[str, Any]
Column: TypeAlias = str | Callable[[Record], object]
"""How a column's cells are written: a template such as "{successes} of {games}", or a function from an entry."""


@dataclass(frozen=True)
class Heading:
    """A section's title."""

    text: str


@dataclass(frozen=True)
class Paragraph:
    """Plain text; it may hold any character. In HTML it is collapsed behind the name `folded`, if that is given."""

    text: str
    folded: str = ""


@dataclass(frozen=True)
class Table:
    """Rows of plain text below a header. In HTML the table is collapsed behind the name `folded`, if that is given."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: str = ""

    @classmethod
    def of(cls, entries: Any, columns: Mapping[str, Column], folded: str = "") -> Table:
        """Return a table with a row for each entry, a mapping or a row of a DataFrame; `columns` are by header.

        A template is one of `str.format` on the entry, of which `{x!u}` is upper case, `{x!l}` a list in words, `{x!m}`
        metres, `{x!t}` a duration in seconds, and `{x!f}` and `{x!d}` mark games that failed or were disturbed. Floats
        of no format, or one as `{x:.3g}`, are written as people do (`number`). The cell is "-" where a value in it is
        not known.
        """
        records = entries.to_dict("records") if hasattr(entries, "to_dict") else list(entries)
        rows = [tuple(fill(column, record) for column in columns.values()) for record in records]
        return cls(tuple(columns), rows, folded)


@dataclass(frozen=True)
class Picture:
    """A PNG file, the caption below it, and what is seen in it, in a sentence for those who cannot see it."""

    path: Path
    caption: str
    alt: str


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


Block: TypeAlias = Heading | Paragraph | Table | Picture | Movie | Listing
KINDS: tuple[type, ...] = (Heading, Paragraph, Table, Picture, Movie, Listing)


class UnknownValue(Exception):
    """A template needs a value that is not known."""


def unknown(value: object) -> bool:
    """Return whether a value of a table is not known: None or NaN."""
    return value is None or (isinstance(value, float) and math.isnan(value))


def listed(values: Iterable[object]) -> str:
    """Return values in words, as in "1, 2, 3"."""
    return ", ".join(str(value) for value in values)


class _Template(Formatter):
    """`str.format` with the conversions of tables. Raises UnknownValue for a value that is not known."""

    conversions: Mapping[str, Callable[[Any], str]] = {
        "u": str.upper,
        "l": listed,
        "m": metres,
        "t": in_words,
        "f": lambda games: f" ({games:g} failed)" if games else "",
        "d": lambda games: f" ({games:g} disturbed)" if games else "",
    }

    def get_field(self, field_name: str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        value, key = super().get_field(field_name, args, kwargs)
        if unknown(value):
            raise UnknownValue(field_name)
        return value, key

    def convert_field(self, value: Any, conversion: Any) -> Any:
        own = self.conversions.get(conversion)
        return own(value) if own else super().convert_field(value, conversion)

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, float) and format_spec in ("", "g"):
            return number(value)
        if isinstance(value, float) and format_spec.endswith("g"):
            return number(value, int(format_spec[1:-1]))
        return str(super().format_field(value, format_spec))


def fill(column: Column, record: Record) -> str:
    """Return a table's cell: the template filled in, or what the function returns; "-" for what is not known."""
    if not isinstance(column, str):
        return fill("{found}", {"found": column(record)})
    try:
        return _Template().vformat(column, (), record)
    except UnknownValue:
        return "-"


def to_markdown(title: str, blocks: Sequence[Block], folder: Path) -> str:
    """Return the page as Markdown; pictures are linked relative to `folder`, in which the file will lie."""
    return "\n\n".join([f"# {title}", *(_markdown(block, folder) for block in blocks)]) + "\n"


def _markdown(block: Block, folder: Path) -> str:
    match block:
        case Heading(text):
            return f"## {text}"
        case Paragraph(text):
            return _escape_markdown(text)
        case Table(header, rows):
            lines = [header, ["---"] * len(header), *rows]
            return "\n".join("| " + " | ".join(map(_escape_markdown, line)) + " |" for line in lines)
        case Picture(path, caption, alt):
            return f"![{_escape_markdown(alt)}]({path.relative_to(folder).as_posix()})\n\n{_escape_markdown(caption)}"
        case Movie(path, sheet, caption):
            film = path.relative_to(folder).as_posix()
            return f"{_markdown(Picture(sheet, caption, caption), folder)}\n\n[{path.name}]({film})"
        case Listing(text):
            return f"```\n{text.rstrip()}\n```"


def to_html(title: str, blocks: Sequence[Block]) -> str:
    """Return the page as one HTML file that embeds its style, script and pictures and needs no network."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    how: dict[str, Any] = {"autoescape": True, "keep_trailing_newline": True, "undefined": StrictUndefined}
    environment = Environment(loader=PackageLoader("uavaccel.draw", ""), **how)
    kind = {".mp4": "video/mp4"}
    environment.filters["data_url"] = lambda path: _data_url(path.read_bytes(), kind.get(path.suffix, "image/png"))
    environment.filters["poster_url"] = _poster_url
    return environment.get_template("page.html.jinja").render(title=title, blocks=blocks)


def _data_url(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}" if content else ""


def _poster_url(path: Path) -> str:
    try:
        from uavaccel.draw.film import poster  # with what reads films, of which most pages have none

        return _data_url(poster(path), "image/jpeg")
    except ImportError:  # without the extra `film` the page shows the film's first frame
        return ""


def _escape_markdown(text: str) -> str:
    return re.sub(r"([\\|*_<])", r"\\\1", text)
