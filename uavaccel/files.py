"""Files that survive a crash whole, in which equal values are equal bytes; and the bounds of those that are read.

What a user names, or a folder from elsewhere holds, is opened by `open_bounded`: devices, pipes and files beyond any
reasonable size are refused before they are read. Names that come from such a folder become paths by `inside`. A folder
that one process alone may write is locked by `lock_of`.
"""

import errno
import hashlib
import json
import os
import stat
import sys
import weakref
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np

from uavaccel.errors import UserError, naming

UNFINISHED = ".unfinished"
"""The suffix of a file that is being written; a crash may leave one behind."""
TEXT_BYTES = 16 << 20
"""The largest YAML or JSON document, script or scene that is read."""
LINES_BYTES, MOST_LINES, LINE_BYTES = 512 << 20, 10_000_000, 16 << 20
"""The same of a file of rows, their most, and the longest."""
ARRAYS_BYTES = 8 << 30
"""The same of the arrays in an .npz, unpacked, and of a policy's weights."""


def open_bounded(path: Path, most_bytes: int = TEXT_BYTES) -> BufferedReader:
    """Open a file to be read. Raises UserError for a device, a pipe and a larger file, OSError where there is none."""
    without_waiting = getattr(os, "O_NONBLOCK", 0)  # for a pipe's writer
    file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | without_waiting))  # noqa: SIM115
    status = os.fstat(file.fileno())
    why = "" if stat.S_ISREG(status.st_mode) else "no regular file"
    if status.st_size > most_bytes:
        why = f"has {status.st_size:,} bytes, where at most {most_bytes:,} are read"
    if why:
        file.close()
        raise UserError(f"{path}: {why}")
    return file


def read_bounded(path: Path, most_bytes: int = TEXT_BYTES) -> bytes:
    """Return a file's bytes. Raises as `open_bounded` does, also for a file that tells another size than it has."""
    with open_bounded(path, most_bytes) as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise UserError(f"{path}: is longer than {most_bytes:,} bytes")
    return content


def is_file_name(name: object) -> bool:
    """Return whether a name can be that of a file in a folder: of a case, say."""
    return isinstance(name, str) and "/" not in name and name.isprintable() and bool(name.strip("."))


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder. Raises UserError if it would be elsewhere, also by a link."""
    path = folder / name
    with suppress(OSError, RuntimeError, ValueError):  # links in a circle, a zero byte
        if folder.resolve() in path.resolve().parents:
            return path
    raise UserError(f"{name!r} would be a file outside of {folder}")


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Yield a file to write, which replaces `path` once it is whole and on disk."""
    unfinished = path.with_name(path.name + UNFINISHED)
    try:
        with naming(path):
            with open(unfinished, "wb", opener=_without_links) as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(path)
    except BaseException:  # a full disk needs the room that a half file takes
        unfinished.unlink(missing_ok=True)
        raise


