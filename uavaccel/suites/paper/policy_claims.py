"""The claims on training (section IV-D), decided by a function each, which has the claim's id as its name.

As in flight_claims.py, a claim is decided by whether an interval lies within stated margins.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from uavaccel.metrics.equivalence import Interval, all_of, exceeds, ratio_estimate, success_estimate, within
from uavaccel.metrics.intervals import Proportion
from uavaccel.sim.lane.layout import LENGTH_M, Difficulty, draw_layout
from uavaccel.suites import paper_results
from uavaccel.suites.paper.evidence import (
    BESIDE_SIMULATION,
    SIMULATION,
    Finding,
    NoEvidence,
    Policies,
    Trajectories,
    Undecided,
)
from uavaccel.suites.paper.flight_claims import FASTEST, LONGEST_S

# Margins of success over that at 1x. ALIKE are the margins of bioequivalence, 80 to 125 %: the paper's 21 to 23 lies
# within, its 21 to 13 and 21 to 30 outside. A COLLAPSE keeps at most a third: the interval of 23 to 1 of 100 games
# reaches to a quarter. In between lies a LOSS, such as 38 %.
COLLAPSE: Interval = (0.0, 1 / 3)
LOSS: Interval = (1 / 3, 0.8)
ALIKE: Interval = (0.8, 1.25)
GAIN: Interval = (1.25, np.inf)
FLIES = 0.1  # success that a policy trained at 1x needs for a comparison
SPEEDUP: Interval = (0.85, 1.15)  # relative to the paper's


def _compared(
    first: tuple[str, float], second: tuple[str, float], margins: Interval, rl: Policies
) -> Finding:
    """The success of the second training over that of the first, which must be able to fly, lies within `margins`."""
    after, before = rl.success(*second), rl.success(*first)
    _check_flies(rl.trainings(*first), f"{first[0].upper()} at {first[1]:g}x")
    if before.high * margins[0] > 1:
        raise Undecided(f"{_won(rl, *first)} leaves no room for {margins[0]:g} times as much")
    ratio = ratio_estimate(after, before)
    text = f"{_won(rl, *first)} v {_won(rl, *second)}: {ratio.text(' times', 2)}"
    return Finding(text, within(ratio.interval, margins))


adsc_collapses_at_5x = partial(_compared, ("adsc", 1.0), ("adsc", 5.0), COLLAPSE)
tcsc_preserved_at_10x = partial(_compared, ("tcsc", 1.0), ("tcsc", 10.0), ALIKE)
tcsc_loses_at_100x = partial(_compared, ("tcsc", 1.0), ("tcsc", 100.0), LOSS)
tcsc_loses_at_50x = partial(_compared, ("tcsc", 1.0), ("tcsc", 50.0), LOSS)
tcsc_improves_at_5x = partial(_compared, ("tcsc", 1.0), ("tcsc", 5.0), GAIN)
commands_interchange_at_1x = partial(_compared, ("adsc", 1.0), ("tcsc", 1.0), ALIKE)


def adsc_fails_accelerated(rl: Policies) -> Finding:
    """At each ClockSpeed above 1 an ADSC-trained policy keeps at most a third of the success of one trained at 1x."""
    clocks = [k for k in rl.clocks("adsc") if k > 1]
    if not clocks:
        raise NoEvidence("ADSC was trained at no ClockSpeed above 1")
    findings = [_compared(("adsc", 1.0), ("adsc", k), COLLAPSE, rl) for k in clocks]
    text = ", ".join(f"{k:g}x {_won(rl, 'adsc', k)}" for k in [1.0, *clocks])
    return Finding(text, all_of(finding.holds for finding in findings))


def policy_flies_with_both(rl: Policies) -> Finding:
    """Policies trained with TCSC in real time have equal success with both commands.

    As the lanes are the same, the interval of the ratio is wider than necessary.
    """
    with_tcsc, with_adsc = rl.interchanged()
    _check_flies([with_tcsc], "TCSC at 1x")
    ratio = ratio_estimate(*(success_estimate([each]) for each in (with_adsc, with_tcsc)))
    text = f"TCSC {_share([with_tcsc])} v ADSC {_share([with_adsc])}: {ratio.text(' times', 2)}"
    return Finding(text, within(ratio.interval, ALIKE))


def lines_peak_at_obstacles(rl: Policies) -> Finding:
    """At each ClockSpeed, of TCSC's games that end before the goal more end within 1 m of a row of obstacles than the
    rows' share of the lane.
    """
    rows_m = np.unique(draw_layout(0, Difficulty()).x_m)
    by_chance = len(rows_m) * 2.0 / LENGTH_M
    texts, peaks = [], []
    for k in rl.clocks("tcsc"):
        rl.trainings("tcsc", k)
        ended_m = rl.ended_m[("tcsc", k)]
        if not len(ended_m):
            raise Undecided(f"no game of TCSC at {k:g}x ended before the goal")
        near = int(np.sum(np.abs(ended_m[:, None] - rows_m).min(axis=1) <= 1.0))
        texts.append(f"{k:g}x {_share([Proportion(near, len(ended_m))])}")
        peaks.append(exceeds(Proportion(near, len(ended_m)).interval, by_chance))
    if not texts:
        raise NoEvidence("TCSC was not trained")
    return Finding(f"{', '.join(texts)}; by chance {by_chance:.0%}", all_of(peaks))


def _check_flies(trainings: list[Proportion], name: str) -> None:
    if not exceeds(success_estimate(trainings).interval, FLIES):
        raise Undecided(f"{name} won {_share(trainings)}, not surely above {FLIES:.0%}")


def _won(rl: Policies, command: str, clock_speed: float) -> str:
    return _share(rl.trainings(command, clock_speed))


def _share(trainings: list[Proportion]) -> str:
    """Return the games won, as in "290 of 300 (97%)" or, of several trainings, "2900 of 3000 (97%, 10 trainings)"."""
    pooled = Proportion.pooled(trainings)
    several = f", {len(trainings)} trainings" if len(trainings) > 1 else ""
    return f"{pooled.successes} of {pooled.games} ({pooled.ratio:.0%}{several})"


def _training_speedup(
    phases: tuple[str, ...], paper: dict[float, float], clock_speed: float, rl: Policies
) -> Finding:
    """The speed-up of a training is within 15 % of the paper's, in either direction."""
    speedup, aim = rl.speedup(clock_speed, phases), paper[clock_speed]
    return Finding(f"{speedup.value:.3g}x", within(speedup.interval, (SPEEDUP[0] * aim, SPEEDUP[1] * aim)))


