"""DP1's report, from rows and arrays: every number, on flights whose errors are known by hand, its figures and page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.dp1_games import SEED, Row, line_row, quantile, report_of
from tests.drawing import boxes, headline, labelled, legend_texts, points, record_figures, texts, tick_texts
from tests.test_trellis import recorded_trace
from uavaccel.draw import style
from uavaccel.draw.page import Table
from uavaccel.errors import UserError
from uavaccel.suites import dp1
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.rows import disturbances
from uavaccel.suites.trellis import MOST_EVENTS, trellis_figure

FIGURES = ("figure2_velocity", "figure3_trajectories", "figure4_trellis", "figure5_accuracy", "figure6_speedup")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Figure]]:
    with style.project_style():
        yield record_figures(monkeypatch)


# --- the summary --------------------------------------------------------------------------------------------------

REFERENCES_M, GAMES_M = [0.0, 0.2, 0.5], [0.1, 0.9, 0.3, 0.35]
REFERENCE_WALL_S, WALL_S = [4.1, 4.3, 4.9], [0.12, 0.09, 0.1, 0.2]
GAPS_S = [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06], [0.07, 0.08, 0.3], [0.2, 0.21, 0.22]]
FACTORS, LOST_S = [40.0, 48.0, 50.0, 45.0], [0.1, 0.0, 0.25, 0.0]


def cell_rows() -> list[Row]:
    """Two cells, their references, what is to be left out, and other paths whose references are far off."""
    rows = [
        line_row("reference", "adsc", 1.0, i, offset_m, wall_s=wall_s, gaps_s=[0.0, 0.01 * i, 0.0])
        for i, (offset_m, wall_s) in enumerate(zip(REFERENCES_M, REFERENCE_WALL_S, strict=True))
    ]
    rows += [
        line_row("lockstep", "adsc", 1.0, 0, 0.05, timing="lockstep"),
        line_row("lockstep", "tcsc", 1.0, 0, 0.6, timing="lockstep"),
        line_row("game", "tcsc", 50.0, 4, 5.0, error="the drone crashed", timing="wall"),
        line_row("figure2", "tcsc", 50.0, 0, 7.0, timing="wall"),
        line_row("reference", "adsc", 1.0, 0, 30.0, t_move_s=0.5),
        line_row("reference", "adsc", 1.0, 0, 40.0, rounds=2),
        line_row("game", "adsc", 1.0, 0, 50.0, timing="wall"),  # a cell beside the references'
    ]
    for i in (2, 0, 3, 1):
        keys = {"wall_s": WALL_S[i], "gaps_s": GAPS_S[i], "real_time_factor": FACTORS[i], "lost_wall_s": LOST_S[i]}
        rows.append(line_row("game", "tcsc", 50.0, i, GAMES_M[i], timing="wall", **keys))
    return rows


def find(summary: Any, **wanted: Any) -> dict[str, Any]:
    (cell,) = (c for c in summary["cells"] if all(c[key] == value for key, value in wanted.items()))
    return dict(cell)


def bootstrapped(*samples: Any, of: Any) -> list[float]:
    """The interval of a statistic over resampled games, the samples drawn one after another."""
    rng = np.random.default_rng(SEED)
    drawn = [np.array(sample)[rng.integers(len(sample), size=(2000, len(sample)))] for sample in samples]
    found = of(*drawn).tolist()
    return [quantile(found, 0.025), quantile(found, 0.975)]


def test_every_number_of_a_cell(tmp_path: Path) -> None:
    report = report_of(tmp_path / "run", cell_rows())
    aside_m = np.abs(np.subtract.outer(GAMES_M, REFERENCES_M))
    stlc, rmse_m = (1 + np.exp(-aside_m)).mean(axis=1), aside_m.mean(axis=1)
    reference = {"command": "adsc", "clock_speed": 1.0, "timing": "virtual", "provenance": "modelled", "games": 3}
    expected = {
        "command": "tcsc", "clock_speed": 50.0, "t_move_s": 1.0, "rounds": 1, "timing": "wall",
        "games": 4, "failed_games": 1, "distinct_games": 4, "provenance": "measured", "seed": SEED,
        "reference": {**reference, "is_this_cell": False},
        **{f"stlc_{name}": quantile(stlc.tolist(), share) for name, share in
           (("median", 0.5), ("q25", 0.25), ("q75", 0.75))},
        "stlc_median_interval": bootstrapped(stlc, of=lambda drawn: np.median(drawn, axis=1)),
        "position_rmse_m": quantile(rmse_m.tolist(), 0.5),
        "position_rmse_interval_m": bootstrapped(rmse_m, of=lambda drawn: np.median(drawn, axis=1)),
        "position_rmse_vs_lockstep_m": quantile(np.abs(np.array(GAMES_M) - 0.6).tolist(), 0.5),
        "duration_error_s": quantile([4.0 + sum(gaps) for gaps in GAPS_S], 0.5) - (4.0 + 4.01 + 4.02) / 3,
        "command_gap_median_s": 0.065,  # of twelve: between 0.06 and 0.07
        "command_gap_q95_s": quantile([gap for gaps in GAPS_S for gap in gaps], 0.95),
        "effective_speedup": (13.3 / 3) / (0.51 / 4),
        "effective_speedup_interval": bootstrapped(
            REFERENCE_WALL_S, WALL_S, of=lambda base, own: base.mean(axis=1) / own.mean(axis=1)
        ),
        "effective_speedup_provenance": "mixed", "real_time_factor": 183.0 / 4, "lost_wall_s": 0.35,
    }  # fmt: skip
    found = find(report.summary, command="tcsc", t_move_s=1.0)
    plain = {key for key, value in expected.items() if isinstance(value, dict | str)}
    assert {key: found.pop(key) for key in plain} == {key: expected.pop(key) for key in plain}
    assert found == {key: pytest.approx(value) for key, value in expected.items()}
    assert {key: report.summary[key] for key in ("suite", "profile", "seed")} == {
        "suite": "dp1", "profile": "native", "seed": SEED,
    }  # fmt: skip
    own = report.scores[(report.scores.command == "tcsc") & (report.scores.clock_speed == 50.0)]
    assert own.stlc.dropna().tolist() == pytest.approx(stlc.tolist())


def test_intervals_are_drawn_with_the_runs_seed(tmp_path: Path) -> None:
    """Of so many games that two seeds give two intervals."""
    aside_m = np.linspace(0.0, 1.0, 25) ** 2
    rows = [line_row("reference", "adsc", 1.0, 0, 0.0)]
    rows += [line_row("game", "tcsc", 5.0, game, offset_m) for game, offset_m in enumerate(aside_m)]
    cell = find(report_of(tmp_path / "run", rows).summary, command="tcsc")
    expected = bootstrapped(aside_m, of=lambda drawn: np.median(drawn, axis=1))
    assert cell["position_rmse_interval_m"] == pytest.approx(expected)
    stlc = 1 + np.exp(-aside_m)
    assert cell["stlc_median_interval"] == pytest.approx(bootstrapped(stlc, of=lambda drawn: np.median(drawn, axis=1)))


def test_references_are_a_cell_of_their_own_and_not_compared_with_themselves(tmp_path: Path) -> None:
    summary = report_of(tmp_path / "run", cell_rows()).summary
    cell = find(summary, command="adsc", t_move_s=1.0, rounds=1, timing="virtual")
    others_m = [(0.2 + 0.5) / 2, (0.2 + 0.3) / 2, (0.5 + 0.3) / 2]
    stlc = [1 + (np.exp(-a) + np.exp(-b)) / 2 for a, b in ((0.2, 0.5), (0.2, 0.3), (0.5, 0.3))]
    assert cell["reference"]["is_this_cell"] is True
    assert (cell["games"], cell["failed_games"], cell["provenance"]) == (3, 0, "modelled")
    assert cell["position_rmse_m"] == pytest.approx(quantile(others_m, 0.5))
    assert [cell["stlc_q25"], cell["stlc_q75"]] == pytest.approx([quantile(stlc, 0.25), quantile(stlc, 0.75)])
    assert cell["position_rmse_vs_lockstep_m"] == pytest.approx(0.15)  # the lockstep game of its own command
    assert (cell["effective_speedup"], cell["effective_speedup_interval"]) == (1.0, None)
    assert cell["effective_speedup_provenance"] == "modelled"
    lone = find(summary, command="adsc", t_move_s=0.5)
    assert (lone["games"], lone["stlc_median"], lone["stlc_median_interval"]) == (1, None, None)


def test_numbers_without_references_lockstep_or_games_are_unknown(tmp_path: Path) -> None:
    game = line_row("game", "tcsc", 50.0, 0, 0.1)
    (cell,) = report_of(tmp_path / "alone", [game]).summary["cells"]
    assert {key for key, value in cell.items() if value is None} == {
        "reference", "stlc_median", "stlc_q25", "stlc_q75", "stlc_median_interval", "position_rmse_m",
        "position_rmse_interval_m", "position_rmse_vs_lockstep_m", "duration_error_s", "effective_speedup",
        "effective_speedup_interval", "effective_speedup_provenance",
    }  # fmt: skip
    (cell,) = report_of(tmp_path / "failed", [game | {"error": "crashed"}]).summary["cells"]
    assert (cell["games"], cell["failed_games"], cell["real_time_factor"]) == (0, 1, None)
    with pytest.raises(UserError, match=r"rows\.jsonl: holds no finished game of dp1"):
        report_of(tmp_path / "none", [])
    lost = report_of(tmp_path / "lost", [game])
    (lost.run.path / lost.games.arrays[0]).unlink()
    with pytest.raises(UserError, match=game["case"]):
        lost.write_summary()


def test_summaries_are_the_same_in_any_order_and_number_of_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = accelerated_rows()
    reports = [report_of(tmp_path / name, each) for name, each in (("a", rows), ("b", rows[::-1]), ("c", rows))]
    for report, least in zip(reports, (400, 400, 0), strict=True):
        monkeypatch.setattr(dp1, "PARALLEL_FROM_GAMES", least)
        report.write_summary()
    assert len({(report.run.path / "summary.json").read_bytes() for report in reports}) == 1
    keys = [[cell[name] for name in dp1.CELL] for cell in reports[0].summary["cells"]]
    assert keys == sorted(keys)


# --- figures ------------------------------------------------------------------------------------------------------


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
                rows.append(
                    line_row("game", command, clock_speed, game, offset_m, **keys, wall_s=wall_s, timing=timing)
                )
    return rows


def test_figure_2_shows_the_games_flown_for_it(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = [
        line_row(
            "figure2", "adsc", 100.0, 1, 0.0, gaps_s=[0.01, 0.02, 0.06], timing="wall", velocity_m_s=[9.0, 0.03, 0.0]
        ),
        line_row("figure2", "adsc", 1.0, 0, 0.0, velocity_m_s=[0.5, 0.04, -0.2]),
        line_row("figure2", "adsc", 9.0, 2, 0.0, error="crashed"),
        line_row("game", "adsc", 7.0, 0, 0.0),
    ]
    picture = dp1.velocity_figure(report_of(tmp_path / "run", rows))
    figure: Any = drawn["figure2_velocity"]
    slow, fast = figure.axes
    assert slow.get_title("left") == "ADSC at 1x: 0.0 ms between commands"
    assert fast.get_title("left") == "ADSC at 100x: 30.0 ms between commands"
    assert [(name, points(line)[0]) for name, line in labelled(slow).items()] == [
        ("north", (0.0, 0.5)),
        ("down", (0.0, -0.2)),
    ], "east is never above 5 cm/s"
    assert labelled(fast)["north"].get_color() == style.BLUE
    assert [round(gap.get_width(), 9) for gap in fast.patches] == [0.01, 0.02, 0.06]
    assert [round(line.get_xdata()[0], 9) for line in fast.lines[:4]] == [1.0, 2.01, 3.03, 4.09], "commands end"
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "simulated time, s"]
    assert {axes.get_ylabel() for axes in figure.axes} == {"velocity, m/s"}
    assert legend_texts(figure.legends[0]) == ["north", "down", "command ends", "no command runs"]
    source = f"modelled (virtual clock): 1 game · measured (wall clock): 1 game · native profile · seed {SEED}"
    assert headline(figure) == ("Two steps forward, one back", source)
    assert picture.caption.startswith("Figure 2. ")
    assert picture.caption.endswith(f"Source: {source}.")


def test_figures_of_accelerated_games(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Figure 3: best and worst replica; 5: STLC with T_moves pooled; 6: speed-ups of the games of most rounds."""
    report = report_of(tmp_path / "run", accelerated_rows())
    report.write()
    trajectories, accuracy, speedup = (drawn[name] for name in (FIGURES[1], FIGURES[3], FIGURES[4]))
    best, worst = (1 + np.exp(-0.03 * (game + 1) ** 2) for game in (0, 2))
    assert {name: line.get_data_3d()[1][0] for name, line in labelled(trajectories.axes[0]).items()} == pytest.approx(
        {
            "ADSC at 1x: reference": 0.0,
            f"ADSC at 100x, best: STLC {best:.3f}": 0.03,
            f"ADSC at 100x, worst: STLC {worst:.3f}": 0.27,
            f"TCSC at 10x, worst: STLC {1 + np.exp(-0.81):.3f}": 0.81,
        }
    )
    clocks = "modelled (virtual clock): {} games · measured (wall clock): {} game{} · native profile · seed 7"
    assert headline(trajectories) == ("Trajectories, 1 round, T_move 1 s", clocks.format(3, 1, ""))
    assert headline(accuracy)[1] == clocks.format(32, 12, "s")
    assert len(accuracy.axes) == 2 * 3
    for panel, factor in ((1, 1), (2, 1), (4, 3)):  # ADSC at 10x and 100x, TCSC at 10x
        for place, paths in enumerate([(0, 2), (1, 3)]):  # 1 round, 24 rounds: both T_moves each
            aside_m = [0.01 * (1 + path) * (game + 1) ** 2 * factor for path in paths for game in range(3)]
            stlc = (1 + np.exp(-np.array(aside_m))).tolist()
            box = boxes(accuracy.axes[panel])[place]
            assert box["median"] == pytest.approx(quantile(stlc, 0.5))
            assert box["box"] == pytest.approx((quantile(stlc, 0.25), quantile(stlc, 0.75)))
    assert boxes(accuracy.axes[1])[0]["colour"] == style.VERMILION.lower()
    assert boxes(accuracy.axes[4])[0]["colour"] == style.BLUE.lower()
    assert texts(accuracy.axes[5]) == ["no games to compare"]
    assert [axes.get_title("center") for axes in accuracy.axes[:3]] == ["1x", "10x", "100x"]
    assert [axes.get_ylabel() for axes in accuracy.axes[::3]] == ["ADSC\nSTLC", "TCSC\nSTLC"]
    assert (accuracy.axes[3].get_xlabel(), tick_texts(accuracy.axes[3].xaxis)) == ("rounds", ["1", "24"])
    for axes in accuracy.axes:
        assert points(axes.lines[0])[0][1] == 1.8
        assert axes.get_ylim() == pytest.approx((min(1.7, 1 + np.exp(-1.08) - 0.05), 2.04))
    assert headline(speedup) == ("Effective speed-up over ADSC at 1x, 24 rounds", clocks.format(16, 6, "s"))
    for axes, command, speeds in zip(speedup.axes, ("adsc", "tcsc"), ([1.0, 10.0, 100.0], [10.0]), strict=True):
        assert list(labelled(axes)) == ["ideal", "T_move 0.5 s", "T_move 1 s"]
        assert axes.get_title("left") == command.upper()
        ideal = labelled(axes)["ideal"]
        assert (points(ideal), ideal.get_linestyle()) == ([(0, 1.0), (1, 10.0), (2, 100.0)], "--")
        assert (axes.get_yscale(), tick_texts(axes.xaxis), axes.get_xlabel()) == (
            "log", ["1x", "10x", "100x"], "ClockSpeed",
        )  # fmt: skip
        for t_move_s in (0.5, 1.0):
            line, _, (bars,) = labelled(axes)[f"T_move {t_move_s:g} s"].lines
            # Games of clock speed k take 1.5, 1.6 and 1.7 times the k-th part of what the references take.
            assert line.get_color() == (style.BLUE if t_move_s == 0.5 else style.ORANGE)
            assert line.get_xdata().tolist() == ([0, 1, 2] if command == "adsc" else [1])
            assert line.get_ydata().tolist() == pytest.approx([k / 1.6 if k > 1 else 1.0 for k in speeds])
            key = {"command": command, "t_move_s": t_move_s, "rounds": 24}
            cells = [find(report.summary, **key, clock_speed=k) for k in speeds]
            ends = [cell["effective_speedup_interval"] or [1.0, 1.0] for cell in cells]
            assert [bar[:, 1].tolist() for bar in bars.get_segments()] == [pytest.approx(end) for end in ends]
    speedup.draw_without_rendering()
    assert {"1x", "2x", "5x", "10x", "20x"} <= set(tick_texts(speedup.axes[0].yaxis))
    page = (report.run.path / "report.md").read_text()
    for name, starts in zip(FIGURES[1:], ("Trajectories", "Messages", "Accuracy", "Effective"), strict=True):
        assert headline(drawn[name])[0].startswith(starts)
        assert f"Source: {headline(drawn[name])[1]}." in page
    assert "Effective speed-up of games of 24 rounds: " in page


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
    rows = [line_row("game", "adsc", 90.0, 0, 0.0, error="crashed")]
    for command, clock_speed, t_move_s, rounds in (others[0], shown, others[1]):
        rows.append(line_row("game", command.lower(), clock_speed, 0, 0.0, t_move_s=t_move_s, rounds=rounds))
    dp1.trajectory_figure(report_of(tmp_path / "run", rows))
    command, clock_speed, t_move_s, rounds = shown
    assert headline(drawn[FIGURES[1]])[0] == f"Trajectories, {rounds} rounds, T_move {t_move_s:g} s"
    assert f"{command} at {clock_speed:g}x, one game: STLC unknown" in labelled(drawn[FIGURES[1]].axes[0])


