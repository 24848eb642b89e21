"""A run's finished games as one tidy table, read once, and what its suite makes of them: summary, page, files.

A suite says how (uavaccel.suites.suite): `score` adds columns that the arrays tell, `summary` makes summary.json of the
scored games, `page` yields the blocks of the page.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uavaccel.config import dotted_keys, validate
from uavaccel.draw import style
from uavaccel.draw.page import KINDS, Heading, Listing, Paragraph, Picture, Table, counted, fill, to_html, to_markdown
from uavaccel.errors import UserError
from uavaccel.files import Plain, check_json, inside, read_bounded, replacing
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.resources import require
from uavaccel.suites.experiment import Row, pace_of

if TYPE_CHECKING:  # matplotlib is loaded by what draws
    from matplotlib.figure import Figure

    from uavaccel.suites.suite import Suite

Games: TypeAlias = pd.DataFrame
"""A table with a row for each game: the columns of its rows' keys, and of its scores."""
Summary: TypeAlias = Mapping[str, Plain]

MADE_BY = {"uavaccel": "uavaccel", "mujoco": "MuJoCo"}
CLOCK = {"wall": "wall clock", "virtual": "virtual clock", "lockstep": "no latency"}
WIDEST = 64  # numbers per line of an array that is exported; images are not


class Report:
    """The report of one run. `games` are its finished games, in the order of rows.jsonl."""

    def __init__(self, run: RunDirectory, suite: Suite[Any, Any]) -> None:
        """Read the rows. Raises UserError for a run without a manifest, a valid configuration or a game."""
        self.run, self.suite = run, suite
        self.config: Any = validate(suite.config, run.config(), str(run.path / "config.yaml"))
        run.manifest()
        self.rows = run.rows()
        """The games' lines of rows.jsonl."""
        if not self.rows:
            raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game of {suite.name}")
        self.games = table_of(self.rows)

    def arrays(self, game: Mapping[str, Any] | pd.Series) -> dict[str, np.ndarray]:
        """Return the arrays of a game, a row of the table. Raises UserError where they are missing or damaged."""
        return self.run.load_arrays(game)

    @cached_property
    def timings(self) -> list[dict[str, Plain]]:
        """The entries of timing.jsonl: what the games took on this machine."""
        return self.run.timings()

    @cached_property
    def scores(self) -> Games:
        """The games with the columns that their arrays tell."""
        return self.suite.score(self)

    @cached_property
    def summary(self) -> Summary:
        """The contents of summary.json. Raises UserError where the suite makes no mapping."""
        made: Summary = self._made("summary", Mapping, "a mapping")
        check_json(made, f"{self.suite.name}: summary")
        return made

    def _made(self, method: str, kind: Any, what: str) -> Any:
        """Return what a method of the suite makes of the report. Raises UserError where it is not of the kind."""
        made = getattr(self.suite, method)(self)
        if not isinstance(made, kind):
            raise UserError(f"{self.suite.name}: {method} returned a {type(made).__name__}, not {what}")
        return made

    def _text(self, method: str) -> str:
        said: str = self._made(method, str, "a text")
        return said

    def figure(self, name: str, figure: Figure, caption: str, alt: str, games: Games | None = None) -> Picture:
        """Save a figure as figures/NAME.png, and return its block; of several clocks the caption names the games'."""
        timings = known(games, "timing") if games is not None else []
        if timings and self.games["timing"].nunique() > 1:
            clocks = " and ".join(map(clock_words, timings))
            caption = f"{caption} {clocks[0].upper()}{clocks[1:]}."
        return Picture(style.save(figure, self.run.file(f"figures/{name}.png")), caption, alt)

    def write_summary(self) -> Summary:
        """Write summary.json. Raises UserError for damaged files."""
        self.run.write_json("summary.json", self.summary)
        return self.summary

    def write(self) -> Summary:
        """Write summary.json, figures/, report.md and report.html. Raises UserError for damaged files."""
        self.write_summary()
        with style.project_style():
            made = self._made("page", Iterable, "blocks")
            yielded = [made] if isinstance(made, str) else made
            own = [Paragraph(block) if isinstance(block, str) else block for block in yielded]
        if wrong := [block for block in own if not isinstance(block, KINDS)]:
            kinds = ", ".join(kind.__name__ for kind in KINDS)
            raise UserError(f"{self.suite.name}: page yields a {type(wrong[0]).__name__}, no block: a text, {kinds}")
        source, versions = self._text("source"), self.run.manifest().get("versions", {})
        made_by = [f"{name} {versions[key]}" for key, name in MADE_BY.items() if key in versions]
        source = " · ".join([*filter(None, [source]), *made_by])
        told = [f"{said}." for said in [self.headline()] if said] + [source[:1].upper() + source[1:]] * bool(source)
        kept = [path for name in ("config.yaml", "manifest.json") if (path := self.run.path / name).is_file()]
        texts = [Listing(read_bounded(path).decode("utf-8", errors="replace"), folded=path.name) for path in kept]
        blocks = [*map(Paragraph, told), *own, Heading("Provenance"), *texts]
        title = self._text("title")
        self.run.write_text("report.md", to_markdown(title, blocks, self.run.path))
        self.run.write_text("report.html", to_html(title, blocks))
        return self.summary

    def headline(self) -> str:
        """Return the result in a sentence, which stands on top of the page and is printed when the run ends."""
        said = self._text("headline")
        return said[:1].upper() + said[1:]

    def overview(self) -> Table | None:
        """Return the result in a small table, which is printed when the run ends."""
        table: Table | None = self._made("overview", Table | None, "a Table")
        return table

    def pace(self) -> str:
        """Return how long the games took on this machine; no summary has it, since it is never reproduced."""
        return pace_of(self.timings, float(self.games["sim_time_s"].sum()) if "sim_time_s" in self.games else 0.0)


