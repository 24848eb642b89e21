"""A sweep's report: summary.json, figures/sweep.png, report.md and report.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw import style
from uavaccel.draw.document import Block, Paragraph, Picture, Table
from uavaccel.envs.conditions import CONDITIONS
from uavaccel.files import Plain
from uavaccel.metrics.intervals import Proportion, mcnemar_exact
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.suites.evaluation.parts import agent_name
from uavaccel.suites.report import Report, Row, Summary
from uavaccel.suites.sweep.conditions import value_text
from uavaccel.suites.sweep.figure import plot_sweeps

FIGURE = "figures/sweep.png"
AS_TRAINED = "as-trained"

Won = Mapping[str, NDArray[np.bool_]]


class SweepReport(Report):
    """Of `uavaccel evaluate --sweep` and `uavaccel run sweep`."""

    def summarise(self) -> Summary:
        won = {row["case"]: self.run.load_arrays(row)["is_success"] for row in self.rows}
        return summarise(self.config, self.rows, won)

    def title(self) -> str:
        return f"Success of {agent_name(self.summary['agent'])}, one condition changed at a time"

    def headline(self) -> str:
        """The success as trained, and where it is least."""
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
        path = style.save(figure, self.run.file(FIGURE))
        said = "with 95 % Wilson intervals; the dashed line is the success as trained"
        return [Picture(path, f"{title}, {said}. Source: {source}.")]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [Paragraph(self.headline() + "."), *figures, self.overview(), Paragraph(_READING)]


def summarise(config: Row, rows: Sequence[Row], won: Won) -> Summary:
    """Every condition with its interval, and McNemar's exact test against the flights as trained.

    `won` has the successes lane by lane, by case.
    """
    by_case = {row["case"]: row for row in rows}
    usual = by_case.get(AS_TRAINED)
    same = set() if usual is None else set(usual["same"])
    cells = []
    for name, value in _conditions(config):
        case = case_id(name, value)
        row = usual if case in same else by_case.get(case)
        if row is not None:
            cells.append(_cell(name, value, row, won))
    return {
        "suite": "sweep",
        "agent": config["agent"],
        "seed": config["seed"],
        "lanes": config["games"],
        "provenance": sorted({timing_provenance(row["timing"]) for row in rows}),
        "cells": cells,
    }


def _conditions(config: Row) -> list[tuple[str, Plain]]:
    return [("", None), *((name, value) for name, values in config["sweep"].items() for value in values)]


def case_id(condition: str, value: object) -> str:
    """Name of a condition's row."""
    return f"{condition}-{value_text(value)}".replace("/", "_") if condition else AS_TRAINED


def _cell(name: str, value: object, row: Row, won: Won) -> Summary:
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
    """The success under the conditions of the training, if that is flown."""
    return next((cell["success_ratio"] for cell in summary["cells"] if not cell["condition"]), None)


def swept(summary: Summary) -> dict[str, dict[str, Proportion]]:
    """Success by condition and value, as the figure takes it."""
    sweeps: dict[str, dict[str, Proportion]] = {}
    for cell in summary["cells"]:
        if cell["condition"]:
            values = sweeps.setdefault(_name(cell["condition"]), {})
            values[value_text(cell["value"])] = Proportion.of(cell)
    return sweeps


def table(summary: Summary) -> Table:
    """A row for each condition."""
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
    "One thing is changed at a time, the lanes are the same ones throughout. p is that of McNemar's exact test against "
    "the flights as trained, lane by lane. Where spacing or gap change, the obstacles stand elsewhere, and a lane may "
    "be harder or easier for any policy."
)
