"""The RL experiment in numbers: success by training, and what its training took on the modelled clock."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.flyable import speed_of
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.stopwatch import PHASES
from uavaccel.metrics.intervals import Proportion, fisher_exact_p, mcnemar_exact
from uavaccel.metrics.seeds import hierarchical_interval, permutation_p, sign_flip_p
from uavaccel.suites import paper_results
from uavaccel.suites.report import Arrays, LoadArrays, Row
from uavaccel.suites.rl.cases import EXACT, other_command

KEY = ("variant", "profile", "timing", "command", "clock_speed")
Groups = Mapping[tuple[Any, ...], list[Row]]
"""Trainings by `KEY`, a row for each seed."""
BOOTSTRAP_SEED = 0
RUNNING = tuple(phase for phase in PHASES if phase != "rendering")  # ADSC's pictures are taken in a pause
SIMULATION = ("simulation", "rendering")  # the paper's "simulation": its images come out of it


def summarise(config: Mapping[str, Any], rows: Sequence[Row], load: LoadArrays) -> dict[str, Any]:
    """A cell for each training, the same with seeds pooled, what flew how; nothing of this machine."""
    load = _once(load)
    groups, exact = (_by_training(rows, trained) for trained in (True, False))
    pooled = list(groups.values())
    return {
        "suite": "rl",
        "seed": config["seed"],
        "training_games": config["games"],
        "evaluation_clock_speed": config["evaluation_clock_speed"],
        "cells": [_cell(row, load(row), _baseline(row, groups)) for row in rows if "training" in row],
        "pooled": [_pooled(members, groups, load) for members in pooled],
        "interchange": [each for members in pooled if (each := _interchange(members, load))],
        "interchange_as_trained": [
            each for members in pooled if (each := _interchange(members, load, members[0]["clock_speed"]))
        ],
        "as_trained": [each for members in pooled if (each := _as_trained(members, groups, load))],
        "exact": [side_by_side(groups[key], members, load) for key, members in exact.items()],
        "same_weights": [_same_weights(each) for each in _over_clocks(groups)],
    }


def _once(load: LoadArrays) -> LoadArrays:
    """Each row's arrays are read and checked once."""
    loaded: dict[str, Arrays] = {}

    def kept(row: Row) -> Arrays:
        if row["case"] not in loaded:
            loaded[row["case"]] = load(row)
        return loaded[row["case"]]

    return kept


def _by_training(rows: Sequence[Row], trained: bool) -> dict[tuple[Any, ...], list[Row]]:
    """Rows of trainings, or of their policies in the exact simulator, by `KEY`: a group holds the seeds of one cell."""
    groups: dict[tuple[Any, ...], list[Row]] = defaultdict(list)
    for row in rows:
        if ("training" in row) == trained:
            groups[tuple(row[name] for name in KEY)].append(row)
    return groups


def _at_1x(row: Row, groups: Groups, command: str) -> list[Row]:
    """Trainings at 1x with that command; none where they were not run, or on a clock without latency."""
    if row["timing"] != "virtual":
        return []
    return groups.get((*(row[name] for name in KEY[:-2]), command, 1.0), [])


def _baseline(row: Row, groups: Groups) -> list[Row]:
    """What speed-ups are over, as the paper's: ADSC at 1x."""
    return _at_1x(row, groups, "adsc")


def _cell(row: Row, arrays: Arrays, baseline: Sequence[Row]) -> dict[str, Any]:
    flown = row["evaluations"][0]
    return {
        **{name: row[name] for name in (*KEY, "seed")},
        **Proportion.of(flown).as_summary(),
        "distance_m_median": float(np.median(arrays[f"{row['command']}_distance_m"])),
        "trained_games": row["training"]["games"],
        "trained_successes": row["training"]["successes"],
        "weights_sha256": row["training"]["weights_sha256"],
        **_times([row], baseline),
    }


def _pooled(members: Sequence[Row], groups: Groups, load: LoadArrays) -> dict[str, Any]:
    """All seeds of one training together, against the same command at 1x and against the paper."""
    first = members[0]
    key = [first[each] for each in ("profile", "variant", "command", "clock_speed")]
    simulation, whole = paper_results.speedups(*key)
    other = [] if first["clock_speed"] == 1.0 else _at_1x(first, groups, first["command"])
    return {
        **{each: first[each] for each in KEY},
        "seeds": [row["seed"] for row in members],
        "successes_by_seed": [row["evaluations"][0]["successes"] for row in members],
        **pooled_success(members, 0, load),
        "trained_games": sum(row["training"]["games"] for row in members),
        "paper_successes": paper_results.successes(*key),
        **against(members, other, 0, load),
        **_times(members, _baseline(first, groups)),
        "gap_s": gap_s(members),
        "paper_training_speedup": simulation,
        "paper_whole_training_speedup": whole,
    }


