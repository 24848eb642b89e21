"""Figures of the RL experiment: each number where it belongs, the paper's beside it, rows of obstacles marked."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from tests.drawing import headline, labelled, points
from uavaccel.suites.rl.figures import (
    SuccessLine,
    distances_m,
    plot_distances,
    plot_success,
    plot_success_over_gap,
    plot_training_time,
    success_lines,
)

PHASES = {
    "simulation": 5000.0,
    "rendering": 400.0,
    "image_processing": 36.0,
    "inference": 72.0,
    "learning": 144.0,
}
SPEEDUPS = (
    "training_speedup",
    "whole_training_speedup",
    "paper_training_speedup",
    "paper_whole_training_speedup",
)


def pooled(faster: float, *speedups: float | None) -> dict[str, Any]:
    """Two seeds whose phases take a share of the time."""
    phase_s = {phase: 2 * spent_s / faster for phase, spent_s in PHASES.items()}
    return {"seeds": [0, 1], "phase_s": phase_s, **dict(zip(SPEEDUPS, speedups, strict=True))}


def test_success_has_a_place_per_clock_speed_an_interval_and_a_dot_per_seed() -> None:
    intervals = [(0.3, 0.7), (0.2, 0.3)]
    line = SuccessLine("TCSC", "tcsc", [1.0, 100.0], [0.5, 0.25], intervals, [[0.4, 0.6], [0.25]])
    figure = plot_success([line], "Success", "modelled")
    assert headline(figure) == ("Success", "modelled")
    axes: Any = figure.axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["1x", "100x"]
    ratio, *seeds = [each for each in axes.lines if each.get_marker() in ("o", ".")]
    assert points(ratio) == [(0.0, 0.5), (1.0, 0.25)]
    assert [y for each in seeds for _, y in points(each)] == [0.4, 0.6, 0.25]
    bars = axes.collections[0].get_segments()
    assert [bar[:, 1].tolist() for bar in bars] == [pytest.approx(each) for each in intervals]


def condition(clock_speed: float, papers: int | None, won: list[int], **keys: Any) -> dict[str, Any]:
    """A cell of seeds that won so many of 40 games each; its two intervals differ."""
    games = 40 * len(won)
    ratio = sum(won) / games
    return {
        "variant": "",
        "profile": "airsim",
        "timing": "virtual",
        "command": "tcsc",
        "clock_speed": clock_speed,
        "seeds": list(range(len(won))),
        "successes_by_seed": won,
        "successes": sum(won),
        "games": games,
        "success_ratio": ratio,
        "seeds_low": ratio / 2,
        "seeds_high": (1 + ratio) / 2,
        "wilson_low": 0.9 * ratio,
        "wilson_high": 1.1 * ratio,
        "paper_successes": papers,
    } | keys


def test_a_line_has_its_seeds_and_the_papers_has_the_clock_speeds_that_the_paper_gives() -> None:
    native = condition(5.0, None, [20, 20], profile="native")
    cells = [
        condition(50.0, 14, [0, 10]),
        condition(1.0, None, [40, 20, 30]),
        condition(5.0, 30, [4]),
        native,
    ]
    ours, papers, other = success_lines(cells)
    assert (ours.label, ours.command, ours.at, ours.colour) == (
        "TCSC, airsim",
        "tcsc",
        [1.0, 5.0, 50.0],
        None,
    )
    assert ours.success == [0.75, 0.1, 0.125]
    assert ours.by_seed == [[1.0, 0.5, 0.75], [0.1], [0.0, 0.25]]
    assert ours.intervals == [(0.375, 0.875), (0.05, 0.55), (0.0625, 0.5625)]
    assert (papers.label, papers.at, papers.success) == ("TCSC, the paper's", [5.0, 50.0], [0.3, 0.14])
    wilson = [binomtest(won, 100).proportion_ci(method="wilson") for won in (30, 14)]
    assert papers.intervals == [(each.low, each.high) for each in wilson]
    assert (ours.dashed, papers.dashed) == (False, True)
    assert (other.label, other.by_seed) == ("TCSC, native", [[0.5, 0.5]])
    assert other.colour is not None


def test_distances_are_those_of_a_cells_own_trainings_with_their_own_command() -> None:
    cell = condition(5.0, None, [1, 1])
    trained = [{**cell, "training": {}, "name": name} for name in ("seed 0", "seed 1")]
    rows: Any = [
        trained[0],
        {**cell, "name": "exact"},
        {**trained[0], "clock_speed": 1.0, "name": "slow"},
        {**trained[0], "variant": "told", "name": "told"},
        trained[1],
    ]
    ends_m = {"seed 0": [9.0, 150.0], "exact": [1.0], "slow": [2.0], "told": [3.0], "seed 1": [40.0, 30.0]}
    run: Any = SimpleNamespace(
        load_arrays=lambda row: {
            "adsc_distance_m": np.zeros(2),
            "tcsc_distance_m": np.array(ends_m[row["name"]]),
        }
    )
    assert distances_m(run, rows, cell).tolist() == [9.0, 150.0, 40.0, 30.0]


def test_success_over_the_gap_has_its_points_where_the_gaps_are() -> None:
    line = SuccessLine(
        "ADSC", "adsc", [0.0, 0.9], [0.5, 0.25], [(0.3, 0.7), (0.2, 0.3)], [[0.4, 0.6], [0.25]]
    )
    axes: Any = plot_success_over_gap([line], "Success", "modelled").axes[0]
    ratio, *seeds = [each for each in axes.lines if each.get_marker() in ("o", ".")]
    assert points(ratio) == [(0.0, 0.5), (0.9, 0.25)]
    assert [point for each in seeds for point in points(each)] == [(0.0, 0.4), (0.0, 0.6), (0.9, 0.25)]
    bars = [bar[:, 1].tolist() for bar in axes.collections[0].get_segments()]
    assert bars == [pytest.approx([0.5, 0.5]), pytest.approx([0.2, 0.3])]  # none over two seeds


def test_cells_at_one_gap_have_points_without_intervals() -> None:
    line = SuccessLine("TCSC", "tcsc", [0.0, 0.0], [0.5, 0.25], [(0.3, 0.7), (0.2, 0.3)], [[0.5], [0.25]])
    axes: Any = plot_success_over_gap([line], "Success", "modelled").axes[0]
    bars = [bar[:, 1].tolist() for bar in axes.collections[0].get_segments()]
    assert bars == [pytest.approx([0.5, 0.5]), pytest.approx([0.25, 0.25])]


def test_distances_fall_at_the_rows_and_their_ends_are_counted() -> None:
    panels = {"ADSC": {1.0: [9.0, 150.0, 29.0, 29.5]}, "TCSC": {1.0: [150.0, 150.0]}}
    figure = plot_distances(panels, [10.0, 30.0], "modelled")
    upper: Any = figure.axes[0]
    curve = labelled(upper)["1x, 4 games"]
    reached = dict(points(curve))  # the share from each distance on
    assert [reached[metres] for metres in (0.0, 9.0, 29.0, 29.5)] == [1.0, 0.75, 0.5, 0.25]
    rows = [line for line in upper.lines if line.get_linestyle() == ":"]
    assert [line.get_xdata()[0] for line in rows] == [10.0, 30.0]
    ended: Any = figure.axes[2].patches[0]
    values, edges = ended.get_data()[:2]
    found = {float(edge): float(share) for edge, share in zip(edges, values, strict=False) if share}
    assert found == {8.0: 0.25, 28.0: 0.5}


def test_training_time_is_bars_by_phase_and_speed_ups_beside_the_papers() -> None:
    cells = {1.0: pooled(1.0, 1.0, 1.0, None, None), 5.0: pooled(4.0, 4.1, 3.9, 4.0, 3.6)}
    figure = plot_training_time({"TCSC": cells}, "modelled")
    bars, speeds = figure.axes
    hours = np.array([[bar.get_height() for bar in container] for container in bars.containers])
    np.testing.assert_allclose(hours[:, 0], np.array([5400.0, 36.0, 72.0, 144.0]) / 3600)
    np.testing.assert_allclose(hours[:, 1], hours[:, 0] / 4)
    shown = {name: [y for _, y in points(line) if np.isfinite(y)] for name, line in labelled(speeds).items()}
    assert shown == {
        "speed-up, simulation alone (right)": [1.0, 4.1],
        "speed-up, whole training (right)": [1.0, 3.9],
        "the paper's, simulation alone": [4.0],
        "the paper's, whole training": [3.6],
    }
