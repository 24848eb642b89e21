"""Reports as Markdown and HTML, text that looks like markup; and what every page says of the project."""

from __future__ import annotations

import ast
import base64
import math
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import typer

from tests.golden import assert_as_recorded
from tests.test_imports import GROUND, ROOMS
from tests.web_pages import assert_sound
from uavaccel.cli.main import app
from uavaccel.config import load_yaml
from uavaccel.draw.page import Block, Column, Heading, Listing, Paragraph, Picture, Table, to_html, to_markdown
from uavaccel.suites.registry import SUITES

NASTY = 'a|b *c* _d_ <e> & "f" \\g'
PNG = b"\x89PNG not really"


@pytest.fixture
def blocks(tmp_path: Path) -> list[Block]:
    picture = tmp_path / "figures" / "one & two.png"
    picture.parent.mkdir()
    picture.write_bytes(PNG)
    return [
        Heading("First"),
        Paragraph(NASTY),
        Paragraph("how", folded="Method"),
        Table(("x", "y <z>"), [("1", "2|3"), ("4", "<5>")], folded="2 rows & more"),
        Table(("alone",), [("6",)]),
        Picture(picture, "Caption <1>", "A curve <2>"),
        Listing("key: <value> | *kept*\n\n"),
        Listing("seed: 0\n", folded="config.yaml"),
    ]


def test_every_block_is_as_recorded_in_markdown_and_html(tmp_path: Path, blocks: list[Block]) -> None:
    """A picture is in the page itself; a table scrolls on a phone, and breaks long cells into lines."""
    short, long = "x" * 32, "x" * 33
    blocks.append(Table(("", "ours"), [(short, long), (long, short)]))
    blocks.append(Table(("", ""), [("a", "b")], folded="all"))
    html = to_html("The <title>", blocks)
    assert_sound(html)
    assert base64.b64encode(PNG).decode() in html
    page = re.sub(r"<(style|script)>.*?</\1>", r"<\1>", html, flags=re.DOTALL)
    assert_as_recorded("every_block", f"{to_markdown('The title', blocks, tmp_path)}\n{page}")


@pytest.mark.parametrize(
    ("there", "instead"),
    [
        (' lang="en"', ""),
        ("<title>The &lt;title&gt;</title>", ""),
        ("width=device-width", "width=800"),
        ('alt="A curve &lt;2&gt;"', 'alt=""'),
        ('src="data:image/png;base64,', 'src="https://example.com/'),
        ('<th scope="col">x</th>', '<th scope="col"></th>'),
        (' role="region"', ""),
        ("<style>", "<style>@import url(look.css);"),
        ("<main>", '<main><a href="https://example.com">'),
    ],
)
def test_what_is_wrong_with_a_page_is_found(blocks: list[Block], there: str, instead: str) -> None:
    html = to_html("The <title>", blocks)
    assert there in html
    with pytest.raises((AssertionError, KeyError)):
        assert_sound(html.replace(there, instead))


@pytest.mark.parametrize(
    ("column", "cell"),
    [
        ("{won} of {games}", "3 of 4"),
        ("{name!u}: {clocks!l}", "ADSC: 1, 2.5"),
        ("{error!m} in {took!t}{failed!f}{games!d}", "0.5 in 12.0 s (4 disturbed)"),
        ("{sum}, {sum:.3g}, {small:.2g}, {games:g}", "671.88, 672, 0.0012, 4"),
        (lambda entry: entry["sum"], "671.88"),
        ("{lost}", "-"),
        ("{won} of {unknown:.2f}", "-"),
        (lambda entry: entry["won"] / 2, "1.5"),
        (lambda entry: entry["unknown"], "-"),
        (lambda entry: entry["lost"], "-"),
    ],
)
def test_a_tables_cell_is_its_template_filled_in_or_a_dash(column: Column, cell: str) -> None:
    entry = {"won": 3, "games": 4, "name": "adsc", "clocks": [1, 2.5], "error": 0.5, "took": 12.0, "failed": 0}
    entry |= {"sum": 671.8800000001, "small": 0.00123, "lost": None, "unknown": math.nan}
    assert Table.of([entry], {"header": column}) == Table(("header",), [(cell,)])
    assert Table.of(pd.DataFrame([entry]), {"header": column}).rows == [(cell,)]


def luminance(colour: str) -> float:
    """Relative luminance (WCAG 2.2) of #RGB or #RRGGBB."""
    digits = colour.lstrip("#")
    digits = "".join(2 * digit for digit in digits) if len(digits) == 3 else digits
    linear = []
    for place in (0, 2, 4):
        share = int(digits[place : place + 2], 16) / 255
        linear.append(share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4)
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_text_stands_out_from_its_background(blocks: list[Block]) -> None:
    """WCAG's AA: at least 4.5 to 1, on the page's white and on the grey of listings."""
    style = to_html("title", blocks).partition("<style>")[2].partition("</style>")[0]
    texts = re.findall(r"(?<![-\w])color: (#\w+)", style)
    backgrounds = re.findall(r"background: (#\w+)", style)
    assert len(texts) == 3
    assert len(backgrounds) == 2
    for text in texts:
        for background in backgrounds:
            assert (luminance(background) + 0.05) / (luminance(text) + 0.05) >= 4.5


