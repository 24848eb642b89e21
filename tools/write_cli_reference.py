"""Writes the reference of the command line from its declarations: `python tools/write_cli_reference.py > cli.md`."""

from __future__ import annotations

import re
from collections import Counter

import typer
from typer.cli import get_docs_for_click
from typer.main import get_command

from uavaccel.cli.main import app

NAME = "uavaccel"
HELP = "* `-h, --help`: Show this message and exit.\n"
LEFT_OUT = r"\*\*Usage\*\*:\n\n|\*\*Options\*\*:\n\n(?!\*)"  # what heads nothing, or what is plain
SHARED = "\n## Options of several commands\n\n"
EXIT_STATUS = """
## Exit status

0: success. 1: a mistake in the input, which one line on standard error explains. 2: wrong usage. 130: interrupted.

This page is made by `python tools/write_cli_reference.py > cli.md`.
"""


def reference() -> str:
    """Return the reference in Markdown: every command with arguments, options, defaults; what several have, once."""
    command = get_command(app)
    context = typer.Context(command, info_name=NAME, **command.context_settings)
    top, *commands = get_docs_for_click(obj=command, ctx=context, name=NAME).split("\n## ")
    shorter = [re.sub(LEFT_OUT, "", text.replace(HELP, "")) for text in commands]
    times = Counter(re.findall(r"^\* `--.*\n", "".join(text for text in shorter if "\n### " not in text), re.MULTILINE))
    shared = [line for line, count in times.items() if count > 2]
    commands = [_without(text, [line for line in shared if line in text]) for text in shorter]
    return "\n## ".join([top, *commands]).rstrip() + "\n" + SHARED + "".join(shared) + EXIT_STATUS


def _without(text: str, shared: list[str]) -> str:
    """Return a command's text with the names alone of the options that others have, too."""
    if not shared or "\n### " in text:  # which has commands of its own
        return text
    *_, last = re.finditer(r"^\* `--.*\n", text, re.MULTILINE)
    names = ", ".join(re.findall(r"^\* (`[^ `]+)", "".join(shared), re.MULTILINE))
    text = (
        text[: last.end()]
        + f"* {names.replace(',', '`,')}`: as [several commands](#options-of-several-commands)\n"
        + text[last.end() :]
    )
    for line in shared:
        text = text.replace(line, "", 1)
    return text


if __name__ == "__main__":
    print(reference(), end="")
