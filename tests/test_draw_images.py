"""The clouds of image errors: which points are drawn, what stands for those without an error, and the scales."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tests.drawing import headline, legend_texts, texts
from uavaccel.draw import style
from uavaccel.suites.old_dp2.image_errors import ImageCloud, plot_images


def cloud(command: str, clock_speed: float, *errors: tuple[float, float]) -> ImageCloud:
    """`errors`: percent and metres of each image."""
    percent, metres = np.array(errors).T
    return ImageCloud(command, clock_speed, percent, metres)


def drawn_points(axes: Any) -> list[tuple[float, float]]:
    return [tuple(point) for group in axes.collections for point in group.get_offsets().tolist()]


TCSC_EXACT = cloud("tcsc", 5.0, (0, 0), (0, 0), (0, 0))
ADSC = [
    cloud("adsc", 5.0, (0, 0), (1.5, 0), (0, 0.02)),
    cloud("adsc", 100.0, (20.0, 3.0), (30.0, 4.0)),
]


def test_clouds_stand_by_command_and_clock_speed() -> None:
    tcsc = [cloud("tcsc", 5.0, (0, 0)), cloud("tcsc", 100.0, (7.0, 0.5))]
    drawn: Any = plot_images([*ADSC, *tcsc], "where from")
    title, below = headline(drawn)
    assert title == "Position error and DVS-ED of each image against the run at 1x"
    assert below == "where from"
    first, second = drawn.axes  # TCSC first, as in the paper
    assert drawn_points(first) == [(7.0, 0.5), (0.0, 0.0)]
    # The fastest first, so that few and near points lie on top; one ring for the images at 0.
    assert drawn_points(second) == [(20.0, 3.0), (30.0, 4.0), (1.5, 0.0), (0.0, 0.02), (0.0, 0.0)]
    legends = [axes.get_legend() for axes in drawn.axes]
    assert [legend.get_title().get_text() for legend in legends if legend] == ["TCSC", "ADSC"]
    assert [legend_texts(legend) for legend in legends] == [
        ["5x: all 1 at 0, 0", "100x: 1 image"],
        ["5x: 1 of 3 at 0, 0", "100x: 2 images"],
    ]
    assert [axes.get_xlabel() for axes in drawn.axes] == ["DVS-ED, % of the pixels"] * 2
    assert first.get_ylabel() == "position error, m"
    assert first.get_shared_x_axes().joined(first, second)
    assert first.get_shared_y_axes().joined(first, second)


def test_a_clock_speed_has_one_colour_and_ring_in_every_panel() -> None:
    clouds = [*ADSC, cloud("tcsc", 100.0, (0, 0), (7.0, 0.5))]
    drawn: Any = plot_images(clouds, "")
    tcsc, adsc = drawn.axes
    fast_adsc, _, slow_adsc, slow_ring, *_ = adsc.collections
    fast_tcsc, fast_ring, *_ = tcsc.collections
    assert np.array_equal(fast_adsc.get_facecolor(), fast_tcsc.get_facecolor())
    assert not np.array_equal(fast_adsc.get_facecolor(), slow_adsc.get_facecolor())
    assert np.array_equal(slow_ring.get_edgecolor()[0, :3], slow_adsc.get_facecolor()[0, :3])
    assert slow_ring.get_facecolor().size == fast_ring.get_facecolor().size == 0
    assert fast_ring.get_sizes()[0] > slow_ring.get_sizes()[0]  # so that one does not hide the other


def test_the_axes_are_logarithmic_but_linear_next_to_zero() -> None:
    (axes,) = plot_images(ADSC, "").axes
    for scale, limits, unit, most in (
        (axes.get_xaxis().get_transform(), axes.get_xlim(), 0.1, 100),
        (axes.get_yaxis().get_transform(), axes.get_ylim(), 0.001, 10),
    ):
        assert limits == pytest.approx((-0.4 * unit, most))
        zero, half, one, ten, hundred = scale.transform(unit * np.array([0.0, 0.5, 1.0, 10.0, 100.0]))
        assert half - zero == pytest.approx(one - half)
        assert hundred - ten == pytest.approx(ten - one)
    assert (axes.get_xscale(), axes.get_yscale()) == ("symlog", "symlog")


@pytest.mark.parametrize(
    ("clouds", "panels", "below"),
    [
        ([*ADSC, TCSC_EXACT], 1, "TCSC at 5x: all 3 images at 0, 0\nfrom"),
        (
            [*ADSC, cloud("tcsc", 100.0, (0, 0)), TCSC_EXACT],
            1,
            "TCSC at 5x, 100x: all 4 images at 0, 0\nfrom",
        ),
        ([*ADSC, cloud("tcsc", 100.0, (0, 0.1)), TCSC_EXACT], 2, "from"),
    ],
)
def test_a_command_without_any_error_has_a_line_in_place_of_an_empty_panel(
    clouds: Sequence[ImageCloud], panels: int, below: str
) -> None:
    drawn: Any = plot_images(clouds, "from")
    assert len(drawn.axes) == panels
    assert headline(drawn)[1] == below


def test_what_is_said_where_there_is_nothing_to_draw() -> None:
    exact = plot_images([TCSC_EXACT], "from")
    assert texts(exact.axes[0]) == ["every image has no error at all"]
    assert headline(exact)[1] == "TCSC at 5x: all 3 images at 0, 0\nfrom"
    assert texts(plot_images([], "from").axes[0]) == ["no accelerated game to compare with a run at 1x"]
    assert exact.axes[0].texts[0].get_color() == style.GREY
