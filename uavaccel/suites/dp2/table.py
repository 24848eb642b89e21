"""DP2's table: a line per command and ClockSpeed, for the terminal and the report."""

from __future__ import annotations

from uavaccel.draw.document import or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.suites.report import Summary, SummaryCell

HEADER = (
    "command",
    "ClockSpeed",
    "images",
    "position error, m: median, max",
    "attitude error, deg: max",
    "DVS-ED, %: median, max",
    "guard retries",
    "poses, counts v. lockstep",
    "distance, m",
    "simulated s a wall s",
    "source",
)


def table(summary: Summary) -> list[tuple[str, ...]]:
    """One row of text a cell, below `HEADER`; what cannot be known is "-"."""
    return [_line(cell) for cell in summary["cells"]]


def _line(cell: SummaryCell) -> tuple[str, ...]:
    return (
        command_name(cell["command"]),
        clock_label(cell["clock_speed"]) + _role(cell),
        str(cell["paired_images"]),
        _pair(cell, "position_error_m", 3),
        _number(cell["attitude_error_deg_max"], 2),
        _pair(cell, "dvs_ed_percent", 2),
        str(cell["guard_retries"]),
        ", ".join(
            or_dash(cell[key], _equality) for key in ("poses_equal_lockstep", "dvs_counts_equal_lockstep")
        ),
        f"{cell['distance_m']:.1f}" + _end(cell),
        _number(cell["simulated_s_per_wall_s"], 2),
        cell["provenance"],
    )


def _role(cell: SummaryCell) -> str:
    reference = " (reference)" if cell["reference"] and cell["reference"]["is_this_cell"] else ""
    return reference + (" (disturbed)" if cell.get("disturbed") else "")


def _end(cell: SummaryCell) -> str:
    return f" (hit {cell['collision']['object']})" if cell["collision"] else ""


def _equality(equal: bool) -> str:
    return "equal" if equal else "differ"


def _pair(cell: SummaryCell, name: str, digits: int) -> str:
    return ", ".join(_number(cell[f"{name}_{which}"], digits) for which in ("median", "max"))


def _number(value: float | None, digits: int) -> str:
    """An exact 0 is a claim, so it is not written 0.000; what is smaller than the digits show is not 0."""

    def form(known: float) -> str:
        if known == 0:
            return "0"
        return f"{known:.{digits}f}" if known >= 10.0**-digits else f"{known:.0e}"

    return or_dash(value, form)
