"""Looks for the law of the largest gap: fits on half of the conditions of a run, predicts the other half.

    python -m tools.fit_gap_law runs/mediation-law docs/figures/gap_law.png > docs/tables/gap_law.csv

The largest gap of a condition is the one at which success has dropped by five points below that without a gap, between
flown gaps by linear interpolation. A law says that it is in proportion to something: constant in seconds, to T_move, to
the time in which a drone crosses the clear width beside its hull, to that between two rows, or to the roots of their
products with the time that position hold takes to brake. Each is fitted on every other condition, the one with the
least error there is told, and its error on the rest, beside that of the constant. An error is the root mean square of
the logarithms of predicted over found, as a factor.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uavaccel.draw import style
from uavaccel.metrics.intervals import TAILS
from uavaccel.sim.lane.layout import HULL_RADIUS_M
from uavaccel.suites.mediation import USUAL, Mediation
from uavaccel.suites.registry import open_run

DROP, BRAKING_S = 0.05, 0.5  # the first is the question; the second is the time in which a gap takes half of the speed
Law = Callable[[pd.DataFrame], NDArray[np.float64]]
LAWS: Mapping[str, Law] = {
    "seconds": lambda of: np.ones(len(of)),
    "T_move": lambda of: of.t_move_s.to_numpy(),
    "clear width / speed": lambda of: clear_s(of),
    "row spacing / speed": lambda of: (of.row_spacing_m / of.speed_m_s).to_numpy(),
    "root of braking and clear width / speed": lambda of: np.sqrt(BRAKING_S * clear_s(of)),
    "root of braking and T_move": lambda of: np.sqrt(BRAKING_S * of.t_move_s.to_numpy()),
}


def clear_s(of: pd.DataFrame) -> NDArray[np.float64]:
    """Return the time in which a drone at its speed crosses half of a gap, less its hull."""
    return np.asarray((of.min_gap_m / 2 - HULL_RADIUS_M) / of.speed_m_s)


def largest_gap(gaps_s: NDArray[np.float64], success: NDArray[np.float64]) -> float:
    """Return the gap at which success drops DROP below its first value; the last one, where it does not."""
    below = np.flatnonzero(success < success[0] - DROP)
    if not len(below):
        return float(gaps_s[-1])
    last = below[0]
    (low, high), (left, right) = gaps_s[last - 1 : last + 1], success[last - 1 : last + 1]
    return float(low + (high - low) * (left - success[0] + DROP) / (left - right))


def conditions(folder: Path) -> pd.DataFrame:
    """Return a row for each condition of a run: what was set, its largest gap, and that gap's 95 % interval."""
    report = Mediation().report(open_run(folder))
    usual = {"t_move_s": 1.0, "speed_m_s": 1.0, "min_gap_m": 2.0, "row_spacing_m": 10.0}
    cells, random, found = report.scores[report.scores.flight != USUAL], np.random.default_rng(0), []
    for name, factor in report.config.flights.items():
        own = cells[cells.factor == name].sort_values("value")
        gaps_s, won = own.value.to_numpy(float), np.stack(own.won.tolist()).astype(float)
        lanes = random.integers(won.shape[1], size=(2000, won.shape[1]))
        low, high = np.quantile([largest_gap(gaps_s, won[:, chosen].mean(axis=1)) for chosen in lanes], TAILS)
        set_to = {key.rpartition(".")[2]: value for key, value in factor.also.items()}
        kept = {key: value for key, value in set_to.items() if key in usual}
        largest = largest_gap(gaps_s, won.mean(axis=1))
        found.append({"condition": name, **usual, **kept, "largest_gap_s": largest, "low": low, "high": high})
    return pd.DataFrame(found)


def compare(table: pd.DataFrame) -> tuple[str, float, float, float]:
    """Return the law that fits every other condition best, its factor, and its error and the constant's on the rest."""
    fitted, rest = table.iloc[::2], table.iloc[1::2]

    def error(law: Law, of: pd.DataFrame) -> tuple[float, float]:
        factor = float(np.exp(np.log(fitted.largest_gap_s / law(fitted)).mean()))
        return factor, float(np.exp(np.sqrt((np.log(of.largest_gap_s / (factor * law(of))) ** 2).mean())))

    best = min(LAWS, key=lambda name: error(LAWS[name], fitted)[1])
    factor, of_rest = error(LAWS[best], rest)
    return best, factor, of_rest, error(LAWS["seconds"], rest)[1]


def draw(table: pd.DataFrame, best: str, factor: float, path: Path) -> None:
    """Draw found over predicted, the conditions of the fit hollow."""
    with style.project_style():
        figure = style.new_figure(4.0, f"Largest gap and {factor:.2g} times {best}")
        axes: Any = figure.subplots()
        predicted = factor * LAWS[best](table)
        for first, label, face in ((0, "fitted", "none"), (1, "predicted", style.BLUE)):
            own, x = table.iloc[first::2], predicted[first::2]
            bars = np.abs(own[["low", "high"]].to_numpy().T - own.largest_gap_s.to_numpy())
            axes.errorbar(x, own.largest_gap_s, bars, fmt="o", color=style.BLUE, markerfacecolor=face, label=label)
        ends = [0.0, float(max(predicted.max(), table.high.max()))]
        axes.plot(ends, ends, **style.LIMIT)
        axes.set(xlabel="predicted, s", ylabel="largest gap, s")
        style.legend(figure)
        style.save(figure, path)


if __name__ == "__main__":
    found = conditions(Path(sys.argv[1]))
    name, times, ours, constant = compare(found)
    draw(found, name, times, Path(sys.argv[2]))
    found.round(4).to_csv(sys.stdout, index=False)
    verdict = "there is none" if ours >= constant and name != "seconds" else "predicts"
    print(
        f"{verdict}: {times:.3g} x {name}, off by {ours:.2f} on the rest; a constant by {constant:.2f}", file=sys.stderr
    )
