"""The RL experiment's report: Table I, Figures 8 and 9, the interchange test, and what a training took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.suites import published
from uavaccel.suites.report import Report, Summary, SummaryCell, listed
from uavaccel.suites.rl.figures import draw_figures, panel_name
from uavaccel.suites.rl.summary import KEY, summarise

SHORT_HEADER = ("trained with", "ClockSpeed", "seeds", "success [95 %]", "the paper's", "training speed-up")
TABLE_HEADER = (
    *("trained with", "ClockSpeed", "seeds", "games", "success [95 % Wilson]", "of each seed"),
    *("the paper's, of 100", "p against 1x: Fisher", "McNemar"),
)
TIME_HEADER = (
    *("trained with", "ClockSpeed", "trainings", "modelled hours", "the same at 1x, hours"),
    *(
        "speed-up of simulation",
        "the paper's",
        "of the whole training",
        "the paper's",
        "this machine, minutes",
    ),
)
INTERCHANGE_HEADER = (
    "trained with",
    "seeds",
    "flown with",
    "success [95 % Wilson]",
    "won with it alone",
    "McNemar p",
)
AS_TRAINED_HEADER = (
    *("trained with", "ClockSpeed", "seeds", "success in real time", "McNemar p against the plain one"),
    *("success at the ClockSpeed of the training", "McNemar p against the plain one"),
)
WEIGHTS_HEADER = ("trained with", "ClockSpeed", "seed", "training games won", "success", "weights (SHA-256)")


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
        lines = [
            (
                panel_name(cell),
                clock_label(cell["clock_speed"]),
                listed(cell["seeds"]),
                success(cell),
                or_dash(cell["paper_successes"], "{} %".format),
                or_dash(cell["training_speedup"], "{:.3g}x".format),
            )
            for cell in self.summary["pooled"]
        ]
        return Table(SHORT_HEADER, lines)

    def figures(self) -> list[Picture]:
        return draw_figures(self.run, self.summary, self.rows)

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        summary, pooled = self.summary, self.summary["pooled"]
        blocks: list[Block] = [
            Paragraph(self.headline() + "."),
            Heading("Table I: success by training"),
            Table(TABLE_HEADER, [_success_line(cell) for cell in pooled]),
            Paragraph(_WHAT_N_TELLS),
            *figures[:2],
        ]
        if summary["interchange"]:
            blocks += [Heading("Commands interchanged"), Table(INTERCHANGE_HEADER, _interchange(summary))]
        if summary["as_trained"]:
            lines = [_as_trained(flown) for flown in summary["as_trained"]]
            blocks += [Heading("Flown at the ClockSpeed of the training"), Table(AS_TRAINED_HEADER, lines)]
        minutes = _machine_minutes(self.run, self.rows)
        return [
            *blocks,
            Heading("Time of the training"),
            Table(TIME_HEADER, [_time_line(cell, minutes) for cell in pooled]),
            Paragraph(_saved(pooled, minutes)),
            Paragraph(_HOW_TIME_IS_MODELLED),
            *figures[2:],
            Heading("Each training"),
            Table(WEIGHTS_HEADER, [_training_line(cell) for cell in summary["cells"]]),
        ]


def success(cell: SummaryCell) -> str:
    """23 of 100: 23.0 % [15.8, 32.2]."""
    return f"{cell['successes']} of {cell['games']}: {Proportion.of(cell).text(interval_digits=1)}"


def _success_line(cell: SummaryCell) -> tuple[str, ...]:
    return (
        panel_name(cell),
        clock_label(cell["clock_speed"]),
        listed(cell["seeds"]),
        str(cell["games"]),
        success(cell),
        listed(cell["successes_by_seed"]),
        or_dash(cell["paper_successes"], "{}".format),
        or_dash(cell["fisher_p"], "{:.2g}".format),
        or_dash(cell["mcnemar_p"], "{:.2g}".format),
    )


def _as_trained(flown: Mapping[str, Any]) -> tuple[str, ...]:
    real_time, own = flown["real_time"], flown["as_trained"]
    return (
        panel_name(flown),
        clock_label(flown["clock_speed"]),
        listed(flown["seeds"]),
        *(success(real_time), or_dash(real_time["mcnemar_p"], "{:.2g}".format)),
        *(success(own), or_dash(own["mcnemar_p"], "{:.2g}".format)),
    )


def _interchange(summary: Summary) -> list[tuple[str, ...]]:
    return [
        (
            f"{panel_name(test)} {clock_label(test['clock_speed'])}",
            listed(test["seeds"]),
            command_name(flown["command"]),
            success(flown),
            str(test[alone]),
            f"{test['mcnemar_p']:.2g}",
        )
        for test in summary["interchange"]
        for flown, alone in zip(test["flown_with"], ("only_first", "only_second"), strict=True)
    ]


def _time_line(cell: SummaryCell, minutes: Mapping[tuple[Any, ...], float]) -> tuple[str, ...]:
    return (
        panel_name(cell),
        clock_label(cell["clock_speed"]),
        str(len(cell["seeds"])),
        f"{cell['training_wall_s'] / 3600:.3g}",
        or_dash(cell["real_time_s"], lambda s: f"{s / 3600:.3g}"),
        or_dash(cell["training_speedup"], "{:.3g}x".format),
        or_dash(cell["paper_training_speedup"], "{:g}x".format),
        or_dash(cell["whole_training_speedup"], "{:.3g}x".format),
        or_dash(cell["paper_whole_training_speedup"], "{:g}x".format),
        or_dash(minutes.get(_key(cell)), "{:.3g}".format),
    )


def _training_line(cell: SummaryCell) -> tuple[str, ...]:
    return (
        panel_name(cell),
        clock_label(cell["clock_speed"]),
        str(cell["seed"]),
        f"{cell['trained_successes']} of {cell['trained_games']}",
        success(cell),
        cell["weights_sha256"] or "-",
    )


def _machine_minutes(run: RunDirectory, rows: Sequence[SummaryCell]) -> dict[tuple[Any, ...], float]:
    """Minutes that the trainings of a cell took here, one after another, by `KEY`."""
    took_s = {entry["case"]: entry["training_s"] for entry in run.timings() if "training_s" in entry}
    minutes: dict[tuple[Any, ...], float] = {}
    for row in rows:
        if row["case"] in took_s:
            minutes[_key(row)] = minutes.get(_key(row), 0.0) + took_s[row["case"]] / 60
    return minutes


def _saved(pooled: Sequence[SummaryCell], minutes: Mapping[tuple[Any, ...], float]) -> str:
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
    f"The paper evaluated one training of each kind in {published.GAMES} games. Of its differences only the "
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
