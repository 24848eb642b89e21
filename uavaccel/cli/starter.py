"""The commands to start with: init, schema. They import what they need when they run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SCHEMA = "train.schema.json"  # the file that the starter's YAML names


def init(folder: Annotated[str, typer.Argument(help="A new or empty folder.")]) -> None:
    """Write a commented training and a task of one's own to begin with."""
    from uavaccel.cli.terminal import console
    from uavaccel.errors import UsageError, UserError
    from uavaccel.resources import asset

    if not folder.strip():  # as a path, this folder
        raise UsageError("init: the folder's name is empty")
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
        if present := sorted(entry.name for entry in path.iterdir()):
            raise UserError(f"{folder}: holds {present[0]}; init wants a new or an empty folder")
        for source in sorted(file for file in asset("starter").iterdir() if file.is_file()):
            (path / source.name).write_bytes(source.read_bytes())
        (path / SCHEMA).write_text(schema_text("train"), encoding="utf-8")
    except OSError as error:
        raise UserError(f"{folder}: {error.strerror}") from error
    console.print(f"{folder}: start with its README.md")


def schema(
    suite: Annotated[str, typer.Argument(help="The value of the key `suite` in a YAML file.")],
) -> None:
    """Print the JSON schema of a suite's YAML files, for editors."""
    print(schema_text(suite), end="")


def schema_text(suite: str) -> str:
    """Return the JSON schema of a suite's YAML files. Raises UserError for an unknown suite."""
    import json

    from uavaccel.config import schema as schema_of
    from uavaccel.suites.own_code import told
    from uavaccel.suites.registry import find_suite

    with told():
        return json.dumps(schema_of(find_suite(suite, "schema").config), indent=2, sort_keys=True) + "\n"
