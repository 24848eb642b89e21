"""A run's finished games as one tidy table, read once, and what its suite makes of them: summary, page, files.

A suite says how (uavaccel.suites.suite): `score` adds columns that the arrays tell, `summary` makes summary.json of the
scored games, `page` yields the blocks of the page.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd

from uavaccel.config import dotted_keys, validate
from uavaccel.draw import style
from uavaccel.draw.page import KINDS, Block, Heading, Listing, Paragraph, Picture, Table, fill, to_html, to_markdown
from uavaccel.errors import UserError
from uavaccel.files import Plain, read_bounded
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.suites.host_time import pace_of

if TYPE_CHECKING:  # matplotlib is loaded by what draws
    from matplotlib.figure import Figure

    from uavaccel.suites.suite import Suite

Games: TypeAlias = pd.DataFrame
"""A table with a row for each game: the columns of its rows' keys, and of its scores."""
Summary: TypeAlias = Mapping[str, Plain]

MADE_BY = {"uavaccel": "uavaccel", "mujoco": "MuJoCo"}
CLOCK = {"wall": "wall clock", "virtual": "virtual clock", "lockstep": "no latency"}


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
        """The contents of summary.json."""
        return self.suite.summary(self)

    def figure(self, name: str, figure: Figure, caption: str, alt: str, games: Games | None = None) -> Picture:
        """Save a figure as figures/NAME.png, and return it as a block: its caption, and what is seen in it.

        In a run on several clocks the caption ends with those of the `games` that the figure shows.
        """
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
            own = [_block(self.suite, block) for block in self.suite.page(self)]
        source, versions = self.suite.source(self), self.run.manifest().get("versions", {})
        made_by = [f"{name} {versions[key]}" for key, name in MADE_BY.items() if key in versions]
        source = " · ".join([*filter(None, [source]), *made_by])
        told = [f"{said}." for said in [self.headline()] if said] + [source[:1].upper() + source[1:]] * bool(source)
        blocks = [*map(Paragraph, told), *own, Heading("Provenance"), *_provenance(self.run)]
        title = self.suite.title(self)
        self.run.write_text("report.md", to_markdown(title, blocks, self.run.path))
        self.run.write_text("report.html", to_html(title, blocks))
        return self.summary

    def headline(self) -> str:
        """Return the result in a sentence, which stands on top of the page and is printed when the run ends."""
        said = self.suite.headline(self)
        return said[:1].upper() + said[1:]

    def overview(self) -> Table | None:
        """Return the result in a small table, which is printed when the run ends."""
        return self.suite.overview(self)

    def pace(self) -> str:
        """Return how long the games took on this machine; no summary has it, since it is never reproduced."""
        return pace_of(self.timings, float(self.games["sim_time_s"].sum()) if "sim_time_s" in self.games else 0.0)


def table_of(rows: Sequence[Mapping[str, Any]]) -> Games:
    """Return rows as a table: columns of numbers where all are known, floats with NaN for unknown ones, else objects.

    Unknown integers and texts stay None, so that no integer becomes a float.
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
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
    by_clock = [f"{clock_words(timing)}: {n} game{'s' if n > 1 else ''}" for timing, n in counts.items()]
    return " · ".join([*by_clock, *profiles_and_seeds(games), *disturbed_words(games)])


def clock_words(timing: str) -> str:
    """Return a timing in words, as in "measured (wall clock)"."""
    return f"{timing_provenance(timing)} ({CLOCK[timing]})"


def profiles_and_seeds(games: Games) -> list[str]:
    """Return the profiles and seeds of the games, as in "airsim profile", "seed 0"."""
    profiles = [f"{each} profile" for each in known(games, "profile")]
    return [*profiles, *(f"seed {each}" for each in known(games, "seed"))]


def known(games: Games, name: str) -> list[Any]:
    """Return the distinct values of a column, sorted; none without such a column."""
    return sorted(games[name].dropna().unique().tolist()) if name in games else []


def disturbed_games(games: Games) -> int:
    """Return how many of the games are marked as disturbed."""
    return int(games["disturbed"].eq(True).sum()) if "disturbed" in games else 0


def disturbed_words(games: Games) -> list[str]:
    """Return a note of how many games were disturbed; none where no game was."""
    count = disturbed_games(games)
    return [f"{count} of {len(games)} games disturbed"] if count else []


def warnings(games: Games) -> Iterator[str]:
    """Yield what a reader of numbers of these games has to know: failures, and wall time lost by the machine."""
    if failed := len(games) - len(finished(games)):
        yield f"Warning: {failed} games failed and are left out; rows.jsonl says why."
    if lost_s := float(finished(games).get("lost_wall_s", pd.Series(dtype=float)).sum()):
        yield f"Warning: the machine could not keep up and lost {lost_s:.3f} s of wall time."
    if disturbed := disturbed_games(finished(games)):
        yield (
            f"Warning: {disturbed} games were disturbed: they lost wall time, or their server stalled or was started "
            "again; rows.jsonl says which."
        )


def summary_table(summary: Summary) -> Table:
    """Return the summary without its lists as a collapsed table."""
    plain = {key: value for key, value in dotted_keys(summary).items() if not isinstance(value, list)}
    lines = [(key, fill("{value}", {"value": value})) for key, value in plain.items()]
    return Table(("", ""), lines, folded="summary.json")


def method_note(text: str) -> Paragraph:
    """Return how the page's numbers are made, collapsed."""
    return Paragraph(text, folded="How this is measured")


def _block(suite: Suite[Any, Any], block: object) -> Block:
    if isinstance(block, str):
        return Paragraph(block)
    if not isinstance(block, KINDS):
        kinds = ", ".join(kind.__name__ for kind in KINDS)
        raise TypeError(f"{type(suite).__name__}.page: {block!r} is no block of a page: a text, {kinds}")
    return block  # type: ignore[return-value]


def _provenance(run: RunDirectory) -> Iterable[Block]:
    for path in (run.path / "config.yaml", run.path / "manifest.json"):
        if path.is_file():
            yield Listing(read_bounded(path).decode("utf-8", errors="replace"), folded=path.name)
