"""The report of the suite `realtime`: cells and their results as a file, rankings, figures, tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise, permutations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from uavaccel.draw import style
from uavaccel.draw.page import Column, Picture, Table, clock_label, listed, unknown
from uavaccel.metrics.intervals import hierarchical_interval
from uavaccel.suites import plots
from uavaccel.suites.report import Report

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLACE = ["environment", "command", "latency_s", "clock_speed"]
CELL = ["environment", "agent", "command", "latency_s", "clock_speed"]
"""What the evaluations of a cell have in common: they are of one agent's trainings."""
TRAINING = ["environment", "agent", "seed", "steps", "last_return", "agent_sha256"]
ESTIMATES = [f"{of}_{name}" for of in ("score", "return") for name in ("mean", "low", "high")]
RESULTS = [*CELL, "delay_s", "seeds", "episodes", *ESTIMATES]


def cells_of(report: Report) -> pd.DataFrame:
    """Return a cell for each agent, latency, ClockSpeed and command, in the order of the rows.

    `delay_s` is the median of simulated seconds from an observation to its action; intervals are over trainings and
    episodes, and NaN of a single one.
    """

    def cell(own: pd.DataFrame) -> dict[str, Any]:
        returns = own.returns.tolist()
        low, high = hierarchical_interval(returns, report.config.seed)
        found = {"mean": float(np.mean([np.mean(each) for each in returns])), "low": low, "high": high}
        scale = report.config.scale(own.environment.iloc[0])
        scores = {} if scale is None else {f"score_{name}": _on(scale, value) for name, value in found.items()}
        return {
            "delay_s": float(np.median(np.concatenate(own.delays_s.tolist()))),
            "seeds": len(own),
            "episodes": sum(map(len, returns)),
            **{f"return_{name}": value for name, value in found.items()},
            **scores,
            "late_s": own.late_s.max(),
        }

    groups = report.scores.groupby(CELL, sort=False)
    return pd.DataFrame([dict(zip(CELL, key, strict=True)) | cell(own) for key, own in groups])


def _on(scale: tuple[float, float], value: float) -> float:
    return (value - scale[0]) / (scale[1] - scale[0])


def results(report: Report) -> str:
    """Return results.csv: a line for each cell, in the order of their names and numbers, numbers with six digits.

    `policies` are the first digits of the hashes of what was flown, training by training.
    """
    cells = pd.DataFrame(report.summary["cells"])
    trainings = pd.DataFrame(report.summary["trainings"], columns=TRAINING).sort_values(
        ["environment", "agent", "seed"]
    )
    trainings["digest"] = trainings.agent_sha256.str[:12]
    hashes = trainings.groupby(["environment", "agent"]).digest.agg(" ".join).to_dict()
    flown = zip(cells.environment, cells.agent, strict=True)
    trained = [hashes.get((place, report.config.trained_as(place, agent))) for place, agent in flown]
    lines = cells.reindex(columns=RESULTS).assign(policies=trained).sort_values(CELL)
    text: str = lines.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    return text


def ranking(cells: pd.DataFrame) -> dict[str, Any]:
    """Return the order of the agents at each ClockSpeed, best first, and how far it is that at the slowest.

    `holds_to` is the largest ClockSpeed up to which no two agents change places.
    """
    by_speed = {speed: own.set_index("agent") for speed, own in cells.groupby("clock_speed")}
    speeds, slowest = list(by_speed), next(iter(by_speed.values()))
    reversals = [each for speed in speeds[1:] for each in _reversals(slowest, by_speed[speed], speed)]
    broken = min((reversal["clock_speed"] for reversal in reversals), default=np.inf)
    means = [own.return_mean for own in by_speed.values()]
    return {
        "clock_speeds": speeds,
        "orders": [here.sort_values(ascending=False, kind="stable").index.tolist() for here in means],
        "kendall_tau": [kendall_tau(means[0], here) for here in means],
        "holds_to": max(speed for speed in speeds if speed < broken),
        "reversals": reversals,
    }


def kendall_tau(first: pd.Series, second: pd.Series) -> float | None:
    """Return Kendall's tau-b of the agents, the index of both, by their returns; None where either ranks nothing."""
    tau = first.corr(second, method="kendall", min_periods=2)
    return None if np.isnan(tau) else float(tau)


def _reversals(before: pd.DataFrame, after: pd.DataFrame, clock_speed: float) -> Iterator[dict[str, Any]]:
    """Yield the pairs of agents, the index, whose order is reversed and whose intervals are disjoint both times."""
    both = [agent for agent in before.index if agent in after.index]
    for ahead, behind in sorted(permutations(both, 2), key=lambda pair: sorted(map(both.index, pair))):
        was_behind = before.return_low[behind] > before.return_high[ahead]
        if was_behind and after.return_low[ahead] > after.return_high[behind]:
            yield {"clock_speed": clock_speed, "ahead": ahead, "behind": behind}


