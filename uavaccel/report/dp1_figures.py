"""DP1's five figures: which games of a run each one shows, and where their numbers come from."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uavaccel.errors import UserError
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.report.document import Picture
from uavaccel.report.dp1_scores import CellScores, LoadArrays, Row
from uavaccel.report.figure2_velocity import VelocityPanel, draw_velocity
from uavaccel.report.figure3_trajectories import TrajectoryLine, draw_trajectories
from uavaccel.report.figure4_trellis import Trace, draw_trellis
from uavaccel.report.figure5_accuracy import draw_accuracy
from uavaccel.report.figure6_speedup import SpeedupCurve, draw_speedup
from uavaccel.report.style import clock_label, command_name

FIGURE3_ROUNDS = 4  # enough laps to drift, few enough to tell them apart


def source_line(rows: Sequence[Row]) -> str:
    """Which clock the games' numbers come from, how many games there are, profile and seed."""
    counts = Counter(row["timing"] for row in rows)
    games = [
        f"{timing_provenance(timing)} ({timing} clock): {count} game{'s' if count > 1 else ''}"
        for timing, count in sorted(counts.items())
    ]
    conditions = {f"{row['profile']} profile" for row in rows} | {f"seed {row['seed']}" for row in rows}
    return " · ".join([*games, *sorted(conditions)])


def velocity_figure(scores: Sequence[CellScores], load_arrays: LoadArrays, path: Path) -> Picture:
    """Figure 2 from the shortest path of the longest T_move: the reference over the fastest ADSC."""
    rows = [row for row in (_reference_row(scores), _fastest_row(scores)) if row is not None]
    draw_velocity([_velocity_panel(row, load_arrays(row)) for row in rows], path, source_line(rows))
    return Picture(
        path,
        "Figure 2. Velocity over simulated time in real time and in the fastest run, one game each. Dashed: "
        "a command ends. Grey: no command runs, the drone flies on while the client reacts. "
        f"{source_line(rows)}.",
    )


def trajectory_figure(scores: Sequence[CellScores], load_arrays: LoadArrays, path: Path) -> Picture:
    """Figure 3 from the fastest ADSC cell of the longest T_move: best and worst replica by STLC."""
    score = _fastest_cell(scores, FIGURE3_ROUNDS)
    rows = [] if score is None else _best_and_worst(score)
    lines = [
        TrajectoryLine(_trajectory_label(row, stlc), load_arrays(row)["position_m"]) for row, stlc in rows
    ]
    source = source_line([row for row, _ in rows])
    draw_trajectories(lines, path, source, "" if score is None else _path_label(score))
    return Picture(
        path,
        "Figure 3. A real-time trajectory, and the best and the worst replica of the fastest cell by STLC. "
        f"Height is up, −z of the NED frame. {source}.",
    )


def trellis_figure(run_dir: Path, rows: Sequence[Row], path: Path) -> Picture:
    """Figure 4 from the traces that the run recorded, if it did."""
    traces = _traces(run_dir)
    profiles = sorted({str(row["profile"]) for row in rows})
    source = f"one recorded command each · {', '.join(profiles)} profile"
    draw_trellis(traces, path, source)
    return Picture(
        path,
        "Figure 4. Messages of one command between client and server, from a recorded trace; not to scale. "
        "Thick: simulated time runs. Left of the client's line wall time, right of the server's simulated "
        "time, both since the first event.",
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
        f"it is. {source}.",
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
        f"Figure 6. Effective speed-up of games of {rounds} rounds: mean wall time of ADSC at 1x over the "
        f"cell's, with 95 % bootstrap intervals over games. Dashed: the ideal. {source}.",
    )


def _rows(scores: Sequence[CellScores]) -> list[Row]:
    return [row for score in scores for row in score.cell.rows]


def _reference_row(scores: Sequence[CellScores]) -> Row | None:
    fastest = _fastest_cell(scores, 0)
    rows = () if fastest is None else fastest.cell.reference_rows
    return rows[0] if rows else None


def _fastest_row(scores: Sequence[CellScores]) -> Row | None:
    fastest = _fastest_cell(scores, 0)
    return None if fastest is None or fastest.cell.is_reference else fastest.cell.rows[0]


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
    return VelocityPanel(
        f"{command_name(row['command'])} at {clock_label(row['clock_speed'])}, T_move {row['t_move_s']:g} s",
        arrays["time_s"],
        arrays["linear_velocity_m_s"],
        arrays["command_start_s"],
        arrays["command_end_s"],
    )


def _best_and_worst(score: CellScores) -> list[tuple[Row, float | None]]:
    """A reference, then the replicas of highest and lowest STLC; one replica only once."""
    chosen: list[tuple[Row, float | None]] = [(row, None) for row in score.cell.reference_rows[:1]]
    order = [] if score.cell.is_reference else np.argsort(-np.nan_to_num(score.stlc), kind="stable").tolist()
    replicas = dict.fromkeys([*order[:1], *order[-1:]])
    return chosen + [(score.cell.rows[i], float(score.stlc[i])) for i in replicas]


def _trajectory_label(row: Row, stlc: float | None) -> str:
    name = f"{command_name(row['command'])} at {clock_label(row['clock_speed'])}"
    if stlc is None:
        return f"{name}: reference"
    return (
        f"{name}, game {row['game']}: STLC {stlc:.3f}" if np.isfinite(stlc) else f"{name}, game {row['game']}"
    )


def _path_label(score: CellScores) -> str:
    key = score.cell.key
    return f"{key.rounds} round{'s' if key.rounds > 1 else ''}, T_move {key.t_move_s:g} s"


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
            found[command_name(command)] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise UserError(f"{path}: not JSON: {error}") from error
    return found
