"""The messages of a flight, a line of JSON each, and the first one in which two flights differ."""

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
LONG_BYTES = 200  # of a state or an image, of which polling scripts ask a million


_encode = json.JSONEncoder(ensure_ascii=False, default=bytes.hex).encode


class DifferenceError(UserError):
    """Two flights that should be equal are not."""


class MessageLog:
    """Writes calls and answers in order. With a `reference`, a folder, stops at the first line that is not as there.

    Raises DifferenceError then; UserError where it cannot be written, and, since scripts catch what calls raise, from
    then on.
    """

    def __init__(self, folder: Path, reference: Path | None = None) -> None:
        self._path = folder / FILE_NAME
        self._refused = ""
        with naming(self._path):
            self._file = self._path.open("w", encoding="utf-8", newline="\n")
        self._expected = None if reference is None else _lines(reference / FILE_NAME)
        self.calls = 0

    def call(self, wall_ns: int, time_ns: int | None, method: str, params: Sequence[object]) -> int:
        """A call as it is handled, at wall and simulated time; returns its number."""
        self.calls += 1
        row = {"call": self.calls, "wall_ns": wall_ns, "time_ns": time_ns, "method": method}
        self._write(row | {"params": [brief(value) for value in params]})
        return self.calls

    def answer(self, number: int, wall_ns: int, error: str | None, result: object) -> None:
        """An answer, at the wall time from which it is on its way."""
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
        """In a process that was forked off: what is not written yet is the other one's to write."""
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), self._file.fileno())

    def close_file(self) -> None:
        """Raises UserError if not all of it could be written."""
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
            self.abandon()  # its end would complain of it again
        try:
            with naming(self._path):
                raise error
        except UserError as refused:
            self._refused = str(refused)
            raise

    def close(self) -> None:
        """Raises DifferenceError if the reference has more lines."""
        self.close_file()
        if self._expected is not None and (expected := next(self._expected, None)) is not None:
            raise differs(self.calls, expected, "(has ended)")


def differs(call: int, first: str, second: str) -> DifferenceError:
    """What the user is told: the last call that was made, and the two lines."""
    return DifferenceError(f"the flights differ at call {call}\n  first:  {first}\n  second: {second}")


def brief(value: object) -> object:
    """A value as it is, or, of what is long on the wire, the length there and a digest."""
    packed = msgpack.packb(value)
    if len(packed) <= LONG_BYTES:
        return value
    return {"bytes": len(packed), "sha256": hashlib.sha256(packed).hexdigest()[:32]}


def _lines(path: Path) -> Iterator[str]:
    with path.open(encoding="utf-8") as file:
        for line in file:
            yield line.rstrip("\n")
