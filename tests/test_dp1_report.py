"""DP1's report, from rows and arrays: every number, on flights whose errors are known by hand, its figures and page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.dp1_games import SEED, Row, line_row, report_of
from tests.drawing import boxes, headline, labelled, legend_texts, points, record_figures, texts, tick_texts
from uavaccel.draw import style
from uavaccel.draw.labels import metres
from uavaccel.draw.page import Table
from uavaccel.errors import UserError
from uavaccel.suites import dp1
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.rows import disturbances

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
REFERENCE = line_row("reference", "adsc", 1.0, 0, 0.0)
ALIKE = [line_row("game", "tcsc", 50.0, game, 0.1) for game in range(3)]
QUARTILES = (0.5, 0.25, 0.75)


def cell_rows() -> list[Row]:
    """Two cells, their references, what is to be left out, and other paths whose references are far off."""
    rows = [
        line_row("reference", "adsc", 1.0, i, offset_m, wall_s=wall_s, gaps_s=[0.0, 0.01 * i, 0.0])
        for i, (offset_m, wall_s) in enumerate(zip(REFERENCES_M, REFERENCE_WALL_S, strict=True))
    ]
    rows += [
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


def bootstrapped(*samples: Any, of: Any = lambda drawn: np.median(drawn, axis=1)) -> Any:
    """The interval of a statistic over resampled games, the samples drawn one after another."""
    rng = np.random.default_rng(SEED)
    drawn = [np.array(sample)[rng.integers(len(sample), size=(2000, len(sample)))] for sample in samples]
    return pytest.approx(np.quantile(of(*drawn), (0.025, 0.975)).tolist())


def test_every_number_of_a_cell(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    report = report_of(tmp_path / "run", cell_rows())
    aside_m = np.abs(np.subtract.outer(GAMES_M, REFERENCES_M))
    stlc, rmse_m = (1 + np.exp(-aside_m)).mean(axis=1), aside_m.mean(axis=1)
    reference = {"command": "adsc", "clock_speed": 1.0, "timing": "virtual", "provenance": "modelled", "games": 3}
    near = {
        **dict(zip(("stlc_median", "stlc_q25", "stlc_q75"), np.quantile(stlc, QUARTILES), strict=True)),
        "position_rmse_m": np.median(rmse_m),
        "position_rmse_vs_lockstep_m": np.median(np.abs(np.array(GAMES_M) - 0.6)),
        "duration_error_s": np.median(4.0 + np.sum(GAPS_S, axis=1)) - (4.0 + 4.01 + 4.02) / 3,
        "command_gap_median_s": 0.065,  # of twelve: between 0.06 and 0.07
        "command_gap_q95_s": np.quantile(GAPS_S, 0.95),
        "effective_speedup": (13.3 / 3) / (0.51 / 4),
        "real_time_factor": 183.0 / 4,
        "lost_wall_s": 0.35,
    }
    assert find(report.summary, command="tcsc") == {key: pytest.approx(value) for key, value in near.items()} | {
        "command": "tcsc", "clock_speed": 50.0, "t_move_s": 1.0, "rounds": 1, "timing": "wall",
        "games": 4, "failed_games": 1, "distinct_games": 4, "provenance": "measured", "seed": SEED,
        "reference": {**reference, "is_this_cell": False}, "effective_speedup_provenance": "mixed",
        "stlc_median_interval": bootstrapped(stlc), "position_rmse_interval_m": bootstrapped(rmse_m),
        "effective_speedup_interval": bootstrapped(REFERENCE_WALL_S, WALL_S, of=lambda a, b: a.mean(1) / b.mean(1)),
    }  # fmt: skip
    assert [report.summary[key] for key in ("suite", "profile", "seed")] == ["dp1", "native", SEED]
    own = report.scores[report.scores.command == "tcsc"]
    assert own.stlc.dropna().tolist() == pytest.approx(stlc.tolist())
    *_, table, _ = Dp1().page(report)
    assert isinstance(table, Table)
    line = ("TCSC", "50x", "measured", "1", "1", "4", "1", "0", f"{near['stlc_median']:.3f}")
    assert table.rows[-1] == [*line, metres(near["position_rmse_m"]), "0.3", "34.77", "45.75", "mixed"]


def test_what_is_not_compared_with_others_or_itself_is_unknown(tmp_path: Path) -> None:
    """References are a cell of their own, compared with each other; others may lack references, or finished games."""
    summary = report_of(tmp_path / "run", cell_rows()).summary
    cell, lone = (find(summary, command="adsc", t_move_s=t, rounds=1, timing="virtual") for t in (1.0, 0.5))
    aside_m = np.array([(0.2, 0.5), (0.2, 0.3), (0.5, 0.3)])
    stlc = np.quantile((1 + np.exp(-aside_m)).mean(axis=1), QUARTILES)
    assert (cell["reference"]["is_this_cell"], cell["games"], cell["provenance"]) == (True, 3, "modelled")
    assert cell["position_rmse_m"] == pytest.approx(np.median(aside_m.mean(axis=1)))
    assert [cell[key] for key in ("stlc_median", "stlc_q25", "stlc_q75")] == pytest.approx(stlc.tolist())
    names = ("effective_speedup", "effective_speedup_interval", "effective_speedup_provenance")
    assert [cell[name] for name in names] == [1.0, None, "modelled"]
    assert (lone["games"], lone["stlc_median"], lone["stlc_median_interval"]) == (1, None, None)
    (cell,) = report_of(tmp_path / "alone", ALIKE).summary["cells"]
    assert {key for key, value in cell.items() if value is None} == {
        "reference", "stlc_median", "stlc_q25", "stlc_q75", "stlc_median_interval", "position_rmse_m",
        "position_rmse_interval_m", "position_rmse_vs_lockstep_m", "duration_error_s", *names,
    }  # fmt: skip
    assert cell["distinct_games"] == 1
    (cell,) = report_of(tmp_path / "failed", [ALIKE[0] | {"error": "crashed"}]).summary["cells"]
    assert [cell[key] for key in ("games", "failed_games", "real_time_factor", "lost_wall_s")] == [0, 1, None, None]


def test_a_run_without_rows_or_arrays_is_the_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"rows\.jsonl: holds no finished game of dp1"):
        report_of(tmp_path / "none", [])
    with pytest.raises(UserError, match="path: has no games but those of Figure 2 yet"):
        report_of(tmp_path / "path", [line_row("figure2", "adsc", 5.0, 0, 0.0)]).write_summary()
    lost = report_of(tmp_path / "lost", ALIKE)
    (lost.run.path / lost.games.arrays[0]).unlink()
    with pytest.raises(UserError, match=ALIKE[0]["case"]):
        lost.write_summary()


def test_summaries_are_the_same_in_any_order_and_number_of_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, written = accelerated_rows()[:11], set()
    for name, order, least in (("a", 1, 400), ("b", -1, 400), ("c", 1, 0)):
        monkeypatch.setattr(dp1, "PARALLEL_FROM_GAMES", least)
        report = report_of(tmp_path / name, rows[::order])
        report.write_summary()
        written.add((report.run.path / "summary.json").read_bytes())
    keys = [[cell[name] for name in dp1.CELL] for cell in report.summary["cells"]]
    assert (len(written), keys) == (1, sorted(keys))


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
                keys["wall_s"] = (100.0 + path) / clock_speed * (1.5 + game / 10)
                timing = "wall" if command == "tcsc" else "virtual"
                rows.append(line_row("game", command, clock_speed, game, offset_m, **keys, timing=timing))
            del keys["wall_s"]
    return rows


def test_figure_2_shows_the_games_flown_for_it(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    gaps_s, fast = [0.01, 0.02, 0.06], {"timing": "wall", "velocity_m_s": [9.0, 0.03, 0.0]}
    rows = [
        line_row("figure2", "adsc", 100.0, 1, 0.0, gaps_s=gaps_s, **fast),
        line_row("figure2", "adsc", 1.0, 0, 0.0, velocity_m_s=[0.5, 0.04, -0.2]),
        line_row("figure2", "adsc", 9.0, 2, 0.0, error="crashed"),
        line_row("game", "adsc", 7.0, 0, 0.0),
    ]
    picture, figure = dp1.velocity_figure(report_of(tmp_path / "run", rows)), drawn["figure2_velocity"]
    slow_axes, fast_axes = figure.axes
    titles = ["ADSC at 1x: 0.0 ms between commands", "ADSC at 100x: 30.0 ms between commands"]
    assert [axes.get_title("left") for axes in figure.axes] == titles
    lines = {end.get_text(): points(line)[0] for end, line in zip(slow_axes.texts, slow_axes.lines[-2:], strict=True)}
    assert lines == {"north": (0.0, 0.5), "down": (0.0, -0.2)}, "the path leads nowhere east"
    assert [round(gap.get_width(), 9) for gap in fast_axes.patches] == gaps_s  # type: ignore[attr-defined]
    assert [round(points(line)[0][0], 9) for line in fast_axes.lines[:4]] == [1.0, 2.01, 3.03, 4.09], "commands end"
    assert legend_texts(figure.legends[0]) == ["command ends", "no command runs"]
    assert headline(figure) == ("Two steps forward, one back", "")
    assert picture.caption.endswith(" Modelled (virtual clock) and measured (wall clock).")


def test_figures_of_accelerated_games(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Figure 3: best and worst replica; 5: STLC with T_moves pooled; 6: speed-ups of the games of most rounds."""
    report = report_of(tmp_path / "run", accelerated_rows())
    report.write()
    trajectories, accuracy, speedup = (drawn[name] for name in (FIGURES[1], FIGURES[3], FIGURES[4]))
    best, worst = (1 + np.exp(-0.03 * (game + 1) ** 2) for game in (0, 2))
    assert {name: line.get_data_3d()[1][0] for name, line in labelled(trajectories.axes[0]).items()} == pytest.approx(
        {
            "ADSC at 1x, reference": 0.0,
            f"ADSC at 100x, best of 3: STLC {best:.3f}": 0.03,
            f"ADSC at 100x, worst of 3: STLC {worst:.3f}": 0.27,
            f"TCSC at 10x, worst of 3: STLC {1 + np.exp(-0.81):.3f}": 0.81,
        }
    )
    assert headline(trajectories) == ("Trajectories, 1 round, T_move 1 s", "")
    for panel, factor, aside in ((1, 1, -0.2), (1, 3, 0.2), (2, 1, 0.0)):  # at 10x ADSC beside TCSC, at 100x ADSC
        for place, paths in enumerate([(0, 2), (1, 3)]):  # 1 round, 24 rounds: both T_moves each
            aside_m = [0.01 * (1 + path) * (game + 1) ** 2 * factor for path in paths for game in range(3)]
            box = boxes(accuracy.axes[panel])[place + aside]
            quartiles = np.quantile(1 + np.exp(-np.array(aside_m)), QUARTILES)
            assert (box["median"], *box["box"]) == pytest.approx(quartiles)
            assert box["colour"] == style.COMMAND_COLOUR["tcsc" if factor == 3 else "adsc"].lower()
    assert [axes.get_title("left") for axes in accuracy.axes] == ["1x", "10x", "100x"], "no panel is empty"
    assert [axes.get_ylabel() for axes in accuracy.axes] == ["STLC", "", ""]
    assert tick_texts(accuracy.axes[0].xaxis) == ["1", "24"]
    assert legend_texts(accuracy.legends[0]) == ["ADSC", "TCSC", "alike above 1.8"]
    assert {points(axes.lines[0])[0][1] for axes in accuracy.axes} == {1.8}
    assert accuracy.axes[0].get_ylim() == pytest.approx((min(1.7, 1 + np.exp(-1.08) - 0.05), 2.04))
    assert headline(speedup) == ("Effective speed-up over ADSC at 1x, 24 rounds", "")
    assert legend_texts(speedup.legends[0]) == ["T_move 0.5 s", "T_move 1 s", "ideal"]
    for axes, command, speeds in zip(speedup.axes, ("adsc", "tcsc"), ([1.0, 10.0, 100.0], [10.0]), strict=True):
        lines = list(labelled(axes).values())
        assert ([points(line)[0][1] for line in axes.lines[:3]], axes.get_title("left")) == (
            [1, 10, 100],
            command.upper(),
        )
        assert (axes.get_yscale(), tick_texts(axes.xaxis)) == ("log", ["1x", "10x", "100x"])
        for t_move_s, aside, line in zip((0.5, 1.0), (-0.07, 0.07), lines, strict=True):
            line, _, (bars,) = line.lines
            # Games of ClockSpeed k take 1.5, 1.6 and 1.7 times the k-th part of what the references take.
            places = [place + aside for place in ((0, 1, 2) if command == "adsc" else (1,))]
            assert line.get_xdata().tolist() == places, "beside each other, with a mark even where alone"
            assert line.get_marker() != "None"
            assert line.get_ydata().tolist() == pytest.approx([k / 1.6 if k > 1 else 1.0 for k in speeds])
            key = {"command": command, "t_move_s": t_move_s, "rounds": 24}
            cells = [find(report.summary, **key, clock_speed=k) for k in speeds]
            ends = [cell["effective_speedup_interval"] or [1.0, 1.0] for cell in cells]
            assert [bar[:, 1].tolist() for bar in bars.get_segments()] == [pytest.approx(end) for end in ends]
    page = (report.run.path / "report.md").read_text()
    assert page.count("Modelled (virtual clock) and measured (wall clock).") == 3, "what a run on two clocks shows"


