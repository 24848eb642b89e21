"""The suite `sweep`: evaluations in which one condition departs from those of the training, and their report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uavaccel.draw import style
from uavaccel.draw.document import Block, Paragraph, Picture, Table
from uavaccel.envs.conditions import CONDITIONS
from uavaccel.files import Plain
from uavaccel.metrics.intervals import Proportion, mcnemar_exact
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.suites.evaluation.parts import EvaluationCase, PolicyRow, PolicySuite, agent_name
from uavaccel.suites.experiment import Timing, timing_of
from uavaccel.suites.old_report import Report, Summary
from uavaccel.suites.parts import part_simulated_s, part_suite
from uavaccel.suites.rows import Row, grouped, subset
from uavaccel.suites.sweep.config import SweepConfig, keys_of, value_text

COLUMNS = 3


def plot_sweeps(
    sweeps: Mapping[str, Mapping[str, Proportion]], as_trained: float | None, title: str, source: str
) -> Figure:
    """Plot success at each value of a condition, a panel per condition; the dashed line is success as trained."""
    columns = max(min(len(sweeps), COLUMNS), 1)
    rows = max(math.ceil(len(sweeps) / columns), 1)
    with style.project_style():
        figure = style.new_figure(max(2.9 * columns, 5.0), 0.9 + 2.2 * rows, title, source)
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for axes, (name, success) in zip(panels, sweeps.items(), strict=False):
            _plot_condition(axes, success, as_trained)
            axes.set_xlabel(name)
        for axes in panels[len(sweeps) :]:
            axes.set_visible(False)
        for axes in panels[::columns]:
            axes.set_ylabel("success")
        return figure


def _plot_condition(axes: Axes, success: Mapping[str, Proportion], as_trained: float | None) -> None:
    places, won = range(len(success)), list(success.values())
    ratios = [each.ratio for each in won]
    reach = style.error_bars(ratios, [each.interval for each in won])
    axes.errorbar(places, ratios, reach, color=style.BLUE, marker="o", markersize=4, capsize=3)
    if as_trained is not None:
        axes.axhline(as_trained, color=style.GREY, linestyle="--", linewidth=1.0)
    axes.set_xticks(list(places), list(success))
    axes.set(ylim=(-0.03, 1.03), xlim=(-0.5, len(success) - 0.5))
    axes.yaxis.set_major_formatter("{x:.0%}")


AS_TRAINED = "as-trained"

Won = Mapping[str, NDArray[np.bool_]]


class SweepReport(Report):
    """The report of `uavaccel evaluate --sweep` and `uavaccel run sweep`."""

    def summarise(self) -> Summary:
        won = {row["case"]: self.run.load_arrays(row)["is_success"] for row in self.rows}
        return summarise(self.config, self.rows, won)

    def title(self) -> str:
        return f"Success of {agent_name(self.summary['agent'])}, one condition changed at a time"

    def headline(self) -> str:
        departed = [cell for cell in self.summary["cells"] if cell["condition"]]
        usual = as_trained(self.summary)
        parts = [] if usual is None else [f"{usual:.1%} as trained"]
        if departed:
            worst = min(departed, key=lambda cell: float(cell["success_ratio"]))
            where = f"{worst['condition']} = {value_text(worst['value'])}"
            parts.append(f"{worst['success_ratio']:.1%} at {where}, the least of {len(departed)} conditions")
        provenance = " and ".join(self.summary["provenance"])
        who, lanes = agent_name(self.summary["agent"]), self.summary["lanes"]
        return f"{who} wins {', '.join(parts)}; {provenance}, {lanes} lanes each"

    def overview(self) -> Table:
        return table(self.summary)

    def figures(self) -> list[Picture]:
        summary, title = self.summary, self.title()
        provenance = " and ".join(summary["provenance"])
        source = f"{provenance} · {summary['lanes']} lanes each · seed {summary['seed']}"
        figure = plot_sweeps(swept(summary), as_trained(summary), title, source)
        caption = f"{title}, with 95 % Wilson intervals; the dashed line is the success as trained."
        return [style.picture(figure, self.run.file("figures/sweep.png"), caption, source)]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [*figures, self.overview(), Paragraph(_READING)]


class SweepRow(PolicyRow):
    """The row of an evaluation under one condition."""

    condition: str
    """Short name or dotted key; empty as trained."""
    value: Plain
    same: list[str]
    """In the row as trained, the cases that change nothing and are not flown again."""
    timing: Timing


def summarise(config: Row, rows: Sequence[SweepRow], won: Won) -> Summary:
    """Summarise each condition: success with its interval, and McNemar's exact test against the flights as trained.

    `won` has the successes of the lanes by case.
    """
    by_case = {row["case"]: row for row in rows}
    usual = by_case.get(AS_TRAINED)
    same = set() if usual is None else set(usual["same"])
    cells, conditions = [], [(name, value) for name, values in config["sweep"].items() for value in values]
    for name, value in [("", None), *conditions]:
        case = case_id(name, value)
        row = usual if case in same else by_case.get(case)
        if row is not None:
            cells.append(_cell(name, value, row, won))
    return {
        "suite": "sweep",
        **subset(config, "agent", "seed"),
        "lanes": config["games"],
        "provenance": sorted({timing_provenance(row["timing"]) for row in rows}),
        "cells": cells,
    }


def case_id(condition: str, value: object) -> str:
    """Return the name of a condition's case."""
    return f"{condition}-{value_text(value)}".replace("/", "_") if condition else AS_TRAINED


