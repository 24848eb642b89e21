"""The paper's claims, decided from what DP1, DP2 and trainings have flown.

experiments/claims.yaml says which function decides which claim: the one of the claim's id, or one that decides several.
A claim holds where the 95 % interval of its number lies within the stated margins, fails where it lies outside them,
and is undecided where it straddles an end of the margins, or where too few games were flown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uavaccel.metrics.estimates import (
    Estimate,
    Success,
    all_of,
    exceeds,
    mean_estimate,
    opposite,
    ratio_estimate,
    within,
)
from uavaccel.metrics.intervals import Proportion, bootstrap_interval, median_interval
from uavaccel.sim.lane import LENGTH_M, Difficulty, sample_layout
from uavaccel.suites import paper_results
from uavaccel.suites.dp1 import CELL
from uavaccel.suites.report import finished
from uavaccel.suites.rl import Flights, success_of, where

FloatArray = NDArray[np.float64]

LEAST_FLIGHTS = 6  # in a cell of DP1: the range of five contains the median with less than 95 %
LEAST_IMAGES = 100  # if none of so many exceeds a limit, fewer than 3 % of all do, with 95 %
LEAST_GAMES = 100  # of a training, and of its evaluation, as in the paper
LEAST_TRAININGS = 3  # seeds: what one policy does tells little of what another training would give
RARE = 0.05  # share of games, or images, up to which they count for nothing
SIMULATION = ("simulation", "rendering")  # the paper's "simulation" renders the images
BESIDE_SIMULATION = ("image_processing", "inference", "learning")
PHASES = {"simulation": SIMULATION, "all": (*SIMULATION, *BESIDE_SIMULATION)}
SIMILAR, MAXIMUM = 1.8, 2.0  # STLC above which trajectories look alike (section III-C2a), and of identical ones
FASTEST, LONGEST_S = 100.0, 1.0
SPAN = 0.05, 0.95  # quantiles
SAME_PLACE_M = 0.05  # within which the paper's images at 5x and 10x are (section IV-C)

# Margins of success over that at 1x. Alike are the margins of bioequivalence, 80 to 125 %: the paper's 21 to 23 lies
# within, its 21 to 13 and 21 to 30 outside. A collapse keeps at most a third: the interval of 23 to 1 of 100 games
# reaches to a quarter. In between lies a loss, such as 38 %.
MARGINS = {"collapse": (0.0, 1 / 3), "loss": (1 / 3, 0.8), "alike": (0.8, 1.25), "gain": (1.25, np.inf)}
FLIES = 0.1  # success that a policy trained at 1x needs for a comparison


class NoEvidence(Exception):
    """The runs lack the games that would decide a claim, or those to compare them with."""


class Undecided(Exception):
    """The runs have the games, but these cannot decide the claim, for the reason given."""


class Finding(NamedTuple):
    """What a run tells of a claim: the deciding number in words, and whether it holds, None where that is open."""

    value: str
    holds: bool | None


class Flown(NamedTuple):
    """What a run of DP1 or DP2 tells: its scored games, of which claims need the columns below, and its summary."""

    scores: pd.DataFrame
    summary: Mapping[str, Any]


SCORES = {
    "dp1": [*CELL, "error", "stlc"],
    "dp2": ["command", "clock_speed", "reference", "position_error_m", "dvs_ed_percent"],
}


def at(table: pd.DataFrame, command: str, clock_speed: float | None = None, **keys: Any) -> pd.DataFrame:
    """Return the entries of a command, at a ClockSpeed, with these values. Raises NoEvidence where there are none."""
    keys |= {"command": command} | ({"clock_speed": clock_speed} if clock_speed else {})
    for name, value in keys.items():
        table = table[table[name] == value] if len(table) else table
    if table.empty:
        raise NoEvidence
    return table


def enough(count: int, least: int, what: str) -> None:
    """Raise Undecided where a run has less than it needs."""
    if count < least:
        raise Undecided(f"{what}: {count:g}, at least {least} are needed")


def known(values: Any) -> FloatArray:
    """Return values. Raises NoEvidence where there are none, or where one is not known."""
    values = np.asarray(values, float)
    if not values.size or np.isnan(values).any():
        raise NoEvidence
    return values


def ratio(first: Estimate, second: Estimate) -> Estimate:
    """Return first / second. Raises NoEvidence where one is not known or the second is 0."""
    if known([first, second])[1, 0] <= 0.0:
        raise NoEvidence
    return ratio_estimate(first, second)


# --- DP1: its games with their STLC, and the cells of its summary -------------------------------------------------


def clocks(dp1: Flown) -> list[float]:
    """Return 1x and the ClockSpeeds above it. Raises NoEvidence where none was flown."""
    if not (above := sorted({clock for clock in dp1.scores.clock_speed if clock > 1})):
        raise NoEvidence
    return [1.0, *above]


def stlc(dp1: Flown, command: str, clock_speed: float, **keys: Any) -> list[FloatArray]:
    """Return the STLC (games,) of each cell. Raises Undecided for one of fewer than LEAST_FLIGHTS games."""
    groups = at(dp1.scores, command, clock_speed, **keys).groupby(CELL)
    cells = [finished(cell).stlc.to_numpy(float) for _, cell in groups]
    for cell in cells:
        enough(len(cell), LEAST_FLIGHTS, f"games of {command} at {clock_speed:g}x in a cell")
    known(np.concatenate(cells))
    return cells


def pooled_median(*cells: FloatArray) -> FloatArray:
    """Return the median over the last axis of all cells together: T_moves and rounds pooled, as in Figure 5."""
    return np.asarray(np.median(np.concatenate(cells, axis=-1), axis=-1))


def median(dp1: Flown, command: str, clock_speed: float) -> Estimate:
    """Return the pooled median of the STLC; games are resampled within their cell, which keeps the cells' shares."""
    cells = stlc(dp1, command, clock_speed)
    return Estimate(float(pooled_median(*cells)), *bootstrap_interval(cells, pooled_median, dp1.summary["seed"]))


