"""Python code that a configuration names, as "module:name" or "file.py:name": whose it may be, and where it is.

A YAML file or a run's folder may come from anybody. So a name means a file of the current project alone: below the
working directory, or beside the YAML file that the user has named; never what is installed, nor a part of Python. And
nothing of it runs before its user has told so, by --trust, or by naming the YAML file (`uavaccel run my.yaml`): code
that this file itself names, not that of --set, nor of another file which either of them names. The module is remembered
then, by its place and its contents, below $XDG_STATE_HOME/uavaccel/trusted. A run and a policy note the folder of the
code that they were made with, in which it is also looked up, if it is remembered there.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from inspect import signature
from itertools import takewhile
from pathlib import Path
from traceback import walk_tb
from types import ModuleType
from typing import Any

from uavaccel.errors import UserError, suggestion
from uavaccel.files import read_bounded, replacing

Stamp = tuple[int, int] | None
"""Changes with a file: when it was written, and its size; None without a file."""
_trusted: list[tuple[Path | None, frozenset[str] | None]] = []
"""What the user has said so far: the folder beside the working directory, and the modules that may run; None: all."""
RELATIVE = re.compile(rb"^[ \t]*from[ \t]+\.", re.MULTILINE)
"""Begins an import from the package that a file is in."""
OUTSIDE = ("/", "../")
"""Begin paths that lead out of the folders in which code is looked up."""
NAMING = ("suite", "env_id", "agent")
"""Keys of a run whose values may name code."""

_here: dict[Path, str] = {}
"""What was remembered in this process, which may be unable to write it down."""
_noted: list[Path] = []
"""Folders that runs and policies name, in which only remembered code may run."""
_imported: dict[str, Path] = {}
"""The files of the modules that were imported in this process."""
_projects: dict[Path, dict[Path, Stamp]] = {}
"""The folders from which they were imported, and the files that were read there, theirs too, with their stamps."""
_importing: list[Path | str] = []
"""Those that are being imported."""


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
    """Return the modules that a YAML's values name, as in "module:name", "file.py:name" or "file.py"."""
    if isinstance(value, Mapping | list):
        return set().union(*map(modules_in, value.values() if isinstance(value, Mapping) else value))
    return {module_of(value)} if isinstance(value, str) and (":" in value or value.endswith(".py")) else set()


def module_of(place: str) -> str:
    """Return the module in "module:name" or, by its path, in "folder/file.py:name"; one from outside stays."""
    file = place.partition(":")[0]
    if not file.endswith(".py") or file.startswith(OUTSIDE):
        return file
    return file.removesuffix(".py").removeprefix("./").replace("/", ".")


def trusted_folder() -> Path | None:
    """Return the folder in which code may be beside the working directory; None without one."""
    return next((folder for folder, _ in reversed(_trusted) if folder is not None), None)


def file_beside(name: str | Path) -> Path:
    """Return the file of a name in a YAML file: from the working directory or, if none is there, from beside it."""
    path, folder = Path(name), trusted_folder()
    return path if folder is None or path.exists() or not (folder / path).exists() else folder / path


def name_beside(name: str) -> str:
    """Return a name, or the path beside a YAML file that it is, if it is none from the working directory."""
    return name if (found := file_beside(name)) == Path(name) else str(found)


def look_also_in(folder: object) -> None:
    """Look code up in a folder that a run or a policy has noted, too; there only what was trusted before may run.

    What another has noted before is looked up after it: their files may have the same names.
    """
    if isinstance(folder, str):
        _noted[:] = dict.fromkeys((Path(folder), *_noted))


def as_noted(mapping: Mapping[str, Any], folder: object) -> dict[str, Any]:
    """Return the mapping of a run or a policy, in which names of code mean that of the folder that it has noted.

    Where they would lead to another file here, of another project, they become paths, if that code is remembered.
    """
    made = dict(mapping)
    if isinstance(folder, str):
        noted = Path(os.path.abspath(folder))
        made |= {key: _as_noted(made[key], noted) for key in NAMING if key in made}
        if isinstance(part := made.get("training"), Mapping):  # of several seeds
            made["training"] = {**part, **{key: _as_noted(part[key], noted) for key in NAMING if key in part}}
    return made