def table_of(rows: Sequence[Mapping[str, Any]]) -> Games:
    """Return rows as a table: columns of numbers where all are known, floats with NaN for unknown ones, else objects.

    Unknown integers and texts stay None, so that no integer becomes a float.
    """
    names = list(dict.fromkeys(chain.from_iterable(rows)))
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    return pd.DataFrame(columns, columns=names)


def _column(values: list[Any]) -> pd.Series:
    kinds = {type(value) for value in values}
    if len(kinds) == 1 and kinds <= {bool, int}:
        return pd.Series(values)
    if float in kinds and kinds <= {int, float, type(None)}:
        return pd.Series(values, dtype=np.float64)
    return pd.Series(values, dtype=object)


def records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return a table's rows as plain data for summary.json: NaN, which is what is not known, as None."""
    return [
        {key: None if isinstance(value, float) and np.isnan(value) else value for key, value in row.items()}
        for row in frame.to_dict("records")
    ]


def finished(games: Games) -> Games:
    """Return the games that ended without an error."""
    return games[games["error"].isna()] if "error" in games else games


def source_line(games: Games) -> str:
    """Return where the numbers of these games come from: clock, count, profile, seed, disturbances."""
    counts = games["timing"].value_counts().sort_index() if len(games) else {}
    by_clock = [f"{clock_words(timing)}: {counted(n, 'game')}" for timing, n in counts.items()]
    profiles = [f"{each} profile" for each in known(games, "profile")]
    seeds = [f"seed {each}" for each in known(games, "seed")]
    return " · ".join([*by_clock, *profiles, *seeds, *disturbed_words(games)])


def source_of(told: Iterable[str], reports: Sequence[Report]) -> str:
    """Return where the numbers of several runs come from: what is `told` of each, once, their seeds, disturbances."""
    seeds = f"seed {', '.join(map(str, sorted({report.config.seed for report in reports})))}"
    return " · ".join([" and ".join(sorted(set(told))), seeds, *disturbed_words(pd.concat([r.games for r in reports]))])


