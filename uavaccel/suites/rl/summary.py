"""The summary of the RL experiment: success by training, and what its training took on the modelled clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.flyable import speed_of
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.stopwatch import PHASES
from uavaccel.metrics.equivalence import success_estimate
from uavaccel.metrics.intervals import Proportion, fisher_exact_p, mcnemar_exact
from uavaccel.metrics.seeds import permutation_p, sign_flip_p
from uavaccel.suites import paper_results
from uavaccel.suites.old_report import Arrays, LoadArrays, Values
from uavaccel.suites.rl.cases import EXACT, RlRow, other_command
from uavaccel.suites.rows import Row, grouped, subset

CellKey = tuple[object, ...]
Groups = Mapping[CellKey, list[RlRow]]
"""Trainings by `KEY`, a row for each seed."""
KEY = ("variant", "profile", "timing", "command", "clock_speed")
"""The conditions of a training; trainings that have them in common differ in their seed alone."""
key_of: Callable[[Row | RlRow], CellKey] = itemgetter(*KEY)
"""Returns the values of `KEY` of a row or of an entry of the summary."""
WITHOUT_IMAGES = tuple(phase for phase in PHASES if phase != "rendering")  # ADSC takes its images in a pause
SIMULATION = ("simulation", "rendering")  # the paper's "simulation" renders the images


def summarise(config: Row, rows: Sequence[RlRow], load: LoadArrays) -> Values:
    """Summarise each training, the seeds of each condition pooled, and the comparisons between conditions."""
    load = _cached(load)
    groups, exact = (
        grouped([row for row in rows if ("training" in row) == trained], key_of) for trained in (True, False)
    )
    pooled = list(groups.values())
    return {
        "suite": "rl",
        "seed": config["seed"],
        "training_games": config["games"],
        "evaluation_clock_speed": config["evaluation_clock_speed"],
        "cells": [_cell(row, load(row), _at_1x(row, groups, "adsc")) for row in rows if "training" in row],
        "pooled": [_pooled(members, groups, load) for members in pooled],
        "interchange": [each for members in pooled if (each := _interchange(members, load))],
        "interchange_as_trained": [
            each for members in pooled if (each := _interchange(members, load, members[0]["clock_speed"]))
        ],
        "as_trained": [each for members in pooled if (each := _as_trained(members, groups, load))],
        "exact": [side_by_side(groups[key], members, load) for key, members in exact.items()],
        "same_weights": _same_weights(groups),
    }


def _cached(load: LoadArrays) -> LoadArrays:
    """Return a loader that reads and checks the arrays of each row once."""
    loaded: dict[str, Arrays] = {}

    def cached(row: Row) -> Arrays:
        if row["case"] not in loaded:
            loaded[row["case"]] = load(row)
        return loaded[row["case"]]

    return cached


def _at_1x(row: RlRow, groups: Groups, command: str) -> list[RlRow]:
    """Return the trainings with that command at 1x; none in lockstep, or where they were not run.

    With ADSC they are the baseline of speed-ups, as in the paper.
    """
    return groups.get((*key_of(row)[:-2], command, 1.0), []) if row["timing"] == "virtual" else []


def _cell(row: RlRow, arrays: Arrays, baseline: Sequence[RlRow]) -> Values:
    trained = row["training"]
    return {
        **subset(row, *KEY, "seed"),
        **Proportion.of(row["evaluations"][0]).as_summary(),
        "distance_m_median": float(np.median(arrays[f"{row['command']}_distance_m"])),
        "trained_games": trained["games"],
        "trained_successes": trained["successes"],
        "weights_sha256": trained["weights_sha256"],
        **_times([row], baseline),
    }


def _pooled(members: Sequence[RlRow], groups: Groups, load: LoadArrays) -> Values:
    """Summarise all seeds of one training, compared with the same command at 1x and with the paper."""
    first = members[0]
    conditions = first["profile"], first["variant"], first["command"], first["clock_speed"]
    simulation, whole = paper_results.speedups(*conditions)
    other = [] if first["clock_speed"] == 1.0 else _at_1x(first, groups, first["command"])
    return {
        **_identity(members),
        "successes_by_seed": [row["evaluations"][0]["successes"] for row in members],
        **pooled_success(members, 0),
        "trained_games": sum(row["training"]["games"] for row in members),
        "paper_successes": paper_results.successes(*conditions),
        **compare(members, other, 0, load),
        **_times(members, _at_1x(first, groups, "adsc")),
        "gap_s": gap_s(members),
        "paper_training_speedup": simulation,
        "paper_whole_training_speedup": whole,
    }


def _identity(members: Sequence[RlRow]) -> Values:
    """Return the conditions of a group of trainings, and its seeds."""
    return {**subset(members[0], *KEY), "seeds": [row["seed"] for row in members]}


def pooled_success(members: Sequence[RlRow], flight: int) -> Values:
    """Return the success of all seeds together in one of their flights, with two 95 % intervals.

    `wilson_low` and `wilson_high` are of the games of these very policies; `seeds_low` and `seeds_high` also cover what
    trainings with other seeds would have given (`success_estimate`).
    """
    evaluated = _evaluated(members, flight)
    over_seeds = success_estimate(evaluated)
    pooled = Proportion.pooled(evaluated).as_summary()
    return {**pooled, "seeds_low": over_seeds.low, "seeds_high": over_seeds.high}


def ratios(members: Sequence[RlRow], flight: int) -> NDArray[np.float64]:
    """Return the success of each seed in one of their flights, (seeds,)."""
    return np.array([each.ratio for each in _evaluated(members, flight)])


def compare(members: Sequence[RlRow], others: Sequence[RlRow], flight: int, load: LoadArrays) -> Values:
    """Return p-values of the difference between two groups of trainings in a flight; None without a second group.

    `permutation_p` takes trainings as its samples; Fisher's test of the pooled games and McNemar's of equal seeds and
    lanes compare these very policies alone.
    """
    if not others:
        return {"permutation_p": None, "fisher_p": None, "mcnemar_p": None}
    first, second = paired(members, others, (flight, flight), load)
    mine, theirs = (Proportion.pooled(_evaluated(group, flight)) for group in (members, others))
    return {
        "permutation_p": permutation_p(ratios(members, flight), ratios(others, flight)),
        "fisher_p": fisher_exact_p((mine.successes, mine.games), (theirs.successes, theirs.games)),
        "mcnemar_p": mcnemar_exact(first, second).p_value if len(first) else None,
    }


def _evaluated(members: Sequence[RlRow], flight: int) -> list[Proportion]:
    return [Proportion.of(row["evaluations"][flight]) for row in members]


def paired(
    some: Sequence[RlRow], others: Sequence[RlRow], flight: tuple[int, int], load: LoadArrays
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the outcomes (n,) of two groups, each in one of its flights, paired by seed and lane."""
    of_seed = {row["seed"]: row for row in others}
    pairs: list[tuple[bool, bool]] = []
    for row in some:
        if row["seed"] in of_seed:
            mine, theirs = _outcomes(row, flight[0], load), _outcomes(of_seed[row["seed"]], flight[1], load)
            pairs += [(won, theirs[lane]) for lane, won in mine.items() if lane in theirs]
    first, second = np.array(pairs, bool).reshape(-1, 2).T
    return first, second