def above(
    dp1: Flown, first: list[FloatArray], second: list[FloatArray], statistic: Callable[..., FloatArray] = pooled_median
) -> bool | None:
    """Return whether a statistic of the first cells is above that of the second."""

    def difference(*cells: FloatArray) -> FloatArray:
        return statistic(*cells[: len(first)]) - statistic(*cells[len(first) :])

    return exceeds(bootstrap_interval([*first, *second], difference, dp1.summary["seed"]), 0.0)


def cells_of(dp1: Flown, command: str, clock_speed: float, **keys: Any) -> pd.DataFrame:
    """Return the cells of the summary. Raises as `at` does, and Undecided for one of too few games."""
    cells = at(pd.DataFrame(dp1.summary["cells"]), command, clock_speed, **keys).sort_values("t_move_s")
    enough(known(cells.games).min(), LEAST_FLIGHTS, f"games of {command} at {clock_speed:g}x in a cell")
    return cells


def speedups(dp1: Flown, command: str, clock_speed: float, **keys: Any) -> list[Estimate]:
    """Return the effective speed-ups on the longest path, by T_move. Raises as `cells_of` does."""
    cells = cells_of(dp1, command, clock_speed, rounds=dp1.scores["rounds"].max(), **keys)
    if cells.effective_speedup_interval.isna().any() or known(cells.effective_speedup).min() <= 0:
        raise NoEvidence
    ends = known(cells.effective_speedup_interval.tolist())
    return [Estimate(value, *interval) for value, interval in zip(cells.effective_speedup, ends.tolist(), strict=True)]


def longest(dp1: Flown, command: str) -> Estimate:
    """Return the effective speed-up at 100x on the longest path with the longest T_move. Raises as `speedups` does."""
    found = speedups(dp1, command, FASTEST, t_move_s=LONGEST_S)
    if len(found) > 1:
        raise NoEvidence
    return found[0]


