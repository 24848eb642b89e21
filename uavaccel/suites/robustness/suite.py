"""The suite `robustness`: one policy evaluated over a grid of latency and ClockSpeed, and where it collapses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from operator import itemgetter
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from pydantic import field_validator

from uavaccel.draw import style
from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_at_clock, command_name
from uavaccel.files import Plain
from uavaccel.forms import NotNegative, Positive
from uavaccel.limits import MOST_SCALE, Games
from uavaccel.metrics.intervals import Proportion
from uavaccel.suites.evaluation.parts import EvaluationCase, PolicyExperiment, PolicyRow, PolicySuite, agent_name
from uavaccel.suites.experiment import ClockSpeeds, CommandName, CommandNames, ProfileName, distinct
from uavaccel.suites.old_report import Report, Summary, SummaryCell, Values
from uavaccel.suites.parts import part_simulated_s
from uavaccel.suites.rows import Row, grouped, subset
from uavaccel.suites.sweep.config import key_of


class RobustnessConfig(PolicyExperiment):
    """`suite: robustness`."""

    suite: Literal["robustness"]
    profile: ProfileName = "airsim"
    """How time is handled: exact to the tick, or as AirSim does."""
    command: CommandNames = ("tcsc", "adsc")
    """The synchronous commands to fly with."""
    clock_speed: ClockSpeeds
    """ClockSpeeds to fly at: simulated seconds per wall second."""
    latency_scale: tuple[float, ...]
    """Factors of the latencies of the profile's model, flown in this order: put what matters most first."""
    games: Games = 100
    """Lanes flown in each cell."""

    @field_validator("latency_scale")
    @classmethod
    def _not_negative(cls, scales: tuple[float, ...]) -> tuple[float, ...]:
        if any(not 0 <= scale <= MOST_SCALE for scale in scales):
            raise ValueError(f"must be 0 to {MOST_SCALE:g}")
        return distinct(scales)


COLOURS = "cividis"  # which the common colour-vision deficiencies keep apart


SuccessMap = Mapping[tuple[float, float], Proportion]  # by latency scale and ClockSpeed


def plot_success_maps(maps: Mapping[str, SuccessMap], fitted: float, title: str, source: str) -> Figure:
    """Plot a map per command: success as colour and text above its interval, with a frame around the row `fitted`."""
    scales = sorted({scale for panel in maps.values() for scale, _ in panel})
    clocks = sorted({clock for panel in maps.values() for _, clock in panel})
    with style.project_style():
        figure = style.new_figure(
            1.6 + 0.95 * len(clocks) * len(maps), 1.8 + 0.62 * len(scales), title, source
        )
        row = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
        for axes, (name, panel) in zip(row, maps.items(), strict=True):
            ratios = np.array(
                [[panel[s, k].ratio if (s, k) in panel else np.nan for k in clocks] for s in scales]
            )
            image = axes.imshow(ratios, COLOURS, aspect="auto", origin="lower", vmin=0.0, vmax=1.0)
            _write_success(axes, panel, scales, clocks)
            axes.set_title(name, loc="center")
            axes.set_xticks(range(len(clocks)), [style.clock_label(clock) for clock in clocks])
            axes.set_yticks(range(len(scales)), [f"×{scale:g}" for scale in scales])
            axes.set_xlabel("ClockSpeed")
            axes.grid(visible=False)
            if fitted in scales:
                corner = -0.5, scales.index(fitted) - 0.5
                frame: dict[str, Any] = {"fill": False, "edgecolor": style.VERMILION, "linewidth": 2.0}
                axes.add_patch(Rectangle(corner, len(clocks), 1.0, **frame))
        row[0].set_ylabel("latency, times the fitted one")
        figure.colorbar(image, ax=list(row), label="success", fraction=0.04)
        return figure


def _write_success(axes: Axes, panel: SuccessMap, scales: Sequence[float], clocks: Sequence[float]) -> None:
    for (scale, clock), success in panel.items():
        place = clocks.index(clock), scales.index(scale)
        colour = "white" if success.ratio < 0.5 else "black"
        axes.annotate(
            f"{success.ratio:.0%}", place, ha="center", va="bottom", color=colour, fontweight="bold"
        )
        interval = "–".join(f"{100 * end:.0f}" for end in success.interval)
        below: dict[str, Any] = {"xytext": (0, -2), "textcoords": "offset points", "va": "top", "fontsize": 7}
        axes.annotate(interval, place, ha="center", color=colour, **below)


FITTED = 1.0
COLLAPSED = 0.5  # share of the success in real time with the fitted latency


class RobustnessReport(Report):
    """The report of `uavaccel run robustness`."""

    def summarise(self) -> Summary:
        return summarise(self.config, self.rows)

    def title(self) -> str:
        return f"Success of {agent_name(self.config['agent'])} over latency and ClockSpeed"

    def headline(self) -> str:
        cells, who = self.summary["cells"], agent_name(self.summary["agent"])
        by_success = sorted(cells, key=lambda cell: float(cell["success_ratio"]))
        worst, best = (
            f"{cell['success_ratio']:.1%} with {command_at_clock(cell)} and latency ×{cell['latency_scale']:g}"
            for cell in (by_success[0], by_success[-1])
        )
        return (
            f"{who} wins from {worst} to {best}: "
            f"{sum(cell['games'] for cell in cells)} games over {len(cells)} points of latency and "
            f"ClockSpeed, all of it modelled under {self.summary['profile']}"
        )

    def overview(self) -> Table:
        return table(self.summary)

    def figures(self) -> list[Picture]:
        lanes = max(row["games"] for row in self.rows)
        source = (
            f"modelled, profile {self.config['profile']} · {lanes} lanes each · seed {self.config['seed']}"
        )
        figure = plot_success_maps(maps(self.summary["cells"]), FITTED, self.title(), source)
        caption = f"{self.title()}, with 95 % Wilson intervals; the frame is the latency as fitted."
        return [style.picture(figure, self.run.file("figures/robustness_map.png"), caption, source)]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [
            *figures,
            self.overview(),
            Heading("Where success collapses"),
            _collapse_table(self.summary["collapses"]),
            Paragraph(_READING),
        ]


