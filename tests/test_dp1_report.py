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
from uavaccel.draw import style
from uavaccel.draw.page import Table
from uavaccel.errors import UserError
from uavaccel.suites import dp1
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.rows import disturbances
from uavaccel.suites.trellis import trellis_figure

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
STLC = f"STLC {1 + np.exp(-0.1):.3f}"


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


def bootstrapped(*samples: Any, of: Any = lambda drawn: np.median(drawn, axis=1)) -> Any:
    """The interval of a statistic over resampled games, the samples drawn one after another."""
    rng = np.random.default_rng(SEED)
    drawn = [np.array(sample)[rng.integers(len(sample), size=(2000, len(sample)))] for sample in samples]
    found = of(*drawn).tolist()
    return pytest.approx([quantile(found, 0.025), quantile(found, 0.975)])


def test_every_number_of_a_cell(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    report = report_of(tmp_path / "run", cell_rows())
    aside_m = np.abs(np.subtract.outer(GAMES_M, REFERENCES_M))
    stlc, rmse_m = (1 + np.exp(-aside_m)).mean(axis=1), aside_m.mean(axis=1)
    speedups = bootstrapped(REFERENCE_WALL_S, WALL_S, of=lambda base, own: base.mean(axis=1) / own.mean(axis=1))
    reference = {"command": "adsc", "clock_speed": 1.0, "timing": "virtual", "provenance": "modelled", "games": 3}
    expected = {
        "command": "tcsc", "clock_speed": 50.0, "t_move_s": 1.0, "rounds": 1, "timing": "wall",
        "games": 4, "failed_games": 1, "distinct_games": 4, "provenance": "measured", "seed": SEED,
        "reference": {**reference, "is_this_cell": False}, "effective_speedup_provenance": "mixed",
        "stlc_median_interval": bootstrapped(stlc), "position_rmse_interval_m": bootstrapped(rmse_m),
        "effective_speedup_interval": speedups,
    }  # fmt: skip
    near = {
        "stlc_median": quantile(stlc.tolist(), 0.5),
        "stlc_q25": quantile(stlc.tolist(), 0.25),
        "stlc_q75": quantile(stlc.tolist(), 0.75),
        "position_rmse_m": quantile(rmse_m.tolist(), 0.5),
        "position_rmse_vs_lockstep_m": quantile(np.abs(np.array(GAMES_M) - 0.6).tolist(), 0.5),
        "duration_error_s": quantile([4.0 + sum(gaps) for gaps in GAPS_S], 0.5) - (4.0 + 4.01 + 4.02) / 3,
        "command_gap_median_s": 0.065,  # of twelve: between 0.06 and 0.07
        "command_gap_q95_s": quantile([gap for gaps in GAPS_S for gap in gaps], 0.95),
        "effective_speedup": (13.3 / 3) / (0.51 / 4),
        "real_time_factor": 183.0 / 4,
        "lost_wall_s": 0.35,
    }
    cell = find(report.summary, command="tcsc", t_move_s=1.0)
    assert cell == expected | {key: pytest.approx(value) for key, value in near.items()}
    assert [report.summary[key] for key in ("suite", "profile", "seed")] == ["dp1", "native", SEED]
    own = report.scores[(report.scores.command == "tcsc") & (report.scores.clock_speed == 50.0)]
    assert own.stlc.dropna().tolist() == pytest.approx(stlc.tolist())
    *_, table = Dp1().page(report)
    assert isinstance(table, Table)
    assert table.rows[-1] == (
        *("TCSC", "50x", "1", "1", "4 (1 failed)"),
        f"{near['stlc_median']:.3f} [{near['stlc_q25']:.3f}, {near['stlc_q75']:.3f}]",
        *(f"{near['position_rmse_m']:.3f}", "0.300", f"{near['duration_error_s']:+.3f}", "34.77 (mixed)", "45.75"),
        "measured",
    )


def test_intervals_are_of_the_runs_seed(tmp_path: Path) -> None:
    """Of so many games that two seeds give two intervals."""
    aside_m = np.linspace(0.0, 1.0, 25) ** 2
    rows = [line_row("game", "tcsc", 5.0, game, offset_m) for game, offset_m in enumerate(aside_m)]
    cell = find(report_of(tmp_path / "run", [REFERENCE, *rows]).summary, command="tcsc")
    assert cell["position_rmse_interval_m"] == bootstrapped(aside_m)
    assert cell["stlc_median_interval"] == bootstrapped(1 + np.exp(-aside_m))


def test_references_are_a_cell_of_their_own_and_not_compared_with_themselves(tmp_path: Path) -> None:
    summary = report_of(tmp_path / "run", cell_rows()).summary
    cell = find(summary, command="adsc", t_move_s=1.0, rounds=1, timing="virtual")
    pairs = [(0.2, 0.5), (0.2, 0.3), (0.5, 0.3)]
    stlc = [1 + (np.exp(-a) + np.exp(-b)) / 2 for a, b in pairs]
    assert (cell["reference"]["is_this_cell"], cell["games"], cell["provenance"]) == (True, 3, "modelled")
    assert cell["position_rmse_m"] == pytest.approx(quantile([(a + b) / 2 for a, b in pairs], 0.5))
    assert [cell["stlc_q25"], cell["stlc_q75"]] == pytest.approx([quantile(stlc, 0.25), quantile(stlc, 0.75)])
    assert cell["position_rmse_vs_lockstep_m"] == pytest.approx(0.15)  # the lockstep game of its own command
    assert (cell["effective_speedup"], cell["effective_speedup_interval"]) == (1.0, None)
    assert cell["effective_speedup_provenance"] == "modelled"
    lone = find(summary, command="adsc", t_move_s=0.5)
    assert (lone["games"], lone["stlc_median"], lone["stlc_median_interval"]) == (1, None, None)


def test_numbers_without_references_lockstep_or_games_are_unknown(tmp_path: Path) -> None:
    (cell,) = report_of(tmp_path / "alone", ALIKE).summary["cells"]
    assert {key for key, value in cell.items() if value is None} == {
        "reference", "stlc_median", "stlc_q25", "stlc_q75", "stlc_median_interval", "position_rmse_m",
        "position_rmse_interval_m", "position_rmse_vs_lockstep_m", "duration_error_s", "effective_speedup",
        "effective_speedup_interval", "effective_speedup_provenance",
    }  # fmt: skip
    assert cell["distinct_games"] == 1
    (cell,) = report_of(tmp_path / "failed", [ALIKE[0] | {"error": "crashed"}]).summary["cells"]
    assert [cell[key] for key in ("games", "failed_games", "real_time_factor", "lost_wall_s")] == [0, 1, None, None]
    with pytest.raises(UserError, match=r"rows\.jsonl: holds no finished game of dp1"):
        report_of(tmp_path / "none", [])
    lost = report_of(tmp_path / "lost", ALIKE)
    (lost.run.path / lost.games.arrays[0]).unlink()
    with pytest.raises(UserError, match=ALIKE[0]["case"]):
        lost.write_summary()


def test_summaries_are_the_same_in_any_order_and_number_of_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, written = accelerated_rows(), set()
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
    assert {name: points(line)[0] for name, line in labelled(slow_axes).items()} == {
        "north": (0.0, 0.5), "down": (0.0, -0.2),
    }, "east is never above 5 cm/s"  # fmt: skip
    assert [round(gap.get_width(), 9) for gap in fast_axes.patches] == gaps_s  # type: ignore[attr-defined]
    assert [round(points(line)[0][0], 9) for line in fast_axes.lines[:4]] == [1.0, 2.01, 3.03, 4.09], "commands end"
    assert legend_texts(figure.legends[0]) == ["north", "down", "command ends", "no command runs"]
    source = f"modelled (virtual clock): 1 game · measured (wall clock): 1 game · native profile · seed {SEED}"
    assert headline(figure) == ("Two steps forward, one back", source)
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
    for panel, factor in ((1, 1), (2, 1), (4, 3)):  # ADSC at 10x and 100x, TCSC at 10x
        for place, paths in enumerate([(0, 2), (1, 3)]):  # 1 round, 24 rounds: both T_moves each
            aside_m = [0.01 * (1 + path) * (game + 1) ** 2 * factor for path in paths for game in range(3)]
            stlc, box = (1 + np.exp(-np.array(aside_m))).tolist(), boxes(accuracy.axes[panel])[place]
            assert (box["median"], *box["box"]) == pytest.approx([quantile(stlc, share) for share in (0.5, 0.25, 0.75)])
            assert box["colour"] == (style.BLUE if factor == 3 else style.VERMILION).lower()
    assert texts(accuracy.axes[5]) == ["no games to compare"]
    assert [axes.get_title("center") for axes in accuracy.axes] == ["1x", "10x", "100x", "", "", ""]
    assert [axes.get_ylabel() for axes in accuracy.axes[::3]] == ["ADSC\nSTLC", "TCSC\nSTLC"]
    assert tick_texts(accuracy.axes[3].xaxis) == ["1", "24"]
    for axes in accuracy.axes:
        assert points(axes.lines[0])[0][1] == 1.8
        assert axes.get_ylim() == pytest.approx((min(1.7, 1 + np.exp(-1.08) - 0.05), 2.04))
    assert headline(speedup) == ("Effective speed-up over ADSC at 1x, 24 rounds", clocks.format(16, 6, "s"))
    for axes, command, speeds in zip(speedup.axes, ("adsc", "tcsc"), ([1.0, 10.0, 100.0], [10.0]), strict=True):
        ideal, *lines = labelled(axes).values()
        assert list(labelled(axes)) == ["ideal", "T_move 0.5 s", "T_move 1 s"]
        assert (points(ideal), axes.get_title("left")) == ([(0, 1.0), (1, 10.0), (2, 100.0)], command.upper())
        assert (axes.get_yscale(), tick_texts(axes.xaxis)) == ("log", ["1x", "10x", "100x"])
        for t_move_s, line in zip((0.5, 1.0), lines, strict=True):
            line, _, (bars,) = line.lines
            # Games of ClockSpeed k take 1.5, 1.6 and 1.7 times the k-th part of what the references take.
            assert line.get_xdata().tolist() == ([0, 1, 2] if command == "adsc" else [1])
            assert line.get_ydata().tolist() == pytest.approx([k / 1.6 if k > 1 else 1.0 for k in speeds])
            key = {"command": command, "t_move_s": t_move_s, "rounds": 24}
            cells = [find(report.summary, **key, clock_speed=k) for k in speeds]
            ends = [cell["effective_speedup_interval"] or [1.0, 1.0] for cell in cells]
            assert [bar[:, 1].tolist() for bar in bars.get_segments()] == [pytest.approx(end) for end in ends]
    page = (report.run.path / "report.md").read_text()
    assert all(f"Source: {headline(drawn[name])[1]}." in page for name in FIGURES)


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
    assert list(labelled(drawn[FIGURES[1]].axes[0])) == [f"{command} at {clock_speed:g}x, one game: STLC unknown"]


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
    notes = {name: texts(drawn[name].axes[0]) for name in FIGURES}
    assert (notes["figure4_trellis"], notes["figure2_velocity"]) == (["no trace recorded"], ["no flight recorded"])
    if REFERENCE not in rows:
        assert notes["figure6_speedup"] == ["no speed-up without ADSC games at 1x"]
    if labels:
        assert drawn["figure5_accuracy"].axes[0].get_ylim() == pytest.approx((1.7, 2.04))


CALLED, RETURNED = ["client call move", "server handle move"], "client return move"
SLICE = [
    *("client call continue", "server handle continue", "server run"),
    *("server end", "server pause", "client return continue"),
]
ASKED = ["client call ask", "server handle ask", "client return ask"]


@pytest.mark.parametrize(
    ("events", "arrows", "spans"),
    [
        ([*CALLED, *SLICE, RETURNED], [(0, 1), (2, 3), (5, 7), (5, 8)], [(4, 6)]),
        (ASKED * 2, [(0, 1), (1, 2), (3, 4), (4, 5)], [(0, 5)]),
        (
            [*CALLED, *SLICE, *SLICE, RETURNED, *ASKED],
            [(0, 1), (2, 3), (5, 7), (8, 9), (11, 13), (11, 14), (15, 16), (16, 17)],
            [(4, 6), (10, 12)],
        ),
        (SLICE[3:], [], [(0, 1)]),
        ([*CALLED, *SLICE[:4]], [(0, 1), (2, 3)], [(4, 5)]),
    ],
)
def test_figure_4_shows_the_recorded_messages(
    events: list[str], arrows: list[Any], spans: list[Any], tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """Answers leave where their work ended, and time runs up to a pause; events are 0.1 ms apart, a slice is 1 s."""
    report = report_of(tmp_path / "run", [ALIKE[0] | {"timing": "wall"}, REFERENCE])
    trace = [
        dict(zip(("source", "event"), event.split(" ", 1), strict=True), wall_s=5 + place * 1e-4, sim_s=7.0)
        for place, event in enumerate(events)
    ]
    for event in trace[events.index("server end") :] if "server end" in events else ():
        event["sim_s"] = 8.0
    report.run.write_json("traces/tcsc.json", trace)
    report.run.write_json("traces/adsc.json", [{**trace[0], "source": "server", "event": "run"}] * 53)
    picture, figure = trellis_figure(report), drawn["figure4_trellis"]
    tcsc, adsc = figure.axes
    drawn_arrows: list[Any] = [text for text in tcsc.texts if not text.get_text()]
    at = [float(event.startswith("server")) for event in events]
    assert [(a.xyann, a.xy) for a in drawn_arrows] == [((at[a], a), (at[b], b)) for a, b in arrows]
    assert len({(arrow.arrow_patch.get_edgecolor(), arrow.xy[0]) for arrow in drawn_arrows}) <= 2, "calls and answers"
    running = [points(line) for line in tcsc.lines if line.get_linewidth() > 2]
    assert running == [[(1.0, start), (1.0, end)] for start, end in spans]
    assert len(texts(adsc)) == 2 + 44, "a longer trace is cut"
    assert adsc.get_ylim()[0] > 43 > adsc.get_ylim()[1], "time runs downwards"
    assert [axes.get_title("left") for axes in figure.axes] == ["TCSC", "ADSC"]
    assert legend_texts(figure.legends[0]) == ["call", "answer", "simulated time runs"]
    source = "one recorded command each · measured (wall clock) · native profile · seed 7"
    assert (headline(figure)[1], picture.caption.endswith(f"Source: {source}.")) == (source, True)
    if len(events) == 9:
        assert [text for text in texts(tcsc) if text] == [
            *("client", "server", "move   0.00 ms", "0.000 s", "continue   0.20 ms", "0.000 s", "0.000 s   run"),
            *("1.000 s   end", "1.000 s   pause", "0.70 ms", "0.80 ms"),
        ]
        assert [text.get_position()[1] for text in tcsc.texts[-9:]] == list(range(9))


@pytest.mark.parametrize(
    ("damaged", "complaint"),
    [("no JSON", "not JSON"), ("[]", "holds no event"), ('[{"event": "run"}]', "key '0.source' is missing")],
)
def test_a_damaged_trace_is_the_users_mistake(damaged: str, complaint: str, tmp_path: Path) -> None:
    report = report_of(tmp_path / "run", [REFERENCE])
    report.run.write_text("traces/tcsc.json", damaged)
    with pytest.raises(UserError, match=rf"tcsc\.json: {complaint}"):
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
    warnings = ["1 games failed", "the machine could not keep up and lost 0.375 s", "1 games were disturbed", "some"]
    found = [line.removeprefix("Warning: ") for line in page.splitlines() if "Warning" in line]
    assert [line[: len(start)] for line, start in zip(found, warnings, strict=True)] == warnings
    pictures = [line for line in page.splitlines() if line.startswith("![")]
    assert pictures == [f"![{name}](figures/{name}.png)" for name in FIGURES]
    assert "| TCSC | 50x | 2 (1 disturbed) | - | - | - | - | 50.00 | measured |" in page
    assert "| TCSC | 50x | 1 | 1 | 2 (1 failed) (1 disturbed) | - | - | - | - | - | 50.00 | measured |" in page
    assert '"host": "synthetic"' in page
    assert html.count("data:image/png;base64,") == len(FIGURES)


def flown(command: str, clock_speed: float, stlc: Any, error_m: Any, speedup: Any, timing: str = "virtual") -> Any:
    """A cell of a summary."""
    return {
        "command": command, "clock_speed": clock_speed, "timing": timing, "stlc_median": stlc, "games": 4,
        "position_rmse_m": error_m, "position_rmse_vs_lockstep_m": error_m, "effective_speedup": speedup,
        "effective_speedup_provenance": "mixed" if timing == "wall" else None, "real_time_factor": clock_speed - 0.25,
        "provenance": "measured" if timing == "wall" else "modelled",
    }  # fmt: skip


def test_overview_and_headline_are_of_each_commands_worst_cells(tmp_path: Path) -> None:
    """As in real time up to the last ClockSpeed before a cell that is not; error and speed-up are at the fastest."""
    cells = [
        *(flown("tcsc", 5.0, 1.5, 0.3, 4.0), flown("tcsc", 10.0, 1.9, 0.004, 8.0)),
        *(flown("adsc", 1.0, 1.0, 5.0, 1.0), flown("adsc", 2.0, 1.9, 0.1, 2.0)),
        *(flown("adsc", 5.0, 1.81, 0.2, 4.0), flown("adsc", 5.0, 1.95, 0.2, 4.5)),
        *(flown("adsc", 10.0, 1.99, 0.9, 8.0), flown("adsc", 10.0, 1.8, 0.9, 8.0)),
        *(flown("adsc", 50.0, 1.9, 0.25, 30.0), flown("adsc", 50.0, 1.9, 0.125, 20.0)),
        flown("adsc", 100.0, 0.1, 9.0, 99.0, "lockstep"),
    ]
    report: Any = SimpleNamespace(summary={"cells": cells})
    assert Dp1().headline(report) == (
        "ADSC flies as in real time up to 5x (STLC above 1.8); at 50x it is up to 0.250 m off (RMSE) and 20.00 to "
        "30.00 times as fast; TCSC no longer flies as in real time at 5x (STLC above 1.8); at 10x it is up to 4.0e-03 "
        "m off (RMSE) and 8.00 times as fast (modelled)"
    )
    report.summary["cells"] = [flown("adsc", 1.0, 2.0, 0.0, 1.0), flown("adsc", 5.0, None, 0.0, 1.0)]
    assert Dp1().headline(report) == "8 games, none of them accelerated and comparable with real time"
    report.summary["cells"] += [flown("tcsc", 5.0, 1.99, 0.01, 3.0, "wall"), flown("tcsc", 5.0, 1.8, 0.5, 4.0, "wall")]
    report.summary["cells"] += [flown("tcsc", 5.0, None, None, None, "wall")]
    assert Dp1().overview(report).rows == [
        ("ADSC", "1x", "4", "2.0000", "0", "0", "1.00", "0.75", "modelled"),
        ("ADSC", "5x", "4", "-", "0", "0", "1.00", "4.75", "modelled"),
        ("TCSC", "5x", "12", "1.8000", "0.500", "0.500", "3.00 to 4.00 (mixed)", "4.75", "measured"),
    ]


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
