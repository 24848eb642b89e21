"""Figures against small asymmetric examples: the numbers drawn, where, in which colour, what they are called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from scipy.stats import binomtest

from tests.drawing import boxes, headline, labelled, legend_texts, points, texts, tick_texts
from uavaccel.draw import style
from uavaccel.suites.evaluation.report import plot_survival
from uavaccel.suites.old_dp1.cell_figures import plot_accuracy, plot_speedup
from uavaccel.suites.old_dp1.flight_figures import TrajectoryLine, VelocityPanel, plot_trajectories, plot_velocity
from uavaccel.suites.training.phases import PhaseTimes, plot_phases

BLUE, ORANGE, GREEN, VERMILION = "#0072b2", "#e69f00", "#009e73", "#d55e00"

# --- boxes of STLC ------------------------------------------------------------------------------------------


def test_boxes_stand_by_command_clock_speed_and_rounds() -> None:
    drawn: Any = plot_accuracy(
        {
            ("adsc", 5.0, 2): [1.7, 1.99, 1.8, 1.95],
            ("adsc", 50.0, 1): [1.6],
            ("tcsc", 5.0, 1): [2.0, 2.0],
            ("tcsc", 5.0, 2): [],
        },
        "where from",
    )
    assert headline(drawn) == ("Accuracy of the trajectories: STLC", "where from")
    adsc5, adsc50, tcsc5, tcsc50 = drawn.axes
    # Quartiles of four: 1.7 + .75 (1.8 - 1.7), halfway from 1.8 to 1.95, 1.95 + .25 (1.99 - 1.95).
    assert boxes(adsc5) == {
        1.0: {
            "box": (1.775, 1.96),
            "median": pytest.approx(1.875),
            "whiskers": [1.7, 1.99],
            "colour": VERMILION,
        }
    }
    assert [(place, box["median"]) for place, box in boxes(adsc50).items()] == [(0.0, 1.6)]
    assert boxes(tcsc5)[0.0] == {"box": (2.0, 2.0), "median": 2.0, "whiskers": [2.0, 2.0], "colour": BLUE}
    assert list(boxes(tcsc5)) == [0.0]
    assert (boxes(tcsc50), texts(tcsc50)) == ({}, ["no games to compare"])
    assert [axes.get_title("center") for axes in drawn.axes[:2]] == ["5x", "50x"]
    assert [axes.get_ylabel() for axes in (adsc5, tcsc5)] == ["ADSC\nSTLC", "TCSC\nSTLC"]
    assert [axes.get_xlabel() for axes in (tcsc5, tcsc50)] == ["rounds"] * 2
    assert tick_texts(tcsc5.xaxis) == ["1", "2"]
    for axes in drawn.axes:
        assert set(axes.lines[0].get_ydata()) == {1.8}
        assert axes.get_ylim() == pytest.approx((1.55, 2.04))
    assert texts(plot_accuracy({}, "").axes[0]) == ["no games to compare"]


def test_boxes_of_good_flights_keep_the_line_of_similarity_in_view() -> None:
    (axes, _) = plot_accuracy({("adsc", 5.0, 1): [1.99], ("adsc", 9.0, 1): [1.98]}, "").axes
    assert axes.get_ylim() == pytest.approx((1.7, 2.04))


# --- speed-ups ----------------------------------------------------------------------------------------------


def speedup_cell(
    command: str, t_move_s: float, clock_speed: float, speedup: float | None, interval: list[float] | None
) -> dict[str, Any]:
    return {
        "command": command,
        "t_move_s": t_move_s,
        "clock_speed": clock_speed,
        "effective_speedup": speedup,
        "effective_speedup_interval": interval,
    }


def test_speedups_stand_at_their_clock_speed_with_their_interval() -> None:
    drawn: Any = plot_speedup(
        [
            speedup_cell("tcsc", 0.1, 100.0, 70.0, [69.0, 90.0]),
            speedup_cell("tcsc", 0.1, 2.5, 2.0, [1.5, 2.1]),
            speedup_cell("adsc", 1.0, 1.0, 1.0, None),
            speedup_cell("adsc", 1.0, 2.5, 2.4, [2.3, 2.45]),
            speedup_cell("tcsc", 1.0, 100.0, 95.0, [94.0, 97.0]),
            speedup_cell("tcsc", 0.5, 50.0, None, None),
        ],
        "where from",
        24,
    )
    assert headline(drawn) == ("Effective speed-up over ADSC at 1x, 24 rounds", "where from")
    adsc, tcsc = drawn.axes
    assert (adsc.get_title("left"), tcsc.get_title("left")) == ("ADSC", "TCSC")
    assert list(labelled(tcsc)) == ["ideal", "T_move 0.1 s", "T_move 1 s"]
    short, long = labelled(tcsc)["T_move 0.1 s"], labelled(tcsc)["T_move 1 s"]
    assert points(short.lines[0]) == [(1, 2.0), (2, 70.0)]
    assert points(long.lines[0]) == [(2, 95.0)]
    assert [bar[:, 1].tolist() for bar in short.lines[2][0].get_segments()] == [[1.5, 2.1], [69.0, 90.0]]
    assert points(labelled(adsc)["T_move 1 s"].lines[0]) == [(0, 1.0), (1, 2.4)]
    for axes in (adsc, tcsc):
        ideal = labelled(axes)["ideal"]
        assert (points(ideal), ideal.get_linestyle()) == ([(0, 1.0), (1, 2.5), (2, 100.0)], "--")
        assert tick_texts(axes.xaxis) == ["1x", "2.5x", "100x"]
        assert axes.get_xlabel() == "ClockSpeed"
    colours = [labelled(axes)["T_move 1 s"].lines[0].get_color() for axes in (adsc, tcsc)]
    assert colours[0] == colours[1] != short.lines[0].get_color()
    assert legend_texts(adsc.get_legend()) == ["ideal", "T_move 1 s"]


def test_speedups_of_1_to_10_can_be_read() -> None:
    cells = [speedup_cell("adsc", 1.0, 1.0, 1.0, None), speedup_cell("adsc", 1.0, 100.0, 80.0, None)]
    (axes,) = (drawn := plot_speedup(cells, "", 1)).axes
    drawn.draw_without_rendering()
    assert (axes.get_yscale(), axes.get_ylabel()) == ("log", "effective speed-up")
    low, high = axes.get_ylim()
    shown = [
        text for text, y in zip(tick_texts(axes.yaxis), axes.get_yticks(), strict=True) if low <= y <= high
    ]
    assert shown == ["1x", "2x", "5x", "10x", "20x", "50x", "100x"]
    assert headline(drawn)[0].endswith("at 1x, 1 round")
    assert texts(plot_speedup([], "", 0).axes[0]) == ["no speed-up without ADSC games at 1x"]


# --- velocities ---------------------------------------------------------------------------------------------


def flight(title: str, fastest: tuple[float, float, float]) -> VelocityPanel:
    time_s = np.array([0.0, 0.5, 1.5])
    shape = np.array([[0.0], [1.0], [-0.5]])
    return VelocityPanel(title, time_s, shape * fastest, np.array([0.0, 0.7]), np.array([0.6, 1.4]))


def test_velocities_are_drawn_over_time_with_the_commands_ends() -> None:
    drawn: Any = plot_velocity(
        [flight("slow", (0.02, 0.0, 0.01)), flight("fast", (1.0, 0.04, -0.2))], "from", "A title"
    )
    assert headline(drawn) == ("A title", "from")
    slow, fast = drawn.axes
    assert (slow.get_title("left"), fast.get_title("left")) == ("slow", "fast")
    assert list(labelled(fast)) == list(labelled(slow)) == ["north", "down"]  # east is never above 5 cm/s
    assert points(labelled(fast)["north"]) == [(0.0, 0.0), (0.5, 1.0), (1.5, -0.5)]
    assert points(labelled(fast)["down"]) == [(0.0, 0.0), (0.5, -0.2), (1.5, 0.1)]
    assert points(labelled(slow)["north"]) == [(0.0, 0.0), (0.5, 0.02), (1.5, -0.01)]
    assert [labelled(fast)[name].get_color().lower() for name in ("north", "down")] == [BLUE, GREEN]
    ends = [line.get_xdata()[0] for line in fast.lines if not line.get_label().isalpha()]
    assert ends == [0.6, 1.4]
    (gap,) = fast.patches
    assert (gap.get_x(), gap.get_width()) == (0.6, pytest.approx(0.1))
    assert [axes.get_ylabel() for axes in drawn.axes] == ["velocity, m/s"] * 2
    assert [axes.get_xlabel() for axes in drawn.axes] == ["", "simulated time, s"]
    (legend,) = drawn.legends
    assert legend_texts(legend) == ["north", "down", "command ends", "no command runs"]
    assert texts(plot_velocity([], "", "").axes[0]) == ["no flight recorded"]


# --- trajectories -------------------------------------------------------------------------------------------


def test_trajectories_are_drawn_with_height_upwards() -> None:
    first = np.array([[0.0, 1.0, -10.0], [2.0, 1.5, -10.1]])
    second = np.array([[0.5, 4.0, -10.2], [1.0, 2.0, -10.0], [0.0, 2.0, -10.0]])
    drawn: Any = plot_trajectories(
        [TrajectoryLine("first", first), TrajectoryLine("second", second)], "from", "A title"
    )
    assert headline(drawn) == ("A title", "from")
    axes: Any = drawn.axes[0]
    lines = labelled(axes)
    np.testing.assert_array_equal(lines["first"].get_data_3d(), [[0.0, 2.0], [1.0, 1.5], [10.0, 10.1]])
    np.testing.assert_array_equal(lines["second"].get_data_3d(), (second * [1, 1, -1]).T)
    assert [line.get_color().lower() for line in lines.values()] == [BLUE, GREEN]
    assert legend_texts(axes.get_legend()) == ["first", "second"]
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()) == (
        "north x, m",
        "east y, m",
        "height −z, m",
    )
    # East spans 3 m and north 2: both are shown at one scale, 5 % wider than the longer; height at least 50 cm.
    limits = [axis.get_view_interval() for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
    np.testing.assert_allclose(limits, [[1 - 1.575, 1 + 1.575], [2.5 - 1.575, 2.5 + 1.575], [9.85, 10.35]])
    assert plot_trajectories([], "", "none").axes[0].get_legend() is None


@pytest.mark.parametrize("size_m", [0.001, 0.8, 40.0])
def test_ticks_of_trajectories_keep_clear_of_the_common_corner(size_m: float) -> None:
    corners = size_m * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    axes: Any = plot_trajectories([TrajectoryLine("square", corners)], "", "").axes[0]
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        low, high = axis.get_view_interval()
        ticks = axis.get_majorticklocs()
        assert 2 <= len(ticks) <= 6
        assert low + 0.08 * (high - low) <= ticks[0] < ticks[-1] <= high
    assert np.diff(axes.xaxis.get_view_interval()) == pytest.approx(max(size_m, 0.2) * 1.05)


# --- training and evaluation --------------------------------------------------------------------------------


def test_phases_are_stacked_and_speeds_stand_on_their_own_axis() -> None:
    drawn: Any = plot_phases(
        [
            PhaseTimes("one", {"simulation": 120.0, "image_processing": 30.0}, 40.0),
            PhaseTimes("two", {"simulation": 60.0, "image_processing": 90.0}, 10.0),
        ],
        "where from",
    )
    assert headline(drawn) == ("Time of training by phase", "where from")
    axes, speed = drawn.axes
    bars = {label: [(b.get_x() + b.get_width() / 2, b.get_y(), b.get_height()) for b in container]
            for label, container in labelled(axes).items()}  # fmt: skip
    assert bars == {
        "simulation": [pytest.approx((0, 0.0, 2.0)), pytest.approx((1, 0.0, 1.0))],
        "image processing": [pytest.approx((0, 2.0, 0.5)), pytest.approx((1, 1.0, 1.5))],
    }
    assert (axes.get_ylabel(), tick_texts(axes.xaxis)) == ("minutes", ["one", "two"])
    assert points(labelled(speed)["speed (right)"]) == [(0, 40.0), (1, 10.0)]
    assert (speed.get_ylabel(), speed.get_ylim()) == ("simulated seconds per wall second", (0, 48.0))
    (legend,) = drawn.legends
    assert legend_texts(legend) == ["simulation", "image processing", "speed (right)"]


@pytest.mark.parametrize(
    ("longest_s", "unit", "height"), [(7200.0, "hours", 2), (59.0, "seconds", 59), (0.5, "seconds", 0.5)]
)
def test_phases_have_the_unit_of_the_longest(longest_s: float, unit: str, height: float) -> None:
    trainings = [PhaseTimes(name, {"learning": s}, 1.0) for name, s in (("short", 0.1), ("long", longest_s))]
    axes = plot_phases(trainings, "").axes[0]
    assert (axes.get_ylabel(), labelled(axes)["learning"][1].get_height()) == (unit, pytest.approx(height))


def test_labels_of_phases_do_not_run_into_each_other() -> None:
    trainings = [
        PhaseTimes(f"TCSC 100x\nruns/a-training-with-a-long-name-{i}", {"learning": 1.0}, 1.0) for i in (1, 2)
    ]
    drawn: Any = plot_phases(trainings, "")
    drawn.draw_without_rendering()
    left, right = (label.get_window_extent() for label in drawn.axes[0].get_xticklabels())
    assert left.x1 < right.x0


def test_survival_is_the_share_of_games_that_got_at_least_so_far() -> None:
    drawn: Any = plot_survival({"one": [30.0, 151.0, 10.0, 150.0], "two": [20.0]}, "where from")
    assert headline(drawn) == ("Distance travelled", "where from")
    (axes,) = drawn.axes
    one, two, end = (labelled(axes)[name] for name in ("one", "two", "end of the lane"))
    assert points(one) == [(0.0, 1.0), (10.0, 0.75), (30.0, 0.5), (150.0, 0.25), (150.0, 0.0)]
    assert points(two) == [(0.0, 1.0), (20.0, 0.0)]
    assert {line.get_drawstyle() for line in (one, two)} == {"steps-post"}  # games last until their distance
    assert end.get_xdata()[0] == 150.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("distance north, m", "share of games that got there")
    assert axes.get_ylim() == (0.0, 1.05)
    assert legend_texts(axes.get_legend()) == ["one", "two", "end of the lane"]
    low, high = axes.collections[0].get_paths()[0].get_extents().get_points()[:, 1]
    assert (low, high) == (0.0, 1.0)
    vertices = axes.collections[0].get_paths()[0].vertices
    at_10_m = sorted({round(y, 9) for x, y in vertices if x == 10.0})
    interval = binomtest(3, 4).proportion_ci(method="wilson")
    assert {round(interval.low, 9), round(interval.high, 9)} <= set(at_10_m)


# --- style --------------------------------------------------------------------------------------------------


def test_equal_figures_are_equal_files_and_leave_no_style_behind(tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    for name in ("a/one.png", "b/two.png"):
        figure = plot_accuracy({("adsc", 5.0, 1): [1.9]}, "from")
        assert style.save(figure, tmp_path / name) == tmp_path / name
    assert dict(mpl.rcParams) == before
    one, two = ((tmp_path / name).read_bytes() for name in ("a/one.png", "b/two.png"))
    assert one == two
    assert b"Software" not in one
    image = cv2.imread(str(tmp_path / "a/one.png"))
    assert image is not None
    width_in, height_in = plot_accuracy({("adsc", 5.0, 1): [1.9]}, "from").get_size_inches()
    assert image.shape[:2] == (round(height_in * 150), round(width_in * 150))
    assert np.mean(np.any(image != 255, axis=-1)) > 0.01


def test_words_and_colours_of_all_figures() -> None:
    assert [style.clock_label(clock) for clock in (1.0, 1.5, 100.0)] == ["1x", "1.5x", "100x"]
    assert [style.rounds_label(rounds) for rounds in (1, 2, 24)] == ["1 round", "2 rounds", "24 rounds"]
    assert style.command_name("adsc") == "ADSC"
    assert [to_hex(colour) for colour in style.CYCLE[:4]] == [BLUE, ORANGE, GREEN, VERMILION]
    assert (style.COMMAND_COLOUR["adsc"], style.COMMAND_COLOUR["tcsc"]) == (style.VERMILION, style.BLUE)