def command_delay_grows(dp1: Flown) -> Finding:
    """The gap before the next command, simulated, the median over resampled cells, grows with each ClockSpeed."""
    gaps_ms = [1e3 * known(cells_of(dp1, "adsc", k).sort_values(CELL[2:]).command_gap_median_s) for k in clocks(dp1)]
    if len({len(gaps) for gaps in gaps_ms}) > 1:
        raise NoEvidence
    rises = [median_interval(later - earlier, dp1.summary["seed"]) for earlier, later in pairwise(gaps_ms)]
    text = " < ".join(f"{float(f'{np.median(gaps):.3g}'):g}" for gaps in gaps_ms) + " ms"
    return Finding(text, all_of(exceeds(interval, 0.0) for interval in rises))


def replicas_differ(dp1: Flown) -> Finding:
    """The STLC of replicas of one path, ADSC's games at 100x in a cell, lies on both sides of 1.8, as in Figure 3: that
    of more than RARE of the games on the other side than most of their cell's, by more than those at 1x scatter.
    """
    cells, real = stlc(dp1, "adsc", FASTEST), stlc(dp1, "adsc", 1.0)
    noise = 3.0 * max(float(cell.std()) for cell in real)
    sides = [(int(np.sum(cell < SIMILAR - noise)), int(np.sum(cell > SIMILAR + noise))) for cell in cells]
    games = np.concatenate(cells)
    others = Proportion(sum(map(min, sides)), len(games))
    text = f"{games.min():.2f} to {games.max():.2f}, {others.ratio:.0%} across {SIMILAR:g} from their path's others"
    return Finding(text, exceeds(others.interval, RARE))


def reference_near_2(dp1: Flown) -> Finding:
    """The pooled median of the real-time games, compared with each other, is less than .05 below the maximum."""
    real = median(dp1, "adsc", 1.0)
    return Finding(real.text(), exceeds(real.interval, MAXIMUM - 0.05))


def variance_grows(dp1: Flown) -> Finding:
    """The variance of ADSC's STLC grows with each ClockSpeed: that of the games of each number of rounds, T_moves
    pooled as in the boxes of Figure 5, averaged over the numbers of rounds.
    """
    lengths = sorted(dp1.scores["rounds"].unique())
    boxes = [[stlc(dp1, "adsc", k, rounds=rounds) for rounds in lengths] for k in clocks(dp1)]
    ends = np.cumsum([0, *map(len, boxes[0])])
    if any([*map(len, clock)] != [*map(len, boxes[0])] for clock in boxes):  # cells that one ClockSpeed lacks
        raise NoEvidence

    def evenness(*cells: FloatArray) -> FloatArray:
        pooled = [np.concatenate(cells[first:last], axis=-1) for first, last in pairwise(ends)]
        return -np.asarray(np.mean([box.var(axis=-1) for box in pooled], axis=0))

    by_clock = [[cell for box in clock for cell in box] for clock in boxes]
    grows = all_of(above(dp1, slow, fast, evenness) for slow, fast in pairwise(by_clock))
    return Finding(", ".join(f"{-float(evenness(*cells)):.2g}" for cells in by_clock), grows)


def median_above(dp1: Flown, first: Sequence[Any], second: Sequence[Any], form: str) -> Finding:
    """At each ClockSpeed above 1 a pooled median is above another, each of a command, on the shortest or longest path
    (min or max), or, with None, on all.
    """
    lengths, by_clock = dp1.scores["rounds"], []
    for k in clocks(dp1)[1:]:
        both = [(command, {"rounds": getattr(lengths, end)()} if end else {}) for command, end in (first, second)]
        by_clock.append([stlc(dp1, command, k, **keys) for command, keys in both])
    text = ", ".join(form.format(*(float(pooled_median(*cells)) for cells in both)) for both in by_clock)
    return Finding(text, all_of(above(dp1, one, other) for one, other in by_clock))


def tcsc_above_1_8(dp1: Flown) -> Finding:
    """TCSC's pooled median is above 1.8 at every ClockSpeed."""
    medians = {k: median(dp1, "tcsc", k) for k in clocks(dp1)}
    lowest = min(medians, key=lambda k: medians[k].value)
    similar = all_of(exceeds(found.interval, SIMILAR) for found in medians.values())
    return Finding(f"lowest at {lowest:g}x: {medians[lowest].text()}", similar)


