"""DP1's written report, and which games and numbers each of its figures takes from a run."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.dp1_games import Arrays, Row, cell_games, line_arrays, line_row, quantile, synthetic_games, write_run
from tests.drawing import boxes, headline, labelled, points, record_figures, texts
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.old_dp1.cell_figures import accuracy_figure, speedup_figure
from uavaccel.suites.old_dp1.flight_figures import trajectory_figure, velocity_figure
from uavaccel.suites.old_dp1.report import Dp1Report, table
from uavaccel.suites.old_dp1.scores import CellScores, cells_of, score_cells, summarise
from uavaccel.suites.old_dp1.trellis import trellis_figure
from uavaccel.suites.rows import disturbances

FIGURES = (
    "figure2_velocity",
    "figure3_trajectories",
    "figure4_trellis",
    "figure5_accuracy",
    "figure6_speedup",
)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    return record_figures(monkeypatch)


def scored(rows: list[Row]) -> list[CellScores]:
    return score_cells(cells_of(rows), line_arrays)


def accelerated_rows() -> list[Row]:
    """Two T_moves and two numbers of rounds; each path's games lie elsewhere beside its two references."""
    rows = []
    for path, (t_move_s, rounds) in enumerate([(0.5, 1), (0.5, 24), (1.0, 1), (1.0, 24)]):
        keys: dict[str, Any] = {"t_move_s": t_move_s, "rounds": rounds}
        rows += [line_row("reference", "adsc", 1.0, i, 0.0, **keys, wall_s=100.0 + path) for i in (0, 1)]
        for command, clock_speed in (("adsc", 10.0), ("tcsc", 10.0), ("adsc", 100.0)):
            for game in range(3):
                offset_m = 0.01 * (1 + path) * (game + 1) ** 2 * (1 if command == "adsc" else 3)
                wall_s = (100.0 + path) / clock_speed * (1.5 + game / 10)
                timing = "wall" if command == "tcsc" else "virtual"
                timed = {**keys, "wall_s": wall_s, "timing": timing}
                rows.append(line_row("game", command, clock_speed, game, offset_m, **timed))
    return rows


# --- which numbers a figure shows ---------------------------------------------------------------------------


