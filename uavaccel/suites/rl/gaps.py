"""Where acceleration breaks a policy: success in real time over the gap between two commands of the training."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from uavaccel.draw.style import command_name
from uavaccel.suites.report import SummaryCell

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
    lines: dict[tuple[str, str], list[SummaryCell]] = {}
    for cell in sorted(virtual, key=lambda cell: (cell["gap_s"], cell["clock_speed"])):
        lines.setdefault((lane_of(cell), cell["command"]), []).append(cell)
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
    sentences = []
    for line in lines:
        if len({cell["gap_s"] for cell in line.cells}) >= LEAST_GAPS:
            best = max(
                cell["success_ratio"] for each in lines if each.lane == line.lane for cell in each.cells
            )
            sentences.append(f"{line.label}: {_from(line.cells, best)}.")
    return " ".join(sentences)


def collapse_gap_s(cells: Sequence[SummaryCell], best: float) -> float | None:
    """Return the smallest gap from which success stays below half of `best`, of cells by rising gap, if any."""
    above = [cell["gap_s"] for cell in cells if cell["success_ratio"] >= COLLAPSED * best]
    below = [cell["gap_s"] for cell in cells if not above or cell["gap_s"] > above[-1]]
    return min(below, default=None)


def _from(cells: Sequence[SummaryCell], best: float) -> str:
    gap_s, half = collapse_gap_s(cells, best), f"half of the best cell's {best:.1%}"
    if gap_s is None:
        longest_s = cells[-1]["gap_s"]
        return (
            f"no gap was flown, up to {longest_s:.2f} s, from which success in real time stays below {half}"
        )
    return f"success in real time stays below {half} from a gap of {gap_s:.2f} simulated seconds on"