def clock_words(timing: str) -> str:
    """Return a timing in words, as in "measured (wall clock)"."""
    return f"{timing_provenance(timing)} ({CLOCK[timing]})"


def known(games: Games, name: str) -> list[Any]:
    """Return the distinct values of a column, sorted; none without such a column."""
    values = games[name].dropna().tolist() if name in games else []
    plain = {value for value in values if isinstance(value, str | int | float)}  # an own suite's may be lists
    return sorted(plain, key=lambda value: (isinstance(value, str), value))


def disturbed_games(games: Games) -> dict[str, int]:
    """Return how many of the games are marked as disturbed, as summaries have it; nothing where none is."""
    count = int(games["disturbed"].eq(True).sum()) if "disturbed" in games else 0
    return {"disturbed_games": count} if count else {}


def disturbed_words(games: Games) -> list[str]:
    """Return a note of how many games that ended without an error were disturbed; none where no game was."""
    games = finished(games)
    return [f"{count} of {len(games)} games disturbed" for count in disturbed_games(games).values()]


def warnings(games: Games) -> Iterator[str]:
    """Yield what a reader of numbers of these games has to know: failures, and wall time lost by the machine."""
    if failed := len(games) - len(finished(games)):
        are = "is" if failed == 1 else "are"
        yield f"Warning: {counted(failed, 'game')} failed and {are} left out; rows.jsonl says why."
    if lost_s := float(finished(games).get("lost_wall_s", pd.Series(dtype=float)).sum()):
        yield f"Warning: the machine could not keep up and lost {lost_s:.3f} s of wall time."
    for disturbed in disturbed_games(finished(games)).values():
        yield (
            f"Warning: {counted(disturbed, 'game')} disturbed, by wall time lost or a server that stalled or was "
            "started again; rows.jsonl says which."
        )


def summary_table(summary: Summary) -> Table:
    """Return the summary without its lists as a collapsed table."""
    plain = {key: value for key, value in dotted_keys(summary).items() if not isinstance(value, list)}
    lines = [(key, fill("{value}", {"value": value})) for key, value in plain.items()]
    return Table(("", ""), lines, folded="summary.json")


def method_note(text: str) -> Paragraph:
    """Return how the page's numbers are made, collapsed."""
    return Paragraph(text, folded="How this is measured")


# --- tables for other programs --------------------------------------------------------------------------------------


def write_tables(run: RunDirectory, folder: Path, kind: str) -> Iterator[Path]:
    """Write `rows` and, below `samples`, a table per game and length of its arrays, and yield each file written.

    `kind` is csv, whose floats have the digits that are needed to read them back equal, or parquet. Raises UserError
    where the run has no rows, the folder cannot be written, or pyarrow is missing.
    """
    if kind == "parquet":
        require("pyarrow", "--parquet", "parquet")
    rows = run.rows()
    if not rows:
        raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game")

    def tables() -> Iterator[tuple[Path, pd.DataFrame]]:
        yield folder / f"rows.{kind}", row_table(rows)
        for row in rows:
            for length, table in sample_tables(run.load_arrays(row) if "arrays" in row else {}):
                yield inside(folder, f"samples/{row['case']}-{length}.{kind}"), table

    try:
        for path, table in tables():
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as file:
                table.to_csv(file, index=False) if kind == "csv" else table.to_parquet(file, index=False)
            yield path
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
    """Yield the arrays (n, ...) of a game, but images, by length n: a column for each number, as position_m.0."""
    lines = {name: array for name, array in arrays.items() if array.ndim and array.size and array[:1].size <= WIDEST}
    for length in sorted({len(array) for array in lines.values()}):
        columns: dict[str, NDArray[Any]] = {}
        for name, array in lines.items():
            if array.ndim == 1 and len(array) == length:
                columns[name] = array
            elif len(array) == length:
                columns |= {f"{name}.{n}": column for n, column in enumerate(array.reshape(length, -1).T)}
        yield length, pd.DataFrame(columns)
