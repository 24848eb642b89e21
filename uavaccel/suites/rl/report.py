"""The RL experiment's report: Table I, Figures 8 and 9, the interchange test, and what a training took."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.suites import paper_results
from uavaccel.suites.report import Report, Summary, SummaryCell, listed
from uavaccel.suites.rl.figures import draw_figures, panel_name
from uavaccel.suites.rl.summary import KEY, summarise

Column = tuple[str, Callable[[SummaryCell], str]]
Minutes = Mapping[tuple[Any, ...], float]
"""Of this machine, by `KEY`."""


class RlReport(Report):
    """Of `uavaccel run rl`."""

    def summarise(self) -> Summary:
        return summarise(self.config, self.rows, self.run.load_arrays)

    def title(self) -> str:
        return "Policies by the command and ClockSpeed of their training"

    def headline(self) -> str:
        """How many trainings, of what size, evaluated on what."""
        cells, trained = self.summary["cells"], self.summary["training_games"]
        lanes = listed(sorted({cell["games"] for cell in cells}))
        clock = clock_label(self.summary["evaluation_clock_speed"])
        return (
            f"{len(cells)} trainings of {trained} games, each policy flown on {lanes} lanes at {clock}; all times are "
            "modelled but those of this machine"
        )

    def overview(self) -> Table:
        return Table.of(
            self.summary["pooled"],
            *_TRAINED,
            ("success [95 %]", success),
            _number("the paper's", "paper_successes", "{} %"),
            _number("training speed-up", "training_speedup", "{:.3g}x"),
        )

    def figures(self) -> list[Picture]:
        return draw_figures(self.run, self.summary, self.rows)

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        summary, pooled = self.summary, self.summary["pooled"]
        blocks: list[Block] = [
            Paragraph(self.headline() + "."),
            Heading("Table I: success by training"),
            _success_table(pooled),
            Paragraph(_WHAT_N_TELLS),
            *figures[:2],
        ]
        if summary["interchange"]:
            blocks += [Heading("Commands interchanged"), _interchange_table(summary["interchange"])]
        if summary["as_trained"]:
            table = _as_trained_table(summary["as_trained"])
            blocks += [Heading("Flown at the ClockSpeed of the training"), table]
        minutes = _machine_minutes(self.run, self.rows)
        return [
            *blocks,
            Heading("Time of the training"),
            _time_table(pooled, minutes),
            Paragraph(_saved(pooled, minutes)),
            Paragraph(_HOW_TIME_IS_MODELLED),
            *figures[2:],
            Heading("Each training"),
            _trainings_table(summary["cells"]),
        ]


def success(cell: SummaryCell) -> str:
    """23 of 100: 23.0 % [15.8, 32.2]."""
    return f"{cell['successes']} of {cell['games']}: {Proportion.of(cell).text(interval_digits=1)}"


def _number(header: str, key: str, form: str) -> Column:
    return header, lambda cell: or_dash(cell[key], form.format)


_CELL: Sequence[Column] = (
    ("trained with", panel_name),
    ("ClockSpeed", lambda cell: clock_label(cell["clock_speed"])),
)
_TRAINED: Sequence[Column] = (*_CELL, ("seeds", lambda cell: listed(cell["seeds"])))


def _success_table(pooled: Sequence[SummaryCell]) -> Table:
    return Table.of(
        pooled,
        *_TRAINED,
        ("games", lambda cell: str(cell["games"])),
        ("success [95 % Wilson]", success),
        ("of each seed", lambda cell: listed(cell["successes_by_seed"])),
        _number("the paper's, of 100", "paper_successes", "{}"),
        _number("p against 1x: Fisher", "fisher_p", "{:.2g}"),
        _number("McNemar", "mcnemar_p", "{:.2g}"),
    )


def _as_trained_table(tests: Sequence[SummaryCell]) -> Table:
    def flight(header: str, key: str) -> list[Column]:
        p_value = "McNemar p against the plain one"
        return [
            (header, lambda test: success(test[key])),
            (p_value, lambda test: or_dash(test[key]["mcnemar_p"], "{:.2g}".format)),
        ]

    return Table.of(
        tests,
        *_TRAINED,
        *flight("success in real time", "real_time"),
        *flight("success at the ClockSpeed of the training", "as_trained"),
    )


def _interchange_table(tests: Sequence[SummaryCell]) -> Table:
    flown = [
        {**test, **flight, "with": flight["command"], "command": test["command"], "alone": test[alone]}
        for test in tests
        for flight, alone in zip(test["flown_with"], ("only_first", "only_second"), strict=True)
    ]
    return Table.of(
        flown,
        ("trained with", lambda test: f"{panel_name(test)} {clock_label(test['clock_speed'])}"),
        ("seeds", lambda test: listed(test["seeds"])),
        ("flown with", lambda test: command_name(test["with"])),
        ("success [95 % Wilson]", success),
        ("won with it alone", lambda test: str(test["alone"])),
        ("McNemar p", lambda test: f"{test['mcnemar_p']:.2g}"),
    )


def _time_table(pooled: Sequence[SummaryCell], minutes: Minutes) -> Table:
    return Table.of(
        pooled,
        *_CELL,
        ("trainings", lambda cell: str(len(cell["seeds"]))),
        ("modelled hours", lambda cell: f"{cell['training_wall_s'] / 3600:.3g}"),
        ("the same at 1x, hours", lambda cell: or_dash(cell["real_time_s"], lambda s: f"{s / 3600:.3g}")),
        _number("speed-up of simulation", "training_speedup", "{:.3g}x"),
        _number("the paper's", "paper_training_speedup", "{:g}x"),
        _number("of the whole training", "whole_training_speedup", "{:.3g}x"),
        _number("the paper's", "paper_whole_training_speedup", "{:g}x"),
        ("this machine, minutes", lambda cell: or_dash(minutes.get(_key(cell)), "{:.3g}".format)),
    )


def _trainings_table(cells: Sequence[SummaryCell]) -> Table:
    return Table.of(
        cells,
        *_CELL,
        ("seed", lambda cell: str(cell["seed"])),
        ("training games won", lambda cell: f"{cell['trained_successes']} of {cell['trained_games']}"),
        ("success", success),
        ("weights (SHA-256)", lambda cell: cell["weights_sha256"] or "-"),
    )


def _machine_minutes(run: RunDirectory, rows: Sequence[SummaryCell]) -> dict[tuple[Any, ...], float]:
    """Minutes that the trainings of a cell took here, one after another, by `KEY`."""
    took_s = {entry["case"]: entry["training_s"] for entry in run.timings() if "training_s" in entry}
    minutes: dict[tuple[Any, ...], float] = {}
    for row in rows:
        if row["case"] in took_s:
            minutes[_key(row)] = minutes.get(_key(row), 0.0) + took_s[row["case"]] / 60
    return minutes


def _saved(pooled: Sequence[SummaryCell], minutes: Minutes) -> str:
    """Modelled real time against this machine's, of all trainings that have both."""
    both = [cell for cell in pooled if cell["real_time_s"] is not None and _key(cell) in minutes]
    if not both:
        return "No training at 1x to say what the others would have taken in real time."
    hours = sum(cell["real_time_s"] for cell in both) / 3600
    took_h = sum(minutes[_key(cell)] for cell in both) / 60
    games = sum(cell["trained_games"] for cell in both)
    return (
        f"These trainings' {games} games would have taken {hours:.3g} hours in real time (modelled, "
        f"{3600 * hours / games:.0f} s per game; the paper's 5 000 games took 182 hours, 131 s per game). This machine "
        f"took {took_h:.2g} hours of training, measured, one after another: {hours / took_h:.0f} times less."
    )


def _key(cell: SummaryCell) -> tuple[Any, ...]:
    return tuple(cell[name] for name in KEY)


_WHAT_N_TELLS = (
    f"The paper evaluated one training of each kind in {paper_results.GAMES} games. Of its differences only the "
    "collapse of ADSC (23 to 1) is significant by Fisher's exact test; 21 against 30, and 21 against 13, have p = "
    "0.19. 100 games tell ratios 16 points apart, 300 nine points, 1 000 five. Wilson intervals and Fisher's test "
    "here are of pooled games, and so of these very policies: what another training would have given is seen in "
    "the spread of the seeds, which no number of evaluation games makes smaller. McNemar's test compares policies "
    "of the same seed on the same lanes."
)
_HOW_TIME_IS_MODELLED = (
    "Hours are of the simulated wall clock, summed over the lanes flown side by side, each charged as if alone; "
    "simulation holds rendering, as in the paper. Speed-ups are of a command's mean time at 1x over that at the "
    "ClockSpeed: of simulation alone, and with image processing, inference and learning, whose costs are keys of the "
    "configuration and no measurements of the paper's machine."
)