class RobustnessRow(PolicyRow):
    """The row of an evaluation with one command at one latency and ClockSpeed."""

    command: CommandName
    clock_speed: Positive
    latency_scale: NotNegative


def summarise(config: Row, rows: Sequence[RobustnessRow]) -> Summary:
    """Summarise each cell with its interval, and the latencies between which each command and ClockSpeed collapses."""
    kept = ("command", "clock_speed", "latency_scale", "distance_m_median")
    cells = [subset(row, *kept) | Proportion.of(row).as_summary() for row in rows]
    pairs = sorted({(cell["command"], cell["clock_speed"]) for cell in cells})
    return {
        "suite": "robustness",
        **subset(config, "agent", "profile", "seed"),
        "cells": cells,
        "collapses": [collapse(cells, *pair) for pair in pairs],
    }


def collapse(cells: Sequence[SummaryCell], command: str, clock_speed: float) -> Summary:
    """Return the latencies between which success falls below half of that in real time at the fitted latency.

    `above` is the largest latency up to which it does not, `below` the next that was flown; None where there is none.
    Without the cell in real time both are None.
    """
    success = {
        (cell["clock_speed"], cell["latency_scale"]): cell["success_ratio"]
        for cell in cells
        if cell["command"] == command
    }
    scales = sorted(scale for clock, scale in success if clock == clock_speed)
    real_time = success.get((1.0, FITTED))
    found: Values = {"above": None, "below": None}
    if real_time is not None:
        for scale in scales:
            if success[clock_speed, scale] < COLLAPSED * real_time:
                found["below"] = scale
                break
            found["above"] = scale
    fitted = success.get((clock_speed, FITTED))
    return {"command": command, "clock_speed": clock_speed, "fitted": fitted, "real_time": real_time, **found}


def maps(cells: Sequence[SummaryCell]) -> dict[str, SuccessMap]:
    """Return the cells as the figure takes them, ADSC first."""
    by_command = grouped(sorted(cells, key=itemgetter("command")), lambda cell: command_name(cell["command"]))
    return {
        name: {(cell["latency_scale"], cell["clock_speed"]): Proportion.of(cell) for cell in own}
        for name, own in by_command.items()
    }


def table(summary: Summary) -> Table:
    """Return a table of success with a row for each command and latency, and a column for each ClockSpeed."""
    success = {
        (cell["command"], cell["latency_scale"], cell["clock_speed"]): Proportion.of(cell).text(0)
        for cell in summary["cells"]
    }
    clocks = sorted({clock for _, _, clock in success})
    rows = [
        (
            command_name(command),
            f"×{scale:g}",
            *(success.get((command, scale, clock), "-") for clock in clocks),
        )
        for command, scale in sorted({key[:2] for key in success})
    ]
    return Table(("command", "latency", *map(clock_label, clocks)), rows)


def _collapse_table(collapses: Sequence[Summary]) -> Table:
    return Table.of(
        collapses,
        ("command", lambda found: command_name(found["command"])),
        ("ClockSpeed", lambda found: clock_label(found["clock_speed"])),
        ("success at the fitted latency", lambda found: or_dash(found["fitted"], "{:.1%}".format)),
        ("falls below half of that in real time", _collapse_words),
    )


def _collapse_words(found: Summary) -> str:
    above, below = found["above"], found["below"]
    if found["real_time"] is None:
        return "- (1x at the fitted latency was not flown)"
    if below is None:
        return f"nowhere up to ×{above:g}"
    return f"at ×{below:g} or less" if above is None else f"between ×{above:g} and ×{below:g}"


_READING = (
    "Latencies are those of all messages of the profile's frozen model, requests, replies and callbacks, times the "
    "factor; the costs of frames, ticks and timers stay as they are, and are all that is left at ×0. Policy and lanes "
    "are the same in all cells: the map shows what a policy that was trained without latency tolerates; training with "
    "latency may do better or worse."
)


class Robustness(PolicySuite[RobustnessConfig]):
    """`uavaccel run robustness`."""

    name = "robustness"
    config = RobustnessConfig
    report_class = RobustnessReport
    row = RobustnessRow

    def evaluations(self, config: RobustnessConfig) -> Iterator[EvaluationCase]:
        """Yield the cells latency by latency, so that an interrupted run has complete rows of the map."""
        for scale, clock_speed, command in product(config.latency_scale, config.clock_speed, config.command):
            point = {"profile": config.profile, "command": command, "clock": clock_speed, "latency": scale}
            keys = {key_of(name): value for name, value in point.items()}
            labels = {"command": command, "clock_speed": clock_speed, "latency_scale": scale}
            case = self.case_of(labels)
            yield EvaluationCase(case, "virtual", 0.0, {**keys, "task.timing": "virtual"}, labels)

    def case_of(self, row: Plain) -> str:
        return f"latency{row['latency_scale']:g}-{row['command']}-{row['clock_speed']:g}x"

    def cases(self, config: RobustnessConfig) -> Iterator[EvaluationCase]:
        evaluations = list(self.evaluations(config))
        simulated_s = part_simulated_s(self.part(config, evaluations[0]), config.seed)
        return (replace(case, typical_s=simulated_s) for case in evaluations)
