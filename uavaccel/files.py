"""Files that survive a crash whole, in which equal values are equal bytes."""

import hashlib
import json
import math
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np

from uavaccel.errors import UserError, naming

UNFINISHED = ".unfinished"
"""The suffix of a file that is being written; a crash may leave one behind."""


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Yield a file to write, which replaces `path` once it is whole and on disk."""
    unfinished = path.with_name(path.name + UNFINISHED)
    try:
        with naming(path), unfinished.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except BaseException:  # a full disk needs the room that a half file takes
        unfinished.unlink(missing_ok=True)
        raise


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
    """Return the arrays of an .npz. Raises UserError if it is missing or damaged."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
    except (OSError, EOFError, ValueError, zipfile.BadZipFile) as error:
        raise UserError(f"{path}: cannot be read: {error}") from error


def file_sha256(path: Path) -> str:
    """Return the hash of a file's bytes, in hex. Raises UserError if it cannot be read."""
    try:
        with path.open("rb") as file:
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
        return json.dumps(value, sort_keys=True, allow_nan=False, indent=indent, default=_plain_kind)
    except ValueError:  # something is not finite
        return json.dumps(_plain(value), sort_keys=True, allow_nan=False, indent=indent)


def _plain_kind(value: object) -> object:
    """Return mappings and numpy's values as the plain data of JSON."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"Object of type {type(value).__name__} is not JSON serializable")


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def append_line(path: Path, entry: Mapping[str, object], on_disk: bool = True) -> None:
    """Append a line of JSON; with `on_disk` it is on disk on return, with all lines before it."""
    line = to_json(entry).encode() + b"\n"
    with naming(path), path.open("ab") as file:
        file.write(line)
        if on_disk:
            file.flush()
            os.fsync(file.fileno())


def read_lines(path: Path) -> list[Plain]:
    """Return the whole lines that `append_line` wrote, without a truncated or unfinished one; none without a file.

    Raises UserError, naming the line, if one is not a JSON object.
    """
    if not path.exists():
        return []
    whole = path.read_bytes().split(b"\n")[:-1]
    return [_parse_line(line, f"{path}: line {number}") for number, line in enumerate(whole, start=1)]


def _parse_line(line: bytes, where: str) -> dict[str, Plain]:
    try:
        entry = parse_json(line)
    except ValueError as error:
        raise UserError(f"{where}: not JSON: {error}") from error
    if not isinstance(entry, dict):
        raise UserError(f"{where}: not a JSON object")
    return entry


def drop_cut_line(path: Path) -> None:
    """Remove a last line that a crash truncated."""
    if path.exists():
        whole, newline, _ = path.read_bytes().rpartition(b"\n")
        os.truncate(path, len(whole + newline))