_simulation = partial(_training_speedup, SIMULATION, paper_results.SIMULATION_SPEEDUP)
_whole = partial(_training_speedup, (*SIMULATION, *BESIDE_SIMULATION), paper_results.TRAINING_SPEEDUP)
training_speedup_5x = partial(_simulation, 5.0)
training_speedup_10x = partial(_simulation, 10.0)
training_speedup_50x = partial(_simulation, 50.0)
training_speedup_100x = partial(_simulation, 100.0)
week_to_two_days = partial(_whole, 5.0)
week_to_day_and_a_half = partial(_whole, 10.0)


def simulation_dominates_at_1x(rl: Policies) -> Finding:
    """Simulation with rendering takes more than half of the time of a command in real time."""
    simulation, whole = (
        rl.command_s("adsc", 1.0, each) for each in (SIMULATION, (*SIMULATION, *BESIDE_SIMULATION))
    )
    return Finding(
        f"{simulation.value / whole.value:.1%}", exceeds(ratio_estimate(simulation, whole).interval, 0.5)
    )


def rendering_costs_scalability(dp1: Trajectories, rl: Policies) -> Finding:
    """TCSC's speed-up at 100x, T_move 1 s, longest path, is more than twice as high without rendering as with it."""
    without, rendered = dp1.longest("tcsc", FASTEST, LONGEST_S), rl.speedup(FASTEST)
    text = f"{without.value:.3g}x v {rendered.value:.3g}x"
    return Finding(text, exceeds(ratio_estimate(without, rendered).interval, 2.0))
