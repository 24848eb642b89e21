"""What every page says of the project is so: links, files, commands, and the drawings of the architecture."""

from __future__ import annotations

import ast
import re
import runpy
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from tests.test_imports import GROUND, ROOMS
from uavaccel.cli.main import app
from uavaccel.config import load_yaml
from uavaccel.suites.registry import SUITES

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("experiments/*.md")])
PAGES_AND_TEXTS = [(page, page.read_text(encoding="utf-8")) for page in PAGES]
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def parse(words: list[str]) -> None:
    """Parse a command line without running it: the command is there, and so are its options, where there are any."""
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands") and words:
        name, *words = words
        command = command.commands[name]
    command.make_context(command.name, words, resilient_parsing=not words)


def found(pattern: str) -> list[tuple[str, str]]:
    return [
        (page.relative_to(ROOT).as_posix(), hit) for page, text in PAGES_AND_TEXTS for hit in re.findall(pattern, text)
    ]


@pytest.mark.parametrize(("page", "link"), sorted(set(found(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)"))))
def test_links_lead_somewhere(page: str, link: str) -> None:
    assert ((ROOT / page).parent / link).exists()


@pytest.mark.parametrize(("page", "file"), sorted(set(found(r"\b((?:uavaccel|tests|experiments|assets)/[\w/]+\.\w+)"))))
def test_files_that_are_named_are_there(page: str, file: str) -> None:
    assert "NAME" in file or (ROOT / file).exists()


@pytest.mark.parametrize(("page", "line"), sorted(set(found(r"`(uavaccel [a-z][^`\n]*)`"))))
def test_commands_within_the_text_parse(page: str, line: str) -> None:
    """The command and its options exist; blocks of them are tests/test_docs.py's."""
    parse(shlex.split(line.partition("#")[0])[1:])


@pytest.mark.parametrize("name", sorted({name for _, name in found(r"(?m)(?:`|^::: )(uavaccel\.[a-z_.]+)(?:`|$)")}))
def test_packages_and_modules_that_are_named_are_there(name: str) -> None:
    path = ROOT / name.replace(".", "/")
    assert path.is_dir() or path.with_suffix(".py").is_file()


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


def test_every_key_of_the_yaml_files_has_a_meaning() -> None:
    """On the page that docs/site makes of the schemas."""
    path = ROOT / "docs" / "site" / "keys.py"
    rows = [line for line in runpy.run_path(str(path))["page"]().splitlines() if line.startswith("| `")]
    assert len(rows) > 200
    assert [row for row in rows if row.rstrip(" |").count(" | ") != 3] == []


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
    files = dict(re.findall(r"participant (\w+) as (\S+)", ARCHITECTURE))
    names = {key: _defined(ROOT / "uavaccel" / file) for key, file in files.items()}
    calls = re.findall(r"^ +\w->>(\w): (\w+)\(", ARCHITECTURE, re.MULTILINE)
    assert len(calls) >= 6
    for receiver, function in calls:
        assert function in names[receiver], f"{files[receiver]}: {function}"


def _defined(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("target", sorted({target for _, target in found(r"(?m)(?:^|`)make (\w+)(?:`|$)")}))
def test_make_has_its_targets(target: str) -> None:
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
