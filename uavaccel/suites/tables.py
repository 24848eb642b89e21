"""Export of a run as CSV or Parquet: its rows, a line per game, and its samples, a table for each length of array.

In Parquet numbers keep their types; in CSV floats have as many digits as are needed to read them back equal.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.config import dotted_keys
from uavaccel.errors import UserError
from uavaccel.files import inside, replacing
from uavaccel.records import RunDirectory
from uavaccel.suites.rows import Row

Columns = dict[str, list[object] | NDArray[np.generic]]
WriteTable = Callable[[Columns, IO[bytes]], None]
MISSING = "Parquet needs the package pyarrow: pip install 'uavaccel[parquet]'; CSV needs nothing more"
WIDEST = 64  # numbers per line of an array that is exported; images are not


def write_tables(run: RunDirectory, folder: Path, kind: str) -> Iterator[Path]:
    """Write `rows` and, below `samples`, a table per game and length of its arrays, and yield each file written.

    `kind` is csv or parquet. Raises UserError where the run has no rows, the folder cannot be written, or pyarrow is
    missing.
    """
    write = _writer(kind)
    rows = run.rows()
    if not rows:
        raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield _written(folder / f"rows.{kind}", row_table(rows), write)
        for row in rows:
            for length, table in sample_tables(run.load_arrays(row) if "arrays" in row else {}):
                path = inside(folder, f"samples/{row['case']}-{length}.{kind}")
                path.parent.mkdir(parents=True, exist_ok=True)
                yield _written(path, table, write)
    except OSError as error:
        raise UserError(f"{folder}: {error.strerror}") from error


def row_table(rows: Sequence[Row]) -> Columns:
    """Return a column per dotted key, with lists as JSON, and None in rows that lack a key."""
    flat = [
        {
            key: json.dumps(value) if isinstance(value, list) else value
            for key, value in dotted_keys(row).items()
            if value != {}
        }
        for row in rows
    ]
    names = list(dict.fromkeys(name for line in flat for name in line))
    return {name: _of_one_kind([line.get(name) for line in flat]) for name in names}


def _of_one_kind(values: list[object]) -> list[object]:
    """Return the values, all as texts where their types differ."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) < 2 or kinds <= {int, float}:
        return values
    return [value if value is None or isinstance(value, str) else json.dumps(value) for value in values]


def sample_tables(arrays: Mapping[str, NDArray[Any]]) -> Iterator[tuple[int, Columns]]:
    """Yield the arrays (n, ...) of a game by length n, with a column for each number of a line, such as position_m.0.

    Images, whose lines have more than 64 numbers, are left out.
    """
    lengths = sorted({len(array) for array in arrays.values() if array.size and array.ndim})
    for length in lengths:
        table: Columns = {}
        for name, array in arrays.items():
            if array.ndim and len(array) == length and array[:1].size <= WIDEST:
                flat = array.reshape(length, -1)
                single = array.ndim == 1
                table |= {name if single else f"{name}.{n}": flat[:, n] for n in range(flat.shape[1])}
        if table:
            yield length, table


def _written(path: Path, table: Columns, write: WriteTable) -> Path:
    with replacing(path) as file:
        write(table, file)
    return path


def _writer(kind: str) -> WriteTable:
    if kind == "csv":
        return _write_csv
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError:
        raise UserError(MISSING) from None

    def write(table: Columns, file: IO[bytes]) -> None:
        parquet.write_table(arrow.table({name: arrow.array(column) for name, column in table.items()}), file)

    return write


def _write_csv(table: Columns, file: IO[bytes]) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="", write_through=True)
    writer = csv.writer(text)
    writer.writerow(table)
    columns = [column.tolist() if isinstance(column, np.ndarray) else column for column in table.values()]
    writer.writerows(zip(*columns, strict=True))
    text.detach()