@pytest.mark.parametrize(
    ("cells", "shown"),
    [
        ([("adsc", 50.0, 1.0, 24), ("adsc", 50.0, 0.5, 4), ("adsc", 90.0, 0.1, 24)], ["24 rounds", "ADSC at 50x"]),
        ([("adsc", 50.0, 1.0, 2), ("adsc", 50.0, 1.0, 1), ("adsc", 50.0, 1.0, 24)], ["2 rounds", "ADSC at 50x"]),
        ([("adsc", 10.0, 1.0, 4), ("adsc", 50.0, 1.0, 4), ("tcsc", 5.0, 1.0, 4), ("tcsc", 2.0, 1.0, 4)],
         ["4 rounds", "ADSC at 50x", "TCSC at 5x"]),
    ],
)  # fmt: skip
def test_figure_3_is_of_the_longest_t_move_then_near_four_rounds_then_of_the_fastest(
    cells: list[Any], shown: list[str], tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """The run flew no other cells; a game that failed is none."""
    rows = [line_row("game", "adsc", 90.0, 0, 0.0, error="crashed")]
    rows += [line_row("game", name, clock, 0, 0.0, t_move_s=t, rounds=rounds) for name, clock, t, rounds in cells]
    dp1.trajectory_figure(report_of(tmp_path / "run", rows))
    labels = labelled(drawn[FIGURES[1]].axes[0])
    assert headline(drawn[FIGURES[1]])[0] == f"Trajectories, {shown[0]}, T_move 1 s"
    assert sorted({label.partition(",")[0] for label in labels}) == shown[1:]
    assert all(label.endswith(" of 1: STLC -") for label in labels)


def test_a_run_of_few_games_has_a_whole_report(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """One of equal replicas shows them; a run whose only game failed has notes in place of figures."""
    report_of(tmp_path / "equal", [REFERENCE, *ALIKE]).write()
    labels = ["ADSC at 1x, reference", f"TCSC at 50x, worst of 3: STLC {1 + np.exp(-0.1):.3f}"]
    assert list(labelled(drawn[FIGURES[1]].axes[0])) == labels
    page = (tmp_path / "equal/report.md").read_text()
    assert "Real-time ADSC games that a cell is compared with, of the same T\\_move and rounds: 1." in page
    report_of(tmp_path / "failed", [ALIKE[0] | {"error": "crashed"}]).write()
    nothing = (
        "no flight recorded",
        "",
        "no trace recorded",
        "no games to compare",
        "no speed-up without ADSC games at 1x",
    )
    assert tuple("".join(texts(drawn[name].axes[0])) for name in FIGURES) == nothing


SLICE = [
    *("client call continue", "server handle continue", "server run"),
    *("server end", "server pause", "client return continue"),
]
MOVE = ["client call move", "server handle move", *SLICE, "client return move"]
ASKED = ["client call ask", "server handle ask", "client return ask"]


@pytest.mark.parametrize(
    ("events", "arrows", "spans"),
    [
        (MOVE, [(0, 1), (2, 3), (5, 7), (5, 8)], [(4, 6)]),
        (ASKED * 2, [(0, 1), (1, 2), (3, 4), (4, 5)], [(0, 5)]),
        ([*SLICE, *SLICE, *ASKED], [(0, 1), (3, 5), (6, 7), (9, 11), (12, 13), (13, 14)], [(2, 4), (8, 10)]),
        (SLICE[3:], [], [(0, 1)]),
        (MOVE[:6], [(0, 1), (2, 3)], [(4, 5)]),
    ],
)
def test_figure_4_shows_the_recorded_messages(
    events: list[str], arrows: list[Any], spans: list[Any], tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """Answers leave where their work ended, and time runs up to a pause; events are 0.1 ms apart, a slice is 1 s."""
    report, trace = report_of(tmp_path / "run", [ALIKE[0]], timing="wall"), list[dict[str, Any]]()
    for place, event in enumerate(events):
        source, _, name = event.partition(" ")
        simulated_s = 7.0 + ("server end" in events[: place + 1])
        trace.append({"source": source, "event": name, "wall_s": 5 + place * 1e-4, "sim_s": simulated_s})
    report.run.write_json("traces/tcsc.json", trace)
    report.run.write_json("traces/adsc.json", [{**trace[0], "source": "server", "event": "run"}] * 53)
    dp1.trellis_figure(report)
    tcsc, adsc = drawn["figure4_trellis"].axes
    found: list[Any] = [text for text in tcsc.texts if not text.get_text()]
    at = [float(event.startswith("server")) for event in events]
    assert sorted((arrow.xyann, arrow.xy) for arrow in found) == sorted(((at[a], a), (at[b], b)) for a, b in arrows)
    assert len({(arrow.arrow_patch.get_edgecolor(), arrow.xy[0]) for arrow in found}) <= 2, "calls and answers"
    running = [points(line) for line in tcsc.lines if line.get_linewidth() > 2]
    assert running == [[(1.0, start), (1.0, end)] for start, end in spans]
    assert len(texts(adsc)) == 2 + 44, "a longer trace is cut"
    assert adsc.get_ylim()[0] > 43 > adsc.get_ylim()[1], "time runs downwards"
    assert headline(drawn["figure4_trellis"]) == ("Messages of one command", "")
    if events == MOVE:
        assert [text.strip() for text in texts(tcsc) if text] == [
            *("client", "server", "move   0.00 ms", "0.000 s", "continue   0.20 ms", "0.000 s", "0.000 s   run"),
            *("1.000 s   end", "1.000 s   pause", "0.70 ms", "0.80 ms"),
        ]


@pytest.mark.parametrize(
    ("damaged", "complaint"),
    [
        ("no JSON", "not JSON"),
        ("[]", "List should have at least 1 item"),
        ('[{"event": "run"}]', "key '0.source' is missing"),
    ],
)
def test_a_damaged_trace_is_the_users_mistake(damaged: str, complaint: str, tmp_path: Path) -> None:
    report = report_of(tmp_path / "run", [REFERENCE])
    report.run.write_text("traces/tcsc.json", damaged)
    with pytest.raises(UserError, match=rf"tcsc\.json: {complaint}"):
        dp1.trellis_figure(report)


# --- the page -----------------------------------------------------------------------------------------------------


def test_the_page_warns_and_has_figures_tables_and_provenance(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    lost_s = (0.25, 0.125, 0.0)
    rows = [line_row("game", "tcsc", 50.0, i, 0.0, timing="wall", lost_wall_s=s) for i, s in enumerate(lost_s)]
    rows[2]["error"] = "the drone crashed"
    rows[1]["disturbed"] = True
    report = report_of(tmp_path / "run", rows)
    report.write()
    page = (report.run.path / "report.md").read_text()
    assert page.startswith("# DP1, native profile, seed 7\n\n2 games, none of them accelerated and comparable")
    assert "Measured (wall clock): 3 games · native profile · seed 7 · 1 of 3 games disturbed\n" in page
    warnings = ["1 games failed", "the machine could not keep up and lost 0.375 s", "1 games were disturbed", "some"]
    found = [line.removeprefix("Warning: ") for line in page.splitlines() if "Warning" in line]
    assert [line[: len(start)] for line, start in zip(found, warnings, strict=True)] == warnings
    pictures = [line for line in page.splitlines() if line.startswith("![")]
    assert [line.rpartition("](")[2] for line in pictures] == [f"figures/{name}.png)" for name in FIGURES]
    assert all(line.index("]") > 30 for line in pictures), "each says what is seen"
    assert page.count("| TCSC | 50x | measured | 1 | 1 | 2 | 1 | 1 | - | - | - | - | 50.00 | - |") == 2
    assert '"host": "synthetic"' in page


def cells_of(*cells: tuple[Any, ...]) -> Any:
    """A report whose summary has these cells: command, ClockSpeed, STLC, error, speed-up, and the timing if another."""
    names = ("command", "clock_speed", "stlc_median", "position_rmse_m", "effective_speedup")
    found = []
    for *values, timing in [(*cell, "virtual")[:6] for cell in cells]:
        other = {"t_move_s": 0.5, "rounds": 4, "games": 4, "failed_games": 0, "timing": timing}
        other |= {"provenance": "measured" if timing == "wall" else "modelled", "effective_speedup_provenance": None}
        cell = dict(zip(names, values, strict=True)) | other
        found.append({**cell, "position_rmse_vs_lockstep_m": 0.0, "real_time_factor": values[1] - 0.25})
    return SimpleNamespace(summary={"cells": found})


def test_overview_and_headline_are_of_each_commands_cells() -> None:
    """As in real time up to the last ClockSpeed before a cell that is not; error and speed-up are at the fastest."""
    report = cells_of(
        *(("tcsc", 5.0, 1.5, 0.3, 4.0), ("tcsc", 10.0, 1.9, 0.004, 8.0), ("adsc", 1.0, 1.0, 5.0, 1.0)),
        *(("adsc", 2.0, 1.9, 0.1, 2.0), ("adsc", 5.0, 1.81, 0.2, 4.0), ("adsc", 10.0, 1.99, 0.9, 8.0)),
        *(("adsc", 10.0, 1.8, 0.9, 8.0), ("adsc", 50.0, 1.9, 0.25, 30.0), ("adsc", 50.0, 1.9, 0.125, 20.0)),
        ("adsc", 100.0, 0.1, 9.0, 99.0, "lockstep"),
    )
    assert Dp1().headline(report) == (
        "At 50x ADSC strays up to 0.25 m (RMSE; median STLC 1.90, above 1.8 counts as alike). At 10x TCSC strays up to "
        "0.004 m (RMSE; median STLC 1.90, above 1.8 counts as alike). Speed-up over real time: ADSC 20 to 30, "
        "TCSC 8"
    )
    same = cells_of(("adsc", 50.0, 1.66, 2.8512, 40.0), ("tcsc", 50.0, 2.0, 0.0, 45.25))
    assert Dp1().headline(same) == (
        "At 50x ADSC strays up to 2.85 m (RMSE; median STLC 1.66, above 1.8 counts as alike). TCSC is identical to "
        "real time. Speed-up over real time: ADSC 40, TCSC 45.2"
    )
    few = cells_of(("adsc", 1.0, 2.0, 0.0, 1.0), ("adsc", 5.0, None, 0.0, 1.0))
    assert Dp1().headline(few) == "8 games, none of them accelerated and comparable with real time"
    wall = [("tcsc", 5.0, *numbers, "wall") for numbers in ((1.99, 0.01, 3.0), (1.8, 0.5, 4.0), (None, None, None))]
    few.summary["cells"] += cells_of(*wall).summary["cells"]
    few.summary["cells"][-1] |= {"rounds": 8, "disturbed_games": 2, "effective_speedup_provenance": "mixed"}
    path = ("0.5", "4", "4", "0", "0")
    assert Dp1().overview(few).rows == [
        ["ADSC", "1x", "modelled", *path, "2.000", "0", "0", "1.00", "0.75", "-"],
        ["ADSC", "5x", "modelled", *path, "-", "0", "0", "1.00", "4.75", "-"],
        ["TCSC", "5x", "measured", "0.5", "4 to 8", "4", "0", "0 to 2", "1.800 to 1.990", "0.01 to 0.5",
         "0", "3.00 to 4.00", "4.75", "mixed"],
    ]  # fmt: skip


def test_a_flight_has_the_commands_of_its_path(tmp_path: Path) -> None:
    rows = [line_row("game", "tcsc", 50.0, 0, 0.1), line_row("figure2", "adsc", 5.0, 0, 0.2)]
    report = report_of(tmp_path / "run", rows, speed_m_s=2.0)
    square, forward = (Dp1().flight(report, game) for _, game in report.games.iterrows())
    assert (square.title, square.clock_speed, square.position_m[0, 1]) == ("TCSC at 50x", 50.0, 0.1)
    assert square.commands.velocity_m_s.tolist() == [[2, 0, 0], [0, 2, 0], [-2, 0, 0], [0, -2, 0]]
    assert square.commands.end_ns.tolist() == [second * 10**9 for second in (1, 2, 3, 4)]
    assert forward.commands.velocity_m_s.tolist() == [[2, 0, 0], [2, 0, 0], [-2, 0, 0]]


@pytest.mark.parametrize(
    ("row", "restarts", "marks"),
    [
        ({"lost_wall_s": 0.0, "restarts": 0}, 0, {}),
        *((row, 0, {"disturbed": True}) for row in ({"lost_wall_s": 0.25}, {"stalled_wall_s": 0.5}, {"restarts": 1})),
        ({"lost_wall_s": 0.0}, 2, {"restarts": 2, "disturbed": True}),
    ],
)
def test_a_measured_game_is_marked_by_what_disturbed_it(row: dict[str, Any], restarts: int, marks: Any) -> None:
    assert disturbances(row, restarts) == marks
