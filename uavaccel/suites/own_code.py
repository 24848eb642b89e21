"""Python code that a configuration names, as "module:name": whose it may be, and where it is.

A YAML file or a run's folder may come from anybody. So a name means a file of the current project alone: below the
working directory, or beside the YAML file that the user has named; never what is installed, nor a part of Python. And
nothing of it runs before its user has told so, by --trust, or by naming the YAML file (`uavaccel run my.yaml`): code
that this file itself names, not that of --set, nor of another file which either of them names. The module is remembered
then, by its place and its contents, below $XDG_STATE_HOME/uavaccel/trusted.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType

from uavaccel.errors import UserError
from uavaccel.files import read_bounded, replacing

_trusted: list[tuple[Path | None, frozenset[str] | None]] = []
"""What the user has said so far: the folder beside the working directory, and the modules that may run; None: all."""
_here: dict[Path, str] = {}
"""What was remembered in this process, which may be unable to write it down."""


@contextmanager
def trusting(
    by_user: bool = True, beside: Path | None = None, modules: Collection[str] | None = None
) -> Iterator[None]:
    """In the `with` block, code of the project may run, and is remembered, if its user has said so.

    That is all of it, or `modules` alone. It is also looked up in the folder `beside`, of the YAML file that was named.
    """
    if not by_user:
        yield
        return
    _trusted.append((beside, None if modules is None else frozenset(modules)))
    try:
        yield
    finally:
        _trusted.pop()


def modules_in(value: object) -> set[str]:
    """Return the modules that a YAML's values name, as in "module:name"."""
    if isinstance(value, Mapping | list):
        return set().union(*map(modules_in, value.values() if isinstance(value, Mapping) else value))
    return {value.partition(":")[0]} if isinstance(value, str) and ":" in value else set()


def trusted_folder() -> Path | None:
    """Return the folder in which code may be beside the working directory; None without one."""
    return next((folder for folder, _ in reversed(_trusted) if folder is not None), None)


def own_module(name: str, where: str, remembered_in: Path | None = None) -> ModuleType:
    """Import a module of the current project; in the folder `remembered_in` only one that was trusted there before.

    Raises UserError, beginning with `where`, if there is none, nobody has told to run it, or it cannot be imported.
    """
    folder, files = _found(name, where, remembered_in)
    file, code = files[-1], _digest(files)
    if any(modules is None or name in modules for _, modules in _trusted):
        _remember(file, code)
    elif _remembered(file) != code:
        changed = "has changed since it was trusted" if _remembered(file) else "is code that nobody has trusted here"
        raise UserError(f"{where}: {file} {changed}: read it, then add --trust, once")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    try:
        module = import_module(name)
    except (ImportError, SyntaxError, ValueError) as error:
        raise UserError(f"{where}: {error}") from error
    if Path(module.__file__ or "").resolve() != file:
        raise UserError(f"{where}: {file} has the name of another module, {module.__file__}; rename it")
    return module


def _found(name: str, where: str, remembered_in: Path | None) -> tuple[Path, list[Path]]:
    """Return the folder in which a module is found, and the files that importing it runs, its own last."""
    beside = (folder for folder, _ in _trusted if folder is not None)
    folders = list(dict.fromkeys(folder.resolve() for folder in (Path.cwd(), *beside)))
    for folder in folders:
        if files := _files(folder, name):
            return folder, files
    if remembered_in is not None and (files := _files(remembered_in.resolve(), name)) and _remembered(files[-1]):
        return remembered_in.resolve(), files
    places = " or ".join(map(str, folders))
    raise UserError(
        f"{where}: no module {name!r} in {places}: own code is looked up in the working directory and beside the "
        "YAML file alone, not in what is installed"
    )


def _files(folder: Path, name: str) -> list[Path]:
    """Return the files that importing a module below a folder runs: its packages' and its own; none if it has none."""
    parts = name.split(".")
    if not all(part.isidentifier() for part in parts):
        return []
    above = [folder.joinpath(*parts[:count]) / "__init__.py" for count in range(1, len(parts))]
    place = folder.joinpath(*parts)
    own = next((file for file in (place / "__init__.py", place.with_suffix(".py")) if file.is_file()), None)
    return [] if own is None else [file.resolve() for file in (*above, own) if file.is_file()]


def _digest(files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(hashlib.sha256(read_bounded(file)).digest())
    return digest.hexdigest()


def _note(file: Path) -> Path | None:
    """Return where is written what was trusted at a place; None for a user without a home."""
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        folder = Path(state) if Path(state).is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError:
        return None
    return folder / "uavaccel" / "trusted" / hashlib.sha256(os.fsencode(file)).hexdigest()


def _remembered(file: Path) -> str | None:
    """Return the hash of the code that was trusted last in this place."""
    if file in _here:
        return _here[file]
    note = _note(file)
    try:
        return None if note is None else read_bounded(note).decode(errors="replace").partition(" ")[0]
    except OSError:
        return None


def _remember(file: Path, code: str) -> None:
    """Keep in mind that this code is trusted in this place, beyond this process where that can be written down."""
    if _remembered(file) == code:
        return
    _here[file] = code
    if (note := _note(file)) is not None:
        with suppress(OSError, UserError):
            note.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with replacing(note) as written:
                written.write(f"{code} {file}\n".encode(errors="surrogateescape"))
