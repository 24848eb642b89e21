"""Export of a run as CSV or Parquet: its rows, a line per game, and its samples, a table for each length of array.

In Parquet numbers keep their types; in CSV floats have as many digits as are needed to read them back equal.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from numpy.typing import NDArray

from uavaccel.config import dotted_keys
from uavaccel.errors import UserError
from uavaccel.files import inside, replacing
from uavaccel.records import RunDirectory
from uavaccel.resources import require
from uavaccel.suites.report import table_of
from uavaccel.suites.rows import Row

WIDEST = 64  # numbers per line of an array that is exported; images are not


def write_tables(run: RunDirectory, folder: Path, kind: str) -> Iterator[Path]:
    """Write `rows` and, below `samples`, a table per game and length of its arrays, and yield each file written.

    `kind` is csv or parquet. Raises UserError where the run has no rows, the folder cannot be written, or pyarrow is
    missing.
    """
    if kind == "parquet":
        require("pyarrow", "--parquet", "parquet")
    rows = run.rows()
    if not rows:
        raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield _written(folder / f"rows.{kind}", row_table(rows), kind)
        for row in rows:
            for length, table in sample_tables(run.load_arrays(row) if "arrays" in row else {}):
                path = inside(folder, f"samples/{row['case']}-{length}.{kind}")
                path.parent.mkdir(parents=True, exist_ok=True)
                yield _written(path, table, kind)
    except OSError as error:
        raise UserError(f"{folder}: {error.strerror}") from error


def row_table(rows: Sequence[Row]) -> pd.DataFrame:
    """Return a column per dotted key, with lists as JSON, all as texts where types differ, None where a key lacks."""
    table = table_of([
        {
            key: json.dumps(value) if isinstance(value, list) else value
            for key, value in dotted_keys(row).items()
            if value != {}
        }
        for row in rows
    ])  # fmt: skip
    for name, column in table.items():
        if len({type(value) for value in column if value is not None}) > 1:
            texts = [value if value is None or isinstance(value, str) else json.dumps(value) for value in column]
            table[name] = pd.Series(texts, dtype=object)
    return table


def sample_tables(arrays: Mapping[str, NDArray[Any]]) -> Iterator[tuple[int, pd.DataFrame]]:
    """Yield the arrays (n, ...) of a game by length n, with a column for each number of a line, such as position_m.0.

    Images, whose lines have more than 64 numbers, are left out.
    """
    lines = {name: array for name, array in arrays.items() if array.ndim and array.size and array[:1].size <= WIDEST}
    for length in sorted({len(array) for array in lines.values()}):
        columns: dict[str, NDArray[Any]] = {}
        for name, array in lines.items():
            if array.ndim == 1 and len(array) == length:
                columns[name] = array
            elif len(array) == length:
                columns |= {f"{name}.{n}": column for n, column in enumerate(array.reshape(length, -1).T)}
        yield length, pd.DataFrame(columns)


def _written(path: Path, table: pd.DataFrame, kind: str) -> Path:
    with replacing(path) as file:
        if kind == "csv":
            table.to_csv(file, index=False)
        else:
            table.to_parquet(file, index=False)
    return path
