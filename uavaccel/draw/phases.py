"""Where the time of a training goes, and how fast it was (the paper's Figure 9, section IV-D)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uavaccel.draw import style

UNITS = (("hours", 3600.0), ("minutes", 60.0), ("seconds", 1.0))
LETTER_IN = 0.085  # width of a label's letter


@dataclass(frozen=True)
class PhaseTimes:
    """Seconds of a training by phase, those of the lanes summed over all, and how fast it was all in all."""

    label: str
    phase_s: Mapping[str, float]
    simulated_s_per_wall_s: float


def draw_phases(trainings: Sequence[PhaseTimes], path: Path, source: str) -> Path:
    """Write `plot_phases` as a PNG; returns `path`."""
    return style.save(plot_phases(trainings, source), path)


def plot_phases(trainings: Sequence[PhaseTimes], source: str) -> Figure:
    """A bar per training, its phases on top of each other, and the speeds as points on an axis of their own."""
    with style.project_style():
        longest = max(len(line) for training in trainings for line in training.label.splitlines())
        bar_in = max(1.5, LETTER_IN * longest)  # labels are not to run into each other
        figure = style.new_figure(3.2 + bar_in * len(trainings), 4.2, "Time of training by phase", source)
        axes = figure.subplots()
        longest_s = max(sum(training.phase_s.values()) for training in trainings)
        unit, unit_s = next((name, size) for name, size in UNITS if longest_s >= size or size == 1.0)
        places, below = np.arange(len(trainings)), np.zeros(len(trainings))
        for phase, colour in zip(trainings[0].phase_s, style.CYCLE, strict=False):
            spent = np.array([training.phase_s[phase] for training in trainings]) / unit_s
            axes.bar(places, spent, 0.55, below, color=colour, label=phase.replace("_", " "))
            below += spent
        axes.set_xticks(places, [training.label for training in trainings])
        axes.set(ylabel=unit, xlim=(-0.6, len(trainings) - 0.4))
        speed = axes.twinx()
        speeds = [training.simulated_s_per_wall_s for training in trainings]
        speed.plot(places, speeds, "o", color=style.BLACK, label="speed (right)")
        speed.set(ylabel="simulated seconds per wall second", ylim=(0, 1.2 * max(speeds)))
        speed.grid(visible=False)
        figure.legend(loc="outside right upper")
        return figure
