"""The map's report: summary.json, figures/map.png, report.md and report.html, and where success collapses."""

from __future__ import annotations

from collections.abc import Sequence

from uavaccel.draw import style
from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.metrics.intervals import Proportion
from uavaccel.suites.evaluation.parts import agent_name
from uavaccel.suites.report import Report, Row, Summary, SummaryCell, Values
from uavaccel.suites.robustness.success_map import SuccessMap, plot_success_maps

FIGURE = "figures/robustness_map.png"
FITTED = 1.0
COLLAPSED = 0.5  # of the success in real time with the latency as it was fitted
COLLAPSE_HEADER = (
    "command",
    "ClockSpeed",
    "success at the fitted latency",
    "falls below half of that in real time",
)


class RobustnessReport(Report):
    """Of `uavaccel run robustness`."""

    def summarise(self) -> Summary:
        return summarise(self.config, self.rows)

    def title(self) -> str:
        return f"Success of {agent_name(self.config['agent'])} over latency and ClockSpeed"

    def headline(self) -> str:
        """How much was flown, by whom."""
        cells, who = self.summary["cells"], agent_name(self.summary["agent"])
        return (
            f"{who} in {sum(cell['games'] for cell in cells)} games over {len(cells)} points of latency and "
            f"ClockSpeed, all of it modelled under {self.summary['profile']}"
        )

    def overview(self) -> Table:
        return Table(header(self.summary), table(self.summary))

    def figures(self) -> list[Picture]:
        lanes = max(row["games"] for row in self.rows)
        source = (
            f"modelled, profile {self.config['profile']} · {lanes} lanes each · seed {self.config['seed']}"
        )
        figure = plot_success_maps(maps(self.summary["cells"]), FITTED, self.title(), source)
        path = style.save(figure, self.run.file(FIGURE))
        said = "with 95 % Wilson intervals; the frame is the latency as fitted"
        return [Picture(path, f"{self.title()}, {said}. Source: {source}.")]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [
            Paragraph(self.headline() + "."),
            *figures,
            self.overview(),
            Heading("Where success collapses"),
            Table(COLLAPSE_HEADER, [_collapse_line(each) for each in self.summary["collapses"]]),
            Paragraph(_READING),
        ]


def summarise(config: Row, rows: Sequence[Row]) -> Summary:
    """Every cell with its interval, and for each command and ClockSpeed between which latencies it collapses."""
    kept = ("command", "clock_speed", "latency_scale", "distance_m_median")
    cells = [{**{name: row[name] for name in kept}, **Proportion.of(row).as_summary()} for row in rows]
    pairs = sorted({(cell["command"], cell["clock_speed"]) for cell in cells})
    return {
        "suite": "robustness",
        "agent": config["agent"],
        "profile": config["profile"],
        "seed": config["seed"],
        "cells": cells,
        "collapses": [collapse(cells, *pair) for pair in pairs],
    }


def collapse(cells: Sequence[SummaryCell], command: str, clock_speed: float) -> Summary:
    """Between which latencies success falls below half of the command's own in real time at the fitted latency.

    `above` is the largest latency below which it never does, `below` the next that was flown; None where there is
    none. Without the cell in real time both are None.
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
    """The cells as the figure takes them, ADSC first."""
    found: dict[str, dict[tuple[float, float], Proportion]] = {}
    for cell in sorted(cells, key=lambda cell: str(cell["command"])):
        panel = found.setdefault(command_name(cell["command"]), {})
        panel[cell["latency_scale"], cell["clock_speed"]] = Proportion.of(cell)
    return dict(found)


def header(summary: Summary) -> tuple[str, ...]:
    """A column for each ClockSpeed."""
    return ("command", "latency", *(clock_label(clock) for clock in _clocks(summary)))


def table(summary: Summary) -> list[tuple[str, ...]]:
    """A line for each command and latency, below `header`."""
    success = {
        (cell["command"], cell["latency_scale"], cell["clock_speed"]): Proportion.of(cell).text(0)
        for cell in summary["cells"]
    }
    return [
        (
            command_name(command),
            f"×{scale:g}",
            *(success.get((command, scale, clock), "-") for clock in _clocks(summary)),
        )
        for command, scale in sorted({key[:2] for key in success})
    ]


def _clocks(summary: Summary) -> list[float]:
    return sorted({cell["clock_speed"] for cell in summary["cells"]})


def _collapse_line(found: Summary) -> tuple[str, ...]:
    above, below = found["above"], found["below"]
    if found["real_time"] is None:
        where = "- (1x at the fitted latency was not flown)"
    elif below is None:
        where = f"nowhere up to ×{above:g}"
    else:
        where = f"at ×{below:g} or less" if above is None else f"between ×{above:g} and ×{below:g}"
    fitted = or_dash(found["fitted"], "{:.1%}".format)
    return command_name(found["command"]), clock_label(found["clock_speed"]), fitted, where


_READING = (
    "Latency is that of all messages of the profile's frozen model, requests, replies and callbacks, times the factor; "
    "what frames, ticks and timers cost stays as it is. At ×0 these alone are left. The policy is one and the same in "
    "all cells, and so are the lanes: the map says what a policy that was trained without latency stands, and a "
    "training under latency may do better or worse."
)