def test_figure_2_shows_the_games_flown_for_it(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    keys = {"gaps_s": [0.01, 0.02, 0.06], "timing": "wall"}
    rows = [
        line_row("figure2", "adsc", 100.0, 1, 0.0, **keys),
        line_row("figure2", "adsc", 1.0, 0, 0.0),
        line_row("figure2", "adsc", 9.0, 2, 0.0, error="crashed"),
        line_row("game", "adsc", 7.0, 0, 0.0),
    ]

    def load(row: Mapping[str, Any]) -> Arrays:
        speed = np.full((81, 3), row["clock_speed"])
        return line_arrays(row) | {"linear_velocity_m_s": speed, "time_s": np.arange(81) * 0.05}

    picture = velocity_figure(rows, load, tmp_path / "two.png")
    slow, fast = drawn["two"].axes
    assert (slow.get_title("left"), fast.get_title("left")) == (
        "ADSC at 1x: 0.0 ms between commands",
        "ADSC at 100x: 30.0 ms between commands",
    )
    assert points(labelled(fast)["east"])[0] == (0.0, 100.0)
    assert [round(gap.get_width(), 9) for gap in fast.patches] == [0.01, 0.02, 0.06]  # type: ignore[attr-defined]
    source = "modelled (virtual clock): 1 game · measured (wall clock): 1 game · native profile · seed 0"
    assert headline(drawn["two"]) == ("Two steps forward, one back", source)
    assert picture.path == tmp_path / "two.png"
    assert picture.caption.startswith("Figure 2. ")
    assert picture.caption.endswith(f"Source: {source}.")


def test_figure_3_shows_the_best_and_the_worst_replica(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = accelerated_rows()
    picture = trajectory_figure(scored(rows), line_arrays, tmp_path / "three.png")
    lines = labelled(drawn["three"].axes[0])
    best, worst = (1 + np.exp(-0.03 * (game + 1) ** 2) for game in (0, 2))
    assert {name: round(line.get_data_3d()[1][0], 9) for name, line in lines.items()} == {
        "ADSC at 1x: reference": 0.0,
        f"ADSC at 100x, best: STLC {best:.3f}": 0.03,
        f"ADSC at 100x, worst: STLC {worst:.3f}": 0.27,
        f"TCSC at 10x, worst: STLC {1 + np.exp(-0.81):.3f}": 0.81,
    }
    source = "modelled (virtual clock): 3 games · measured (wall clock): 1 game · native profile · seed 0"
    assert headline(drawn["three"]) == ("Trajectories, 1 round, T_move 1 s", source)
    assert picture.caption.startswith("Figure 3. ")
    assert source in picture.caption


@pytest.mark.parametrize(
    ("shown", "others"),
    [
        (("ADSC", 2.0, 0.5, 24), [("TCSC", 100.0, 1.0, 4), ("ADSC", 1.0, 1.0, 4)]),
        (("ADSC", 50.0, 0.5, 24), [("ADSC", 10.0, 1.0, 4), ("ADSC", 20.0, 0.5, 4)]),
        (("ADSC", 50.0, 1.0, 24), [("ADSC", 50.0, 0.5, 4), ("ADSC", 50.0, 0.1, 24)]),
        (("ADSC", 50.0, 1.0, 2), [("ADSC", 50.0, 1.0, 1), ("ADSC", 50.0, 1.0, 24)]),
        (("TCSC", 5.0, 0.5, 2), [("ADSC", 1.0, 1.0, 4), ("TCSC", 2.0, 1.0, 4)]),
    ],
)
def test_figure_3_is_of_the_fastest_cell_of_adsc_then_of_the_longest_t_move_then_near_four_rounds(
    shown: Any, others: list[Any], tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """The run flew no other cells; a game that failed is none."""
    rows = [
        line_row("game", command.lower(), clock_speed, 0, 0.0, t_move_s=t_move_s, rounds=rounds)
        for command, clock_speed, t_move_s, rounds in (others[0], shown, others[1])
    ]
    rows.append(line_row("game", "adsc", 90.0, 0, 0.0, error="crashed"))
    trajectory_figure(scored(rows), line_arrays, tmp_path / "three.png")
    command, clock_speed, t_move_s, rounds = shown
    assert headline(drawn["three"])[0] == f"Trajectories, {rounds} rounds, T_move {t_move_s:g} s"
    assert f"{command} at {clock_speed:g}x, one game: STLC unknown" in labelled(drawn["three"].axes[0])


def test_figure_3_of_identical_lone_or_no_replicas(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    reference = line_row("reference", "adsc", 1.0, 0, 0.0)
    alike = [line_row("game", "tcsc", 50.0, game, 0.1) for game in range(3)]
    label = f"STLC {1 + np.exp(-0.1):.3f}"
    for rows, labels in (
        ([reference, *alike], ["ADSC at 1x: reference", f"TCSC at 50x, all 3 identical: {label}"]),
        ([reference, alike[0]], ["ADSC at 1x: reference", f"TCSC at 50x, one game: {label}"]),
        ([alike[0]], ["TCSC at 50x, one game: STLC unknown"]),
        ([reference], ["ADSC at 1x: reference"]),
        ([], []),
    ):
        trajectory_figure(scored(rows), line_arrays, tmp_path / "three.png")
        assert list(labelled(drawn["three"].axes[0])) == labels
    assert headline(drawn["three"])[0] == "Trajectories"


def test_figure_4_shows_the_recorded_traces(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    run_dir = write_run(tmp_path / "run", [])
    rows = [line_row("game", "tcsc", 50.0, 0, 0.0, timing="wall"), line_row("reference", "adsc", 1.0, 0, 0.0)]
    picture = trellis_figure(run_dir, rows, tmp_path / "four.png")
    assert [axes.get_title("left") for axes in drawn["four"].axes] == ["TCSC", "ADSC"]
    assert "1.000 s   end continue" in texts(drawn["four"].axes[0])
    source = "one recorded command each · measured (wall clock) · native profile · seed 0"
    assert headline(drawn["four"])[1] == source
    assert source in picture.caption
    (run_dir / "traces/tcsc.json").write_text("no JSON")
    with pytest.raises(UserError, match=r"tcsc\.json: not JSON"):
        trellis_figure(run_dir, rows, tmp_path / "four.png")


def test_figure_5_shows_stlc_with_t_moves_pooled(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = accelerated_rows()
    picture = accuracy_figure(scored(rows), tmp_path / "five.png")
    cells = {axes: boxes(axes) for axes in drawn["five"].axes}
    assert len(cells) == 2 * 3
    for axes, (command, factor, clock_speed) in zip(
        drawn["five"].axes[1:3] + drawn["five"].axes[4:5],
        [("adsc", 1, "10x"), ("adsc", 1, "100x"), ("tcsc", 3, "10x")],
        strict=True,
    ):
        for place, paths in enumerate([(0, 2), (1, 3)]):  # 1 round, 24 rounds: both T_moves each
            aside_m = [0.01 * (1 + path) * (game + 1) ** 2 * factor for path in paths for game in range(3)]
            stlc = (1 + np.exp(-np.array(aside_m))).tolist()
            assert cells[axes][place]["median"] == pytest.approx(quantile(stlc, 0.5)), (command, clock_speed)
            assert cells[axes][place]["box"] == pytest.approx((quantile(stlc, 0.25), quantile(stlc, 0.75)))
    source = "modelled (virtual clock): 32 games · measured (wall clock): 12 games · native profile · seed 0"
    assert headline(drawn["five"])[1] == source
    assert picture.caption.startswith("Figure 5. STLC")
    assert source in picture.caption


def test_figure_6_shows_the_games_of_most_rounds(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = accelerated_rows()
    scores = scored(rows)
    summary = summarise(rows, scores)
    picture = speedup_figure(scores, summary, tmp_path / "six.png")
    adsc, tcsc = drawn["six"].axes
    assert headline(drawn["six"]) == (
        "Effective speed-up over ADSC at 1x, 24 rounds",
        "modelled (virtual clock): 16 games · measured (wall clock): 6 games · native profile · seed 0",
    )
    cells = {
        (c["command"], c["clock_speed"], c["t_move_s"]): c for c in summary["cells"] if c["rounds"] == 24
    }
    for axes, command, clocks in ((adsc, "adsc", [1.0, 10.0, 100.0]), (tcsc, "tcsc", [10.0])):
        assert list(labelled(axes)) == ["ideal", "T_move 0.5 s", "T_move 1 s"]
        for t_move_s in (0.5, 1.0):
            line, _, (bars,) = labelled(axes)[f"T_move {t_move_s:g} s"].lines
            # Games of clock speed k take 1.5, 1.6 and 1.7 times the k-th part of what the references take.
            assert line.get_ydata().tolist() == pytest.approx([k / 1.6 if k > 1 else 1.0 for k in clocks])
            lows_highs = [
                cells[command, k, t_move_s]["effective_speedup_interval"] or [1.0, 1.0] for k in clocks
            ]
            assert [bar[:, 1].tolist() for bar in bars.get_segments()] == [
                pytest.approx(interval) for interval in lows_highs
            ]
    assert picture.caption.startswith("Figure 6. Effective speed-up of games of 24 rounds: ")
    assert headline(drawn["six"])[1] in picture.caption


# --- the written report -------------------------------------------------------------------------------------


def find(summary: Mapping[str, Any], **wanted: Any) -> dict[str, Any]:
    (cell,) = (c for c in summary["cells"] if all(c[key] == value for key, value in wanted.items()))
    return dict(cell)


def test_the_report_of_a_run_whatever_jobs(tmp_path: Path) -> None:
    """Once more, the scores by two processes: the same numbers."""
    run_dir, again = (write_run(tmp_path / name, synthetic_games()) for name in ("run", "again"))
    summary = Dp1Report(RunDirectory(run_dir), "dp1").write()
    other = Dp1Report(RunDirectory(again), "dp1")
    other.jobs = 2
    other.write_summary()
    for name in ("summary.json", "scores.json"):
        assert (again / name).read_bytes() == (run_dir / name).read_bytes()
    assert json.loads((run_dir / "summary.json").read_text()) == summary
    for name in FIGURES:
        image = cv2.imread(str(run_dir / "figures" / f"{name}.png"))
        assert image is not None
        assert np.mean(np.any(image != 255, axis=-1)) > 0.01
    markdown, html = ((run_dir / f"report.{suffix}").read_text() for suffix in ("md", "html"))
    assert markdown.startswith("# DP1, native profile, seed 0\n\nADSC flies as in real time up to 100x")
    places = [markdown.index(f"(figures/{name}.png)") for name in FIGURES]
    assert places == sorted(places)
    assert html.count("data:image/png;base64,") == len(FIGURES)
    assert 'src="http' not in html
    assert "<summary>20 cells</summary>" in html
    assert "modelled (no latency): 4 games · modelled (virtual clock): 62 games" in markdown
    assert "```\nsuite: dp1\nseed: 0\n```" in markdown
    assert '"host": "synthetic"' in markdown
    assert "Warning" not in markdown
    for line in table(summary).rows:
        assert " | ".join(line).replace("_", "\\_") in markdown
    fast = {"clock_speed": 100.0, "t_move_s": 1.0, "rounds": 4}
    assert find(summary, command="tcsc", **fast)["position_rmse_vs_lockstep_m"] == 0.0
    assert find(summary, command="adsc", **fast)["position_rmse_vs_lockstep_m"] > 0.2


def test_the_report_warns(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    flown = cell_games("game", "tcsc", 50.0, 1.0, 1, 3, "wall")
    for (row, _), lost_s in zip(flown, (0.25, 0.125, 0.0), strict=True):
        row["lost_wall_s"] = lost_s
    flown[2][0]["error"] = "the drone crashed"
    flown[1][0]["disturbed"] = True
    run_dir = write_run(tmp_path / "run", flown)
    report = Dp1Report(RunDirectory(run_dir), "dp1")
    report.write()
    page = (run_dir / "report.md").read_text()
    assert "Games: measured (wall clock): 3 games · native profile · seed 0 · 1 of 3 games disturbed." in page
    assert report.overview().rows[0][2] == "2 (1 disturbed)"
    assert table(report.summary).rows[0][4] == "2 (1 failed) (1 disturbed)"
    said = [line for line in page.splitlines() if "Warning" in line]
    assert said == [
        "Warning: 1 games failed and are left out; rows.jsonl says why.",
        "Warning: the machine could not keep up and lost 0.375 s of wall time.",
        "Warning: 1 games were disturbed: they lost wall time, or their server stalled or was started again; "
        "rows.jsonl says which.",
        "Warning: some cells have no real-time ADSC games to compare with.",
    ]


@pytest.mark.parametrize(
    ("row", "restarts", "marks"),
    [
        ({}, 0, {}),
        ({"lost_wall_s": 0.0, "restarts": 0}, 0, {}),
        ({"lost_wall_s": 0.25}, 0, {"disturbed": True}),
        ({"stalled_wall_s": 0.5}, 0, {"disturbed": True}),
        ({"restarts": 1}, 0, {"disturbed": True}),  # of an environment's own server
        ({"lost_wall_s": 0.0}, 2, {"restarts": 2, "disturbed": True}),
    ],
)
def test_a_measured_game_is_marked_by_what_disturbed_it(
    row: dict[str, Any], restarts: int, marks: dict[str, Any]
) -> None:
    assert disturbances(row, restarts) == marks


SPARSE_RUNS: dict[str, Callable[[], list[tuple[Row, Arrays]]]] = {
    "references alone": lambda: cell_games("reference", "adsc", 1.0, 1.0, 1, 1, "virtual"),
    "one cell without references": lambda: cell_games("game", "tcsc", 50.0, 0.1, 1, 1, "wall"),
    "one ClockSpeed": lambda: synthetic_games(
        clocks=(50.0,), t_moves_s=(0.5,), rounds=(2,), timing="wall", games=1
    ),
}


@pytest.mark.parametrize("name", SPARSE_RUNS)
def test_little_data_still_makes_a_report(tmp_path: Path, name: str, drawn: dict[str, Figure]) -> None:
    run_dir = write_run(tmp_path / "run", SPARSE_RUNS[name](), traces=False)
    summary = Dp1Report(RunDirectory(run_dir), "dp1").write()
    assert sorted(drawn) == sorted(FIGURES)
    assert texts(drawn["figure4_trellis"].axes[0]) == ["no trace recorded"]
    assert all(len(line) == 12 for line in table(summary).rows)


def test_a_run_without_games_is_the_users_mistake(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run", [])
    with pytest.raises(UserError, match=r"rows\.jsonl: holds no finished game of dp1"):
        Dp1Report(RunDirectory(run_dir), "dp1").write()


def test_missing_arrays_are_named(tmp_path: Path) -> None:
    flown = cell_games("reference", "adsc", 1.0, 1.0, 1, 2, "virtual")
    run_dir = write_run(tmp_path / "run", flown)
    (run_dir / flown[1][0]["arrays"]).unlink()
    with pytest.raises(UserError, match="reference-adsc-k1-t1-r1-g01"):
        Dp1Report(RunDirectory(run_dir), "dp1").write()
