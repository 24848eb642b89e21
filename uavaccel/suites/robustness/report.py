"""The map's report: summary.json, figures/map.png, report.md and report.html, and where success collapses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table
from uavaccel.draw.style import clock_label, command_name
from uavaccel.draw.success_map import Success, draw_success_maps
from uavaccel.metrics.intervals import wilson_interval
from uavaccel.rl.agents import DEFAULT
from uavaccel.suites.report import Report, Row, Summary

FIGURE = "figures/robustness_map.png"
FITTED = 1.0
COLLAPSED = 0.5  # of the success in real time with the latency as it was fitted
COLLAPSE_HEADER = (
    "command",
    "ClockSpeed",
    "success at the fitted latency",
    "falls below half of that in real time",
)

Cell = Mapping[str, Any]


class RobustnessReport(Report):
    """Of `uavaccel run robustness`."""

    def summarise(self) -> Summary:
        return summarise(self.config, self.rows)

    def title(self) -> str:
        return f"Success of {agent_name(self.config['agent'])} over latency and ClockSpeed"

    def headline(self) -> str:
        return headline(self.summary)

    def overview(self) -> Table:
        return Table(header(self.summary), table(self.summary))

    def figures(self) -> list[Picture]:
        lanes = max(row["games"] for row in self.rows)
        source = (
            f"modelled, profile {self.config['profile']} · {lanes} lanes each · seed {self.config['seed']}"
        )
        drawn = maps(self.summary["cells"])
        path = draw_success_maps(drawn, FITTED, self.title(), self.run.file(FIGURE), source)
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


def summarise(config: Mapping[str, Any], rows: Sequence[Row]) -> dict[str, Any]:
    """Every cell with its interval, and for each command and ClockSpeed between which latencies it collapses."""
    cells = []
    for row in rows:
        low, high = wilson_interval(row["successes"], row["games"])
        kept = ("command", "clock_speed", "latency_scale", "games", "successes", "distance_m_median")
        cells.append(
            {
                **{name: row[name] for name in kept},
                "success_ratio": row["successes"] / row["games"],
                "wilson_low": low,
                "wilson_high": high,
            }
        )
    pairs = sorted({(cell["command"], cell["clock_speed"]) for cell in cells})
    return {
        "suite": "robustness",
        "agent": config["agent"],
        "profile": config["profile"],
        "seed": config["seed"],
        "cells": cells,
        "collapses": [collapse(cells, *pair) for pair in pairs],
    }


def collapse(cells: Sequence[Cell], command: str, clock_speed: float) -> dict[str, Any]:
    """Between which latencies success falls below half of the command's own in real time at the fitted latency.

    `above` is the largest latency below which it never does, `below` the next that was flown; None where there is
    none. Without the cell in real time both are None.
    """
    line = {
        cell["latency_scale"]: cell
        for cell in cells
        if (cell["command"], cell["clock_speed"]) == (command, clock_speed)
    }
    real_time = next(
        (
            cell
            for cell in cells
            if (cell["command"], cell["clock_speed"], cell["latency_scale"]) == (command, 1.0, FITTED)
        ),
        None,
    )
    found: dict[str, Any] = {"above": None, "below": None}
    if real_time is not None:
        for scale in sorted(line):
            if line[scale]["success_ratio"] < COLLAPSED * real_time["success_ratio"]:
                found["below"] = scale
                break
            found["above"] = scale
    fitted = line.get(FITTED)
    return {
        "command": command,
        "clock_speed": clock_speed,
        "fitted": None if fitted is None else fitted["success_ratio"],
        "real_time": None if real_time is None else real_time["success_ratio"],
        **found,
    }


def maps(cells: Sequence[Cell]) -> dict[str, dict[tuple[float, float], Success]]:
    """The cells as the figure takes them, ADSC first."""
    found: dict[str, dict[tuple[float, float], Success]] = {}
    for cell in sorted(cells, key=lambda cell: str(cell["command"])):
        panel = found.setdefault(command_name(cell["command"]), {})
        panel[cell["latency_scale"], cell["clock_speed"]] = Success(
            cell["success_ratio"], cell["wilson_low"], cell["wilson_high"]
        )
    return found


def agent_name(agent: str) -> str:
    """An agent in a sentence."""
    return "the policy that ships" if agent == DEFAULT else agent


def headline(summary: Mapping[str, Any]) -> str:
    """How much was flown, by whom."""
    games, points = sum(cell["games"] for cell in summary["cells"]), len(summary["cells"])
    return (
        f"{agent_name(summary['agent'])} in {games} games over {points} points of latency and ClockSpeed, all of it "
        f"modelled under {summary['profile']}"
    )


def header(summary: Mapping[str, Any]) -> tuple[str, ...]:
    return ("command", "latency", *(clock_label(clock) for clock in _clocks(summary)))


def table(summary: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """A line for each command and latency, below `header`."""
    cells = {(cell["command"], cell["latency_scale"], cell["clock_speed"]): cell for cell in summary["cells"]}
    lines = []
    for command, scale in sorted({key[:2] for key in cells}):
        line = [cells.get((command, scale, clock)) for clock in _clocks(summary)]
        lines.append(
            (command_name(command), f"×{scale:g}", *("-" if each is None else _text(each) for each in line))
        )
    return lines


def _clocks(summary: Mapping[str, Any]) -> list[float]:
    return sorted({cell["clock_speed"] for cell in summary["cells"]})


def _text(cell: Cell) -> str:
    return f"{cell['success_ratio']:.0%} [{100 * cell['wilson_low']:.0f}, {100 * cell['wilson_high']:.0f}]"


def _collapse_line(found: Mapping[str, Any]) -> tuple[str, ...]:
    above, below = found["above"], found["below"]
    if found["real_time"] is None:
        where = "- (1x at the fitted latency was not flown)"
    elif below is None:
        where = f"nowhere up to ×{above:g}"
    else:
        where = f"at ×{below:g} or less" if above is None else f"between ×{above:g} and ×{below:g}"
    fitted = "-" if found["fitted"] is None else f"{found['fitted']:.1%}"
    return command_name(found["command"]), clock_label(found["clock_speed"]), fitted, where


_READING = (
    "Latency is that of all messages of the profile's frozen model, requests, replies and callbacks, times the factor; "
    "what frames, ticks and timers cost stays as it is. At ×0 these alone are left. The policy is one and the same in "
    "all cells, and so are the lanes: the map says what a policy that was trained without latency stands, and a "
    "training under latency may do better or worse."
)