def _as_noted(name: object, noted: Path) -> object:
    if not isinstance(name, str) or ":" not in name:
        return name
    here, there = _found_here(module_of(name)), _found_in(noted, module_of(name))
    if not here or not there or here[1][-1] == (file := there[1][-1]) or _remembered(file) is None:
        return name
    return f"{file}:{name.partition(':')[2]}" if imported_from(file) == there[0] else name


def own_class(place: str, where: str, *bases: type) -> type[Any]:
    """Return the class "module:name" of the current project, a subclass of one of `bases`.

    Raises UserError, beginning with `where`, as `own_module` does, and if it is none.
    """
    name, named = place.partition(":")[2], vars(own_module(module_of(place), where))
    there = {each: value for each, value in named.items() if isinstance(value, type) and issubclass(value, bases)}
    if name in there:
        return there[name]
    none = f"{where}: names no {' or '.join(f'{base.__module__}.{base.__qualname__}' for base in bases)}"
    if name in named:
        raise UserError(f"{none}: {name} is none")
    raise UserError(f"{none}: {module_of(place)} has no {name}; {suggestion(name, list(there))}")


def own_function(place: str, where: str) -> tuple[Callable[..., Any], Path]:
    """Return the function "module:name" of the current project, and the file of its module.

    Raises UserError, beginning with `where`, as `own_module` does, and if it is none.
    """
    module, name = own_module(module_of(place), where), place.partition(":")[2]
    if isinstance(found := getattr(module, name, None), type):
        raise UserError(f"{where}: {name} is a class: name a function, or an object of that class")
    if callable(found):
        return found, Path(str(module.__file__)).resolve()
    there = [each for each, value in vars(module).items() if callable(value) and not each.startswith("_")]
    raise UserError(f"{where}: {module_of(place)} has no function {name}; {suggestion(name, there)}")


def takes(function: Callable[..., Any], count: int) -> bool:
    """Whether a function can be called with so many values."""
    try:
        signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # NumPy's functions do not say
        return count == 1
    return True


def own_module(name: str, where: str) -> ModuleType:
    """Import a module of the current project.

    Raises UserError, beginning with `where`, if there is none, nobody has told to run it, or it cannot be imported.
    """
    folder, files = _found(name, where)
    file, place = files[-1], name
    if place.endswith(".py"):
        name = module_of(str(file.relative_to(folder)))
    if name in sys.modules and _imported.get(name) == file:
        return sys.modules[name]  # though its file may have changed since
    if not is_trusted(file, _digest(files), place):
        changed = "has changed since it was trusted" if _remembered(file) else "is code that nobody has trusted here"
        raise UserError(f"{where}: {file} {changed}: read it, then add --trust, once")
    sys.path[:] = [str(folder), *(place for place in sys.path if place != str(folder))]
    if name in _imported:  # from another project of this process
        sys.modules.pop(name, None)
    _forget_namesakes(folder)
    try:
        with errors_named(file, where):
            module = import_alone(name, file)
    except (ImportError, SyntaxError) as error:  # of a module that it imports
        raise UserError(f"{where}: {error}") from error
    if Path(module.__file__ or "").resolve() != file:
        raise UserError(f"{where}: {file} has the name of another module, {module.__file__}; rename it")
    _imported[name] = file
    _projects.setdefault(folder, {}).update((each, stamp(each)) for each in _modules_from(folder).values())
    return module


