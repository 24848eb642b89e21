"""Figures against small asymmetric examples: the numbers drawn, where, in which colour, what they are called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.text import Text

from uavaccel.draw import page, style
from uavaccel.draw.style import save
from uavaccel.suites import plots

# --- trajectories in space -----------------------------------------------------------------------------------


def space(*flights_m: Any) -> Any:
    axes: Any = style.new_figure(6.0, "A title").add_subplot(projection="3d")
    for number, (north, east, down) in enumerate(flight.T for flight in flights_m):
        axes.plot(north, east, -down, label=str(number))
    style.space(axes, flights_m)
    return axes


def test_trajectories_are_drawn_at_one_scale_with_height_upwards() -> None:
    first = np.array([[0.0, 1.0, -10.0], [2.0, 1.5, -10.1]])
    second = np.array([[0.5, 4.0, -10.2], [1.0, 2.0, -10.0], [0.0, 2.0, -10.0]])
    axes = space(first, second)
    assert [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()] == ["north x, m", "east y, m", "height −z, m"]
    # East spans 3 m and north 2: both are shown at one scale, 5 % wider than the longer; height at least 50 cm.
    limits = [axis.get_view_interval() for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
    np.testing.assert_allclose(limits, [[1 - 1.575, 1 + 1.575], [2.5 - 1.575, 2.5 + 1.575], [9.85, 10.35]])


@pytest.mark.parametrize("size_m", [0.001, 0.8, 40.0])
def test_ticks_of_trajectories_keep_clear_of_the_common_corner(size_m: float) -> None:
    axes = space(size_m * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        low, high = axis.get_view_interval()
        ticks = axis.get_majorticklocs()
        assert 2 <= len(ticks) <= 6
        assert low + 0.08 * (high - low) <= ticks[0] < ticks[-1] <= high
    assert np.diff(axes.xaxis.get_view_interval()) == pytest.approx(max(size_m, 0.2) * 1.05)


# --- style --------------------------------------------------------------------------------------------------


def test_equal_figures_are_equal_files_and_leave_no_style_behind(tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    for name in ("a/one.png", "b/two.png"):
        figure = style.new_figure(3.0, "A title", "from")
        assert save(figure, tmp_path / name) == tmp_path / name
    assert dict(mpl.rcParams) == before
    one, two = ((tmp_path / name).read_bytes() for name in ("a/one.png", "b/two.png"))
    assert one == two
    assert b"Software" not in one
    image = cv2.imread(str(tmp_path / "a/one.png"))
    assert image is not None
    assert image.shape[:2] == (600, 1280)
    assert np.mean(np.any(image != 255, axis=-1)) > 0.002


@pytest.mark.parametrize("count", [0, 1, 5, 12])
def test_no_figure_is_wider_than_1280_pixels_whatever_it_shows(count: int, tmp_path: Path) -> None:
    """Letters are of one size in all, so that a phone's 366 pixels leave them 7 high at least."""
    with style.project_style():
        figure, grid = plots.panels(count, "A title that would not fit on a single line " * 3, 1.2, source="from " * 50)
        for axes in grid:
            axes.plot([0, 1], label=f"a label of some length {count}")
        style.legend(figure, {f"another one, number {number}": style.LIMIT for number in range(9)})
        image = cv2.imread(str(save(figure, tmp_path / "one.png")))
        sizes = [float(text.get_fontsize()) for text in figure.findobj(Text) if text.get_text()]
    assert image is not None
    assert image.shape[1] == 1280
    assert min(sizes) / 72 / style.WIDTH_IN * 366 > 7


def test_survival_reaches_to_the_lanes_end() -> None:
    distances_m, share = style.survival([30.0, 200.0, 10.0, 20.0], 150.0)
    assert (distances_m.tolist(), share.tolist()) == ([0, 10, 20, 30, 150], [1.0, 0.75, 0.5, 0.25, 0.0])


def test_words_and_colours_of_all_figures() -> None:
    assert [page.clock_label(clock) for clock in (1.0, 1.5, 100.0)] == ["1x", "1.5x", "100x"]
    assert [page.counted(rounds, "round") for rounds in (1, 2, 24)] == ["1 round", "2 rounds", "24 rounds"]
    assert page.command_name("adsc") == "ADSC"
    assert len(set(style.CYCLE)) == len(style.CYCLE)
    assert not set(style.CYCLE) & set(style.COMMAND_COLOUR.values()), "the commands' colours mean nothing else"
    assert (style.COMMAND_COLOUR["adsc"], style.COMMAND_COLOUR["tcsc"]) == (style.VERMILION, style.BLUE)