def _cell(name: str, value: object, row: SweepRow, won: Won) -> Summary:
    test = None
    if AS_TRAINED in won and row["case"] != AS_TRAINED:
        test = mcnemar_exact(won[AS_TRAINED], won[row["case"]]).p_value
    return {
        "condition": name,
        "value": value,
        **Proportion.of(row).as_summary(),
        "distance_m_median": row["distance_m_median"],
        "mcnemar_p": test,
    }


def as_trained(summary: Summary) -> float | None:
    """Return the success under the conditions of the training, if that was flown."""
    return next((cell["success_ratio"] for cell in summary["cells"] if not cell["condition"]), None)


def swept(summary: Summary) -> dict[str, dict[str, Proportion]]:
    departed = [cell for cell in summary["cells"] if cell["condition"]]
    return {
        name: {value_text(cell["value"]): Proportion.of(cell) for cell in own}
        for name, own in grouped(departed, lambda cell: _name(cell["condition"])).items()
    }


def table(summary: Summary) -> Table:
    """Return the table of all conditions."""
    return Table.of(
        summary["cells"],
        ("condition", lambda cell: _name(cell["condition"]) if cell["condition"] else "as trained"),
        ("value", lambda cell: value_text(cell["value"]) if cell["condition"] else ""),
        ("success", lambda cell: f"{cell['success_ratio']:.1%}"),
        ("95 % interval", lambda cell: f"{cell['wilson_low']:.1%} to {cell['wilson_high']:.1%}"),
        ("lanes", lambda cell: f"{cell['successes']} of {cell['games']}"),
        ("median distance, m", lambda cell: f"{cell['distance_m_median']:.1f}"),
        ("p", lambda cell: "" if cell["mcnemar_p"] is None else f"{cell['mcnemar_p']:.2g}"),
    )


def _name(condition: str) -> str:
    unit = CONDITIONS[condition].unit if condition in CONDITIONS else ""
    return f"{condition}, {unit}" if unit else condition


_READING = (
    "One condition is changed at a time; the lanes are the same throughout. p is that of McNemar's exact test against "
    "the flights as trained, lane by lane. Where spacing or gap change, the obstacles stand elsewhere, and a lane may "
    "be harder or easier for any policy."
)


class Sweep(PolicySuite[SweepConfig]):
    """`uavaccel evaluate --sweep`, `uavaccel run sweep`."""

    name = "sweep"
    config = SweepConfig
    report_class = SweepReport
    row = SweepRow
    kept = (*PolicySuite.kept, "timing")

    def evaluations(self, config: SweepConfig) -> Iterator[EvaluationCase]:
        """Yield the evaluation as trained, then those with one condition changed."""
        yield EvaluationCase(AS_TRAINED, "virtual", 0.0, {}, {"condition": "", "value": None})
        for name, values in config.sweep.items():
            for value in values:
                labels = {"condition": name, "value": value}
                yield EvaluationCase(case_id(name, value), "virtual", 0.0, keys_of(name, value), labels)

    def cases(self, config: SweepConfig) -> Iterator[EvaluationCase]:
        """Yield the evaluations to fly; conditions that change nothing are flown once, as trained."""
        evaluations = [
            (case, part, part_suite(part, config.seed)[1])
            for case in self.evaluations(config)
            for part in [self.part(config, case)]
        ]
        (_, _, usual), *departed = evaluations
        same = [case.id for case, _, evaluation in departed if evaluation == usual]
        for case, part, evaluation in evaluations:
            if case.id not in same:
                labels = {**case.labels, "same": same if case.id == AS_TRAINED else []}
                simulated_s = part_simulated_s(part, config.seed)
                yield replace(case, labels=labels, timing=timing_of(evaluation), typical_s=simulated_s)

    def why_serial(self, config: SweepConfig) -> str:
        suite, evaluation = self.first(config)
        if timing_of(evaluation) == "wall":
            return "neighbours would spoil the measurement on the wall clock"
        return suite.why_serial(evaluation)
