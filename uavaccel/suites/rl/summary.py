"""The RL experiment in numbers: success by training, and what its training took on the modelled clock."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.stopwatch import PHASES
from uavaccel.metrics.intervals import Proportion, fisher_exact_p, mcnemar_exact
from uavaccel.suites import paper_results
from uavaccel.suites.report import Arrays, LoadArrays, Row

KEY = ("variant", "profile", "timing", "command", "clock_speed")
SIMULATION = ("simulation", "rendering")  # the paper's "simulation": its images come out of it


def summarise(config: Mapping[str, Any], rows: Sequence[Row], load: LoadArrays) -> dict[str, Any]:
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
        "as_trained": [
            flown for members in groups.values() if (flown := _as_trained(members, groups, load)) is not None
        ],
    }


def _real_time(row: Row, groups: Mapping[tuple[Any, ...], list[Row]]) -> list[Row]:
    """The same trainings at 1x; none where they were not run, or on a clock without latency."""
    if row["timing"] != "virtual":
        return []
    return groups.get((*(row[name] for name in KEY[:-1]), 1.0), [])


def _cell(row: Row, arrays: Arrays, real_time: Sequence[Row]) -> dict[str, Any]:
    flown = row["evaluations"][0]
    return {
        **{name: row[name] for name in (*KEY, "seed")},
        **Proportion.of(flown).as_summary(),
        "distance_m_median": float(np.median(arrays[f"{row['command']}_distance_m"])),
        "trained_games": row["training"]["games"],
        "trained_successes": row["training"]["successes"],
        "weights_sha256": row["training"]["weights_sha256"],
        **_times([row], real_time),
    }


def _pooled(members: Sequence[Row], real_time: Sequence[Row], load: LoadArrays) -> dict[str, Any]:
    """All seeds of one training together, against the same at 1x and against the paper."""
    first = members[0]
    key = [first[each] for each in ("profile", "variant", "command", "clock_speed")]
    simulation, whole = paper_results.speedups(*key)
    other = [] if first["clock_speed"] == 1.0 else real_time
    return {
        **{each: first[each] for each in KEY},
        "seeds": [row["seed"] for row in members],
        "successes_by_seed": [row["evaluations"][0]["successes"] for row in members],
        **pooled_success(members, 0),
        "trained_games": sum(row["training"]["games"] for row in members),
        "paper_successes": paper_results.successes(*key),
        **against(members, other, 0, load),
        **_times(members, real_time),
        "paper_training_speedup": simulation,
        "paper_whole_training_speedup": whole,
    }


def pooled_success(members: Sequence[Row], flight: int) -> dict[str, Any]:
    """Success of all seeds together in one of their flights."""
    flown = [row["evaluations"][flight] for row in members]
    won, games = (sum(each[key] for each in flown) for key in ("successes", "games"))
    return Proportion(won, games).as_summary()


def against(members: Sequence[Row], others: Sequence[Row], flight: int, load: LoadArrays) -> dict[str, Any]:
    """p-values of two groups in a flight: Fisher's of pooled games, McNemar's of the same seeds and lanes."""
    if not others:
        return {"fisher_p": None, "mcnemar_p": None}
    mine, theirs = (pooled_success(group, flight) for group in (members, others))
    first, second = paired(members, others, (flight, flight), load)
    return {
        "fisher_p": fisher_exact_p(
            (mine["successes"], mine["games"]), (theirs["successes"], theirs["games"])
        ),
        "mcnemar_p": mcnemar_exact(first, second).p_value if len(first) else None,
    }


def paired(
    some: Sequence[Row], others: Sequence[Row], flight: tuple[int, int], load: LoadArrays
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Outcomes (n,) of two groups of trainings, each in one of its flights, on the same lanes with the same seeds."""
    of_seed = {row["seed"]: row for row in others}
    pairs: list[tuple[bool, bool]] = []
    for row in some:
        if row["seed"] in of_seed:
            mine, theirs = _won(row, flight[0], load), _won(of_seed[row["seed"]], flight[1], load)
            pairs += [(won, theirs[lane]) for lane, won in mine.items() if lane in theirs]
    first, second = np.array(pairs, bool).reshape(-1, 2).T
    return first, second


def _won(row: Row, flight: int, load: LoadArrays) -> dict[int, bool]:
    flown, arrays = row["evaluations"][flight], load(row)
    in_real_time = flown["clock_speed"] == row["evaluations"][0]["clock_speed"]
    name = flown["command"] if in_real_time else f"{flown['command']}-{flown['clock_speed']:g}x"
    return dict(zip(arrays[f"{name}_lane"].tolist(), arrays[f"{name}_is_success"].tolist(), strict=True))


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


def _interchange(members: Sequence[Row], load: LoadArrays) -> dict[str, Any] | None:
    """Policies flown with the command that they were not trained with too; None where none was."""
    flown = members[0]["evaluations"]
    other = next((n for n, each in enumerate(flown) if each["command"] != flown[0]["command"]), None)
    if other is None:
        return None
    test = mcnemar_exact(*paired(members, members, (0, other), load))
    return {
        **{name: members[0][name] for name in KEY},
        "seeds": [row["seed"] for row in members],
        "flown_with": [
            {"command": flown[flight]["command"], **pooled_success(members, flight)} for flight in (0, other)
        ],
        "only_first": test.only_first,
        "only_second": test.only_second,
        "mcnemar_p": test.p_value,
    }


def _as_trained(
    members: Sequence[Row], groups: Mapping[tuple[Any, ...], list[Row]], load: LoadArrays
) -> dict[str, Any] | None:
    """Policies flown at the ClockSpeed of their training, against those without the variant; None where none was."""
    first = members[0]
    flight = next(
        (
            n
            for n, each in enumerate(first["evaluations"])
            if n and (each["command"], each["clock_speed"]) == (first["command"], first["clock_speed"])
        ),
        None,
    )
    if flight is None:
        return None
    plain = groups.get(("", *(first[name] for name in KEY[1:])), []) if first["variant"] else []
    plain = [row for row in plain if len(row["evaluations"]) == len(first["evaluations"])]
    return {
        **{name: first[name] for name in KEY},
        "seeds": [row["seed"] for row in members],
        "real_time": pooled_success(members, 0) | against(members, plain, 0, load),
        "as_trained": pooled_success(members, flight) | against(members, plain, flight, load),
    }
