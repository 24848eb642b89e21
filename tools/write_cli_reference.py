"""Writes the reference of the command line from its declarations: `python tools/write_cli_reference.py > cli.md`."""

from __future__ import annotations

import re

import typer
from typer.cli import get_docs_for_click
from typer.main import get_command

from uavaccel.cli.main import app

NAME = "uavaccel"
HELP = "* `-h, --help`: Show this message and exit.\n"
LEFT_OUT = r"\*\*Usage\*\*:\n\n|\*\*Options\*\*:\n\n(?!\*)"  # what heads nothing, or what is plain
EXIT_STATUS = """
## Exit status

0: success. 1: a mistake in the input, which one line on standard error explains. 2: wrong usage. 130: interrupted.

This page is made by `python tools/write_cli_reference.py > cli.md`.
"""


def reference() -> str:
    """Return the reference in Markdown: every command with its arguments, options and defaults; `--help` once."""
    command = get_command(app)
    context = typer.Context(command, info_name=NAME, **command.context_settings)
    top, *commands = get_docs_for_click(obj=command, ctx=context, name=NAME).split("\n## ")
    shorter = [re.sub(LEFT_OUT, "", text.replace(HELP, "")) for text in commands]
    return "\n## ".join([top, *shorter]).rstrip() + "\n" + EXIT_STATUS


if __name__ == "__main__":
    print(reference(), end="")