def tcsc_equal(evaluations: pd.DataFrame) -> bool | None:
    """Return whether under TCSC every agent's returns are bit-identical at all ClockSpeeds; None for a single one."""
    by_tcsc = evaluations[evaluations.command == "tcsc"]
    groups = [own.returns.tolist() for _, own in by_tcsc.groupby(["environment", "agent", "seed"])]
    if max(map(len, groups), default=0) < 2:
        return None
    return all(returns == group[0] for group in groups for returns in group)


def agreement(pairs: pd.DataFrame) -> dict[str, Any]:
    """Return how far returns, delays and the agents' rankings (Kendall's tau) agree between modelled and measured."""
    groups = [own.set_index("agent") for _, own in pairs.groupby(PLACE)]
    found = [kendall_tau(own.return_mean, own.return_mean_measured) for own in groups]
    taus = [tau for tau in found if tau is not None]

    def off(pairs: pd.DataFrame, name: str) -> float | None:
        modelled, measured = pairs[name], pairs[f"{name}_measured"]
        return float((abs(measured - modelled) / np.maximum(abs(modelled), 1e-9)).median()) if len(pairs) else None

    return {
        "cells": len(pairs),
        "return_difference_median": off(pairs, "return_mean"),
        "delay_difference_median": off(pairs[pairs.delay_s > 0], "delay_s"),
        "kendall_tau_mean": float(np.mean(taus)) if taus else None,
        "kendall_tau_least": min(taus, default=None),
        "late_s": pairs.late_s_measured.max(),
    }


def cell_in_words(cell: Mapping[str, Any]) -> str:
    """Return the result of a cell, as in "hopper-naive: return 70.2 (95 % interval 60 to 80) with 20 ms ..."."""
    of = "score" if cell.get("score_mean") is not None else "return"
    mean, low, high = (cell[f"{of}_{name}"] for name in ("mean", "low", "high"))
    under = f"{_latency_ms(cell)} ms to think, {cell['command'].upper()} at {clock_label(cell['clock_speed'])}"
    interval = "one episode" if unknown(low) else f"95 % interval {low:.4g} to {high:.4g}"
    return f"{cell['environment']}, {cell['agent']}: {of} {mean:.4g} ({interval}) with {under}"


def up_to_which_speed(ranking: Mapping[str, Any], cells: Sequence[Mapping[str, Any]]) -> str:
    """Return up to which ClockSpeed a ranking holds, as in "in hopper the ranking holds up to 5x; at 20x ...".

    At a single one it is the order of the agents, as in "in hopper small = large > slow", from their `cells`.
    """
    where, speeds = f"in {ranking['environment']}", ranking["clock_speeds"]
    if len(speeds) < 2:
        own = [each for each in cells if each["command"] == "adsc"]
        own = [each for each in own if all(each[name] == ranking[name] for name in ("environment", "latency_s"))]
        means, order = {each["agent"]: each["return_mean"] for each in own}, ranking["orders"][0]
        others = (f" {'>' if means[one] > means[other] else '='} {other}" for one, other in pairwise(order))
        return f"{where} {order[0]}{''.join(others)}"
    if not ranking["reversals"]:
        return f"{where} no two agents change places up to {clock_label(speeds[-1])}, the fastest flown"
    return f"{where} the ranking holds up to {clock_label(ranking['holds_to'])} ({_first_change(ranking)})"


def _first_change(ranking: Mapping[str, Any]) -> str:
    """Return the first change of places in words, or "none"."""
    if not ranking["reversals"]:
        return "none"
    first, slowest = ranking["reversals"][0], clock_label(ranking["clock_speeds"][0])
    at = clock_label(first["clock_speed"])
    return f"at {at} {first['ahead']} is ahead of {first['behind']}, which beats it at {slowest}"


