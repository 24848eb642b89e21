"""The report: which agent is best under which delay, and up to which ClockSpeed that does not change."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import cast

import numpy as np

from uavaccel.draw import style
from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.suites.old_report import Report, Summary
from uavaccel.suites.realtime.figures import plot_agreement, plot_rankings, plot_returns
from uavaccel.suites.realtime.flights import EvaluationRow
from uavaccel.suites.realtime.summary import (
    CONDITIONS,
    Cell,
    Ranking,
    cells_of,
    evaluations,
    kendall_tau,
    means_of,
    rankings_of,
    tcsc_equal,
)
from uavaccel.suites.rows import grouped, subset

OF_TRAINING = ("environment", "agent", "seed", "steps", "last_return", "weights_sha256")
key_of = itemgetter(*CONDITIONS)


class RealtimeReport(Report):
    """The report of `uavaccel run realtime`."""

    def summarise(self) -> Summary:
        rows = self._evaluations()
        cells = cells_of(rows, self.config["seed"])
        return {
            "suite": "realtime",
            "seed": self.config["seed"],
            "provenance": timing_provenance(self.config["timing"]),
            "cells": cells,
            "rankings": rankings_of(cells),
            "tcsc_equal_at_every_clock_speed": tcsc_equal(rows),
            "trainings": [subset(row, *OF_TRAINING) for row in self.rows if row["kind"] == "training"],
        }

    def _evaluations(self) -> list[EvaluationRow]:
        if not (rows := evaluations(self.rows)):
            raise UserError(f"{self.run.path / 'rows.jsonl'}: holds no finished evaluation yet")
        return rows

    def title(self) -> str:
        return "Agents that need time to think"

    def headline(self) -> str:
        rankings = self._rankings()
        latencies = sorted({ranking["latency_s"] for ranking in rankings})
        middle = latencies[len(latencies) // 2] if latencies else 0.0
        said = [_up_to_which_speed(ranking) for ranking in rankings if ranking["latency_s"] == middle]
        equal = self.summary["tcsc_equal_at_every_clock_speed"]
        if equal is not None:
            how = "are the same to the bit" if equal else "DIFFER"
            said.append(f"under TCSC all returns {how} at every ClockSpeed")
        return "; ".join(said)

    def overview(self) -> Table:
        return _returns_table(_slowest_with_and_without_latency(self._cells()))

    def figures(self) -> list[Picture]:
        cells, rankings, source = self._cells(), self._rankings(), self._source()
        title = "Return over the delay from observation to action"
        path = self.run.file("figures/returns.png")
        caption = f"{title}, means with 95 % intervals over trainings and episodes."
        pictures = [style.picture(plot_returns(cells, title, source), path, caption, source)]
        if max((len(ranking["clock_speeds"]) for ranking in rankings), default=0) > 1:
            title, path = "Rankings over ClockSpeed", self.run.file("figures/rankings.png")
            caption = f"{title}: Kendall's tau of the agents' ranking against the slowest ClockSpeed, for each latency."
            pictures.append(style.picture(plot_rankings(rankings, title, source), path, caption, source))
        return pictures

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        held = [ranking for ranking in self._rankings() if len(ranking["clock_speeds"]) > 1]
        return [
            *figures,
            Heading("How fast may one simulate before the ranking changes?"),
            *([_rankings_table(held)] if held else []),
            Paragraph(_READING),
            Heading("All cells"),
            _returns_table(self._cells(), "all returns"),
        ]

    def _cells(self) -> list[Cell]:
        return cast("list[Cell]", self.summary["cells"])

    def _rankings(self) -> list[Ranking]:
        return cast("list[Ranking]", self.summary["rankings"])

    def _source(self) -> str:
        cells = self._cells()
        seeds, episodes = {cell["seeds"] for cell in cells}, {cell["episodes"] for cell in cells}
        counts = f"{_range(seeds)} trainings, {_range(episodes)} episodes a cell"
        return f"{self.summary['provenance']} · {counts} · seed {self.summary['seed']}"


def compare_clocks(modelled: RunDirectory, measured: RunDirectory) -> list[Path]:
    """Write a figure and agreement.json of a simulated clock against the machine's, in the second run's folder."""
    by_key = []
    for run in (modelled, measured):
        rows = evaluations([row for row in run.rows() if row.get("suite") == "realtime"])
        by_key.append({key_of(cell): cell for cell in cells_of(rows, run.config()["seed"])})
    pairs = [(by_key[0][key], by_key[1][key]) for key in by_key[0] if key in by_key[1]]
    if not pairs:
        raise UserError(f"{measured.path}: has no cell that {modelled.path} has too")
    measured.write_json("agreement.json", agreement(pairs))
    source = f"modelled: {modelled.path.name}; measured: {measured.path.name}"
    figure = plot_agreement(pairs, "The machine's clock against the simulated one", source)
    return [style.save(figure, measured.file("figures/agreement.png"))]


def agreement(pairs: Sequence[tuple[Cell, Cell]]) -> dict[str, Plain]:
    """Return how far returns, delays and the agents' rankings (Kendall's tau) agree between modelled and measured."""
    without_agent = itemgetter("environment", "command", "latency_s", "clock_speed")
    groups = grouped(pairs, lambda pair: without_agent(pair[0]))
    taus = [
        kendall_tau(means_of([each[0] for each in group]), means_of([each[1] for each in group]))
        for group in groups.values()
    ]
    known = [tau for tau in taus if tau is not None]
    returns = [_relative(each["return_mean"], other["return_mean"]) for each, other in pairs]
    delays = [_relative(each["delay_s"], other["delay_s"]) for each, other in pairs if each["delay_s"] > 0]
    return {
        "cells": len(pairs),
        "return_difference_median": float(np.median(np.abs(returns))),
        "delay_difference_median": float(np.median(np.abs(delays))) if delays else None,
        "kendall_tau_mean": float(np.mean(known)) if known else None,
        "kendall_tau_least": min(known, default=None),
        "late_s": max(measured["late_s"] for _, measured in pairs),
    }


def _relative(modelled: float, measured: float) -> float:
    return (measured - modelled) / max(abs(modelled), 1e-9)


def _up_to_which_speed(ranking: Ranking) -> str:
    """Return up to which ClockSpeed a ranking holds, as in "hopper, 50 ms: the ranking holds up to 5x; at 20x ..."."""
    where = f"{ranking['environment']}, {1e3 * ranking['latency_s']:g} ms"
    speeds, reversals = ranking["clock_speeds"], ranking["reversals"]
    if len(speeds) < 2:
        return f"{where}: {' > '.join(ranking['orders'][0])}"
    if not reversals:
        return f"{where}: no two agents change places up to {clock_label(speeds[-1])}, the fastest flown"
    change = _first_change(ranking)
    return f"{where}: the ranking holds up to {clock_label(ranking['holds_to'])}; {change}"


def _first_change(ranking: Ranking) -> str:
    first, slowest = ranking["reversals"][0], clock_label(ranking["clock_speeds"][0])
    at = clock_label(first["clock_speed"])
    return f"at {at} {first['ahead']} is ahead of {first['behind']}, which beats it at {slowest}"


def _rankings_table(rankings: Sequence[Ranking]) -> Table:
    speeds = ", ".join(clock_label(speed) for speed in rankings[0]["clock_speeds"][1:])
    return Table.of(
        rankings,
        ("environment", lambda ranking: ranking["environment"]),
        ("latency, ms", lambda ranking: f"{1e3 * ranking['latency_s']:g}"),
        ("ranking holds up to", lambda ranking: clock_label(ranking["holds_to"])),
        (
            f"Kendall's tau at {speeds}",
            lambda ranking: ", ".join(or_dash(tau, "{:.2f}".format) for tau in ranking["kendall_tau"][1:]),
        ),
        ("first change", lambda ranking: _first_change(ranking) if ranking["reversals"] else "none"),
    )


def _slowest_with_and_without_latency(cells: Sequence[Cell]) -> list[Cell]:
    """Return ADSC's cells at the slowest ClockSpeed, at the least latency and at the middle one."""
    own = [cell for cell in cells if cell["command"] == "adsc"]
    slowest = min((cell["clock_speed"] for cell in own), default=0.0)
    latencies = sorted({cell["latency_s"] for cell in own})
    shown = {latencies[0], latencies[len(latencies) // 2]} if latencies else set()
    return [cell for cell in own if cell["clock_speed"] == slowest and cell["latency_s"] in shown]


def _returns_table(cells: Sequence[Cell], folded: str = "") -> Table:
    return Table.of(
        cells,
        ("environment", lambda cell: cell["environment"]),
        ("agent", lambda cell: cell["agent"]),
        ("command", lambda cell: command_name(cell["command"])),
        ("latency, ms", lambda cell: f"{1e3 * cell['latency_s']:g}"),
        ("ClockSpeed", lambda cell: clock_label(cell["clock_speed"])),
        ("delay, simulated s", lambda cell: f"{cell['delay_s']:.3g}"),
        ("return", lambda cell: f"{cell['return_mean']:.4g}"),
        ("95 % interval", lambda cell: f"{cell['return_low']:.4g} to {cell['return_high']:.4g}"),
        ("late at most, s", lambda cell: or_dash(cell["late_s"] or None, "{:.3f}".format)),
        folded=folded,
    )


def _range(counts: set[int]) -> str:
    return f"{min(counts)}" if len(counts) == 1 else f"{min(counts)} to {max(counts)}"


_READING = (
    "Between an observation and its action an agent thinks for the latency, on a wall clock that runs ClockSpeed times "
    "slower than the simulation: the environment goes on for their product (ADSC) or is paused (TCSC). Two agents "
    "change places where one is ahead of the other at the slowest ClockSpeed and behind it here, and their 95 % "
    "intervals are apart both times; Kendall's tau compares the order of the means alone."
)
