"""Hours of trainings by phase and their effective speed-up over the ClockSpeed (the paper's Figure 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.suites.training.phases import plot_stacked, unit_of


@dataclass(frozen=True)
class TrainingTime:
    """Seconds of a training by phase, and its speed-ups over real time: of simulation alone, of all, the paper's."""

    clock_speed: float
    phase_s: Mapping[str, float]
    simulation_speedup: float | None
    speedup: float | None
    paper_simulation_speedup: float | None = None
    paper_speedup: float | None = None


def plot_training_time(panels: Mapping[str, Sequence[TrainingTime]], source: str) -> Figure:
    """A panel per command: bars of phases on top of each other, and speed-ups as points on an axis of their own."""
    with style.project_style():
        figure = style.new_figure(2.0 + 5.0 * len(panels), 4.6, "Time of the training by phase", source)
        row = figure.subplots(1, len(panels), squeeze=False)[0]
        unit = unit_of([each.phase_s for panel in panels.values() for each in panel])
        handles: dict[str, Artist] = {}
        for axes, (title, panel) in zip(row, panels.items(), strict=True):
            axes.set_title(title, loc="center")
            for drawn in (_bars(axes, panel, unit), _points(axes, panel)):
                handles |= {
                    name: handle for handle, name in zip(*drawn.get_legend_handles_labels(), strict=True)
                }
        figure.legend(list(handles.values()), list(handles), loc="outside right upper")
        return figure


def _bars(axes: Axes, panel: Sequence[TrainingTime], unit: str) -> Axes:
    places = plot_stacked(axes, [each.phase_s for each in panel], unit)
    axes.set_xticks(places, [style.clock_label(each.clock_speed) for each in panel])
    axes.set(xlabel="ClockSpeed", ylabel=f"{unit} of the training", xlim=(-0.6, len(panel) - 0.4))
    return axes


def _points(axes: Axes, panel: Sequence[TrainingTime]) -> Axes:
    speed = axes.twinx()
    for name, label, marker in (
        ("simulation_speedup", "speed-up, simulation alone (right)", "o"),
        ("speedup", "speed-up, whole training (right)", "s"),
        ("paper_simulation_speedup", "the paper's, simulation alone", "x"),
        ("paper_speedup", "the paper's, whole training", "+"),
    ):
        values = np.array([getattr(each, name) for each in panel], float)
        if np.isfinite(values).any():
            speed.plot(np.arange(len(panel)), values, marker, color=style.BLACK, label=label, markersize=6)
    speed.set(ylabel="effective speed-up")
    speed.set_ylim(bottom=0.0)
    speed.grid(visible=False)
    return speed
