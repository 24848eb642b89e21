"""Figures of the RL experiment: each number where it belongs, the paper's beside it, rows of obstacles marked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.drawing import headline, labelled, points
from uavaccel.suites.rl.figures import (
    SuccessLine,
    plot_distances,
    plot_success,
    plot_success_over_gap,
    plot_training_time,
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
