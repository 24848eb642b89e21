"""The RL experiment's report: Table I, Figures 8 and 9, the interchange test, and the time of the trainings."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from operator import itemgetter

from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.suites import paper_results
from uavaccel.suites.old_report import Column, Report, Summary, SummaryCell, listed, number
from uavaccel.suites.rl.figures import panel_name, plot_figures, plot_gaps
from uavaccel.suites.rl.gaps import GapLine, collapse, over_gaps
from uavaccel.suites.rl.summary import CellKey, key_of, summarise
from uavaccel.suites.rows import grouped

Minutes = Mapping[CellKey, float]
"""Minutes of training on this machine, by the conditions of the training."""


class RlReport(Report):
    """The report of `uavaccel run rl`."""

    def summarise(self) -> Summary:
        return summarise(self.config, self.rows, self.run.load_arrays)

    def title(self) -> str:
        return "Policies by the command and ClockSpeed of their training"

    def headline(self) -> str:
        """Return the success after the slowest and the fastest training of each kind, and how many there were.

        Where all trainings are variants it is the gap from which on success collapses.
        """
        cells, trained, pooled = (self.summary[key] for key in ("cells", "training_games", "pooled"))
        lines = over_gaps(pooled)
        lanes = listed(sorted({cell["games"] for cell in cells}))
        clock = clock_label(self.summary["evaluation_clock_speed"])
        return "; ".join(
            [
                *(_slowest_and_fastest(pooled) or ([collapse(lines).rstrip(".")] if lines else [])),
                f"{len(cells)} trainings of {trained} games, each policy flown on {lanes} lanes at {clock}",
                "all times are modelled but those of this machine",
            ]
        )

    def overview(self) -> Table:
        return Table.of(
            self.summary["pooled"],
            *_TRAINED,
            ("success [95 %]", over_seeds),
            number("the paper's", "paper_successes", "{} %"),
            number("training speed-up", "training_speedup", "{:.3g}x"),
        )

    def figures(self) -> list[Picture]:
        return plot_figures(self.run, self.summary, self.rows)

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        summary, pooled = self.summary, self.summary["pooled"]
        blocks: list[Block] = [
            Heading("Table I: success by training"),
            _success_table(pooled),
            Paragraph(_WHAT_N_TELLS),
            *figures[:2],
        ]
        if lines := over_gaps(pooled):
            blocks += [
                Heading("Success in real time over the gap of the training"),
                Paragraph(collapse(lines)),
                *plot_gaps(self.run, summary),
                _gap_table(lines),
                Paragraph(_WHAT_A_GAP_IS),
            ]
        if interchanged := [*summary["interchange"], *summary["interchange_as_trained"]]:
            blocks += [Heading("Commands interchanged"), _interchange_table(interchanged)]
        if summary["as_trained"]:
            table = _as_trained_table(summary["as_trained"])
            blocks += [Heading("Flown at the ClockSpeed of the training"), table]
        if exact := summary["exact"]:
            blocks += [Heading("The same policies in the exact simulator"), *_in_both_simulators(exact)]
        minutes = _machine_minutes(self.run, self.rows)
        return [
            *blocks,
            Heading("Time of the training"),
            _time_table(pooled, minutes),
            Paragraph(_time_saved(pooled, minutes)),
            Paragraph(_HOW_TIME_IS_MODELLED),
            *figures[2:],
            Heading("Each training"),
            *[Paragraph(_weights(each)) for each in summary["same_weights"]],
            _trainings_table(summary["cells"]),
        ]


def success(cell: SummaryCell) -> str:
    """Return success with Wilson's interval, as in "23 of 100: 23.0% [15.8, 32.2]"."""
    return f"{cell['successes']} of {cell['games']}: {Proportion.of(cell).text(interval_digits=1)}"


def over_seeds(cell: SummaryCell) -> str:
    """Return success with its interval over seeds and games, as in "23.0% [12.1, 35.4]"."""
    low, high = (f"{100 * cell[end]:.1f}" for end in ("seeds_low", "seeds_high"))
    return f"{cell['success_ratio']:.1%} [{low}, {high}]"