def rankings_table(rankings: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of rankings at several ClockSpeeds."""

    def taus(ranking: Mapping[str, Any]) -> str:
        return ", ".join("-" if tau is None else f"{tau:.2f}" for tau in ranking["kendall_tau"][1:])

    columns: dict[str, Column] = {
        "environment": "{environment}",
        "latency, ms": _latency_ms,
        "ranking holds up to": "{holds_to:g}x",
        f"Kendall's tau at {listed(map(clock_label, rankings[0]['clock_speeds'][1:]))}": taus,
        "first change": _first_change,
    }
    return Table.of(rankings, columns)


def _latency_ms(entry: Mapping[str, Any]) -> str:
    return f"{1e3 * entry['latency_s']:g}"


def panels_figure(
    cells: pd.DataFrame, x: str, y: str, by: str, title: str, line: str = "-", ends: Sequence[str] = (), **options: Any
) -> tuple[Figure, list[Axes]]:
    """Draw column `y` over `x`, a panel per environment and a line per value of `by`; `ends` are intervals' columns."""
    labels = cells[by].unique()
    figure, panels = plots.facets(cells, "environment", title, across=2, height_in=2.4, sharey=False, **options)
    for axes, name, own in panels:
        axes.set_title(name)
        for number, label in enumerate(labels):
            of = own[own[by] == label].sort_values(x)
            look = {"color": style.colour(number), "marker": style.marker(number), "markersize": 4}
            look |= {"linestyle": line, "linewidth": 1.2, "elinewidth": 0.8, "label": label.replace("_", " ")}
            if len(of):
                plots.line(axes, of[x], of[y], tuple(of[end] for end in ends) or None, **look)
    style.legend(figure)
    return figure, [axes for axes, *_ in panels]


def returns_figure(report: Report, cells: pd.DataFrame) -> Picture:
    """Draw return, or score where all have one, over the delay; of cells with equal delays and returns, one."""
    of = "score" if "score_mean" in cells and cells.score_mean.notna().all() else "return"
    title = f"{of.capitalize()} over the delay from observation to action"
    adsc = cells[cells.command == "adsc"].assign(delay_s=cells.delay_s.round(6)).sort_values("delay_s", kind="stable")
    adsc = adsc.drop_duplicates(["environment", "agent", "delay_s", "return_mean"], keep="last").sort_index()
    ends = f"{of}_low", f"{of}_high"
    figure, panels = panels_figure(adsc, "delay_s", f"{of}_mean", "agent", title, ends=ends)
    for axes in panels:
        axes.set_xscale("symlog", linthresh=0.01)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set(xlabel="delay, simulated s", ylabel=of, xlim=(-0.001, None))
    plots.label_outer(panels)
    caption = f"{title}, means with 95 % intervals over trainings and episodes."
    alt = f"Lines of {of} by delay, an agent each, in {listed(adsc.environment.unique())}. {report.headline()}."
    return report.figure("returns", figure, caption, alt)


def rankings_figure(report: Report) -> Picture:
    """Draw Kendall's tau against the slowest ClockSpeed."""
    title = "Rankings over ClockSpeed"
    rankings = pd.DataFrame(report.summary["rankings"]).sort_values("latency_s", kind="stable")
    taus = rankings.assign(latency=[f"{1e3 * latency_s:g} ms" for latency_s in rankings.latency_s])
    taus = taus.explode(["clock_speeds", "kendall_tau"]).astype({"clock_speeds": float, "kendall_tau": float})
    clocks = sorted(taus.clock_speeds.unique())
    taus["place"] = np.searchsorted(clocks, taus.clock_speeds)
    figure, panels = panels_figure(taus, "place", "kendall_tau", "latency", title)
    for axes in panels:
        plots.clock_axis(axes, clocks)
        axes.set(ylabel="Kendall's tau", ylim=(-1.1, 1.1))
    plots.label_outer(panels)
    least = plots.span(taus.kendall_tau)
    alt = f"Lines of Kendall's tau by ClockSpeed, a latency each, in {listed(taus.environment.unique())}: {least}."
    return report.figure("rankings", figure, f"{title}{RANKINGS}", alt)


def agreement_figure(pairs: pd.DataFrame, source: str) -> Figure:
    """Return the plot of the mean return on the machine's clock over that on the simulated one, by environment."""
    with style.project_style():
        title, names = "The machine's clock against the simulated one", ("return_mean", "return_mean_measured")
        figure, panels = panels_figure(pairs, *names, "agent", title, line="none", source=source)
        for axes in panels:
            axes.plot(axes.get_xlim(), axes.get_xlim(), **style.LIMIT)
            axes.set(xlabel="modelled return", ylabel="measured return")
    return figure


COUNTS = {"seeds": "training", "episodes": "episode"}
RETURNS: dict[str, Column] = {
    "environment": "{environment}",
    "agent": "{agent}",
    "command": "{command!u}",
    "latency, ms": _latency_ms,
    "ClockSpeed": "{clock_speed:g}x",
    "delay, simulated s": "{delay_s:.3g}",
    "return": "{return_mean:g}",
    "95 % interval": "{return_low:g} to {return_high:g}",
    "late at most, s": lambda cell: f"{cell['late_s']:.3f}" if cell["late_s"] else "-",
}
RANKINGS = ": Kendall's tau of the agents' ranking against the slowest ClockSpeed, for each latency."
READING = (
    "Between an observation and its action an agent thinks for the latency, on a wall clock that runs ClockSpeed times "
    "slower than the simulation: the environment goes on for their product (ADSC) or is paused (TCSC). Two agents "
    "change places where one is ahead of the other at the slowest ClockSpeed and behind it here, and their 95 % "
    "intervals are apart both times; Kendall's tau compares the order of the means alone."
)
