"""DP1's five figures: which games of a run each one shows, and where their numbers come from."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uavaccel.draw import style
from uavaccel.draw.accuracy import draw_accuracy
from uavaccel.draw.document import Picture
from uavaccel.draw.speedup import SpeedupCurve, draw_speedup
from uavaccel.draw.trajectories import TrajectoryLine, draw_trajectories
from uavaccel.draw.trellis import Trace, draw_trellis
from uavaccel.draw.velocity import VelocityPanel, draw_velocity
from uavaccel.errors import UserError
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.metrics.trajectory import command_gaps_s
from uavaccel.suites.disturbed import disturbed_words
from uavaccel.suites.dp1.scores import CellScores, LoadArrays
from uavaccel.suites.report import Row

_CLOCK = {"wall": "wall clock", "virtual": "virtual clock", "lockstep": "no latency"}
FIGURE3_ROUNDS = 4  # enough laps to drift, few enough to tell them apart


def source_line(rows: Sequence[Row]) -> str:
    """Which clock the games' numbers come from, how many games there are, profile and seed."""
    counts = Counter(row["timing"] for row in rows)
    games = [
        f"{timing_provenance(timing)} ({_CLOCK[timing]}): {count} game{'s' if count > 1 else ''}"
        for timing, count in sorted(counts.items())
    ]
    return " · ".join([*games, *_conditions(rows), *disturbed_words(rows)])


def velocity_figure(rows: Sequence[Row], load_arrays: LoadArrays, path: Path) -> Picture:
    """Figure 2 from the games of role "figure2": two steps forward and one back, slowest ClockSpeed on top."""
    flown = [row for row in rows if row["role"] == "figure2" and row.get("error") is None]
    flown.sort(key=lambda row: row["clock_speed"])
    source = source_line(flown)
    panels = [_velocity_panel(row, load_arrays(row)) for row in flown]
    draw_velocity(panels, path, source, "Two steps forward, one back")
    return Picture(
        path,
        "Figure 2. Velocity over simulated time, two steps forward and one back, in real time and at the "
        "run's highest ClockSpeed. Dashed: a command ends. Grey: no command runs, the drone flies on while "
        f"the client reacts. Source: {source}.",
    )


def trajectory_figure(scores: Sequence[CellScores], load_arrays: LoadArrays, path: Path) -> Picture:
    """Figure 3 from the fastest ADSC cell of the longest T_move: best and worst replica by STLC."""
    score = _fastest_cell(scores, FIGURE3_ROUNDS)
    flights = [] if score is None else _compared_flights(score)
    lines = [TrajectoryLine(label, load_arrays(row)["position_m"]) for row, label in flights]
    source = source_line([row for row, _ in flights])
    title = "Trajectories" if score is None else f"Trajectories, {_path_label(score)}"
    draw_trajectories(lines, path, source, title)
    return Picture(
        path,
        "Figure 3. A real-time trajectory, and the best and the worst replica of the fastest cell by STLC. "
        f"Height is up, −z of the NED frame. Source: {source}.",
    )


def trellis_figure(run_dir: Path, rows: Sequence[Row], path: Path) -> Picture:
    """Figure 4 from the traces that the run recorded, if it did."""
    traces = _traces(run_dir)
    timings = sorted({row["timing"] for row in rows if row["role"] == "game"})
    clocks = [f"{timing_provenance(timing)} ({_CLOCK[timing]})" for timing in timings]
    source = " · ".join(["one recorded command each", *clocks, *_conditions(rows)])
    draw_trellis(traces, path, source)
    return Picture(
        path,
        "Figure 4. Messages of one command between client and server, from a recorded trace; not to scale. "
        "Thick: simulated time runs. Left of the client's line wall time, right of the server's simulated "
        f"time, both since the first event. Source: {source}.",
    )


def accuracy_figure(scores: Sequence[CellScores], path: Path) -> Picture:
    """Figure 5 from all games, T_moves pooled."""
    boxes: dict[tuple[str, float, int], list[float]] = defaultdict(list)
    for score in scores:
        key = score.cell.key
        known = score.stlc[np.isfinite(score.stlc)]
        boxes[key.command, key.clock_speed, key.rounds] += known.tolist()
    source = source_line(_rows(scores))
    draw_accuracy(boxes, path, source)
    return Picture(
        path,
        "Figure 5. STLC against the real-time ADSC games; one value a game, its mean over the references, "
        "T_moves pooled; line: 1.8. Replicas whose flights are identical make a box of zero width, drawn as "
        f"it is. Source: {source}.",
    )


