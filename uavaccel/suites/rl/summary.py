"""The RL experiment in numbers: success by training, and what its training took on the modelled clock."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.stopwatch import PHASES
from uavaccel.metrics.intervals import fisher_exact_p, mcnemar_exact, wilson_interval
from uavaccel.suites.rl import paper
from uavaccel.suites.suite import Row

Arrays = Callable[[Row], Mapping[str, NDArray[Any]]]
KEY = ("variant", "profile", "timing", "command", "clock_speed")
SIMULATION = ("simulation", "rendering")  # the paper's "simulation": its images come out of it


def summarise(config: Mapping[str, Any], rows: Sequence[Row], load: Arrays) -> dict[str, Any]:
    """A cell for each training, the same with seeds pooled, the interchange test; nothing of this machine."""
    groups: dict[tuple[Any, ...], list[Row]] = defaultdict(list)
    for row in rows:
        groups[tuple(row[name] for name in KEY)].append(row)
    return {
        "suite": "rl",
        "seed": config["seed"],
        "training_games": config["games"],
        "evaluation_clock_speed": config["evaluation_clock_speed"],
        "cells": [_cell(row, load(row), _real_time(row, groups)) for row in rows],
        "pooled": [_pooled(members, _real_time(members[0], groups), load) for members in groups.values()],
        "interchange": [
            test for members in groups.values() if (test := _interchange(members, load)) is not None
        ],
    }


def _real_time(row: Row, groups: Mapping[tuple[Any, ...], list[Row]]) -> list[Row]:
    """The same trainings at 1x; none where they were not run, or on a clock without latency."""
    if row["timing"] != "virtual":
        return []
    return groups.get((*(row[name] for name in KEY[:-1]), 1.0), [])


def _cell(row: Row, arrays: Mapping[str, NDArray[Any]], real_time: Sequence[Row]) -> dict[str, Any]:
    flown = row["evaluations"][0]
    return {
        **{name: row[name] for name in (*KEY, "seed")},
        **_success(flown["successes"], flown["games"]),
        "distance_m_median": float(np.median(arrays[f"{row['command']}_distance_m"])),
        "trained_games": row["training"]["games"],
        "trained_successes": row["training"]["successes"],
        "weights_sha256": row["training"]["weights_sha256"],
        **_times([row], real_time),
    }


def _pooled(members: Sequence[Row], real_time: Sequence[Row], load: Arrays) -> dict[str, Any]:
    """All seeds of one training together, against the same at 1x and against the paper."""
    first, name = members[0], members[0]["command"]
    won = sum(row["evaluations"][0]["successes"] for row in members)
    games = sum(row["evaluations"][0]["games"] for row in members)
    key = [first[each] for each in ("profile", "variant", "command", "clock_speed")]
    simulation, whole = paper.speedups(*key)
    return {
        **{each: first[each] for each in KEY},
        "seeds": [row["seed"] for row in members],
        "successes_by_seed": [row["evaluations"][0]["successes"] for row in members],
        **_success(won, games),
        "trained_games": sum(row["training"]["games"] for row in members),
        "paper_successes": paper.successes(*key),
        **_against(members, real_time, name, load),
        **_times(members, real_time),
        "paper_training_speedup": simulation,
        "paper_whole_training_speedup": whole,
    }


def _success(won: int, games: int) -> dict[str, Any]:
    low, high = wilson_interval(won, games)
    return {
        "games": games,
        "successes": won,
        "success_ratio": won / games,
        "wilson_low": low,
        "wilson_high": high,
    }


def _against(members: Sequence[Row], real_time: Sequence[Row], command: str, load: Arrays) -> dict[str, Any]:
    """p-values against the trainings at 1x: Fisher's of the pooled games, and McNemar's of the same seeds and lanes."""
    if not real_time or members[0]["clock_speed"] == 1.0:
        return {"fisher_p": None, "mcnemar_p": None}
    counts = [
        (
            sum(row["evaluations"][0]["successes"] for row in group),
            sum(row["evaluations"][0]["games"] for row in group),
        )
        for group in (members, real_time)
    ]
    first, second = paired(members, real_time, f"{command}_", f"{command}_", load)
    return {
        "fisher_p": fisher_exact_p(*counts),
        "mcnemar_p": mcnemar_exact(first, second).p_value if len(first) else None,
    }


def paired(
    some: Sequence[Row], others: Sequence[Row], prefix: str, other_prefix: str, load: Arrays
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Outcomes (n,) of two groups of trainings on the same lanes with the same seeds."""
    of_seed = {row["seed"]: row for row in others}
    pairs: list[tuple[bool, bool]] = []
    for row in some:
        if row["seed"] not in of_seed:
            continue
        mine, theirs = load(row), load(of_seed[row["seed"]])
        known = dict(
            zip(
                theirs[f"{other_prefix}lane"].tolist(),
                theirs[f"{other_prefix}is_success"].tolist(),
                strict=True,
            )
        )
        for lane, won in zip(
            mine[f"{prefix}lane"].tolist(), mine[f"{prefix}is_success"].tolist(), strict=True
        ):
            if lane in known:
                pairs.append((won, known[lane]))
    first, second = np.array(pairs, bool).reshape(-1, 2).T
    return first, second


def _times(members: Sequence[Row], real_time: Sequence[Row]) -> dict[str, Any]:
    """Modelled seconds of the training, of the same commands in real time, and the speed-ups between the two.

    Speed-ups are of a command's mean: trainings that learn differently fly games of different length.
    """
    phase_s = {phase: sum(row["training"]["phase_s"][phase] for row in members) for phase in PHASES}
    commands = sum(row["training"]["commands"] for row in members)
    wall_s = sum(phase_s.values())
    known = bool(real_time)
    return {
        "commands": commands,
        "sim_time_s": sum(row["training"]["sim_time_s"] for row in members),
        "training_wall_s": wall_s,
        "real_time_s": per_command(real_time, PHASES) * commands if known else None,
        "training_speedup": _ratio(real_time, members, SIMULATION) if known else None,
        "whole_training_speedup": _ratio(real_time, members, PHASES) if known else None,
        "phase_s": phase_s,
    }


def _ratio(real_time: Sequence[Row], members: Sequence[Row], phases: Sequence[str]) -> float:
    return per_command(real_time, phases) / per_command(members, phases)


def per_command(members: Sequence[Row], phases: Sequence[str]) -> float:
    """Modelled wall seconds of a command's share of some phases."""
    spent_s = sum(row["training"]["phase_s"][phase] for row in members for phase in phases)
    return float(spent_s / sum(row["training"]["commands"] for row in members))


def _interchange(members: Sequence[Row], load: Arrays) -> dict[str, Any] | None:
    """Policies flown with the command that they were not trained with; None where none was."""
    tested = [row for row in members if len(row["evaluations"]) > 1]
    if not tested:
        return None
    trained, other = (tested[0]["evaluations"][place]["command"] for place in (0, 1))
    outcomes = [
        {
            "command": command,
            **_success(
                sum(row["evaluations"][place]["successes"] for row in tested),
                sum(row["evaluations"][place]["games"] for row in tested),
            ),
        }
        for place, command in enumerate((trained, other))
    ]
    test = mcnemar_exact(*paired(tested, tested, f"{trained}_", f"{other}_", load))
    return {
        **{name: tested[0][name] for name in KEY},
        "seeds": [row["seed"] for row in tested],
        "flown_with": outcomes,
        "only_first": test.only_first,
        "only_second": test.only_second,
        "mcnemar_p": test.p_value,
    }