REFERENCE = line_row("reference", "adsc", 1.0, 0, 0.0)
ALIKE = [line_row("game", "tcsc", 50.0, game, 0.1) for game in range(3)]
STLC = f"STLC {1 + np.exp(-0.1):.3f}"


@pytest.mark.parametrize(
    ("rows", "labels"),
    [
        ([REFERENCE, *ALIKE], ["ADSC at 1x: reference", f"TCSC at 50x, all 3 identical: {STLC}"]),
        ([REFERENCE, ALIKE[0]], ["ADSC at 1x: reference", f"TCSC at 50x, one game: {STLC}"]),
        ([ALIKE[0]], ["TCSC at 50x, one game: STLC unknown"]),
        ([REFERENCE], ["ADSC at 1x: reference"]),
        ([ALIKE[0] | {"error": "crashed"}], []),
    ],
)
def test_a_run_of_few_games_has_a_whole_report(
    rows: list[Row], labels: list[str], tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    report_of(tmp_path / "run", rows).write()
    assert list(labelled(drawn[FIGURES[1]].axes[0])) == labels
    assert sorted(drawn) == sorted(FIGURES)
    assert texts(drawn["figure4_trellis"].axes[0]) == ["no trace recorded"]
    assert texts(drawn["figure2_velocity"].axes[0]) == ["no flight recorded"]
    if REFERENCE not in rows:
        assert texts(drawn["figure6_speedup"].axes[0]) == ["no speed-up without ADSC games at 1x"]
    if labels:
        assert drawn["figure5_accuracy"].axes[0].get_ylim() == pytest.approx((1.7, 2.04))


def test_figure_4_shows_the_recorded_traces(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    report = report_of(tmp_path / "run", [ALIKE[0] | {"timing": "wall"}, REFERENCE])
    long = [{"source": "server", "event": "run", "wall_s": 0.0, "sim_s": float(i)} for i in range(MOST_EVENTS + 9)]
    for name, trace in (("adsc", long), ("tcsc", recorded_trace())):
        report.run.write_json(f"traces/{name}.json", trace)
    picture = trellis_figure(report)
    figure: Any = drawn["figure4_trellis"]
    assert texts(figure.axes[1])[-1] == f"{MOST_EVENTS - 1}.000 s   run"
    assert figure.axes[0].get_ylim()[0] > MOST_EVENTS - 1 > figure.axes[0].get_ylim()[1], "time runs downwards"
    assert legend_texts(figure.legends[0]) == ["call", "answer", "simulated time runs"]
    assert [axes.get_title("left") for axes in figure.axes] == ["TCSC", "ADSC"]
    assert headline(figure)[1] == "one recorded command each · measured (wall clock) · native profile · seed 7"
    assert headline(figure)[1] in picture.caption
    (report.run.path / "traces/tcsc.json").write_text("no JSON")
    with pytest.raises(UserError, match=r"tcsc\.json: not JSON"):
        trellis_figure(report)


# --- the page -----------------------------------------------------------------------------------------------------


def test_the_page_warns_and_has_figures_tables_and_provenance(tmp_path: Path) -> None:
    lost_s = (0.25, 0.125, 0.0)
    rows = [line_row("game", "tcsc", 50.0, i, 0.0, timing="wall", lost_wall_s=s) for i, s in enumerate(lost_s)]
    rows[2]["error"] = "the drone crashed"
    rows[1]["disturbed"] = True
    report = report_of(tmp_path / "run", rows)
    report.write()
    page, html = ((report.run.path / f"report.{suffix}").read_text() for suffix in ("md", "html"))
    assert page.startswith("# DP1, native profile, seed 7\n\n2 games, none of them accelerated and comparable")
    assert "Games: measured (wall clock): 3 games · native profile · seed 7 · 1 of 3 games disturbed." in page
    assert [line for line in page.splitlines() if "Warning" in line] == [
        "Warning: 1 games failed and are left out; rows.jsonl says why.",
        "Warning: the machine could not keep up and lost 0.375 s of wall time.",
        "Warning: 1 games were disturbed: they lost wall time, or their server stalled or was started again; "
        "rows.jsonl says which.",
        "Warning: some cells have no real-time ADSC games to compare with.",
    ]
    places = [page.index(f"(figures/{name}.png)") for name in FIGURES]
    assert places == sorted(places)
    assert "| TCSC | 50x | 2 (1 disturbed) | - | - | - | - | 50.00 | measured |" in page
    assert "| TCSC | 50x | 1 | 1 | 2 (1 failed) (1 disturbed) | - | - | - | - | - | 50.00 | measured |" in page
    assert '"host": "synthetic"' in page
    assert html.count("data:image/png;base64,") == len(FIGURES)
    assert "<summary>1 cells</summary>" in html


CELL: dict[str, Any] = {
    "command": "tcsc", "clock_speed": 2.5, "t_move_s": 0.1, "rounds": 24, "games": 19, "failed_games": 1,
    "timing": "wall", "provenance": "measured", "stlc_median": 1.9154, "stlc_q25": 1.8024, "stlc_q75": 1.9876,
    "position_rmse_m": 0.1234, "position_rmse_vs_lockstep_m": 0.000012, "duration_error_s": 0.0123,
    "effective_speedup": 2.345, "effective_speedup_provenance": "mixed", "real_time_factor": 2.499,
    "reference": {},
}  # fmt: skip
UNKNOWN = dict.fromkeys(
    ("stlc_median", "position_rmse_m", "position_rmse_vs_lockstep_m", "duration_error_s", "effective_speedup")
)


def told(cells: list[dict[str, Any]]) -> Any:
    return SimpleNamespace(summary={"cells": cells})


def test_a_line_of_the_table() -> None:
    exact = {"position_rmse_m": 0.0, "duration_error_s": -0.0001, "failed_games": 0}
    unknown = UNKNOWN | {"effective_speedup_provenance": None, "real_time_factor": None}
    table = Table.of(dp1.cells_of(told([CELL, CELL | exact, CELL | unknown])), dp1.ALL_CELLS)
    assert dict(zip(table.header, table.rows[0], strict=True)) == {
        "command": "TCSC", "clock": "2.5x", "T_move s": "0.1", "rounds": "24", "games": "19 (1 failed)",
        "STLC median [q25, q75]": "1.915 [1.802, 1.988]", "RMSE m": "0.123", "v. lockstep": "1.2e-05",
        "duration s": "+0.012", "speed-up": "2.35 (mixed)", "achieved": "2.50", "source": "measured",
    }  # fmt: skip
    assert [table.rows[1][column] for column in (4, 6, 8)] == ["19", "0", "+0.000"]
    assert table.rows[2][5:11] == ("-",) * 6


def test_the_overview_has_the_worst_of_each_command_and_clock_speed() -> None:
    better = {"stlc_median": 1.99, "position_rmse_m": 0.5, "position_rmse_vs_lockstep_m": 0.02, "games": 5}
    better |= {"effective_speedup": 2.4, "real_time_factor": 2.1}
    fast = CELL | {"clock_speed": 50.0, "timing": "virtual"}
    slow = fast | UNKNOWN | {"command": "adsc", "effective_speedup_provenance": None}
    table = Dp1().overview(told([CELL | {"rounds": 1}, CELL | better, CELL | UNKNOWN, fast, slow]))
    lines = {row[:2]: row[2:] for row in table.rows}
    assert lines["TCSC", "2.5x"] == (
        "43", "1.9154", "0.500", "0.020", "2.35 to 2.40 (mixed)", "2.10 to 2.50", "measured",
    )  # fmt: skip
    assert lines["TCSC", "50x"][:2] == ("19", "1.9154")
    assert lines["ADSC", "50x"] == ("19", "-", "-", "-", "-", "2.50", "measured")


def flown(command: str, clock_speed: float, stlc: Any, error_m: float, speedup: float, timing: str = "virtual") -> Any:
    return CELL | {
        "command": command, "clock_speed": clock_speed, "timing": timing, "stlc_median": stlc, "games": 4,
        "position_rmse_m": error_m, "effective_speedup": speedup, "provenance": "modelled",
    }  # fmt: skip


def test_the_headline_is_of_each_commands_worst_cells_beyond_real_time() -> None:
    """As in real time up to the last ClockSpeed before a cell that is not; error and speed-up are at the fastest."""
    cells = [
        *(flown("tcsc", 5.0, 1.5, 0.3, 4.0), flown("tcsc", 10.0, 1.9, 0.004, 8.0)),
        *(flown("adsc", 1.0, 1.0, 5.0, 1.0), flown("adsc", 2.0, 1.9, 0.1, 2.0)),
        *(flown("adsc", 5.0, 1.81, 0.2, 4.0), flown("adsc", 5.0, 1.95, 0.2, 4.5)),
        *(flown("adsc", 10.0, 1.99, 0.9, 8.0), flown("adsc", 10.0, 1.8, 0.9, 8.0)),
        *(flown("adsc", 50.0, 1.9, 0.25, 30.0), flown("adsc", 50.0, 1.9, 0.125, 20.0)),
        flown("adsc", 100.0, 0.1, 9.0, 99.0, "lockstep"),
    ]
    assert Dp1().headline(told(cells)) == (
        "ADSC flies as in real time up to 5x (STLC above 1.8); at 50x it is up to 0.250 m off (RMSE) and 20.00 to "
        "30.00 times as fast; TCSC no longer flies as in real time at 5x (STLC above 1.8); at 10x it is up to 4.0e-03 "
        "m off (RMSE) and 8.00 times as fast (modelled)"
    )
    nothing = [flown("adsc", 1.0, 2.0, 0.0, 1.0), flown("adsc", 5.0, None, 0.0, 1.0)]
    assert Dp1().headline(told(nothing)) == "8 games, none of them accelerated and comparable with real time"


def test_a_flight_has_the_commands_of_its_path(tmp_path: Path) -> None:
    rows = [line_row("game", "tcsc", 50.0, 0, 0.1), line_row("figure2", "adsc", 5.0, 0, 0.2)]
    report = report_of(tmp_path / "run", rows, speed_m_s=2.0)
    square, forward = (Dp1().flight(report, game) for _, game in report.games.iterrows())
    assert (square.title, square.clock_speed, square.position_m[0, 1]) == ("TCSC at 50x", 50.0, 0.1)
    assert square.commands.velocity_m_s.tolist() == [[2, 0, 0], [0, 2, 0], [-2, 0, 0], [0, -2, 0]]
    assert square.commands.end_ns.tolist() == [each * 10**9 for each in (1, 2, 3, 4)]
    assert forward.commands.velocity_m_s.tolist() == [[2, 0, 0], [2, 0, 0], [-2, 0, 0]]


@pytest.mark.parametrize(
    ("row", "restarts", "marks"),
    [
        ({"lost_wall_s": 0.0, "restarts": 0}, 0, {}),
        ({"lost_wall_s": 0.25}, 0, {"disturbed": True}),
        ({"stalled_wall_s": 0.5}, 0, {"disturbed": True}),
        ({"restarts": 1}, 0, {"disturbed": True}),  # of an environment's own server
        ({"lost_wall_s": 0.0}, 2, {"restarts": 2, "disturbed": True}),
    ],
)
def test_a_measured_game_is_marked_by_what_disturbed_it(row: dict[str, Any], restarts: int, marks: Any) -> None:
    assert disturbances(row, restarts) == marks
