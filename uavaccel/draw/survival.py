"""Figure 8: how many games got how far down the lane (paper, section IV-D)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from uavaccel.draw import style

LANE_M = 150.0


def draw_survival(distances_m: Mapping[str, Sequence[float]], path: Path, source: str) -> Path:
    """Draw the share of games that reached each distance, one line an evaluation; returns `path`."""
    with style.look():
        figure = style.new_figure(8.0, 4.6, "Distance travelled", source)
        axes = figure.subplots()
        for name, values in distances_m.items():
            reached = np.sort(np.minimum(np.asarray(values, float), LANE_M))
            share = 1.0 - np.arange(len(reached) + 1) / len(reached)
            axes.step(np.concatenate([[0.0], reached]), share, where="post", label=name)
        axes.axvline(LANE_M, color=style.BLACK, linewidth=1.2, linestyle="--", label="end of the lane")
        axes.set_xlabel("distance north, m")
        axes.set_ylabel("share of games that got there")
        axes.set_ylim(0.0, 1.05)
        axes.legend(loc="lower left")
        return style.save(figure, path)