def stamp(file: Path) -> Stamp:
    """Return the stamp of a file."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def imported_code() -> tuple[tuple[str, Stamp], ...]:
    """Return the files of own code that were imported in this process, as they were then."""
    return tuple((str(file), then) for files in _projects.values() for file, then in files.items())


def code_state() -> tuple[object, ...]:
    """Return what decides which class a name means: where code is looked up, and what was imported."""
    return (*_folders(), *imported_code())


def forget_changed() -> None:
    """Forget the own code of folders in which a file has changed since: in a notebook, code is edited between runs."""
    for folder, files in _projects.items():
        if any(stamp(file) != then for file, then in files.items()):
            files.clear()
            for name in _modules_from(folder):
                del sys.modules[name]


def _forget_namesakes(folder: Path) -> None:
    """Forget modules from other folders of own code whose names mean what is in this one."""
    for other in _projects.keys() - {folder}:
        for name in _modules_from(other):
            if any((folder / f"{name.partition('.')[0]}{suffix}").exists() for suffix in ("", ".py")):
                del sys.modules[name]


def _modules_from(folder: Path) -> dict[str, Path]:
    """Return the modules that were imported from a folder, by name, with their files; none of this package."""
    found = {}
    for name, module in [*sys.modules.items()]:
        place, file = f"{folder}/{name.replace('.', '/')}", getattr(module, "__file__", None)
        if file in (f"{place}.py", f"{place}/__init__.py") and name.partition(".")[0] != __package__:
            found[name] = Path(file)
    return found


def import_alone(name: str, file: Path | None = None) -> ModuleType:
    """Import a module for a class in it. A program that would fly there, or start processes, is refused.

    The environments are registered before: its own `import uavaccel` comes too late for that in a worker process.
    """
    if find_spec("uavaccel.envs"):
        import_module("uavaccel.envs")
    _importing.append(file or name)
    try:
        return import_module(name)
    finally:
        _importing.pop()


def check_not_importing() -> None:
    """Raise UserError where a program flies while it is imported for a class in it, which would never end."""
    if _importing:
        raise UserError(
            f"{_importing[-1]}: is imported for a class in it, and must not fly then: put what flies below "
            "`if __name__ == '__main__':`"
        )


def file_of(owner: type) -> Path | None:
    """Return the file of a class; None for a class of this package, and for one without a file."""
    module = sys.modules[owner.__module__]
    file, shipped = getattr(module, "__file__", None), module.__name__.partition(".")[0] == __package__
    return Path(file).resolve() if file and not shipped and Path(file).is_file() else None


def files_of(*owners: type) -> list[Path]:
    """Return the files of classes, and of those of one's own from which they are derived."""
    return [file for owner in owners for file in takewhile(bool, map(file_of, owner.__mro__)) if file]


def folder_of(owner: type) -> Path | None:
    """Return the folder from which the module of a class is imported; None as `file_of` has it."""
    file = file_of(owner)
    return file and file.parents[_name_of(owner, file).count(".") + (file.name == "__init__.py")]


def place_of(owner: type) -> str:
    """Return "module:Class" of a class, by which other processes import it. Raises UserError where none can."""
    file = file_of(owner)
    if "<locals>" in owner.__qualname__ or (owner.__module__ == "__main__" and file is None):
        raise UserError(
            f"{owner.__qualname__}: is in no file, or in a function, and so unknown in other processes: write it into "
            "a file of its own, or take simulator = kernels"
        )
    return f"{_name_of(owner, file)}:{owner.__qualname__}"


def _name_of(owner: type, file: Path | None) -> str:
    """Return the name by which the module of a class can be imported, also where it is the program's own."""
    if owner.__module__ != "__main__" or file is None:
        return owner.__module__
    spec = sys.modules["__main__"].__spec__  # of `python -m package.module`
    return file.stem if spec is None else spec.name


@contextmanager
def errors_named(files: Path | Sequence[Path] | None, where: str = "") -> Iterator[None]:
    """Turn an error that comes out of own code into a UserError of one line: file, line, function, and what it says.

    Without a file no code is own. Where other code failed that a file called, the line is that of the call.
    """
    named = [files] if isinstance(files, Path) else files or ()
    try:
        yield
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        frames = [(frame.f_code, line) for frame, line in walk_tb(error.__traceback__)]
        own = [(code, line) for code, line in frames if Path(code.co_filename) in named]
        if isinstance(error, SyntaxError) and Path(error.filename or "") in named:
            place, said = f"{error.filename}:{error.lineno}", error.msg
        elif own:
            code, line = own[-1]
            function = code.co_qualname.replace("<module>", "")
            place, said = f"{code.co_filename}:{line}{': ' * bool(function)}{function}", str(error).partition("\n")[0]
        else:
            raise
        raise UserError(f"{where}{': ' * bool(where)}{place}: {type(error).__name__}: {said}") from error