def adsc_only_below_5x(dp1: Flown) -> Finding:
    """ADSC's pooled median is above 1.8 at 1x and at no ClockSpeed from 5x."""
    medians = {k: median(dp1, "adsc", k) for k in clocks(dp1)}
    if max(medians) < 5:
        raise NoEvidence
    similar = {k: exceeds(found.interval, SIMILAR) for k, found in medians.items()}
    text = ", ".join(f"{k:g}x {found.value:.3f}" for k, found in medians.items())
    return Finding(text, all_of([similar[1.0], *(opposite(similar[k]) for k in similar if k >= 5)]))


def tcsc_closer_to_ideal(dp1: Flown) -> Finding:
    """TCSC's effective speed-up exceeds ADSC's at each ClockSpeed above 1 and T_move, on the longest path."""
    both = [[speedups(dp1, command, k) for command in ("tcsc", "adsc")] for k in clocks(dp1)[1:]]
    if any(len(tcsc) != len(adsc) for tcsc, adsc in both):
        raise NoEvidence
    closer = [ratio(*pair) for tcsc, adsc in both for pair in zip(tcsc, adsc, strict=True)]
    text = f"{min(closer).value:.2f} to {max(closer).value:.2f} times ADSC's"
    return Finding(text, all_of(exceeds(each.interval, 1.0) for each in closer))


def adsc_speedup_grows_with_duration(dp1: Flown) -> Finding:
    """ADSC's effective speed-up at 100x grows with T_move, on the longest path."""
    by_duration = speedups(dp1, "adsc", FASTEST)
    if len(by_duration) < 2:
        raise NoEvidence
    grows = all_of(exceeds(ratio(long, short).interval, 1.0) for short, long in pairwise(by_duration))
    return Finding(" < ".join(f"{found.value:.3g}" for found in by_duration) + "x", grows)


def callback_costs_most(dp1: Flown) -> Finding:
    """ADSC's commands take more wall time beyond their flight at 100x than TCSC's, on the longest path."""
    (adsc, tcsc) = (
        Estimate(*(1e3 * LONGEST_S * (1 / speedup - 1 / FASTEST) for speedup in (value, high, low)))
        for value, low, high in (longest(dp1, command) for command in ("adsc", "tcsc"))
    )
    more = exceeds((adsc.low - tcsc.high, adsc.high - tcsc.low), 0.0)
    return Finding(f"{adsc.value:.3g} v {tcsc.value:.3g} ms", more)


def accelerated(dp1: Flown, error: float) -> Finding:
    """TCSC at 100x, T_move 1 s, longest path: 50x to 65x, and the pooled STLC within `error` of the maximum.

    The paper gives 50x, 62x and 65x for one number in three places: each is read as "50x to 65x" within its own error.
    """
    speedup, accuracy = longest(dp1, "tcsc"), median(dp1, "tcsc", FASTEST)
    near = exceeds(accuracy.interval, MAXIMUM * (1 - error))
    text = f"{speedup.text('x', 1)}, error {1 - accuracy.value / MAXIMUM:.1%}"
    return Finding(text, all_of([within(speedup.interval, (50.0, 65.0)), near]))


# --- DP2: its images with their errors, and its study of the guard ------------------------------------------------


def images(dp2: Flown, clock_speed: float) -> tuple[FloatArray, FloatArray]:
    """Return the position errors, m, and DVS-ED, %, (n,) each, of TCSC's images at a ClockSpeed against those at 1x."""
    game = at(dp2.scores[dp2.scores.reference.notna()], "tcsc", clock_speed).iloc[-1]
    error_m, dvs_ed = known(game.position_error_m), known(game.dvs_ed_percent)
    enough(len(dvs_ed), LEAST_IMAGES, f"images at {clock_speed:g}x")
    return error_m, dvs_ed