_CELL: Sequence[Column] = (
    ("trained with", panel_name),
    ("ClockSpeed", lambda cell: clock_label(cell["clock_speed"])),
)
_TRAINED: Sequence[Column] = (*_CELL, ("seeds", lambda cell: listed(cell["seeds"])))


def _slowest_and_fastest(pooled: Sequence[SummaryCell]) -> list[str]:
    """Return, for each kind of training without a variant, success after its slowest and its fastest ClockSpeed."""
    plain = [cell for cell in pooled if not cell["variant"]]
    ends = {
        name: (own[0], own[-1])[: len(own)]
        for name, own in grouped(sorted(plain, key=itemgetter("clock_speed")), panel_name).items()
    }

    def success_at(cell: SummaryCell) -> str:
        return f"{cell['success_ratio']:.1%} after training at {clock_label(cell['clock_speed'])}"

    return [f"{name}: {', '.join(map(success_at, cells))}" for name, cells in ends.items()]


def _success_table(pooled: Sequence[SummaryCell]) -> Table:
    return Table.of(
        pooled,
        *_TRAINED,
        ("games won", lambda cell: f"{cell['successes']} of {cell['games']}"),
        ("success [95 % over seeds and games]", over_seeds),
        ("won by each seed", lambda cell: listed(cell["successes_by_seed"])),
        number("the paper's, of 100", "paper_successes", "{}"),
        number("p against 1x, over seeds", "permutation_p", "{:.2g}"),
        number("of these policies: McNemar", "mcnemar_p", "{:.2g}"),
    )


def _gap_table(lines: Sequence[GapLine]) -> Table:
    return Table.of(
        [cell for line in lines for cell in line.cells],
        *_CELL,
        ("gap, simulated s", lambda cell: f"{cell['gap_s']:.3f}"),
        ("success in real time [95 % over seeds and games]", over_seeds),
    )


def _as_trained_table(tests: Sequence[SummaryCell]) -> Table:
    def flight(header: str, key: str) -> list[Column]:
        p_value = "p against the plain one, over seeds"
        return [
            (header, lambda test: over_seeds(test[key])),
            (p_value, lambda test: or_dash(test[key]["permutation_p"], "{:.2g}".format)),
        ]

    return Table.of(
        tests,
        *_TRAINED,
        *flight("success in real time [95 %]", "real_time"),
        *flight("success at the ClockSpeed of the training [95 %]", "as_trained"),
        number("p of the two, over seeds", "sign_flip_p", "{:.2g}"),
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
        ("flown with", lambda test: f"{command_name(test['with'])} {clock_label(test['flown_at'])}"),
        ("success [95 % over seeds and games]", over_seeds),
        ("won with it alone", lambda test: str(test["alone"])),
        number("p over seeds", "sign_flip_p", "{:.2g}"),
        number("of these policies: McNemar", "mcnemar_p", "{:.2g}"),
    )


def _in_both_simulators(compared: Sequence[SummaryCell]) -> list[Block]:
    lanes, same = (sum(each[name] for each in compared) for name in ("lanes", "same_end"))
    sentence = (
        f"Of {lanes} flights of a policy over a lane in real time {same} end alike in both, won or lost."
    )
    table = Table.of(
        compared,
        *_TRAINED,
        ("the kernels", lambda each: success(each["kernels"])),
        ("the exact simulator", lambda each: success(each["exact"])),
        ("end alike", lambda each: f"{each['same_end']} of {each['lanes']}"),
        number("McNemar p", "mcnemar_p", "{:.2g}"),
    )
    return [Paragraph(sentence), table]


def _weights(trained: SummaryCell) -> str:
    """Return in words whether trainings at several ClockSpeeds learned the same weights."""
    clocks = listed([clock_label(clock) for clock in trained["clock_speed"]])
    seeds, equal = len(trained["seeds"]), len(trained["equal"])
    same = "one training each" if equal == seeds else f"{seeds - equal} learned others"
    return f"{panel_name(trained)}: of {seeds} seeds {equal} learned the same weights at {clocks}: {same}."