def pooled_success(members: Sequence[Row], flight: int, load: LoadArrays) -> dict[str, Any]:
    """Success of all seeds together in one of their flights; its 95 % interval over seeds and games beside Wilson's.

    Wilson's is of the games of these very policies; the other is of what trainings with other seeds would have given.
    """
    flown = [row["evaluations"][flight] for row in members]
    won, games = (sum(each[key] for each in flown) for key in ("successes", "games"))
    samples = [list(_won(row, flight, load).values()) for row in members]
    low, high = hierarchical_interval(samples, BOOTSTRAP_SEED)
    return {**Proportion(won, games).as_summary(), "seeds_low": low, "seeds_high": high}


def ratios(members: Sequence[Row], flight: int) -> NDArray[np.float64]:
    """Success of each seed in one of their flights."""
    flown = [row["evaluations"][flight] for row in members]
    return np.array([Proportion.of(each).ratio for each in flown])


def against(members: Sequence[Row], others: Sequence[Row], flight: int, load: LoadArrays) -> dict[str, Any]:
    """p-values of two groups in a flight: over seeds, of pooled games, of the same seeds and lanes.

    Only the first is of trainings; Fisher's and McNemar's are of these very policies.
    """
    if not others:
        return {"permutation_p": None, "fisher_p": None, "mcnemar_p": None}
    mine, theirs = ([row["evaluations"][flight] for row in group] for group in (members, others))
    first, second = paired(members, others, (flight, flight), load)
    return {
        "permutation_p": permutation_p(ratios(members, flight), ratios(others, flight)),
        "fisher_p": fisher_exact_p(_sums(mine), _sums(theirs)),
        "mcnemar_p": mcnemar_exact(first, second).p_value if len(first) else None,
    }