def images_within(dp2: Flown, clock_speed: float, percent: float) -> Finding:
    """The distance and the DVS-ED of images are within the limits, as all of the paper's are: all but RARE ones."""
    error_m, dvs_ed = images(dp2, clock_speed)
    beyond = Proportion(int(np.sum((error_m > SAME_PLACE_M) | (dvs_ed > percent))), len(dvs_ed))
    text = (
        f"at most {100 * error_m.max():.2g} cm; DVS-ED {np.median(dvs_ed):.2g} % (median), "
        f"above {percent:g} % in {np.mean(dvs_ed > percent):.1%} of the images, largest {dvs_ed.max():.2g} %"
    )
    return Finding(text, opposite(exceeds(beyond.interval, RARE)))


def images_beyond_10x(dp2: Flown) -> Finding:
    """From 10x to 50x and 100x both medians grow, the DVS-ED by more per cent than the distance by centimetres."""
    slow, texts, grow = images(dp2, 10.0), [], []
    for fast in (images(dp2, k) for k in (50.0, 100.0)):

        def growth(before: FloatArray, after: FloatArray, fast: Any = fast) -> FloatArray:
            """Return that of the distance, cm, and of the DVS-ED, %, of images with these numbers."""
            seen = zip((slow, fast), (before.astype(int), after.astype(int)), strict=True)
            (error_m, dvs_ed), (later_m, later_ed) = ([values[which] for values in both] for both, which in seen)
            rises = 100 * (np.median(later_m, -1) - np.median(error_m, -1))
            return np.array([rises, np.median(later_ed, -1) - np.median(dvs_ed, -1)])

        numbers = [np.arange(len(slow[0]), dtype=float), np.arange(len(fast[0]), dtype=float)]
        distance, dvs_ed = growth(*numbers)
        texts.append(f"{dvs_ed:+.2g} % v {distance:+.0f} cm")
        for statistic in (lambda *which: growth(*which)[0], lambda *which: np.subtract(*growth(*which)[::-1])):
            grow.append(exceeds(bootstrap_interval(numbers, statistic, dp2.summary["seed"]), 0.0))
    return Finding(", ".join(texts), all_of(grow))


def same_place_other_images(dp2: Flown) -> Finding:
    """At 50x and 100x the DVS-ED of images within the same 5 cm of distance, less its median there, spans more from its
    5 to its 95 % quantile than the 5 % of all images at 10x.
    """
    texts, wide, seed = [], [], dp2.summary["seed"]
    for k in (50.0, 100.0):
        error_m, dvs_ed = images(dp2, k)
        by_place = pd.Series(dvs_ed).groupby(np.floor(error_m / SAME_PLACE_M))
        apart = dvs_ed - by_place.transform("median").to_numpy()
        low, high = np.quantile(apart, SPAN)
        texts.append(f"{k:g}x {low:+.2g} to {high:+.2g} %")
        span = bootstrap_interval([apart], lambda each: np.diff(np.quantile(each, SPAN, -1), axis=0)[0], seed)
        wide.append(exceeds(span, 5.0))
    return Finding(", ".join(texts), all_of(wide))


def guard_keeps_out(dp2: Flown) -> Finding:
    """The perturbed share of the accepted images with the guard is at most .8 of that without."""
    if (guard := dp2.summary["guard_study"]) is None:
        raise NoEvidence
    shares, count = guard["perturbed_share_handed_on"], guard["images"] * guard["streams"]
    if known([shares["off"], shares["on"], count])[-1] <= 0:
        raise NoEvidence
    without, guarded = (Proportion(round(shares[state] * count), count) for state in ("off", "on"))
    enough(without.successes, LEAST_IMAGES, "perturbed images")
    kept = ratio(Success((guarded,)).estimate, Success((without,)).estimate)
    text = f"{without.ratio:.1%} to {guarded.ratio:.1%}: {kept.text(' of them', 2)}"
    return Finding(text, within(kept.interval, (0.0, 0.8)))


# --- Trainings (section IV-D) -------------------------------------------------------------------------------------


def trainings(flights: Flights, profile: str) -> Flights:
    """Return the flights in real time of a profile's policies, trained without a variant on the virtual clock."""
    found = where(flights, profile=profile, timing="virtual", variant="", exact=False)
    return found[found["at"].isin(found["at"][found.flight == 0])]


