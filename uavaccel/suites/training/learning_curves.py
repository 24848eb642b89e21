"""Learning curves of trainings: success over games, or over the wall clock, and evaluations during the training."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from numpy.typing import ArrayLike, NDArray

from uavaccel.draw import style
from uavaccel.draw.style import clock_label, command_name
from uavaccel.errors import UserError
from uavaccel.metrics.intervals import Proportion
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.suites import paper_results
from uavaccel.suites.host_time import cumulative_wall_s
from uavaccel.suites.old_report import listed
from uavaccel.suites.training.evaluations import evaluations
from uavaccel.suites.training.rows import RECENT, TrainRow

PAPER_S = {
    "paper: 5 000 games in real time, 182 h": paper_results.REAL_TIME_S
}  # section IV-D: a week, 14 hours
FAR = 30.0  # times the longest training: marks beyond it would squeeze the curves
SCHEDULED = "random actions (ε)"
PROGRESS = {
    "return": "return",
    "length, commands": "commands",
    "loss": "loss",
    "mean Q": "mean_q",
    SCHEDULED: "exploration",
}
"""The panels of `plot_progress`: label, and key of the rows."""
TICKS_S = {
    "10 ms": 0.01,
    "100 ms": 0.1,
    "1 s": 1.0,
    "10 s": 10.0,
    "1 min": 60.0,
    "10 min": 600.0,
    "1 h": 3600.0,
    "10 h": 36_000.0,
    "100 h": 360_000.0,
}


@dataclass(frozen=True)
class Evaluated:
    """Evaluations during a training: when each took place, in games or seconds (n,), and its success (n,)."""

    at: Sequence[float]
    success: Sequence[Proportion]

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Success ratios (n,), from 0 to 1."""
        return np.array([each.ratio for each in self.success])


@dataclass(frozen=True)
class LearningCurve:
    """The moving average of a training's success (n,), from 0 to 1, over games or seconds of wall clock (n,).

    Curves with one label are trainings with different seeds.
    """

    label: str
    at: Sequence[float]
    success: Sequence[float]
    evaluated: Evaluated | None = None


def learning_curve(run: RunDirectory, label: str) -> LearningCurve:
    """Return the share won of the last 100 games over the wall clock of all starts, from the 100th game on.

    In a shorter training it is the share of all games so far. Raises UserError where the run has no games of a
    training, or no wall times.
    """
    rows, timings = run.rows(), run.timings()
    if not rows or len(timings) < len(rows) or any("wall_s" not in entry for entry in timings):
        raise UserError(f"{run.path}: is no training with a wall time in timing.jsonl for each game")
    games, success = _recent_success([row["is_success"] for row in rows])
    wall_s = np.array(cumulative_wall_s(run))
    return LearningCurve(label, wall_s[games - 1].tolist(), success.tolist(), evaluated(run, wall_s))


def games_curve(run: RunDirectory, label: str) -> LearningCurve:
    """Return the share won of the last 100 games over the games, as `learning_curve` does over the wall clock."""
    rows = run.rows()
    games, success = _recent_success([row["is_success"] for row in rows])
    return LearningCurve(
        label, games.tolist(), success.tolist(), evaluated(run, np.arange(1.0, len(rows) + 1))
    )


def evaluated(run: RunDirectory, after_game: NDArray[np.float64]) -> Evaluated | None:
    """Return a run's evaluations on an axis that has the end of each game at `after_game` (n,); None without any."""
    lines = [line for line in evaluations(run) if line["games"] <= len(after_game)]
    if not lines:
        return None
    at = [float(after_game[line["games"] - 1]) for line in lines]
    return Evaluated(at, [Proportion(line["successes"], len(line["lanes"])) for line in lines])


