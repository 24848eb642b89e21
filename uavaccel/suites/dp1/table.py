"""DP1's tables: a line per cell for the terminal and the report, and an overview of the worst cells."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from uavaccel.draw.document import Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.suites.report import Summary, SummaryCell


def table(summary: Summary) -> Table:
    """A row for each cell; what cannot be known is "-"."""
    return Table.of(
        summary["cells"],
        ("command", lambda cell: command_name(cell["command"])),
        ("clock", lambda cell: clock_label(cell["clock_speed"])),
        ("T_move s", lambda cell: f"{cell['t_move_s']:g}"),
        ("rounds", lambda cell: str(cell["rounds"])),
        ("games", lambda cell: f"{cell['games']}{_failed(cell)}{_disturbed([cell])}"),
        ("STLC median [q25, q75]", _stlc),
        ("RMSE m", lambda cell: or_dash(cell["position_rmse_m"], _metres)),
        ("v. lockstep", lambda cell: or_dash(cell["position_rmse_vs_lockstep_m"], _metres)),
        ("duration s", lambda cell: or_dash(cell["duration_error_s"], _seconds)),
        ("speed-up", lambda cell: or_dash(cell["effective_speedup"], "{:.2f}".format) + _mixed(cell)),
        ("achieved", lambda cell: or_dash(cell["real_time_factor"], "{:.2f}".format)),
        ("source", lambda cell: str(cell["provenance"])),
        folded=f"{len(summary['cells'])} cells",
    )


def overview(summary: Summary) -> Table:
    """A row for each command, ClockSpeed and timing: its worst cell, and the range of its speeds."""
    groups: dict[tuple[str, float, str], list[SummaryCell]] = {}
    for cell in summary["cells"]:
        groups.setdefault((cell["command"], cell["clock_speed"], cell["timing"]), []).append(cell)
    worst_m = "position_rmse_m", "position_rmse_vs_lockstep_m"
    return Table.of(
        list(groups.values()),
        ("command", lambda cells: command_name(cells[0]["command"])),
        ("ClockSpeed", lambda cells: clock_label(cells[0]["clock_speed"])),
        ("games", lambda cells: str(sum(cell["games"] for cell in cells)) + _disturbed(cells)),
        ("lowest STLC median", lambda cells: or_dash(_extreme(min, cells, "stlc_median"), "{:.4f}".format)),
        ("largest RMSE v. reference, m", lambda cells: or_dash(_extreme(max, cells, worst_m[0]), _metres)),
        ("largest RMSE v. lockstep, m", lambda cells: or_dash(_extreme(max, cells, worst_m[1]), _metres)),
        ("effective speed-up", lambda cells: _range(cells, "effective_speedup") + _mixed(cells[0])),
        ("real-time factor", lambda cells: _range(cells, "real_time_factor")),
        ("source", lambda cells: str(cells[0]["provenance"])),
    )


def _failed(cell: SummaryCell) -> str:
    return f" ({cell['failed_games']} failed)" if cell["failed_games"] else ""


def _stlc(cell: SummaryCell) -> str:
    return or_dash(cell["stlc_median"], lambda m: f"{m:.3f} [{cell['stlc_q25']:.3f}, {cell['stlc_q75']:.3f}]")


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


def _seconds(error_s: float) -> str:
    return f"{error_s:+.3f}".replace("-0.000", "+0.000")


def _metres(value: float) -> str:
    """Three significant digits: errors reach from micrometres to metres, and an exact 0 is a claim."""
    if value == 0:
        return "0"
    return f"{value:.3f}" if value >= 0.01 else f"{value:.1e}"
