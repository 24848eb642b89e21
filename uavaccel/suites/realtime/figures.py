"""Figures: return over delay, rankings over ClockSpeed, and measured returns over modelled ones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.suites.realtime.summary import Cell, Ranking

COLUMNS = 3


def _panels(names: Sequence[str], title: str, source: str) -> tuple[Figure, Mapping[str, Axes]]:
    columns = max(min(len(names), COLUMNS), 1)
    rows = max(math.ceil(len(names) / columns), 1)
    figure = style.new_figure(1.0 + 3.6 * columns, 0.9 + 2.8 * rows, title, source)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    for axes, name in zip(panels, names, strict=False):
        axes.set_title(name)
    return figure, dict(zip(names, panels, strict=False))


def plot_returns(cells: Sequence[Cell], title: str, source: str) -> Figure:
    """Plot return over the simulated delay, a panel per environment and a line per agent with its 95 % interval."""
    names, agents = _distinct(cells, "environment"), _distinct(cells, "agent")
    with style.project_style():
        figure, panels = _panels(names, title, source)
        for name, axes in panels.items():
            for number, agent in enumerate(agents):
                own = _by_delay(
                    [cell for cell in cells if (cell["environment"], cell["agent"]) == (name, agent)]
                )
                if not own:
                    continue
                colour, delays = style.colour(number), [delay for delay, _ in own]
                means, low, high = (
                    np.array([cell[key] for _, cell in own])
                    for key in ("return_mean", "return_low", "return_high")
                )
                line: style.LineStyle = {"marker": "o", "markersize": 3.5, "color": colour}
                axes.plot(delays, means, **line, label=agent.replace("_", " "))
                axes.fill_between(delays, low, high, color=colour, alpha=0.15, linewidth=0)
            axes.set_xscale("symlog", linthresh=0.01)
            axes.set(xlabel="delay, simulated s", ylabel="return", xlim=(0, None))
        _legend(figure, panels)
        return figure


def plot_rankings(rankings: Sequence[Ranking], title: str, source: str) -> Figure:
    """Plot Kendall's tau against the slowest ClockSpeed, a panel per environment and a line per latency."""
    names = list(dict.fromkeys(ranking["environment"] for ranking in rankings))
    latencies = sorted({ranking["latency_s"] for ranking in rankings})
    with style.project_style():
        figure, panels = _panels(names, title, source)
        for ranking in rankings:
            axes = panels[ranking["environment"]]
            taus = [np.nan if tau is None else tau for tau in ranking["kendall_tau"]]
            colour = style.colour(latencies.index(ranking["latency_s"]))
            label = f"{1e3 * ranking['latency_s']:g} ms"
            axes.plot(ranking["clock_speeds"], taus, marker="o", markersize=3.5, color=colour, label=label)
        for axes in panels.values():
            axes.set_xscale("log")
            axes.set(xlabel="ClockSpeed", ylabel="Kendall's tau", ylim=(-1.1, 1.1))
        _legend(figure, panels)
        return figure


def plot_agreement(pairs: Sequence[tuple[Cell, Cell]], title: str, source: str) -> Figure:
    """Plot the mean return on the machine's clock over that on the simulated one, a panel per environment."""
    names, agents = (_distinct([cell for cell, _ in pairs], key) for key in ("environment", "agent"))
    with style.project_style():
        figure, panels = _panels(names, title, source)
        for number, agent in enumerate(agents):
            for name, axes in panels.items():
                own = [pair for pair in pairs if (pair[0]["environment"], pair[0]["agent"]) == (name, agent)]
                modelled = [cell["return_mean"] for cell, _ in own]
                measured = [cell["return_mean"] for _, cell in own]
                label, colour = agent.replace("_", " "), style.colour(number)
                axes.plot(modelled, measured, "o", markersize=4, color=colour, label=label)
        for axes in panels.values():
            low, high = axes.get_xlim()
            axes.plot((low, high), (low, high), color=style.GREY, linewidth=0.8, linestyle="--")
            axes.set(xlabel="modelled return", ylabel="measured return")
        _legend(figure, panels)
        return figure


def _by_delay(cells: Sequence[Cell]) -> list[tuple[float, Cell]]:
    """Return ADSC's cells by rising delay; of those with equal delays one, since their flights are identical."""
    by_delay = {round(cell["delay_s"], 6): cell for cell in cells if cell["command"] == "adsc"}
    return sorted(by_delay.items())


def _distinct(cells: Sequence[Cell], key: str) -> list[str]:
    return list(dict.fromkeys(str(cell[key]) for cell in cells))  # type: ignore[literal-required]


def _legend(figure: Figure, panels: Mapping[str, Axes]) -> None:
    entries: dict[str, Artist] = {}
    for axes in panels.values():
        entries |= {
            str(label): handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
    figure.legend(list(entries.values()), list(entries), loc="outside right upper")