def _recent_success(won: Sequence[bool]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    so_far = np.array([0, *accumulate(won)])
    games = np.arange(RECENT if len(won) > RECENT else 1, len(won) + 1)
    before = np.maximum(games - RECENT, 0)
    return games, (so_far[games] - so_far[before]) / (games - before)


def plot_over_games(runs: Sequence[RunDirectory], path: Path) -> Path:
    """Plot a curve for each training over its games; trainings that differ in their seed alone form a band."""
    alike: dict[str, list[RunDirectory]] = {}
    for run in runs:
        alike.setdefault(json.dumps({**run.config(), "seed": None}, sort_keys=True), []).append(run)
    curves = [games_curve(run, _label(group)) for group in alike.values() for run in group]
    timings = sorted({timing_provenance(run.config()["task"]["timing"]) for run in runs})
    source = f"{' and '.join(timings)} · seed {_seeds(runs)}"
    return style.save(plot_learning_games(curves, source), path)


def _label(group: Sequence[RunDirectory]) -> str:
    task = group[0].config()["task"]
    flown_by = f"{command_name(task['command'])} {clock_label(task['clock_speed'])}, {group[0].path.name}"
    return flown_by if len(group) == 1 else f"{flown_by} and {len(group) - 1} more seeds"


def plot_over_time(runs: Sequence[RunDirectory], labels: Sequence[str], path: Path) -> Path:
    """Plot a curve for each training over the wall clock, with the paper's real time beside them."""
    curves = [learning_curve(run, label) for run, label in zip(runs, labels, strict=True)]
    source = f"measured, start-up not counted · seed {_seeds(runs)}"
    return style.save(plot_learning_curves(curves, source, PAPER_S), path)


def _seeds(runs: Sequence[RunDirectory]) -> str:
    return listed(sorted({run.config()["seed"] for run in runs}))


def plot_learning_games(curves: Sequence[LearningCurve], source: str) -> Figure:
    """Plot a line per label, the mean of its seeds over the games that all have, in the band of their range."""
    with style.project_style():
        figure = style.new_figure(8.0, 3.8, "Success over the games", source)
        axes = figure.subplots()
        for number, label in enumerate(dict.fromkeys(curve.label for curve in curves)):
            seeds = [curve for curve in curves if curve.label == label]
            first, last = max(seed.at[0] for seed in seeds), min(seed.at[-1] for seed in seeds)
            games = np.arange(first, max(last, first) + 1)
            success = np.array([np.interp(games, seed.at, seed.success) for seed in seeds])
            colour = style.colour(number)
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


def plot_progress(rows: Sequence[TrainRow], path: Path, source: str) -> Path:
    """Plot return, game length, loss, mean Q and the share of random actions over the games of a training.

    Points are single games, lines means of the last 100. What an algorithm does not have is left out.
    """
    games = np.arange(1, len(rows) + 1)
    panels: dict[str, NDArray[np.float64]] = {}
    for label, key in PROGRESS.items():
        values = np.array([row.get(key) for row in rows], np.float64)  # None becomes NaN
        if np.isfinite(values).any():
            panels[label] = values
    with style.project_style():
        lines = -(-len(panels) // 2)
        figure = style.new_figure(8.0, 1.0 + 1.6 * lines, "Progress of the training", source)
        grid = figure.subplots(lines, 2, sharex=True, squeeze=False).ravel()
        all_axes = grid[: len(panels)]
        for unused in grid[len(panels) :]:
            unused.remove()
        for axes, (name, values) in zip(all_axes, panels.items(), strict=True):
            known = np.isfinite(values)
            if name == SCHEDULED:
                axes.plot(games, values, color=style.BLUE)
                axes.set_ylim(-0.02, 1.02)
            else:
                axes.plot(games, values, ".", color=style.SKY, markersize=2, label="a game")
                mean = recent_mean(values[known])
                axes.plot(games[known], mean, color=style.BLUE, label=f"mean of the last {RECENT}")
            axes.set_ylabel(name)
        for axes in all_axes[-2:]:  # the lowest of each column
            axes.set_xlabel("games")
            axes.tick_params(labelbottom=True)
        figure.align_ylabels()
        figure.legend(*all_axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return style.save(figure, path)


def recent_mean(values: ArrayLike) -> NDArray[np.float64]:
    """Return, after each of n games, the mean of a value (n,) over the last 100 of them, or all so far, (n,)."""
    so_far = np.concatenate([[0.0], np.cumsum(values)])
    games = np.arange(1, len(so_far))
    before = np.maximum(games - RECENT, 0)
    return np.asarray((so_far[games] - so_far[before]) / (games - before), np.float64)


def plot_learning_curves(curves: Sequence[LearningCurve], source: str, marks: Mapping[str, float]) -> Figure:
    """Plot a line per training, coloured by label, and a vertical line at each of `marks`, seconds by name."""
    with style.project_style():
        figure = style.new_figure(8.0, 4.2, "Success over the wall clock", source)
        axes = figure.subplots()
        labels = list(dict.fromkeys(curve.label for curve in curves))
        for number, curve in enumerate(curves):
            first = curve.label not in [other.label for other in curves[:number]]
            colour = style.colour(labels.index(curve.label))
            axes.plot(curve.at, curve.success, color=colour, label=curve.label if first else None)
            if curve.evaluated is not None:
                plot_evaluated(axes, [curve.evaluated], colour)
        longest_s = max(curve.at[-1] for curve in curves)
        near = {name: wall_s for name, wall_s in marks.items() if wall_s <= FAR * longest_s}
        for name, wall_s in near.items():
            axes.axvline(wall_s, color=style.BLACK, linewidth=1.2, linestyle="--")
            axes.text(0.93 * wall_s, 0.5, name, rotation=90, ha="right", va="center")
        axes.set_xscale("log")
        longest_s = max([*near.values(), longest_s])
        least_s, most_s = max(0.5 * min(curve.at[0] for curve in curves), 0.01), 2.0 * longest_s
        axes.set_xlim(least_s, most_s)
        ticks = {name: wall_s for name, wall_s in TICKS_S.items() if least_s <= wall_s <= most_s}
        axes.set_xticks(list(ticks.values()), list(ticks))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set(xlabel="wall clock since the first command", ylabel="games won, of the last 100")
        axes.set_ylim(-0.02, 1.02)  # what was never won is a line that is seen
        axes.yaxis.set_major_formatter("{x:.0%}")
        figure.legend(loc="outside upper right")
        return figure


def plot_evaluated(axes: Axes, seeds: Sequence[Evaluated], colour: str) -> None:
    """Plot evaluations: of one seed points with Wilson's intervals, of several the mean in the band of the range."""
    if len(seeds) < 2:
        for seed in seeds:
            _plot_points(axes, seed, colour)
        return
    first, last = max(seed.at[0] for seed in seeds), min(seed.at[-1] for seed in seeds)
    at = np.unique([place for seed in seeds for place in seed.at if first <= place <= last])
    if not at.size:
        return
    success = np.array([np.interp(at, seed.at, seed.ratio) for seed in seeds])
    label = f"evaluated on {seeds[0].success[0].games} lanes: mean, least and most of {len(seeds)} seeds"
    axes.plot(at, success.mean(axis=0), "o--", color=colour, markersize=4, label=label)
    axes.fill_between(at, success.min(axis=0), success.max(axis=0), color=colour, alpha=0.3, linewidth=0)


def _plot_points(axes: Axes, seed: Evaluated, colour: str) -> None:
    label = f"evaluated on {seed.success[0].games} lanes, 95 % Wilson interval"
    axes.errorbar(
        seed.at,
        seed.ratio,
        style.error_bars([each.ratio for each in seed.success], [each.interval for each in seed.success]),
        fmt="o--",
        color=colour,
        markersize=4,
        linewidth=1.0,
        capsize=2,
        label=label,
    )