def _outcomes(row: RlRow, flight: int, load: LoadArrays) -> dict[int, bool]:
    flown, real_time = row["evaluations"][flight], row["evaluations"][0]["clock_speed"]
    at = "" if flown["clock_speed"] == real_time else f"-{flown['clock_speed']:g}x"
    name, arrays = f"{flown['command']}{at}" if "training" in row else EXACT, load(row)
    return dict(zip(arrays[f"{name}_lane"].tolist(), arrays[f"{name}_is_success"].tolist(), strict=True))


def _times(members: Sequence[RlRow], baseline: Sequence[RlRow]) -> Values:
    """Return the modelled seconds of the trainings, those of as many commands of the baseline, and the speed-ups.

    Speed-ups are of a command's mean time, as trainings that learn differently fly games of different length.
    """
    trained = [row["training"] for row in members]
    phase_s = {phase: sum(each["phase_s"][phase] for each in trained) for phase in PHASES}
    commands = sum(each["commands"] for each in trained)
    known = bool(baseline)
    return {
        "commands": commands,
        "sim_time_s": sum(each["sim_time_s"] for each in trained),
        "training_wall_s": sum(phase_s.values()),
        "real_time_s": per_command(baseline, PHASES) * commands if known else None,
        "training_speedup": _ratio(baseline, members, SIMULATION) if known else None,
        "whole_training_speedup": _ratio(baseline, members, PHASES) if known else None,
        "phase_s": phase_s,
    }


def _ratio(baseline: Sequence[RlRow], members: Sequence[RlRow], phases: Sequence[str]) -> float:
    return per_command(baseline, phases) / per_command(members, phases)


def per_command(members: Sequence[RlRow], phases: Sequence[str]) -> float:
    """Return the modelled wall seconds that some phases take per command."""
    spent_s = sum(row["training"]["phase_s"][phase] for row in members for phase in phases)
    return float(spent_s / sum(row["training"]["commands"] for row in members))