def _without_links(path: str, flags: int) -> int:
    """Open a file to be written; a folder from elsewhere may have a link in its place, to any file."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write an .npz whose bytes depend on names and values alone: sorted, C-contiguous, undated.

    Arrays of uint8 are images and are compressed, to about a fifth; their bytes also depend on zlib's version.
    """
    with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name in sorted(arrays):
            array = np.asarray(arrays[name], order="C")
            undated = zipfile.ZipInfo(f"{name}.npy")
            undated.compress_type = zipfile.ZIP_DEFLATED if array.dtype == np.uint8 else zipfile.ZIP_STORED
            with archive.open(undated, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an .npz. Raises UserError if it is missing or damaged, or unpacks beyond ARRAYS_BYTES."""
    try:
        with open_bounded(path, ARRAYS_BYTES) as file:
            if not zipfile.is_zipfile(file):
                raise ValueError("is no .npz, or only a part of one")
            file.seek(0)
            with np.load(file, allow_pickle=False) as arrays:
                if sum(member.file_size for member in arrays.zip.infolist()) > ARRAYS_BYTES:
                    raise UserError(f"{path}: unpacks to more than {ARRAYS_BYTES:,} bytes")
                return dict(arrays)
    except (OSError, EOFError, MemoryError, ValueError, zipfile.BadZipFile) as error:
        raise UserError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error


def file_sha256(path: Path) -> str:
    """Return the hash of a file's bytes, in hex. Raises UserError if it cannot be read."""
    try:
        with open_bounded(path, ARRAYS_BYTES) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from error


Plain: TypeAlias = Any  # data as JSON and YAML hold it, whose form its reader knows or checks


def parse_json(text: str | bytes) -> Plain:
    """Return the value of a JSON text. Raises ValueError, also where it is nested too deeply."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def to_json(value: object, indent: int | None = None) -> str:
    """Return JSON of plain data and numpy's: keys sorted, floats that read back equal, null for a non-finite one."""
    try:
        return json.dumps(value, sort_keys=True, allow_nan=False, indent=indent, default=_plain)
    except ValueError:  # something is not finite
        finite = json.loads(json.dumps(value, default=_plain), parse_constant=lambda _: None)
        return json.dumps(finite, sort_keys=True, allow_nan=False, indent=indent)


def check_json(entries: Mapping[str, object], where: str) -> None:
    """Raise UserError, which names the first such key after `where`, for entries that are no JSON to be read back."""

    def fault(value: object) -> str | None:
        try:
            json.dumps(parse_json(to_json(value)), ensure_ascii=False).encode()
        except (TypeError, ValueError, RecursionError) as error:
            return str(error)
        return None

    if (said := fault(entries)) is not None:
        named = (f"{name!r}: {own}" for name, value in entries.items() if (own := fault({name: value})) is not None)
        raise UserError(f"{where} is no JSON: {next(named, said)}")


def write_json(path: Path, value: object) -> Path:
    """Write JSON, in lines that are indented, in place of what is there; returns the path."""
    with replacing(path) as file:
        file.write(f"{to_json(value, indent=1)}\n".encode())
    return path


def _plain(value: object) -> object:
    """Return mappings and numpy's values as the plain data of JSON."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"Object of type {type(value).__name__} is not JSON serializable")


def append_lines(path: Path, lines: Sequence[str]) -> None:
    """Append lines, such as those of `to_json`; they are on disk on return."""
    with naming(path), open(path, "ab", opener=_without_links) as file:
        file.write("".join(f"{line}\n" for line in lines).encode())
        file.flush()
        os.fsync(file.fileno())


def read_lines(path: Path) -> list[Plain]:
    """Return the whole lines that `append_lines` wrote, without a truncated or unfinished one; none without a file.

    Raises UserError, naming the line, if one is not a JSON object.
    """
    entries: list[Plain] = []
    try:
        with open_bounded(path, LINES_BYTES) as file:
            while (line := file.readline(LINE_BYTES)).endswith(b"\n") or len(line) == LINE_BYTES:
                where = f"{path}: line {len(entries) + 1}"
                if len(entries) == MOST_LINES or len(line) == LINE_BYTES:
                    raise UserError(f"{where}: at most {MOST_LINES:,} lines are read, of {LINE_BYTES:,} bytes each")
                entries.append(_row(line))
                if not isinstance(entries[-1], dict):
                    raise UserError(f"{where}: not a JSON object")
    except ValueError as error:
        raise UserError(f"{path}: line {len(entries) + 1}: not JSON: {error}") from error
    except FileNotFoundError:
        pass
    return entries


def _row(line: bytes) -> Plain:
    """Return what `parse_json` does, in a third of the time where pydantic is installed."""
    try:
        from pydantic_core import from_json

        return from_json(line)
    except (ImportError, ValueError):
        return parse_json(line)  # which says what is wrong


def read_json(path: Path) -> Plain:
    """Return the value in a JSON file. Raises UserError where it is missing or damaged."""
    try:
        return parse_json(read_bounded(path).decode("utf-8"))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise UserError(f"{path}: not JSON: {error}") from error


def drop_cut_line(path: Path) -> None:
    """Remove a last line that a crash truncated."""
    if path.exists():
        whole, newline, _ = read_bounded(path, LINES_BYTES).rpartition(b"\n")
        os.truncate(path, len(whole + newline))


def check_new_folder(folder: Path, resume: bool = False) -> None:
    """Raise UserError for a run's folder that exists, unless the run is resumed, or that cannot be made."""
    if not _exists(folder):
        _check_writable(folder, next(parent for parent in folder.absolute().parents if parent.exists()))
    elif not resume:
        raise UserError(f"{folder}: exists; take another --out, or --resume to go on with it")
    elif not folder.is_dir():
        raise UserError(f"--out {folder}: is no folder, so no run to go on with")


def check_new_file(file: Path) -> None:
    """Raise UserError for a file that exists, or that cannot be made in its folder."""
    if _exists(file):
        raise UserError(f"{file}: exists; take another --out")
    _check_writable(file, file.absolute().parent)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:  # its name is too long
        raise UserError(f"--out {str(path)[:40]}...: {error.strerror}") from error


def _check_writable(path: Path, above: Path) -> None:
    if not above.is_dir():
        raise UserError(f"--out {path}: there is no folder {above}")
    if not os.access(above, os.W_OK):
        raise UserError(f"--out {path}: {above} may not be written")


class FolderLock:
    """Locks an existing folder for one process, as long as this object exists; the system releases it with the process.

    Nothing is written into the folder. On Windows, and on file systems without locks, it has no effect. Raises
    UserError if another process has locked it.
    """

    def __init__(self, folder: Path) -> None:
        if sys.platform == "win32":
            return
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
        weakref.finalize(self, os.close, descriptor)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(
                f"{folder}: another process is flying this run; let it end, or stop it, before --resume"
            ) from None
        except OSError as error:
            if error.errno not in (errno.ENOTSUP, errno.ENOSYS, errno.ENOLCK, errno.EBADF):  # has no locks
                raise


_HELD: weakref.WeakValueDictionary[tuple[int, int], FolderLock] = weakref.WeakValueDictionary()


def lock_of(folder: Path) -> FolderLock:
    """Return this process's lock of a folder, which is shared within it, whatever the folder's name is by now.

    Raises UserError as `FolderLock` does.
    """
    found = folder.stat()
    place = found.st_dev, found.st_ino
    lock = _HELD[place] = _HELD.get(place) or FolderLock(folder)
    return lock