def _found(name: str, where: str) -> tuple[Path, list[Path]]:
    """Return the folder in which a module is found, and the files that importing it runs, its own last."""
    if found := _found_here(name):
        return found
    for noted in _noted:
        if (found := _found_in(noted.resolve(), name)) and _remembered(found[1][-1]):
            return found
    if name in _imported:
        file = _imported[name]
        return file.parents[name.count(".") + (file.name == "__init__.py")], [file]
    parts = [Path(name).stem] if name.endswith(".py") else re.split("[./]", name)
    if wrong := next((part for part in parts if part and not part.isidentifier()), None):
        better = re.sub(r"\W", "_", wrong)
        raise UserError(f"{where}: {wrong!r} is no name that Python can import: rename it, as to {better!r}")
    places = " or ".join(map(str, _folders()))
    what = "file" if name.endswith(".py") else "module"
    raise UserError(
        f"{where}: no {what} {name!r} in {places}: own code is looked up in the working directory and beside the "
        "YAML file alone, not in what is installed"
    )


def _folders() -> list[Path]:
    """Return the folders in which code is looked up."""
    beside = (folder for folder, _ in reversed(_trusted) if folder is not None)
    return list(dict.fromkeys(folder.resolve() for folder in (*beside, Path.cwd())))


def _found_here(name: str) -> tuple[Path, list[Path]] | None:
    """Return what `_found` does of a module that is in one of these folders."""
    return next(filter(None, (_found_in(folder, name) for folder in _folders())), None)


def _found_in(folder: Path, name: str) -> tuple[Path, list[Path]] | None:
    """Return what `_found` does of a module that is looked up in this folder; None if it is not there."""
    if name.startswith(OUTSIDE) and os.path.isfile(folder / name):
        file = folder.joinpath(name).resolve()
        folder = imported_from(file)
        name = module_of(str(file.relative_to(folder)))
    files = _files(folder, name)
    return (folder, files) if files else None


def looked_up_in(place: str) -> Path | None:
    """Return the folder from which the name of own code leads to it; None for other names."""
    return next((folder for folder in _folders() if ":" in place and _found_in(folder, module_of(place))), None)


def imported_from(file: Path) -> Path:
    """Return the folder from which a file is imported: its own or, of one that imports relatively, its package's."""
    folder = file.parent
    if RELATIVE.search(read_bounded(file)):
        while (folder / "__init__.py").is_file():
            folder = folder.parent
    return folder


def _files(folder: Path, name: str) -> list[Path]:
    """Return the files that importing a module below a folder runs: its packages' and its own; none if it has none."""
    parts = name.split(".")
    if not all(part.isidentifier() for part in parts):
        return []
    above = [folder.joinpath(*parts[:count]) / "__init__.py" for count in range(1, len(parts))]
    place = folder.joinpath(*parts)
    own = next((file for file in (place / "__init__.py", place.with_suffix(".py")) if os.path.isfile(file)), None)
    return [] if own is None else [file.resolve() for file in (*above, own) if file.is_file()]


def _digest(files: Sequence[Path]) -> str:
    return hashlib.sha256(b"".join(hashlib.sha256(read_bounded(file)).digest() for file in files)).hexdigest()


def _note(file: Path) -> Path | None:
    """Return where is written what was trusted at a place; None for a user without a home."""
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        folder = Path(state) if Path(state).is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError:
        return None
    return folder / "uavaccel" / "trusted" / hashlib.sha256(os.fsencode(file)).hexdigest()


def is_trusted(file: Path, code: str, name: str | None = None) -> bool:
    """Return whether a file with the hash `code`, that of the module `name`, may run.

    If told now, that is kept in mind, beyond this process where it can be written down.
    """
    told = any(modules is None or name in modules for _, modules in _trusted)
    if told and _remembered(file) != code:
        _here[file] = code
        if (note := _note(file)) is not None:
            with suppress(OSError, UserError):
                note.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
                with replacing(note) as written:
                    written.write(f"{code} {file}\n".encode(errors="surrogateescape"))
    return _remembered(file) == code


def _remembered(file: Path) -> str | None:
    """Return the hash of the code that was trusted last in this place."""
    if file in _here:
        return _here[file]
    with suppress(OSError):
        if (note := _note(file)) is not None:
            return read_bounded(note).decode(errors="replace").partition(" ")[0]
    return None
