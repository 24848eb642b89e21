"""`uavaccel init` and `uavaccel schema`: a folder to begin in, and what a YAML file may hold."""

from __future__ import annotations

import json
from pathlib import Path

from uavaccel.cli.run import console
from uavaccel.config import schema
from uavaccel.errors import UserError
from uavaccel.resources import asset
from uavaccel.suites.registry import find_suite

SCHEMA = "train.schema.json"  # which the starter's YAML names


def init(folder: Path) -> None:
    """Copy the starter into a new or empty folder. Raises UserError where there is something in it."""
    starter = asset("starter")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if strangers := sorted(entry.name for entry in folder.iterdir()):
            raise UserError(f"{folder}: holds {strangers[0]}; init wants a new or an empty folder")
        for source in sorted(file for file in starter.iterdir() if file.is_file()):
            (folder / source.name).write_bytes(source.read_bytes())
        (folder / SCHEMA).write_text(schema_text("train"), encoding="utf-8")
    except OSError as error:
        raise UserError(f"{folder}: {error.strerror}") from error
    console.print(f"{folder}: begin with its README.md", markup=False)


def schema_text(suite: str) -> str:
    """The JSON schema of a suite's YAML files. Raises UserError for a suite that there is not."""
    return json.dumps(schema(find_suite(suite, "schema").config), indent=2, sort_keys=True) + "\n"
