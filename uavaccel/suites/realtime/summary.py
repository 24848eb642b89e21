"""What the rows show: returns with intervals over seeds and episodes, rankings, and how far they hold."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TypedDict, cast

import numpy as np

from uavaccel.metrics.seeds import hierarchical_interval
from uavaccel.suites.realtime.flights import EvaluationRow

Key = tuple[str, str, str, float, float]
"""Environment, agent, command, latency, ClockSpeed."""


class Cell(TypedDict):
    """All trainings of one agent under one latency, ClockSpeed and command."""

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
    """Two agents in one order at the slowest ClockSpeed and in the other here, neither's interval in the other's."""

    clock_speed: float
    ahead: str
    """Who is ahead here."""
    behind: str


class Ranking(TypedDict):
    """The agents of one environment under one latency and ADSC, over ClockSpeed."""

    environment: str
    latency_s: float
    clock_speeds: list[float]
    orders: list[list[str]]
    """Best first, for each ClockSpeed."""
    kendall_tau: list[float | None]
    """Against the slowest ClockSpeed; None where there is one agent."""
    holds_to: float
    """The largest ClockSpeed up to which no two agents change places."""
    reversals: list[Reversal]


def cells_of(rows: Sequence[EvaluationRow], seed: int) -> list[Cell]:
    """One cell for each agent, latency, ClockSpeed and command, in the order of the rows."""
    grouped: dict[Key, list[EvaluationRow]] = defaultdict(list)
    for row in rows:
        key = row["environment"], row["agent"], row["command"], row["latency_s"], row["clock_speed"]
        grouped[key].append(row)
    return [_cell(key, own, seed) for key, own in grouped.items()]


def _cell(key: Key, rows: Sequence[EvaluationRow], seed: int) -> Cell:
    returns = [row["returns"] for row in rows]
    low, high = hierarchical_interval(returns, seed)
    environment, agent, command, latency_s, clock_speed = key
    return {
        "environment": environment,
        "agent": agent,
        "command": command,
        "latency_s": latency_s,
        "clock_speed": clock_speed,
        "delay_s": float(np.median([delay for row in rows for delay in row["delays_s"]])),
        "seeds": len(rows),
        "episodes": sum(map(len, returns)),
        "return_mean": float(np.mean([np.mean(each) for each in returns])),
        "return_low": low,
        "return_high": high,
        "late_s": max(row["late_s"] for row in rows),
    }


def rankings_of(cells: Sequence[Cell]) -> list[Ranking]:
    """One for each environment and latency under ADSC."""
    grouped: dict[tuple[str, float], dict[float, list[Cell]]] = defaultdict(lambda: defaultdict(list))
    for cell in cells:
        if cell["command"] == "adsc":
            grouped[cell["environment"], cell["latency_s"]][cell["clock_speed"]].append(cell)
    return [
        _ranking(environment, latency_s, dict(sorted(by_speed.items())))
        for (environment, latency_s), by_speed in grouped.items()
    ]


def _ranking(environment: str, latency_s: float, by_speed: Mapping[float, Sequence[Cell]]) -> Ranking:
    speeds = list(by_speed)
    slowest = by_speed[speeds[0]]
    reversals = [
        reversal for speed in speeds[1:] for reversal in reversals_between(slowest, by_speed[speed], speed)
    ]
    broken = min((reversal["clock_speed"] for reversal in reversals), default=np.inf)
    return {
        "environment": environment,
        "latency_s": latency_s,
        "clock_speeds": speeds,
        "orders": [order_of(by_speed[speed]) for speed in speeds],
        "kendall_tau": [kendall_tau(means_of(slowest), means_of(by_speed[speed])) for speed in speeds],
        "holds_to": max(speed for speed in speeds if speed < broken),
        "reversals": reversals,
    }


def means_of(cells: Sequence[Cell]) -> dict[str, float]:
    """Mean returns by agent."""
    return {cell["agent"]: cell["return_mean"] for cell in cells}


def order_of(cells: Sequence[Cell]) -> list[str]:
    """Agents by mean return, best first."""
    means = means_of(cells)
    return sorted(means, key=lambda agent: -means[agent])


def kendall_tau(first: Mapping[str, float], second: Mapping[str, float]) -> float | None:
    """Kendall's tau-b of two rankings of the same agents; None where either ranks nothing."""
    from scipy.stats import kendalltau

    agents = sorted(set(first) & set(second))
    if len(agents) < 2:
        return None
    tau = float(kendalltau([first[agent] for agent in agents], [second[agent] for agent in agents]).statistic)
    return None if np.isnan(tau) else tau


def reversals_between(before: Sequence[Cell], after: Sequence[Cell], clock_speed: float) -> list[Reversal]:
    """Pairs of agents whose order is the other one, and whose intervals are apart both times."""
    here, there = ({cell["agent"]: cell for cell in cells} for cells in (before, after))
    found: list[Reversal] = []
    for pair in combinations([agent for agent in here if agent in there], 2):
        for ahead, behind in (pair, pair[::-1]):
            if _apart(here[behind], here[ahead]) and _apart(there[ahead], there[behind]):
                found.append({"clock_speed": clock_speed, "ahead": ahead, "behind": behind})
    return found


def _apart(better: Cell, worse: Cell) -> bool:
    return better["return_low"] > worse["return_high"]


def tcsc_equal(rows: Sequence[EvaluationRow]) -> bool | None:
    """Whether under TCSC every agent's returns are equal at all ClockSpeeds, to the bit; None: there is one speed."""
    grouped: dict[tuple[str, str, int], list[list[float]]] = defaultdict(list)
    for row in rows:
        if row["command"] == "tcsc":
            grouped[row["environment"], row["agent"], row["seed"]].append(row["returns"])
    if not grouped or max(map(len, grouped.values())) < 2:
        return None
    return all(returns == group[0] for group in grouped.values() for returns in group)


def evaluations(rows: Sequence[Mapping[str, object]]) -> list[EvaluationRow]:
    """Rows of evaluations."""
    return [cast("EvaluationRow", row) for row in rows if row["kind"] == "evaluation"]
