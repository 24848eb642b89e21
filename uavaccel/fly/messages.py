"""The message log of a flight: a line of JSON per message, and a comparison with another flight's log."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

import msgpack

from uavaccel.errors import UserError, naming

FILE_NAME = "messages.jsonl"
LONG_BYTES = 200  # longer values, such as images, are logged as digests: a script may poll millions

_encode = json.JSONEncoder(ensure_ascii=False, default=bytes.hex).encode


class DifferenceError(UserError):
    """Two flights that should be equal differ."""


class MessageLog:
    """Writes calls and answers in order, and compares them with the log in the folder `reference`, if given.

    Raises DifferenceError at the first line that differs. Raises UserError if the log cannot be written, and at every
    later message too, since scripts catch the exceptions of calls.
    """

    def __init__(self, folder: Path, reference: Path | None = None) -> None:
        self._path = folder / FILE_NAME
        self._refused = ""
        with naming(self._path):
            self._file = self._path.open("w", encoding="utf-8", newline="\n")
        self._expected = None if reference is None else _lines(reference / FILE_NAME)
        self.calls = 0

    def call(self, wall_ns: int, time_ns: int | None, method: str, params: Sequence[object]) -> int:
        """Log a call at the wall and the simulated time at which it is handled; returns its number."""
        self.calls += 1
        row = {"call": self.calls, "wall_ns": wall_ns, "time_ns": time_ns, "method": method}
        self._write(row | {"params": [brief(value) for value in params]})
        return self.calls

    def answer(self, number: int, wall_ns: int, error: str | None, result: object) -> None:
        """Log an answer at the wall time at which it is sent."""
        outcome = {"result": brief(result)} if error is None else {"error": error}
        self._write({"answer": number, "wall_ns": wall_ns, **outcome})

    def _write(self, row: Mapping[str, object]) -> None:
        line = _encode(row)
        self._check()
        try:
            self._file.write(line + "\n")
        except OSError as error:
            self._refuse(error)
        if self._expected is not None and (expected := next(self._expected, "(has ended)")) != line:
            raise differs(self.calls, expected, line)

    def abandon(self) -> None:
        """In a forked process, drop the buffered lines, which its parent writes, and keep and compare nothing."""
        self._expected = None
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), self._file.fileno())

    def close_file(self) -> None:
        """Close the file. Raises UserError if not all of it could be written."""
        self._check()
        try:
            self._file.close()
        except OSError as error:
            self._refuse(error)

    def _check(self) -> None:
        if self._refused:
            raise UserError(self._refused)

    def _refuse(self, error: OSError) -> NoReturn:
        if not self._file.closed:
            self.abandon()  # or closing the file would fail again
            self._file.close()
        try:
            with naming(self._path):
                raise error
        except UserError as refused:
            self._refused = str(refused)
            raise

    def close(self) -> None:
        """Close the log. Raises DifferenceError if the reference has more lines."""
        self.close_file()
        if self._expected is not None and (expected := next(self._expected, None)) is not None:
            raise differs(self.calls, expected, "(has ended)")


def differs(call: int, first: str, second: str) -> DifferenceError:
    """Return the error for the user, with the number of the last call and the two lines."""
    return DifferenceError(f"the flights differ at call {call}\n  first:  {first}\n  second: {second}")


def brief(value: object) -> object:
    """Return the value itself, or the length and a digest of one that is long on the wire."""
    packed = msgpack.packb(value)
    if len(packed) <= LONG_BYTES:
        return value
    return {"bytes": len(packed), "sha256": hashlib.sha256(packed).hexdigest()[:32]}


def _lines(path: Path) -> Iterator[str]:
    with path.open(encoding="utf-8") as file:
        for line in file:
            yield line.rstrip("\n")
