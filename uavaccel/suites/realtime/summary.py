"""The summary of a run: returns with intervals over seeds and episodes, rankings of agents, and how far these hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from operator import itemgetter
from typing import TypedDict, cast

import numpy as np

from uavaccel.metrics.seeds import hierarchical_interval
from uavaccel.suites.realtime.flights import EvaluationRow
from uavaccel.suites.rows import grouped, subset

CONDITIONS = ("environment", "agent", "command", "latency_s", "clock_speed")


class Cell(TypedDict):
    """The results of all trainings of one agent under one latency, ClockSpeed and command."""

    environment: str
    agent: str
    command: str
    latency_s: float
    clock_speed: float
    delay_s: float
    """Simulated seconds from an observation to its action, the median."""
    seeds: int
    episodes: int
    return_mean: float
    return_low: float
    return_high: float
    late_s: float


class Reversal(TypedDict):
    """Two agents whose order at this ClockSpeed is not that at the slowest; their intervals are disjoint both times."""

    clock_speed: float
    ahead: str
    behind: str


class Ranking(TypedDict):
    """The ranking of the agents in one environment under one latency and ADSC, at each ClockSpeed."""

    environment: str
    latency_s: float
    clock_speeds: list[float]
    orders: list[list[str]]
    """Agents, best first, for each ClockSpeed."""
    kendall_tau: list[float | None]
    """Correlation with the order at the slowest ClockSpeed; None for a single agent."""
    holds_to: float
    """The largest ClockSpeed up to which no two agents change places."""
    reversals: list[Reversal]


def cells_of(rows: Sequence[EvaluationRow], seed: int) -> list[Cell]:
    """Return a cell for each agent, latency, ClockSpeed and command, in the order of the rows."""
    return [_cell(own, seed) for own in grouped(rows, itemgetter(*CONDITIONS)).values()]


def _cell(rows: Sequence[EvaluationRow], seed: int) -> Cell:
    returns = [row["returns"] for row in rows]
    low, high = hierarchical_interval(returns, seed)
    cell = subset(rows[0], *CONDITIONS) | {
        "delay_s": float(np.median([delay for row in rows for delay in row["delays_s"]])),
        "seeds": len(rows),
        "episodes": sum(map(len, returns)),
        "return_mean": float(np.mean([np.mean(each) for each in returns])),
        "return_low": low,
        "return_high": high,
        "late_s": max(row["late_s"] for row in rows),
    }
    return cast(Cell, cell)


def rankings_of(cells: Sequence[Cell]) -> list[Ranking]:
    """Return a ranking for each environment and latency under ADSC."""
    by_adsc = [cell for cell in cells if cell["command"] == "adsc"]
    return [_ranking(own) for own in grouped(by_adsc, itemgetter("environment", "latency_s")).values()]


def _ranking(cells: Sequence[Cell]) -> Ranking:
    by_speed = dict(sorted(grouped(cells, itemgetter("clock_speed")).items()))
    speeds, means = list(by_speed), [means_of(own) for own in by_speed.values()]
    slowest = by_speed[speeds[0]]
    reversals = [
        reversal for speed in speeds[1:] for reversal in reversals_between(slowest, by_speed[speed], speed)
    ]
    broken = min((reversal["clock_speed"] for reversal in reversals), default=np.inf)
    return {
        "environment": cells[0]["environment"],
        "latency_s": cells[0]["latency_s"],
        "clock_speeds": speeds,
        "orders": [sorted(here, key=lambda agent: -here[agent]) for here in means],
        "kendall_tau": [kendall_tau(means[0], here) for here in means],
        "holds_to": max(speed for speed in speeds if speed < broken),
        "reversals": reversals,
    }


def means_of(cells: Sequence[Cell]) -> dict[str, float]:
    """Return the mean return of each agent."""
    return {cell["agent"]: cell["return_mean"] for cell in cells}


def kendall_tau(first: Mapping[str, float], second: Mapping[str, float]) -> float | None:
    """Return Kendall's tau-b of the agents in both rankings; None where either ranks nothing."""
    from scipy.stats import kendalltau

    agents = sorted(set(first) & set(second))
    if len(agents) < 2:
        return None
    tau = float(kendalltau([first[agent] for agent in agents], [second[agent] for agent in agents]).statistic)
    return None if np.isnan(tau) else tau


def reversals_between(before: Sequence[Cell], after: Sequence[Cell], clock_speed: float) -> list[Reversal]:
    """Return the pairs of agents whose order is reversed and whose intervals are disjoint both times."""
    here, there = ({cell["agent"]: cell for cell in cells} for cells in (before, after))
    found: list[Reversal] = []
    for pair in combinations([agent for agent in here if agent in there], 2):
        for ahead, behind in (pair, pair[::-1]):
            was_behind = here[behind]["return_low"] > here[ahead]["return_high"]
            if was_behind and there[ahead]["return_low"] > there[behind]["return_high"]:
                found.append({"clock_speed": clock_speed, "ahead": ahead, "behind": behind})
    return found


def tcsc_equal(rows: Sequence[EvaluationRow]) -> bool | None:
    """Return whether under TCSC every agent's returns are bit-identical at all ClockSpeeds; None for a single one."""
    by_tcsc = [row for row in rows if row["command"] == "tcsc"]
    groups = grouped(by_tcsc, itemgetter("environment", "agent", "seed")).values()
    if max(map(len, groups), default=0) < 2:
        return None
    return all(row["returns"] == group[0]["returns"] for group in groups for row in group)


def evaluations(rows: Sequence[Mapping[str, object]]) -> list[EvaluationRow]:
    """Return the rows of evaluations."""
    return [cast(EvaluationRow, row) for row in rows if row["kind"] == "evaluation"]
