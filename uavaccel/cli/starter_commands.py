"""What helps to begin: init, schema.

Thin shells over plain functions, which are imported when a command runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def init(folder: Annotated[str, typer.Argument(help="A new or an empty one.")]) -> None:
    """Write a commented training and a task of one's own to begin with."""
    from uavaccel.cli.starter import init as write_starter
    from uavaccel.errors import UsageError

    if not folder.strip():  # as a path, this folder
        raise UsageError("init: the folder's name is empty")
    write_starter(Path(folder))


def schema(
    suite: Annotated[str, typer.Argument(help="As the key `suite` of a YAML file names it.")],
) -> None:
    """Print the JSON schema of a suite's YAML files, for editors."""
    from uavaccel.cli.starter import schema_text

    print(schema_text(suite), end="")
