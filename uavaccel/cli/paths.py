"""Whether what a command will write can be written, before anything is flown."""

from __future__ import annotations

import os
from pathlib import Path

from uavaccel.errors import UserError


def check_out(folder: Path, resume: bool = False) -> None:
    """Raises UserError for a run's folder that exists, unless it is gone on with, or that cannot be made."""
    _check_name(folder)
    if folder.exists():
        if not resume:
            raise UserError(f"{folder}: exists; take another --out, or --resume to go on with it")
        return
    above = next(each for each in folder.absolute().parents if each.exists())
    if not above.is_dir():
        raise UserError(f"--out {folder}: {above} is no folder")
    if not os.access(above, os.W_OK):
        raise UserError(f"--out {folder}: {above} may not be written")


def check_file(file: Path, option: str = "--out") -> None:
    """Raises UserError for a file that exists, or that cannot be made in the folder where it would be."""
    _check_name(file)
    if file.exists():
        raise UserError(f"{file}: exists; take another {option}")
    if not file.absolute().parent.is_dir():
        raise UserError(f"{option} {file}: there is no folder {file.parent}")
    if not os.access(file.absolute().parent, os.W_OK):
        raise UserError(f"{option} {file}: {file.parent} may not be written")


def _check_name(path: Path) -> None:
    try:
        path.exists()
    except OSError as error:
        raise UserError(f"--out {str(path)[:40]}...: {error.strerror}") from error
