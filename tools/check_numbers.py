"""Recomputes the numbers of the pages from the rows in docs/tables, and prints what differs.

    python -m tools.check_numbers [--all]

tools/published_numbers.py says what each page has to say, worded with the numbers that it computes. What a page says of
numbers without rows stands in a block of its own, a paragraph, a list or a table, below a comment with the command that
makes them again, `<!-- made by: uavaccel run ... -->`; with --all these are listed. Below `<!-- no results -->` numbers
are settings. Any other number outside code is one without a source. The exit status is 1 where something differs or has
no source.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from difflib import SequenceMatcher
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
MARKED = re.compile(r"<!-- (?:made by: (.+?)|no results) -->\n+(?:.+\n)+")
NO_TEXT = re.compile(r"^```.*?^```$|<!--.*?-->|`[^`]+`|\]\([^)\n]*\)|^#[^\n]*$|^!\[[^\n]*$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])[-−+]?(?:\d[\d.]*|\.\d+)(?: \d{3})*")


class Page(NamedTuple):
    """What a page's numbers are: what it has to say, and patterns of settings, which are no results."""

    says: Iterable[str]
    settings: tuple[str, ...]


class Checked(NamedTuple):
    """What of a page's text differs and has no source, a line each, how many numbers were found, and commands."""

    wrong: list[str]
    recomputed: int
    made_by: list[str]


def check(text: str, page: Page) -> Checked:
    """Compare a page's text with what it has to say."""
    wrong, told, covered = [], 0, [found.span() for found in NO_TEXT.finditer(text)]
    for said in page.says:
        words = re.compile(r"\s+".join(map(re.escape, said.split())))
        if not (spans := [found.span() for found in words.finditer(text)]):
            wrong.append(f"computed: {said}\n    page: {nearest(text, said)}")
        told += len(NUMBER.findall(said))
        covered += spans
    marked = list(MARKED.finditer(text))
    covered += [found.span() for found in marked]
    covered += [found.span() for pattern in page.settings for found in re.finditer(pattern, text)]
    rest = list(text)
    for first, end in covered:
        rest[first:end] = [" " if character != "\n" else "\n" for character in rest[first:end]]
    for number, line in enumerate("".join(rest).splitlines(), 1):
        if found := NUMBER.findall(line):
            wrong.append(f"line {number}: no source of {', '.join(found)} in: {text.splitlines()[number - 1].strip()}")
    return Checked(wrong, told, [found[1] for found in marked if found[1]])


def nearest(text: str, said: str) -> str:
    """Return the line, or the two lines, of a text that are most like what should be said."""
    lines = [line.strip() for line in text.splitlines()]
    both = [*lines, *(" ".join(pair) for pair in pairwise(lines))]
    return max(both, key=lambda line: SequenceMatcher(None, said, line, autojunk=False).ratio())


def checked_pages() -> Iterator[tuple[str, Checked]]:
    """Yield each page's path with what was found."""
    from tools.published_numbers import PAGES

    for path, page in PAGES.items():
        yield path, check((ROOT / path).read_text(encoding="utf-8"), page())


def main(options: list[str]) -> int:
    """Print what differs, and how much was recomputed; return the exit status."""
    failed = False
    for path, (wrong, recomputed, made_by) in checked_pages():
        for line in wrong:
            print(f"{path}: {line}")
        print(f"{path}: {recomputed} numbers recomputed, {len(made_by)} blocks made by commands, {len(wrong)} wrong")
        for command in made_by if "--all" in options else ():
            print(f"    not recomputed: {command}")
        failed |= bool(wrong)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
