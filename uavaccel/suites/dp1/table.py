"""DP1's tables: a line per cell for the terminal and the report, and an overview of the worst cells."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from uavaccel.draw.document import or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.suites.report import Summary, SummaryCell

HEADER = (
    "command",
    "clock",
    "T_move s",
    "rounds",
    "games",
    "STLC median [q25, q75]",
    "RMSE m",
    "v. lockstep",
    "duration s",
    "speed-up",
    "achieved",
    "source",
)

OVERVIEW_HEADER = (
    "command",
    "ClockSpeed",
    "games",
    "lowest STLC median",
    "largest RMSE v. reference, m",
    "largest RMSE v. lockstep, m",
    "effective speed-up",
    "real-time factor",
    "source",
)


def table(summary: Summary) -> list[tuple[str, ...]]:
    """One row of text a cell, below `HEADER`; what cannot be known is "-"."""
    return [_line(cell) for cell in summary["cells"]]


def overview(summary: Summary) -> list[tuple[str, ...]]:
    """One row of text a command, ClockSpeed and timing, below `OVERVIEW_HEADER`."""
    groups: dict[tuple[str, float, str], list[SummaryCell]] = {}
    for cell in summary["cells"]:
        groups.setdefault((cell["command"], cell["clock_speed"], cell["timing"]), []).append(cell)
    return [_overview_line(cells) for cells in groups.values()]


def _line(cell: SummaryCell) -> tuple[str, ...]:
    failed = f" ({cell['failed_games']} failed)" if cell["failed_games"] else ""
    failed += _disturbed([cell])
    return (
        command_name(cell["command"]),
        clock_label(cell["clock_speed"]),
        f"{cell['t_move_s']:g}",
        str(cell["rounds"]),
        f"{cell['games']}{failed}",
        or_dash(cell["stlc_median"], lambda m: f"{m:.3f} [{cell['stlc_q25']:.3f}, {cell['stlc_q75']:.3f}]"),
        or_dash(cell["position_rmse_m"], _metres),
        or_dash(cell["position_rmse_vs_lockstep_m"], _metres),
        or_dash(cell["duration_error_s"], "{:+.3f}".format).replace("-0.000", "+0.000"),
        or_dash(cell["effective_speedup"], "{:.2f}".format) + _mixed(cell),
        or_dash(cell["real_time_factor"], "{:.2f}".format),
        cell["provenance"],
    )


def _overview_line(cells: Sequence[SummaryCell]) -> tuple[str, ...]:
    first = cells[0]
    return (
        command_name(first["command"]),
        clock_label(first["clock_speed"]),
        str(sum(cell["games"] for cell in cells)) + _disturbed(cells),
        or_dash(_extreme(min, cells, "stlc_median"), "{:.4f}".format),
        or_dash(_extreme(max, cells, "position_rmse_m"), _metres),
        or_dash(_extreme(max, cells, "position_rmse_vs_lockstep_m"), _metres),
        _range(cells, "effective_speedup") + _mixed(first),
        _range(cells, "real_time_factor"),
        first["provenance"],
    )


def _disturbed(cells: Sequence[SummaryCell]) -> str:
    """Marks games that lost wall time, or whose server stalled or was started again."""
    count = sum(cell.get("disturbed_games", 0) for cell in cells)
    return f" ({count} disturbed)" if count else ""


def _mixed(cell: SummaryCell) -> str:
    """Marks a speed-up of which one wall time is measured and the other modelled."""
    return " (mixed)" if cell["effective_speedup_provenance"] == "mixed" else ""


def _extreme(
    choose: Callable[[Iterable[float]], float], cells: Sequence[SummaryCell], key: str
) -> float | None:
    values = [cell[key] for cell in cells if cell[key] is not None]
    return choose(values) if values else None


def _range(cells: Sequence[SummaryCell], key: str) -> str:
    low, high = (or_dash(_extreme(choose, cells, key), "{:.2f}".format) for choose in (min, max))
    return low if low == high else f"{low} to {high}"


def _metres(value: float) -> str:
    """Three significant digits: errors reach from micrometres to metres, and an exact 0 is a claim."""
    if value == 0:
        return "0"
    return f"{value:.3f}" if value >= 0.01 else f"{value:.1e}"
