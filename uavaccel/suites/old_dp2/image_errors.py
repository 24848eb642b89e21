"""DP2's figure of position error over DVS-ED: a point per image, a panel per command (the paper's Figure 7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uavaccel.draw import style

LEAST_PERCENT, LEAST_M = 0.1, 0.001  # below, the axes are linear


@dataclass(frozen=True)
class ImageCloud:
    """The images of one command and ClockSpeed; arrays (images,)."""

    command: str
    clock_speed: float
    dvs_ed_percent: np.ndarray
    position_error_m: np.ndarray

    @property
    def at_zero(self) -> NDArray[np.bool_]:
        """Whether an image has neither error (images,)."""
        exact: NDArray[np.bool_] = (self.dvs_ed_percent == 0) & (self.position_error_m == 0)
        return exact


def plot_images(clouds: Sequence[ImageCloud], source: str) -> Figure:
    """Plot the clouds on common axes.

    A command whose images all have no error gets a line below the panels in place of an empty panel.
    """
    commands = sorted({cloud.command for cloud in clouds if not cloud.at_zero.all()}, reverse=True)
    exact = sorted({cloud.command for cloud in clouds} - set(commands), reverse=True)
    clocks = sorted({cloud.clock_speed for cloud in clouds})
    with style.project_style():
        title = "Position error and DVS-ED of each image against the run at 1x"
        at_zero = [_all_at_zero(command, clouds) for command in exact]
        below = "\n".join([*at_zero, source])
        figure = style.new_figure(2.4 + 3.6 * max(len(commands), 1), 4.4, title, below)
        panels = figure.subplots(1, max(len(commands), 1), sharex=True, sharey=True, squeeze=False)[0]
        if not commands:
            some = (
                "every image has no error at all"
                if exact
                else "no accelerated game to compare with a run at 1x"
            )
            style.note(panels[0], some)
            return figure
        for axes, command in zip(panels, commands, strict=True):
            _plot_panel(axes, [cloud for cloud in clouds if cloud.command == command], clocks)
        panels[0].set_ylabel("position error, m")
        _set_scales(panels[0])
        return figure


def _all_at_zero(command: str, clouds: Sequence[ImageCloud]) -> str:
    own = sorted((cloud for cloud in clouds if cloud.command == command), key=lambda cloud: cloud.clock_speed)
    clocks = ", ".join(style.clock_label(cloud.clock_speed) for cloud in own)
    images = sum(cloud.at_zero.size for cloud in own)
    return f"{style.command_name(command)} at {clocks}: all {images} images at 0, 0"


def _plot_panel(axes: Axes, clouds: Sequence[ImageCloud], clocks: Sequence[float]) -> None:
    """The fastest are plotted first, so that few and near points lie on top; images without error are rings."""
    for cloud in sorted(clouds, key=lambda cloud: -cloud.clock_speed):
        place = clocks.index(cloud.clock_speed)
        colour, marker = style.colour(place), style.MARKERS[place % len(style.MARKERS)]
        away = ~cloud.at_zero
        x, y = cloud.dvs_ed_percent[away], cloud.position_error_m[away]
        axes.scatter(x, y, s=13, c=colour, marker=marker, linewidths=0, alpha=0.7, clip_on=False)
        if cloud.at_zero.any():
            size = (5.0 + 4.5 * place) ** 2
            axes.scatter(0, 0, s=size, facecolors="none", edgecolors=colour, linewidths=1.6, clip_on=False)
        label = f"{style.clock_label(cloud.clock_speed)}: {_count(cloud.at_zero)}"
        axes.scatter([], [], s=22, c=colour, marker=marker, label=label)
    axes.set_xlabel("DVS-ED, % of the pixels")
    handles, labels = axes.get_legend_handles_labels()
    above: style.LineStyle = {
        "loc": "lower left",
        "bbox_to_anchor": (-0.02, 1.0),
        "alignment": "left",
        "title_fontsize": 10,
    }
    axes.legend(handles[::-1], labels[::-1], title=style.command_name(clouds[0].command), ncols=2, **above)


def _count(at_zero: NDArray[np.bool_]) -> str:
    if at_zero.all():
        return f"all {at_zero.size} at 0, 0"
    if at_zero.any():
        return f"{np.count_nonzero(at_zero)} of {at_zero.size} at 0, 0"
    return f"{at_zero.size} image{'s' if at_zero.size > 1 else ''}"


def _set_scales(axes: Axes) -> None:
    """Scales are logarithmic, as the clouds lie decades apart, but linear around 0, so that 0 has its place."""
    for axis, unit, ticks in ((axes.xaxis, LEAST_PERCENT, "{x:g}"), (axes.yaxis, LEAST_M, "{x:g}")):
        getattr(axes, f"set_{axis.axis_name}scale")("symlog", linthresh=unit, linscale=0.6)
        axis.set_major_formatter(ticks)
    axes.set(xlim=(-0.4 * LEAST_PERCENT, 100), ylim=(-0.4 * LEAST_M, 10))
