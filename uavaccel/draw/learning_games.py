"""How many games a training wins, over its games, and its evaluations: seeds of one training as a line in a band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.draw.evaluated import Evaluated, plot_evaluated


@dataclass(frozen=True)
class GamesCurve:
    """After so many games of a training, the success lately, 0 to 1; those of one label are its seeds."""

    label: str
    games: Sequence[int]
    success: Sequence[float]
    evaluated: Evaluated | None = None


def draw_learning_games(curves: Sequence[GamesCurve], path: Path, source: str) -> Path:
    """Write `plot_learning_games` as a PNG; returns `path`."""
    return style.save(plot_learning_games(curves, source), path)


def plot_learning_games(curves: Sequence[GamesCurve], source: str) -> Figure:
    """A line per label, the mean of its seeds over the games that all of them flew, in the band from least to most."""
    with style.project_style():
        figure = style.new_figure(8.0, 3.8, "Success over the games", source)
        axes = figure.subplots()
        for number, label in enumerate(dict.fromkeys(curve.label for curve in curves)):
            seeds = [curve for curve in curves if curve.label == label]
            first, last = max(seed.games[0] for seed in seeds), min(seed.games[-1] for seed in seeds)
            games = np.arange(first, max(last, first) + 1)
            success = np.array([np.interp(games, seed.games, seed.success) for seed in seeds])
            colour = style.CYCLE[number % len(style.CYCLE)]
            axes.plot(games, success.mean(axis=0), color=colour, label=label)
            if len(seeds) > 1:
                ends = success.min(axis=0), success.max(axis=0)
                axes.fill_between(games, *ends, color=colour, alpha=0.2, linewidth=0)
            plot_evaluated(axes, [seed.evaluated for seed in seeds if seed.evaluated is not None], colour)
        axes.set(xlabel="games", ylabel="games won, of the last 100", ylim=(-0.02, 1.02))
        axes.set_xlim(left=0)
        axes.yaxis.set_major_formatter("{x:.0%}")
        figure.legend(loc="outside upper right")
        return figure