def speedup_figure(scores: Sequence[CellScores], summary: Mapping[str, Any], path: Path) -> Picture:
    """Figure 6 from the cells with most rounds."""
    rounds = max((cell["rounds"] for cell in summary["cells"]), default=0)
    curves: dict[tuple[str, float], list[Mapping[str, Any]]] = defaultdict(list)
    for cell in summary["cells"]:
        if cell["rounds"] == rounds and cell["effective_speedup"] is not None:
            curves[cell["command"], cell["t_move_s"]].append(cell)
    source = source_line(_rows([score for score in scores if score.cell.key.rounds == rounds]))
    draw_speedup([_curve(*key, cells) for key, cells in sorted(curves.items())], path, source, rounds)
    return Picture(
        path,
        f"Figure 6. Effective speed-up of games of {style.rounds_label(rounds)}: mean wall time of ADSC at 1x over the "
        f"cell's, with 95 % bootstrap intervals over games. Dashed: the ideal. Source: {source}.",
    )


def _conditions(rows: Sequence[Row]) -> list[str]:
    return sorted({f"{row['profile']} profile" for row in rows} | {f"seed {row['seed']}" for row in rows})


def _rows(scores: Sequence[CellScores]) -> list[Row]:
    return [row for score in scores for row in score.cell.rows]


def _fastest_cell(scores: Sequence[CellScores], rounds: int) -> CellScores | None:
    """The fastest cell with games, ADSC before TCSC, of the longest T_move and rounds nearest `rounds`."""
    flown = [score for score in scores if score.cell.rows]
    if not flown:
        return None

    def preference(score: CellScores) -> tuple[bool, bool, float, float, int]:
        key = score.cell.key
        accelerated = key.clock_speed > 1
        return accelerated, key.command == "adsc", key.clock_speed, key.t_move_s, -abs(key.rounds - rounds)

    return max(flown, key=preference)


def _velocity_panel(row: Row, arrays: Mapping[str, np.ndarray]) -> VelocityPanel:
    start_s, end_s = arrays["command_start_s"], arrays["command_end_s"]
    gap_ms = float(np.mean(command_gaps_s(start_s, end_s))) * 1e3
    return VelocityPanel(
        f"{_flown_by(row)}: {gap_ms:.1f} ms between commands",
        arrays["time_s"],
        arrays["linear_velocity_m_s"],
        start_s,
        end_s,
    )


def _compared_flights(score: CellScores) -> list[tuple[Row, str]]:
    """A reference, then the replicas of highest and lowest STLC, each with its label."""
    cell = score.cell
    flights = [(row, f"{_flown_by(row)}: reference") for row in cell.reference_rows[:1]]
    if cell.is_reference:
        return flights
    best_first = np.argsort(-np.nan_to_num(score.stlc), kind="stable").tolist()
    if score.distinct_games == 1:
        ranks = {0: f"all {len(cell.rows)} identical" if len(cell.rows) > 1 else "one game"}
    else:
        ranks = {best_first[0]: "best", best_first[-1]: "worst"}
    return flights + [
        (cell.rows[i], f"{_flown_by(cell.rows[i])}, {rank}: {_stlc_text(score.stlc[i])}")
        for i, rank in ranks.items()
    ]


def _flown_by(row: Row) -> str:
    return f"{style.command_name(row['command'])} at {style.clock_label(row['clock_speed'])}"


def _stlc_text(stlc: float) -> str:
    return f"STLC {stlc:.3f}" if np.isfinite(stlc) else "STLC unknown"


def _path_label(score: CellScores) -> str:
    key = score.cell.key
    return f"{style.rounds_label(key.rounds)}, T_move {key.t_move_s:g} s"


def _curve(command: str, t_move_s: float, cells: Sequence[Mapping[str, Any]]) -> SpeedupCurve:
    cells = sorted(cells, key=lambda cell: cell["clock_speed"])
    speedup = [cell["effective_speedup"] for cell in cells]
    interval = [cell["effective_speedup_interval"] or [cell["effective_speedup"]] * 2 for cell in cells]
    low, high = np.array(interval, dtype=float).T
    clocks = np.array([cell["clock_speed"] for cell in cells])
    return SpeedupCurve(command, t_move_s, clocks, np.array(speedup), low, high)


def _traces(run_dir: Path) -> dict[str, Trace]:
    """The recorded traces, by what stands above them: TCSC first, as in the paper."""
    found: dict[str, Trace] = {}
    for command in ("tcsc", "adsc"):
        path = run_dir / "traces" / f"{command}.json"
        if not path.is_file():
            continue
        try:
            found[style.command_name(command)] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise UserError(f"{path}: not JSON: {error}") from error
    return found