def _time_table(pooled: Sequence[SummaryCell], minutes: Minutes) -> Table:
    return Table.of(
        pooled,
        *_CELL,
        ("trainings", lambda cell: str(len(cell["seeds"]))),
        ("modelled hours", lambda cell: f"{cell['training_wall_s'] / 3600:.3g}"),
        ("as ADSC at 1x, hours", lambda cell: or_dash(cell["real_time_s"], lambda s: f"{s / 3600:.3g}")),
        number("speed-up of simulation", "training_speedup", "{:.3g}x"),
        number("the paper's", "paper_training_speedup", "{:g}x"),
        number("of the whole training", "whole_training_speedup", "{:.3g}x"),
        number("the paper's", "paper_whole_training_speedup", "{:g}x"),
        ("this machine, minutes", lambda cell: or_dash(minutes.get(key_of(cell)), "{:.3g}".format)),
    )


def _trainings_table(cells: Sequence[SummaryCell]) -> Table:
    return Table.of(
        cells,
        *_CELL,
        ("seed", lambda cell: str(cell["seed"])),
        ("training games won", lambda cell: f"{cell['trained_successes']} of {cell['trained_games']}"),
        ("success [95 % Wilson]", success),
        ("weights (SHA-256)", lambda cell: cell["weights_sha256"] or "-"),
        folded=f"{len(cells)} trainings",
    )


def _machine_minutes(run: RunDirectory, rows: Sequence[SummaryCell]) -> Minutes:
    """Return how long the trainings of each cell took on this machine, one after another."""
    took_s = {entry["case"]: entry["training_s"] for entry in run.timings() if "training_s" in entry}
    minutes: dict[CellKey, float] = defaultdict(float)
    for row in rows:
        if row["case"] in took_s:
            minutes[key_of(row)] += took_s[row["case"]] / 60
    return minutes


def _time_saved(pooled: Sequence[SummaryCell], minutes: Minutes) -> str:
    """Compare the modelled real time of the trainings with the time that they took on this machine."""
    both = [cell for cell in pooled if cell["real_time_s"] is not None and key_of(cell) in minutes]
    if not both:
        return "No training of ADSC at 1x to say what the others would have taken in real time."
    hours = sum(cell["real_time_s"] for cell in both) / 3600
    took_h = sum(minutes[key_of(cell)] for cell in both) / 60
    games = sum(cell["trained_games"] for cell in both)
    return (
        f"These trainings' {games} games would have taken {hours:.3g} hours in real time (modelled, "
        f"{3600 * hours / games:.0f} s per game; the paper's 5 000 games took 182 hours, 131 s per game). This machine "
        f"took {took_h:.2g} hours of training, measured, one after another: {hours / took_h:.0f} times less."
    )


_WHAT_N_TELLS = (
    f"The paper evaluated one training of each kind in {paper_results.GAMES} games. Of its differences only the "
    "collapse of ADSC (23 to 1) is significant by Fisher's exact test; 21 against 30, and 21 against 13, have p = "
    "0.19. Here a training, not a game, is one sample: an interval covers both Wilson's interval over all games and "
    "Student's over the trainings, so that it has a width at 0 and 100 % too, and differences are tested by permuting "
    "the trainings. The interval of a single seed is Wilson's, of its games alone. McNemar's test compares these very "
    "policies on the same lanes and says nothing about other seeds."
)
_WHAT_A_GAP_IS = (
    "The gap is the mean simulated time between the end of a command and the next one in the training, worked out from "
    "the modelled wall time of its commands without that of images, which ADSC takes in a pause. With TCSC the clock "
    "is paused while an agent decides: its gap is 0 at every ClockSpeed."
)
_HOW_TIME_IS_MODELLED = (
    "Hours are of the simulated wall clock, summed over the lanes flown side by side, each charged as if alone; "
    "simulation holds rendering, as in the paper. Speed-ups are of a command's mean time with ADSC at 1x, the paper's "
    "baseline, over that of the cell: of simulation alone, and with image processing, inference and learning, whose "
    "costs are keys of the configuration and no measurements of the paper's machine."
)
