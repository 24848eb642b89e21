"""Looks for the law of the largest gap: fits on half of the tasks, predicts the other half.

    uavaccel run mediation_law --jobs 8 --out runs/mediation-law
    uavaccel run realtime_law --jobs 8 --out runs/realtime-law
    python -m tools.fit_gap_law runs/mediation-law runs/realtime-law docs/figures/gap_law.png > law.csv

A table that this has written stands for the runs that it is of: `docs/tables/gap_law.csv runs/more FIGURE`.

The largest gap of a condition is the one at which success has dropped by five points below that without a gap, between
flown gaps by linear interpolation. It is at least the last gap where success never drops (`below_s` is inf), and below
the first one where it drops at once (`at_least_s` is 0). Of Gymnasium's environments the gap is the delay from an
observation to its action, whole physics steps, and success the return, divided by that without a delay. A condition
that wins less than half without a gap is not judged.

A law says that the largest gap is in proportion to one of three times, or to the geometric mean of several:

- `control_s`, a command's or a control period's;
- `own_s`, the body's own: of drones that in which position hold takes half of the speed, of others the root of their
  height over g;
- `room_s`, that in which a drone at its speed leaves the room that its task gives it; of others it is `own_s`.

The law that errs least on the fitted tasks is judged on the rest, beside a constant. An error is the root mean square
of the logarithms by which predictions miss what was found, as a factor; every task counts alike.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import closing
from itertools import combinations
from math import sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uavaccel.draw import style
from uavaccel.metrics.intervals import RESAMPLES, TAILS
from uavaccel.records import RunDirectory
from uavaccel.sim.clutter import ASIDE_M
from uavaccel.sim.lane import HULL_RADIUS_M
from uavaccel.suites.mediation import USUAL, Mediation
from uavaccel.suites.realtime import Realtime
from uavaccel.suites.registry import open_run

DROP, LEAST = 0.05, 0.5  # of success: what is asked for; what a condition must win without a gap
BRAKING_S, GRAVITY_M_S2 = 0.5, 9.81
HEIGHTS_M = {"InvertedPendulum": 0.6, "Hopper": 1.25, "HalfCheetah": 0.7}  # the pole; the torsos, at the start
TIMES = ("control_s", "own_s", "room_s")
LAWS = [law for count in range(len(TIMES) + 1) for law in combinations(TIMES, count)]
FACTORS = np.geomspace(1e-4, 1e4, 2001)  # of a law, in steps of .9 %
PREDICTED = ("Hover motors", "Gates", "Navigate", "InvertedPendulum", "Hopper")  # chosen before any of them was flown
Numbers = NDArray[np.float64]
Missed = dict[tuple[str, ...], dict[str, Numbers]]


class Fit(NamedTuple):
    """A law, the factor before it, and its error and the constant's on the tasks that were not fitted."""

    law: tuple[str, ...]
    factor: float
    error: float
    constant: float


def largest_gap(gaps_s: Numbers, success: Numbers) -> tuple[float, float]:
    """Return the largest gap, twice; where it is not between two gaps, what it is at least, and below."""
    dropped = np.flatnonzero(success < success[0] - DROP)
    if not len(dropped):
        return float(gaps_s[-1]), np.inf
    first = dropped[0]
    if first == 1:
        return 0.0, float(gaps_s[1])
    (low, high), (left, right) = gaps_s[first - 1 : first + 1], success[first - 1 : first + 1]
    return (float(low + (high - low) * (left - success[0] + DROP) / (left - right)),) * 2


def measured(gaps_s: Numbers, success: Numbers) -> dict[str, float]:
    """Return the largest gap and its 95 % bootstrap interval, of success (gaps, trainings, games) from the gap 0 on.

    Trainings and games are resampled, the same for all gaps.
    """
    random, found = np.random.default_rng(0), []
    for _ in range(RESAMPLES):
        chosen = [random.integers(size, size=size) for size in success.shape[1:]]
        found.append(largest_gap(gaps_s, success[:, chosen[0]][:, :, chosen[1]].mean(axis=(1, 2))))
    means, ends = success.mean(axis=(1, 2)), np.array(found)
    at_least, below = largest_gap(gaps_s, means)
    low, high = (np.quantile(ends[:, end], TAILS[end], method="nearest") for end in (0, 1))
    counts = {"trainings": success.shape[1], "games": success.shape[2], "without_gap": float(means[0])}
    return {**counts, "at_least_s": at_least, "below_s": below, "low": float(low), "high": float(high)}