# --- pages of the project ---------------------------------------------------------------------------------------------


ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("experiments/*.md")])
PAGES_AND_TEXTS = [(page, page.read_text(encoding="utf-8")) for page in PAGES]
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def parse(words: list[str]) -> None:
    """Parse a command line without running it: the command is there, and so are its options, where there are any."""
    command: Any = typer.main.get_command(app)
    settings = command.context_settings  # a command keeps the names of its first help
    while hasattr(command, "commands") and words:
        name, *words = words
        command = command.commands[name]
    command.make_context(command.name, words, resilient_parsing=not words, **settings)


def found(pattern: str) -> list[tuple[str, str]]:
    return [
        (page.relative_to(ROOT).as_posix(), hit) for page, text in PAGES_AND_TEXTS for hit in re.findall(pattern, text)
    ]


def test_links_lead_to_and_names_are_of_what_is_there() -> None:
    """Links, files, modules, and targets of make."""
    links = {(page, link) for page, link in found(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)")}
    files = {(page, file) for page, file in found(r"\b((?:uavaccel|tests|experiments|assets)/[\w/]+\.\w+)")}
    names = {(page, name.replace(".", "/")) for page, name in found(r"(?m)(?:`|^::: )(uavaccel\.[a-z_.]+)(?:`|$)")}
    targets = {target for _, target in found(r"(?m)(?:^|`)make (\w+)(?:`|$)")}
    assert min(len(links), len(files), len(names), len(targets)) > 3
    assert [each for each in sorted(links) if not ((ROOT / each[0]).parent / each[1]).exists()] == []
    assert [each for each in sorted(files) if not ("NAME" in each[1] or (ROOT / each[1]).exists())] == []
    modules = {*(path.relative_to(ROOT).with_suffix("").as_posix() for path in ROOT.glob("uavaccel/**/*.py"))}
    assert [each for each in sorted(names) if not (each[1] in modules or (ROOT / each[1]).is_dir())] == []
    assert targets <= set(re.findall(r"(?m)^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8")))


def test_commands_within_the_text_parse() -> None:
    """The command and its options exist; blocks of them are tests/test_docs.py's."""
    for line in sorted({line for _, line in found(r"`(uavaccel [a-z][^`\n]*)`")}):
        try:
            parse(shlex.split(line.partition("#")[0])[1:])
        except Exception as error:
            raise AssertionError(line) from error


def test_every_page_is_in_the_sites_navigation() -> None:
    def pages(entry: Any) -> Iterator[str]:
        """The files of a navigation, whose entries may have titles, and further entries."""
        if isinstance(entry, str):
            yield entry
        for each in entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ():
            yield from pages(each)

    named = list(pages(load_yaml(ROOT / "mkdocs.yml")["nav"]))
    assert len(named) == len(set(named))
    there = {page.relative_to(ROOT).as_posix() for page in PAGES} | {"assets/mjcf/README.md"}
    assert set(named) == there | {"docs/reference/keys.md"}


def test_the_first_page_begins_with_a_small_moving_picture() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    picture = ROOT / re.findall(r"!\[[^]]+\]\(([^)]+)\)", readme.partition("\n## ")[0])[0]
    data = picture.read_bytes()
    assert data[:4] == b"RIFF"
    assert b"ANIM" in data[:64]  # a WebP that moves
    assert len(data) < 1_500_000


def test_every_suite_that_ships_is_among_the_experiments() -> None:
    readme = (ROOT / "experiments" / "README.md").read_text(encoding="utf-8")
    shipped = [name for name in SUITES if (ROOT / "experiments" / f"{name}.yaml").exists()]
    assert [name for name in shipped if f"[{name}.yaml]" not in readme] == []


def test_the_drawing_of_the_rooms_is_the_rule_of_imports() -> None:
    """From below: a room may import rooms of lower lines and no other, but for the ground's."""
    drawing = ARCHITECTURE.split("```text\n")[1].split("```")[0]
    known = set(ROOMS) - {"__init__", "__main__"}
    lines = [set(re.findall(r"\w+", line)) & known for line in drawing.splitlines()]
    assert sorted(room for line in lines for room in line) == sorted(known)
    below = set(GROUND)
    for rooms in reversed(lines):
        for room in rooms:
            assert ROOMS[room] - {"__init__"} <= below, room
        below |= rooms


def test_the_way_of_a_command_goes_through_real_functions() -> None:
    """A participant that is no file is a class of the simulation's."""
    places = re.findall(r"participant (\w+) as (\S+)", ARCHITECTURE)
    files = {key: place if place.endswith(".py") else "sim/simulation.py" for key, place in places}
    names = {key: _defined(ROOT / "uavaccel" / file) for key, file in files.items()}
    calls = re.findall(r"^ +\w->>(\w): (\w+)\(", ARCHITECTURE, re.MULTILINE)
    assert len(calls) >= 6
    for receiver, function in calls:
        assert function in names[receiver], f"{files[receiver]}: {function}"


def _defined(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
