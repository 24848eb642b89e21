"""Where acceleration breaks a policy: success in real time over the gap between two commands of the training."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

from uavaccel.draw.style import command_name
from uavaccel.suites.old_report import SummaryCell
from uavaccel.suites.rows import grouped

THINKING = re.compile(r"_?think_\d+ms$")  # suffix of variants that differ in the duration of a decision alone
LEAST_GAPS = 3  # that a run needs for a figure
LEAST_CELLS = 3  # that a line needs
COLLAPSED = 0.5  # share of the best success on the lane


class GapLine(NamedTuple):
    """The cells of one command on one lane, of all ClockSpeeds and durations of a decision, by rising gap."""

    command: str
    lane: str
    """Profile, and variant without the duration of a decision."""
    cells: list[SummaryCell]

    @property
    def label(self) -> str:
        return f"{command_name(self.command)}, {self.lane}"


def over_gaps(pooled: Sequence[SummaryCell]) -> list[GapLine]:
    """Return a line per command and lane with three cells or more; none where a run has fewer than three gaps."""
    virtual = [cell for cell in pooled if cell["timing"] == "virtual"]
    if len({cell["gap_s"] for cell in virtual}) < LEAST_GAPS:
        return []
    by_gap = sorted(virtual, key=itemgetter("gap_s", "clock_speed"))
    lines = grouped(by_gap, lambda cell: (lane_of(cell), cell["command"]))
    return [
        GapLine(command, lane, cells)
        for (lane, command), cells in sorted(lines.items())
        if len(cells) >= LEAST_CELLS
    ]


def lane_of(cell: SummaryCell) -> str:
    """Return profile and lane of a cell: "airsim, hard" of the variant hard_think_100ms."""
    variant = THINKING.sub("", cell["variant"]).replace("_", " ")
    return f"{cell['profile']}, {variant}" if variant else str(cell["profile"])


def collapse(lines: Sequence[GapLine]) -> str:
    """Return in words from which gap on success stays below half of the lane's best."""
    best: dict[str, float] = defaultdict(float)
    for line in lines:
        best[line.lane] = max(best[line.lane], *(cell["success_ratio"] for cell in line.cells))
    shown = [line for line in lines if len({cell["gap_s"] for cell in line.cells}) >= LEAST_GAPS]
    return " ".join(f"{line.label}: {_from(line.cells, best[line.lane])}." for line in shown)


def _from(cells: Sequence[SummaryCell], best: float) -> str:
    """Return in words the smallest gap from which success stays below half of `best`, of cells by rising gap."""
    half = f"half of the best cell's {best:.1%}"
    above = [cell["gap_s"] for cell in cells if cell["success_ratio"] >= COLLAPSED * best]
    below = [cell["gap_s"] for cell in cells if not above or cell["gap_s"] > above[-1]]
    if below:
        return f"success in real time stays below {half} from a gap of {below[0]:.2f} simulated seconds on"
    longest_s = cells[-1]["gap_s"]
    return f"no gap was flown, up to {longest_s:.2f} s, from which success in real time stays below {half}"