def won(rl: Flights, command: str, clock_speed: float) -> Success:
    """Return the evaluation games won by each training. Raises as `games_won` does."""
    return games_won(at(rl, command, clock_speed, flight=0), f"of {command.upper()} at {clock_speed:g}x")


def games_won(flights: Flights, of: str) -> Success:
    """Return the games won by each training. Raises Undecided for too few games or trainings."""
    enough(sum(success.games for success in flights.success), LEAST_GAMES, f"games {of}")
    enough(len(flights), LEAST_TRAININGS, f"trainings {of}")
    return success_of(flights)


def command_s(
    rl: Flights, command: str, clock_speed: float, phases: Sequence[str], least: int = LEAST_TRAININGS
) -> Estimate:
    """Return the modelled wall seconds of some phases per command, over trainings. Raises Undecided for too few."""
    cells, of = at(rl, command, clock_speed, flight=0), f"of {command.upper()} at {clock_speed:g}x"
    phases_s = known(cells[list(phases)]).sum(axis=1)
    if known(cells[["trained_games", "commands"]]).min() <= 0:
        raise NoEvidence
    enough(cells.trained_games.sum(), LEAST_GAMES, f"training games {of}")
    enough(len(cells), least, f"trainings {of}")
    return mean_estimate(phases_s / cells.commands)


def training_speedup(rl: Flights, clock_speed: float, phases: Sequence[str] = SIMULATION) -> Estimate:
    """Return the speed-up of TCSC over ADSC in real time, the paper's baseline (section III-C3), per command."""
    accelerated = command_s(rl, "tcsc", clock_speed, phases)
    return ratio(command_s(rl, "adsc", 1.0, phases), accelerated)


def share(success: Success) -> str:
    """Return the games won, as in "290 of 300 (97%)" or, of several trainings, "2900 of 3000 (97%, 10 trainings)"."""
    pooled, trainings = success.pooled, len(success.policies)
    several = f", {trainings} trainings" if trainings > 1 else ""
    return f"{pooled.successes} of {pooled.games} ({pooled.ratio:.0%}{several})"


def ratio_within(
    margins: str, name: str, real: Success, other: Success, form: str = "{} v {}: {}", same_policies: bool = False
) -> Finding:
    """Whether the success of other trainings over that of real ones, on the same lanes, lies within the named MARGINS.

    Raises Undecided where the real ones win too little to be compared, or so much that nothing could exceed them.
    """
    before = real.estimate
    if not exceeds(before.interval, FLIES):
        raise Undecided(f"{name} won {share(real)}, not surely above {FLIES:.0%}")
    if before.high * (least := MARGINS[margins][0]) > 1:
        raise Undecided(f"{share(real)} leaves no room for {least:g} times as much")
    kept = other.ratio(real, same_policies)
    text = form.format(share(real), share(other), kept.text(" times", 2))
    return Finding(text, within(kept.interval, MARGINS[margins]))


def success_kept(rl: Flights, real: tuple[str, float], other: tuple[str, float], margins: str) -> Finding:
    """The success of the trainings with a command at a ClockSpeed over that of real ones, which must be able to fly,
    lies within the MARGINS of this name.
    """
    accelerated = won(rl, *other)
    return ratio_within(margins, f"{real[0].upper()} at {real[1]:g}x", won(rl, *real), accelerated)


def adsc_fails_accelerated(rl: Flights) -> Finding:
    """At each ClockSpeed above 1 an ADSC-trained policy keeps at most a third of the success of one trained at 1x."""
    if not (clocks := sorted(k for k in set(at(rl, "adsc").clock_speed) if k > 1)):
        raise NoEvidence
    collapses = all_of(success_kept(rl, ("adsc", 1.0), ("adsc", k), "collapse").holds for k in clocks)
    return Finding(", ".join(f"{k:g}x {share(won(rl, 'adsc', k))}" for k in [1.0, *clocks]), collapses)


