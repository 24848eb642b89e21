"""Figure 7: position error over DVS-ED, a point an image, a colour a ClockSpeed, a panel a command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from uavaccel.report import style

_MARKERS = "osD^v<>"


@dataclass(frozen=True)
class ImageCloud:
    """The images of one command and ClockSpeed; arrays (images,)."""

    command: str
    clock_speed: float
    dvs_ed_percent: np.ndarray
    position_error_m: np.ndarray


def draw_images(clouds: Sequence[ImageCloud], path: Path, source: str) -> Path:
    """Draw the clouds; both axes are common to all panels, from 0; returns `path`."""
    commands = sorted({cloud.command for cloud in clouds}, reverse=True)
    clocks = sorted({cloud.clock_speed for cloud in clouds})
    with style.look():
        title = "Position error and DVS-ED of each image against the run at 1x"
        figure = style.new_figure(2.4 + 3.6 * max(len(commands), 1), 4.4, title, source)
        panels = figure.subplots(1, max(len(commands), 1), sharex=True, sharey=True, squeeze=False)[0]
        if not clouds:
            style.note(panels[0], "no accelerated game to compare with a run at 1x")
            return style.save(figure, path)
        for axes, command in zip(panels, commands, strict=True):
            _draw_panel(axes, [cloud for cloud in clouds if cloud.command == command], clocks)
            axes.set_title(style.command_name(command))
        panels[0].set_ylabel("position error, m")
        _set_limits(panels[0], clouds)
        return style.save(figure, path)


def _draw_panel(axes: Axes, clouds: Sequence[ImageCloud], clocks: Sequence[float]) -> None:
    """Fastest first, so that few and near points lie on top; those at 0 as rings that do not hide each other."""
    for cloud in sorted(clouds, key=lambda cloud: -cloud.clock_speed):
        place = clocks.index(cloud.clock_speed)
        colour, marker = style.CYCLE[place % len(style.CYCLE)], _MARKERS[place % len(_MARKERS)]
        at_zero = (cloud.dvs_ed_percent == 0) & (cloud.position_error_m == 0)
        away = ~at_zero
        x, y = cloud.dvs_ed_percent[away], cloud.position_error_m[away]
        axes.scatter(x, y, s=13, c=colour, marker=marker, linewidths=0, alpha=0.7, clip_on=False)
        if at_zero.any():
            size = (5.0 + 4.5 * place) ** 2
            axes.scatter(0, 0, s=size, facecolors="none", edgecolors=colour, linewidths=1.6, clip_on=False)
        label = f"{style.clock_label(cloud.clock_speed)}: {_count(at_zero)}"
        axes.scatter([], [], s=22, c=colour, marker=marker, label=label)
    axes.set_xlabel("DVS-ED, % of the pixels")
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], loc="upper right")


def _count(at_zero: np.ndarray) -> str:
    if at_zero.all():
        return f"all {at_zero.size} at 0, 0"
    return (
        f"{np.count_nonzero(at_zero)} of {at_zero.size} at 0, 0"
        if at_zero.any()
        else f"{at_zero.size} images"
    )


def _set_limits(axes: Axes, clouds: Sequence[ImageCloud]) -> None:
    """From a little below 0, where rings at 0 have room; where every error is 0, to 1 % and 0.1 m."""
    widest = max(float(np.max(cloud.dvs_ed_percent, initial=0)) for cloud in clouds) or 1.0
    highest = max(float(np.max(cloud.position_error_m, initial=0)) for cloud in clouds) or 0.1
    axes.set(xlim=(-0.08 * widest, 1.05 * widest), ylim=(-0.08 * highest, 1.05 * highest))