def _sums(flown: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    return sum(each["successes"] for each in flown), sum(each["games"] for each in flown)


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
    """Whether each lane was won."""
    name = _array_name(row, flight)
    arrays = load(row)
    return dict(zip(arrays[f"{name}_lane"].tolist(), arrays[f"{name}_is_success"].tolist(), strict=True))


def _array_name(row: Row, flight: int) -> str:
    if "training" not in row:
        return EXACT
    flown = row["evaluations"][flight]
    in_real_time = flown["clock_speed"] == row["evaluations"][0]["clock_speed"]
    return str(flown["command"] if in_real_time else f"{flown['command']}-{flown['clock_speed']:g}x")


def _times(members: Sequence[Row], baseline: Sequence[Row]) -> dict[str, Any]:
    """Modelled seconds of the training, of as many commands of the baseline, and the speed-ups between the two.

    Speed-ups are of a command's mean: trainings that learn differently fly games of different length.
    """
    phase_s = {phase: sum(row["training"]["phase_s"][phase] for row in members) for phase in PHASES}
    commands = sum(row["training"]["commands"] for row in members)
    known = bool(baseline)
    return {
        "commands": commands,
        "sim_time_s": sum(row["training"]["sim_time_s"] for row in members),
        "training_wall_s": sum(phase_s.values()),
        "real_time_s": per_command(baseline, PHASES) * commands if known else None,
        "training_speedup": _ratio(baseline, members, SIMULATION) if known else None,
        "whole_training_speedup": _ratio(baseline, members, PHASES) if known else None,
        "phase_s": phase_s,
    }


def _ratio(baseline: Sequence[Row], members: Sequence[Row], phases: Sequence[str]) -> float:
    return per_command(baseline, phases) / per_command(members, phases)


def per_command(members: Sequence[Row], phases: Sequence[str]) -> float:
    """Modelled wall seconds of a command's share of some phases."""
    spent_s = sum(row["training"]["phase_s"][phase] for row in members for phase in phases)
    return float(spent_s / sum(row["training"]["commands"] for row in members))


def gap_s(members: Sequence[Row]) -> float:
    """Mean simulated seconds between a command's end and the next one in the trainings of one cell.

    Under TCSC the clock stands meanwhile: 0. Under ADSC it is what passes from command to command less T_move, all of
    the wall time but that of pictures, at the speed that the profile's platform reaches. A few calls of a millisecond
    that ADSC makes in its pauses are counted too, and a command that a collision ends early counts as a whole one.
    """
    first = members[0]
    if first["command"] == "tcsc":
        return 0.0
    task = LaneTask(timing=first["timing"], profile=first["profile"], clock_speed=first["clock_speed"])
    trained = [row["training"] for row in members]
    t_move_s: float = sum(each["sim_time_s"] for each in trained) / sum(each["commands"] for each in trained)
    return max(per_command(members, RUNNING) * float(speed_of(task)) - t_move_s, 0.0)


def _flight(row: Row, command: str, clock_speed: float) -> int | None:
    """Which of a row's flights is that; None where it was not flown."""
    flown = [(each["command"], each["clock_speed"]) for each in row["evaluations"]]
    return flown.index((command, clock_speed)) if (command, clock_speed) in flown else None


def _interchange(
    members: Sequence[Row], load: LoadArrays, clock_speed: float | None = None
) -> dict[str, Any] | None:
    """Policies flown with both commands in real time, or at another ClockSpeed; None where they were not."""
    first = members[0]
    in_real_time = first["evaluations"][0]["clock_speed"]
    if clock_speed == in_real_time:
        return None
    at = in_real_time if clock_speed is None else clock_speed
    commands = first["command"], other_command(first["command"])
    own, other = (_flight(first, command, at) for command in commands)
    if own is None or other is None:
        return None
    test = mcnemar_exact(*paired(members, members, (own, other), load))
    return {
        **{name: first[name] for name in KEY},
        "seeds": [row["seed"] for row in members],
        "flown_at": at,
        "flown_with": [
            {"command": command, **pooled_success(members, flight, load)}
            for command, flight in zip(commands, (own, other), strict=True)
        ],
        "only_first": test.only_first,
        "only_second": test.only_second,
        "mcnemar_p": test.p_value,
        "sign_flip_p": sign_flip_p(ratios(members, own) - ratios(members, other)),
    }


def _as_trained(members: Sequence[Row], groups: Groups, load: LoadArrays) -> dict[str, Any] | None:
    """Policies flown at the ClockSpeed of their training, against those without the variant; None where none was."""
    first = members[0]
    flight = _flight(first, first["command"], first["clock_speed"])
    if not flight:  # in real time it is the first
        return None
    plain = groups.get(("", *(first[name] for name in KEY[1:])), []) if first["variant"] else []
    plain = [row for row in plain if len(row["evaluations"]) == len(first["evaluations"])]
    return {
        **{name: first[name] for name in KEY},
        "seeds": [row["seed"] for row in members],
        "real_time": pooled_success(members, 0, load) | against(members, plain, 0, load),
        "as_trained": pooled_success(members, flight, load) | against(members, plain, flight, load),
        "sign_flip_p": sign_flip_p(ratios(members, 0) - ratios(members, flight)),
    }


def side_by_side(members: Sequence[Row], exact: Sequence[Row], load: LoadArrays) -> dict[str, Any]:
    """The same policies on the same lanes by the kernels and by the exact simulator, in real time."""
    seeds = [row["seed"] for row in exact]
    ours = [row for row in members if row["seed"] in seeds]
    first, second = paired(ours, exact, (0, 0), load)
    test = mcnemar_exact(first, second)
    return {
        **{name: exact[0][name] for name in KEY},
        "seeds": seeds,
        "kernels": pooled_success(ours, 0, load),
        "exact": pooled_success(exact, 0, load),
        "lanes": len(first),
        "same_end": int((first == second).sum()),
        "mcnemar_p": test.p_value,
    }


def _over_clocks(groups: Groups) -> list[list[Row]]:
    """The trainings of one command, all ClockSpeeds together, where there are several."""
    families: dict[tuple[Any, ...], list[Row]] = defaultdict(list)
    for key, members in groups.items():
        families[key[:-1]] += members
    return [rows for rows in families.values() if len({row["clock_speed"] for row in rows}) > 1]


def _same_weights(trainings: Sequence[Row]) -> dict[str, Any]:
    """How many seeds learned the same weights, by their hashes, at all ClockSpeeds that were trained."""
    clocks = sorted({row["clock_speed"] for row in trainings})
    by_seed: dict[int, list[str]] = defaultdict(list)
    for row in trainings:
        by_seed[row["seed"]].append(row["training"]["weights_sha256"])
    whole = {seed: hashes for seed, hashes in by_seed.items() if len(hashes) == len(clocks)}
    return {
        **{name: trainings[0][name] for name in KEY[:-1]},
        "clock_speed": clocks,
        "seeds": sorted(whole),
        "equal": [seed for seed in sorted(whole) if len(set(whole[seed])) == 1],
    }