def policy_flies_with_both(rl: Flights) -> Finding:
    """Policies trained with TCSC in real time have equal success with both commands."""
    tcsc, adsc = (games_won(at(rl, "tcsc", 1.0, **{"with": name}), f"with {name.upper()}") for name in ("tcsc", "adsc"))
    return ratio_within("alike", "TCSC at 1x", tcsc, adsc, "TCSC {} v ADSC {}: {}", same_policies=True)


def lines_peak_at_obstacles(rl: Flights) -> Finding:
    """At each ClockSpeed, of TCSC's games that end before the goal more end within 1 m of a row of obstacles than the
    rows' share of the lane.
    """
    if (flown := at(rl, "tcsc", flight=0)).distance_m.isna().any():
        raise NoEvidence
    rows_m = np.unique(sample_layout(0, Difficulty()).x_m)
    by_chance, texts, peaks = len(rows_m) * 2.0 / LENGTH_M, [], []
    for k, own in flown.groupby("clock_speed"):
        won(rl, "tcsc", k)  # enough games
        ended_m = np.concatenate([each.distance_m[~each.won.to_numpy(bool)] for each in own.itertuples()])
        if not len(ended_m):
            raise Undecided(f"no game of TCSC at {k:g}x ended before the goal")
        near_m = np.abs(ended_m[:, None] - rows_m).min(axis=1)
        near = Proportion(int(np.sum(near_m <= 1.0)), len(ended_m))
        texts.append(f"{k:g}x {share(Success((near,)))}")
        peaks.append(exceeds(near.interval, by_chance))
    return Finding(f"{', '.join(texts)}; by chance {by_chance:.0%}", all_of(peaks))


def as_fast(rl: Flights, clock_speed: float, phases: str) -> Finding:
    """The speed-up of a training, of the simulation alone or of all phases, is within 15 % of the paper's."""
    speedup = training_speedup(rl, clock_speed, PHASES[phases])
    aim = {"simulation": paper_results.SIMULATION_SPEEDUP, "all": paper_results.TRAINING_SPEEDUP}[phases][clock_speed]
    return Finding(f"{speedup.value:.3g}x", within(speedup.interval, (0.85 * aim, 1.15 * aim)))


def simulation_dominates_at_1x(rl: Flights) -> Finding:
    """Simulation with rendering takes more than half of the time of a command in real time."""
    simulated = ratio(*(command_s(rl, "adsc", 1.0, phases) for phases in (SIMULATION, PHASES["all"])))
    return Finding(f"{simulated.value:.1%}", exceeds(simulated.interval, 0.5))


def rendering_costs_scalability(dp1: Flown, rl: Flights) -> Finding:
    """TCSC's speed-up at 100x, T_move 1 s, longest path, is more than twice as high without rendering as with it."""
    without, rendered = longest(dp1, "tcsc"), training_speedup(rl, FASTEST)
    text = f"{without.value:.3g}x v {rendered.value:.3g}x"
    return Finding(text, exceeds(ratio(without, rendered).interval, 2.0))


def training_phases(rl: Flights) -> list[dict[str, float]]:
    """Return the hours of TCSC's trainings by ClockSpeed and phase, beside those that the paper's speed-ups imply.

    Hours are scaled to trainings that take ADSC the paper's 182 hours at 1x. Empty where ADSC was not trained at 1x.
    """
    found, named = [], {"simulation": SIMULATION, **{phase: (phase,) for phase in BESIDE_SIMULATION}}
    try:
        hour_s = (
            command_s(rl, "adsc", 1.0, PHASES["all"], 1).value * 3600 / paper_results.REAL_TIME_S
        )  # of a command in an hour's
        for k in [k for k in paper_results.CLOCKS if k in set(at(rl, "tcsc").clock_speed)]:
            hours = {f"{name}_h": command_s(rl, "tcsc", k, phases, 1).value / hour_s for name, phases in named.items()}
            paper = zip(("paper_simulation_h", "paper_beside_h"), paper_results.phase_hours(k), strict=True)
            found.append({"clock_speed": k, **hours, **dict(paper)})
    except (NoEvidence, Undecided):
        return []
    return found
