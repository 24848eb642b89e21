"""DP2's table: a line per command and ClockSpeed, for the terminal and the report."""

from __future__ import annotations

from uavaccel.draw.document import Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.suites.report import Summary, SummaryCell


def table(summary: Summary) -> Table:
    """A row for each command and ClockSpeed; what cannot be known is "-"."""
    return Table.of(
        summary["cells"],
        ("command", lambda cell: command_name(cell["command"])),
        ("ClockSpeed", lambda cell: clock_label(cell["clock_speed"]) + _role(cell)),
        ("images", lambda cell: str(cell["paired_images"])),
        ("position error, m: median, max", lambda cell: _pair(cell, "position_error_m", 3)),
        ("attitude error, deg: max", lambda cell: _number(cell["attitude_error_deg_max"], 2)),
        ("DVS-ED, %: median, max", lambda cell: _pair(cell, "dvs_ed_percent", 2)),
        ("guard retries", lambda cell: str(cell["guard_retries"])),
        ("poses, counts v. lockstep", _against_lockstep),
        ("distance, m", lambda cell: f"{cell['distance_m']:.1f}" + _end(cell)),
        ("simulated s a wall s", lambda cell: _number(cell["simulated_s_per_wall_s"], 2)),
        ("source", lambda cell: str(cell["provenance"])),
    )


def _role(cell: SummaryCell) -> str:
    reference = " (reference)" if cell["reference"] and cell["reference"]["is_this_cell"] else ""
    return reference + (" (disturbed)" if cell.get("disturbed") else "")


def _end(cell: SummaryCell) -> str:
    return f" (hit {cell['collision']['object']})" if cell["collision"] else ""


def _against_lockstep(cell: SummaryCell) -> str:
    compared = (cell[key] for key in ("poses_equal_lockstep", "dvs_counts_equal_lockstep"))
    return ", ".join(or_dash(equal, {True: "equal", False: "differ"}.__getitem__) for equal in compared)


def _pair(cell: SummaryCell, name: str, digits: int) -> str:
    return ", ".join(_number(cell[f"{name}_{which}"], digits) for which in ("median", "max"))


def _number(value: float | None, digits: int) -> str:
    """An exact 0 is a claim, so it is not written 0.000; what is smaller than the digits show is not 0."""

    def form(known: float) -> str:
        if known == 0:
            return "0"
        return f"{known:.{digits}f}" if known >= 10.0**-digits else f"{known:.0e}"

    return or_dash(value, form)
