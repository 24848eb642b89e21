"""The forms of what a run's files hold: rows, host times, manifest and arrays, checked once where they are read.

A suite declares its row as a TypedDict and its arrays as a mapping of names to `ArrayForm`; whatever reads a run then
finds the keys that it needs, with finite numbers of the declared types.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from typing_extensions import TypedDict  # pydantic takes typing's from Python 3.12 on

from uavaccel.config import explain_value
from uavaccel.errors import UserError
from uavaccel.files import Plain

FAR, MANY = 1e12, 1 << 53  # beyond any number of a run, and within what figures and floats represent
Number = Annotated[float, Field(ge=-FAR, le=FAR)]
NotNegative = Annotated[float, Field(ge=0.0, le=FAR)]
Positive = Annotated[float, Field(gt=0.0, le=FAR)]
Count = Annotated[int, Field(ge=0, le=MANY)]
LONGEST = 1e9  # seconds, which nanoseconds can hold

MEND = "delete the line and --resume the run"


class HostTimes(TypedDict, total=False):
    """An entry of timing.jsonl."""

    wall_s: NotNegative
    host_phase_s: dict[str, NotNegative]
    learner_s: dict[str, NotNegative]


class Source(TypedDict, total=False):
    """The source tree that flew."""

    commit: str
    dirty: bool


class Start(TypedDict, total=False):
    """What describes a start of a run: the manifest of the first one, and those under `resumed`."""

    versions: dict[str, str | None]
    git: Source | None
    policy_sha256: str | None
    command_line: list[str]
    own_code: str
    """The folder of the own code that it was made with: a suite, an environment."""
    own_code_sha256: dict[str, str]
    """Hashes of its files, by their paths in that folder."""


class Manifest(Start, total=False):
    """manifest.json."""

    resumed: list[Start]


@dataclass(frozen=True)
class ArrayForm:
    """An array of finite numbers.

    `kinds` are those of its dtype, as numpy's `dtype.kind`, perhaps with the bytes of a number. A name in `shape` is a
    key of the row that has the length, or stands for one length, at least 1, of all arrays of the case.
    """

    kinds: str
    shape: tuple[str | int, ...] | None = None
    optional: bool = False
    ascends: bool = False


@dataclass(frozen=True)
class RowForm:
    """The form of a suite's rows and of their arrays, by name or by a pattern of names such as `*_lane`."""

    row: Any
    """A TypedDict, or a union of such."""
    suite: str | None = None
    case_of: Callable[[Plain], str] | None = None
    """Returns the name of a row's case by its other keys."""
    arrays: Mapping[str, ArrayForm] = field(default_factory=dict)

    def check_rows(self, rows: Sequence[Plain], source: object) -> None:
        """Raise UserError, naming line, game, key and value, unless every row has this form."""
        for number, row in enumerate(rows, start=1):
            self.check_row(row, f"{source}: line {number}: {row.get('case')}")

    def check_row(self, row: Plain, where: str, mend: str = MEND) -> None:
        """Raise UserError, naming key and value after `where`, and what to do, unless a row has this form."""
        suite, then = row.get("suite", self.suite), mend and f"; {mend}"
        if self.suite is not None and suite != self.suite:
            raise UserError(f"{where}: suite = {reprlib.repr(suite)}: this is a run of {self.suite}{then}")
        check(self.row, row, where, mend)
        if self.case_of is not None and row["case"] != (name := self.case_of(row)):
            raise UserError(f"{where}: by its other keys it is the row of {name}{then}")

    def check_arrays(
        self, arrays: Mapping[str, np.ndarray], row: Mapping[str, Plain], where: str, mend: str = MEND
    ) -> None:
        """Raise UserError, naming the array after `where`, and what to do, unless a row's arrays have this form."""
        then = mend and f"; {mend}"
        lengths: dict[str, int] = {}
        for pattern, form in self.arrays.items():
            names = [name for name in arrays if fnmatchcase(name, pattern)]
            if not (names or form.optional):
                raise UserError(f"{where}: has no array {pattern!r}{then}")
            for name in names:
                own = name.removesuffix(pattern.removeprefix("*")) if pattern.startswith("*_") else ""
                wrong = _fault(arrays[name], form) or _misfit(arrays[name], form, row, lengths, own)
                if wrong:
                    raise UserError(f"{where}: {name}: {wrong}{then}")


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    # within a list, since a TypedDict itself takes no configuration from outside
    return TypeAdapter(list[kind], config=ConfigDict(strict=True, allow_inf_nan=False))


def check(kind: Any, value: Plain, where: str, mend: str = "") -> None:
    """Raise UserError, naming key and value after `where`, unless plain data is of a kind; unknown keys may be there.

    `kind` is a TypedDict or another annotation; a number is finite, and neither a text nor a truth.
    """
    try:
        _adapter(kind).validate_python([value])
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        said = explain_value(value, {**first, "loc": first["loc"][1:]})
        raise UserError(f"{where}: {said}{mend and '; ' + mend}") from error


def check_all(kind: Any, values: Iterable[Plain], source: object) -> None:
    """Check each line of a file as `check` does, and name it."""
    for number, value in enumerate(values, start=1):
        check(kind, value, f"{source}: line {number}")


def _fault(array: np.ndarray, form: ArrayForm) -> str | None:
    """Return what is wrong with an array by itself."""
    kinds, size = form.kinds.rstrip("0123456789"), form.kinds.lstrip("abcdefghijklmnopqrstuvwxyz")
    if array.dtype.kind not in kinds or (size and array.dtype.itemsize != int(size)):
        wanted = " or ".join(_KINDS[kind] for kind in kinds)
        return f"is of {array.dtype}, not of {wanted}{size and f' of {size} byte'}"
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        return "has numbers that are not finite"
    if array.dtype.kind == "f" and array.size and np.abs(array).max() > FAR:
        return f"has numbers beyond {FAR:g}"
    if form.ascends and array.ndim == 1 and np.any(array[1:] < array[:-1]):
        return "has to ascend"
    if form.ascends and array.ndim == 1 and array.size and (array[0] < 0 or array[-1] > LONGEST):
        return f"has to begin at 0 or later and to end below {LONGEST:g}"
    return None


_KINDS = {"f": "floats", "i": "integers", "u": "unsigned integers", "b": "booleans"}


def _misfit(
    array: np.ndarray, form: ArrayForm, row: Mapping[str, Plain], lengths: dict[str, int], own: str
) -> str | None:
    """Return how an array's shape differs from its form; `lengths` are known from arrays before, by name."""
    if form.shape is None:
        return None
    wanted = []
    for depth, length in enumerate(form.shape):
        if isinstance(length, str):
            here = array.shape[depth] if depth < array.ndim else 0
            length = row[length] if length in row else lengths.setdefault(own + length, max(here, 1))
        wanted.append(length)
    fits = array.shape == tuple(wanted) and array.size
    return None if fits else f"has the shape {array.shape}, not {tuple(wanted)}"