def gap_s(members: Sequence[RlRow]) -> float:
    """Return the mean simulated time between the end of a command and the next one in the trainings of one cell.

    With TCSC the clock is paused meanwhile: 0. With ADSC it is the simulated time from command to command less
    T_move: all of the wall time but that of images, at the speed that the profile's platform reaches. A few calls of a
    millisecond that ADSC makes in its pauses are counted too, and a command that a collision ends early counts as a
    whole one.
    """
    first = members[0]
    if first["command"] == "tcsc":
        return 0.0
    task = LaneTask(timing=first["timing"], profile=first["profile"], clock_speed=first["clock_speed"])
    trained = [row["training"] for row in members]
    t_move_s: float = sum(each["sim_time_s"] for each in trained) / sum(each["commands"] for each in trained)
    return max(per_command(members, WITHOUT_IMAGES) * float(speed_of(task)) - t_move_s, 0.0)


def _flight(row: RlRow, command: str, clock_speed: float) -> int | None:
    """Return the index of a flight among those of a row; None where it was not flown."""
    flown = [(each["command"], each["clock_speed"]) for each in row["evaluations"]]
    return next((n for n, each in enumerate(flown) if each == (command, clock_speed)), None)


def _interchange(
    members: Sequence[RlRow], load: LoadArrays, clock_speed: float | None = None
) -> Values | None:
    """Compare the flights with either command in real time, or at another ClockSpeed; None where there are none."""
    first = members[0]
    real_time = first["evaluations"][0]["clock_speed"]
    if clock_speed == real_time:
        return None
    at = real_time if clock_speed is None else clock_speed
    commands = first["command"], other_command(first["command"])
    own, other = (_flight(first, command, at) for command in commands)
    if own is None or other is None:
        return None
    test = mcnemar_exact(*paired(members, members, (own, other), load))
    return {
        **_identity(members),
        "flown_at": at,
        "flown_with": [
            {"command": command, **pooled_success(members, flight)}
            for command, flight in zip(commands, (own, other), strict=True)
        ],
        "only_first": test.only_first,
        "only_second": test.only_second,
        "mcnemar_p": test.p_value,
        "sign_flip_p": sign_flip_p(ratios(members, own) - ratios(members, other)),
    }


def _as_trained(members: Sequence[RlRow], groups: Groups, load: LoadArrays) -> Values | None:
    """Compare the flights at the ClockSpeed of the training with those of trainings without the variant.

    None where policies were flown in real time alone.
    """
    first = members[0]
    flight = _flight(first, first["command"], first["clock_speed"])
    if not flight:  # 0 is the flight in real time
        return None
    plain = groups.get(("", *key_of(first)[1:]), []) if first["variant"] else []
    plain = [row for row in plain if len(row["evaluations"]) == len(first["evaluations"])]
    return {
        **_identity(members),
        "real_time": pooled_success(members, 0) | compare(members, plain, 0, load),
        "as_trained": pooled_success(members, flight) | compare(members, plain, flight, load),
        "sign_flip_p": sign_flip_p(ratios(members, 0) - ratios(members, flight)),
    }


def side_by_side(members: Sequence[RlRow], exact: Sequence[RlRow], load: LoadArrays) -> Values:
    """Compare the same policies on the same lanes in real time in the kernels and in the exact simulator."""
    seeds = [row["seed"] for row in exact]
    kernels = [row for row in members if row["seed"] in seeds]
    first, second = paired(kernels, exact, (0, 0), load)
    return {
        **_identity(exact),
        "kernels": pooled_success(kernels, 0),
        "exact": pooled_success(exact, 0),
        "lanes": len(first),
        "same_end": int((first == second).sum()),
        "mcnemar_p": mcnemar_exact(first, second).p_value,
    }


def _same_weights(groups: Groups) -> list[Values]:
    """Return how many seeds learned the same weights at all ClockSpeeds that a command was trained at, if several."""
    found = []
    for family in grouped(groups.values(), lambda members: key_of(members[0])[:-1]).values():
        if len(family) > 1:
            rows = [row for members in family for row in members]
            by_seed = sorted(grouped(rows, itemgetter("seed")).items())
            hashes = {seed: {row["training"]["weights_sha256"] for row in own} for seed, own in by_seed}
            whole = [seed for seed, own in by_seed if len(own) == len(family)]
            equal = [seed for seed in whole if len(hashes[seed]) == 1]
            clocks = sorted(members[0]["clock_speed"] for members in family)
            conditions = subset(rows[0], *KEY[:-1])
            found.append({**conditions, "clock_speed": clocks, "seeds": whole, "equal": equal})
    return found