def room_m(task: Any) -> float:
    """Return the room that a task gives a drone to either side, less its hull."""
    if hasattr(task, "difficulty"):
        return float(task.difficulty.min_gap_m / 2 - HULL_RADIUS_M)
    if hasattr(task, "clutter"):  # half of what is between two shapes of their mean size, were they on a grid
        apart_m, wide_m = 2 * ASIDE_M / sqrt(task.clutter.shapes), sum(task.clutter.half_m)
        return float((apart_m - wide_m) / 2 - HULL_RADIUS_M)
    return float(task.half_width_m - HULL_RADIUS_M if hasattr(task, "half_width_m") else task.radius_m)


def of_drones(run: RunDirectory) -> Iterator[dict[str, Any]]:
    """Yield the conditions of a run of the suite `mediation`, its policies; the gap is its only factor."""
    suite = Mediation()
    report = suite.report(run)
    first = {case.policy: case for case in reversed([*suite.policies_of(report.config)])}
    for policy, own in report.scores.groupby("policy", sort=False):
        flown: Any = suite.runs(report.config, first[str(policy)])[0][1]
        kind = "" if flown.task.action == "velocity" else f" {flown.task.action}"
        of_gaps = own.groupby(own.value.where(own.flight != USUAL, 0.0))
        yield {
            "condition": policy,
            "task": flown.env_id.removeprefix("uavaccel/").partition("-")[0] + kind,
            "control_s": flown.task.t_move_s,
            "own_s": BRAKING_S,
            "room_s": room_m(flown.task) / flown.task.speed_m_s,
            **measured(np.array([*of_gaps.groups], float), np.array([each.won.tolist() for _, each in of_gaps], float)),
        }


def of_others(run: RunDirectory) -> Iterator[dict[str, Any]]:
    """Yield the conditions of a run of the suite `realtime`, its environments, flown by the first agent under ADSC."""
    from uavaccel.suites.realtime_agents import make

    report = Realtime().report(run)
    scores = report.scores[
        (report.scores.command == "adsc") & (report.scores.agent == next(iter(report.config.agents)))
    ]
    for name, own in scores.groupby("environment", sort=False):
        block = report.config.environments[str(name)]
        delays = own.assign(delay_s=own.delays_s.map(np.median).round(9)).drop_duplicates(["delay_s", "seed"])
        swept = [each.sort_values("seed")["returns"].tolist() for _, each in delays.groupby("delay_s")]
        returns, gaps_s = np.array(swept), np.sort(delays.delay_s.unique())
        with closing(make(block, "adsc", 1.0)) as env:
            control_s = float(env.unwrapped.dt)  # type: ignore[attr-defined]
        task = block.id.partition("-")[0]
        own_s = sqrt(HEIGHTS_M[task] / GRAVITY_M_S2)
        times = {"control_s": control_s, "own_s": own_s, "room_s": own_s}
        yield {"condition": name, "task": task, **times, **measured(gaps_s, returns / returns[0].mean())}


def conditions(sources: list[Path]) -> pd.DataFrame:
    """Return a row for each condition of runs and tables: its times, its success without a gap, and its largest gap."""
    tables = [pd.read_csv(path) if path.suffix == ".csv" else of_run(open_run(path)) for path in sources]
    return pd.concat(tables, ignore_index=True)


def of_run(run: RunDirectory) -> pd.DataFrame:
    """Return the conditions of a run."""
    return pd.DataFrame((of_drones if run.config()["suite"] == Mediation.name else of_others)(run))


def judged(table: pd.DataFrame) -> pd.DataFrame:
    """Return the conditions that say something of a gap."""
    return table[table.without_gap >= LEAST].reset_index(drop=True)


def misses(law: tuple[str, ...], factors: Numbers, of: pd.DataFrame) -> dict[str, Numbers]:
    """Return by how much a law with each factor (n,) misses each task: the mean of squared logarithms (n,)."""
    times = np.exp(np.log(of[list(law)]).mean(axis=1)).to_numpy() if law else np.ones(len(of))
    predicted = factors * times[:, None]
    nearest = np.clip(predicted, of[["at_least_s"]].to_numpy(), of[["below_s"]].to_numpy())
    squared = np.log(predicted / nearest) ** 2
    tasks = of.task.to_numpy()
    return {task: squared[tasks == task].mean(axis=0) for task in np.unique(tasks)}


def fit(table: pd.DataFrame, predicted: tuple[str, ...], missed: Missed | None = None) -> Fit:
    """Return the law that errs least on the other tasks, judged on those predicted; without any, on all of them.

    `missed` is what laws miss by FACTORS, for many fits of one table.
    """
    missed = missed or {law: misses(law, FACTORS, table) for law in LAWS}
    of_fitted = {law: mean(each for task, each in of.items() if task not in predicted) for law, of in missed.items()}
    factors = {law: np.exp(np.log(FACTORS[each <= each.min() + 1e-12]).mean()) for law, each in of_fitted.items()}
    rest = table[table.task.isin(predicted)] if predicted else table

    def error(law: tuple[str, ...]) -> float:
        return float(np.exp(np.sqrt(mean(misses(law, np.array([factors[law]]), rest).values())[0])))

    best = min(LAWS, key=lambda law: of_fitted[law].min())
    return Fit(best, float(factors[best]), error(best), error(()))


def mean(of_tasks: Iterable[Numbers]) -> Numbers:
    missed: Numbers = np.mean([*of_tasks], axis=0)
    return missed


def halves(table: pd.DataFrame) -> list[Fit]:
    """Return the fits on every half of the tasks, judged on the other half."""
    tasks, missed = table.task.unique(), {law: misses(law, FACTORS, table) for law in LAWS}
    return [fit(table, chosen, missed) for chosen in combinations(tasks, len(tasks) // 2)]


def words(found: Fit) -> str:
    """Return a law and its errors in words."""
    law = " and ".join(found.law) or "a constant, s"
    return f"{found.factor:.3g} x {law}: off by {found.error:.2f} on the rest, a constant by {found.constant:.2f}"


def draw(table: pd.DataFrame, found: Fit, path: Path) -> None:
    """Draw the largest gaps, a colour for each task, over each of the three times, and the law where it is of one."""
    never, at_once = np.isinf(table.below_s), table.at_least_s == 0.0
    shown = table.at_least_s.where(~at_once, table.below_s)
    ends_s = (table.low.where(~at_once, shown), table.high.where(~np.isinf(table.high), shown))
    bars = [(end - shown).abs() for end in ends_s]
    marks = (("o", ~never & ~at_once), ("^", never), ("v", at_once))
    with style.project_style():
        source = "95 % intervals; pointing up: more than the largest that was flown; down: less than the least"
        figure = style.new_figure(4.4, "The largest gap before success drops by five points", source)
        panels: Any = figure.subplots(1, len(TIMES), sharey=True, sharex=True)
        for axes, name in zip(panels, TIMES, strict=True):
            for number, task in enumerate(table.task.unique()):
                look: Any = {"color": style.shade(number, table.task.nunique()), "markersize": 5, "linestyle": "none"}
                axes.plot([], [], "s", label=task, **look)
                for mark, kind in marks:
                    of = kind & (table.task == task)
                    both = [each[of] for each in bars]
                    axes.errorbar(table[name][of], shown[of], both, marker=mark, elinewidth=0.9, **look)
            if found.law == (name,):
                ends = np.array([table[name].min(), table[name].max()])
                axes.plot(ends, found.factor * ends, **style.LIMIT)
            axes.set(xscale="log", yscale="log", xlabel=f"{name.removesuffix('_s')} time, s")
        panels[0].set(ylabel="largest gap, s")
        style.legend(figure)
        style.save(figure, path)


if __name__ == "__main__":
    *runs, picture = map(Path, sys.argv[1:])
    every = conditions(runs)
    every.round(4).to_csv(sys.stdout, index=False)
    kept = judged(every)
    draw(kept, fit(kept, ()), picture)
    others = tuple(set(kept.task) - set(PREDICTED))
    for half, rest in ((PREDICTED, others), (others, PREDICTED)):
        print(f"fitted on {', '.join(rest)}: {words(fit(kept, half))}", file=sys.stderr)
    errors = np.array([[found.error, found.constant] for found in halves(kept)])
    print(f"errors over all halves, and the constant's: {np.quantile(errors, (*TAILS, 0.5), axis=0)}", file=sys.stderr)
    print(f"all tasks: {words(fit(kept, ()))}", file=sys.stderr)
