"""What the pages say of rows in docs/tables, worded with the numbers that these give; see check_numbers.py.

A page may say more than is here; what is here it has to say, word for word. A line of a table is a text like any other.
"""

from __future__ import annotations

import csv
import gzip
import json
from collections import Counter
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from tools import fit_gap_law
from tools.check_numbers import ROOT, Page
from tools.fit_agent import agent_costs, command_wall_s
from tools.fit_airsim import Parameters, model
from uavaccel.config import parse_yaml, validate
from uavaccel.metrics.estimates import Estimate, Success
from uavaccel.metrics.intervals import TAILS, Proportion, fisher_exact_p, mcnemar_exact, permutation_p
from uavaccel.sim.lane import LENGTH_M
from uavaccel.suites import claims, paper_results
from uavaccel.suites.mediation import Contrast, Share, effect, share_of_loss
from uavaccel.suites.paper import Claim, PaperConfig, read_claims, verdict
from uavaccel.suites.parts import Part
from uavaccel.suites.realtime import Evaluation, Realtime
from uavaccel.suites.report import table_of
from uavaccel.suites.rl import against_plain, flight_name, flights_of, gap_s, same_weights, success_of, times_of, where
from uavaccel.suites.session import RunRequest, configure
from uavaccel.wire.latency import shipped_latency

CLOCKS = paper_results.CLOCKS
OTHER = {"tcsc": "adsc", "adsc": "tcsc"}
TABLES = ROOT / "docs/tables"
Text = Iterator[str]

# --- rows -----------------------------------------------------------------------------------------------------------


@cache
def rows_of(name: str) -> list[dict[str, Any]]:
    """Return the rows of docs/tables/NAME.csv, as `uavaccel export --csv` has made it: keys with dots are nested."""
    rows = []
    with (TABLES / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            row: dict[str, Any] = {"timing": "virtual"}
            for key, value in line.items():
                *path, last = key.split(".")
                at = row
                for part in path:
                    at = at.setdefault(part, {})
                try:
                    at[last] = json.loads(value)
                except ValueError:
                    at[last] = value
            rows.append(row)
    return rows


@cache
def by_lane(name: str) -> pd.DataFrame:
    """Return the flights of docs/tables/NAME.csv, made by tools/outcomes_by_lane.py, as `flights_of` has them."""
    table = pd.read_csv(TABLES / f"{name}.csv", dtype={"won": str}, keep_default_na=False)
    lanes = [first + np.arange(len(won)) for first, won in zip(table.first_lane, table.won, strict=True)]
    won = [pd.Series([each == "1" for each in won], at) for won, at in zip(table.won, lanes, strict=True)]
    success = [Proportion(int(each.sum()), len(each)) for each in won]
    return table.assign(won=won, success=success, ratio=[each.ratio for each in success])


def arrays_of(row: dict[str, Any]) -> dict[str, Any]:
    """Return the outcomes by lane of a row of Table I, as its run keeps them; a lane that was won ends with it."""
    arrays: dict[str, Any] = {}
    keys = {key: row[key] for key in ("profile", "command", "clock_speed", "seed")}
    for flight in where(by_lane("rl_test_lanes"), **keys).to_dict("records"):
        name, won = flight_name(flight["with"], flight["at"], 1.0), flight["won"]
        distance_m = np.full(len(won), LENGTH_M)
        if flight["ended_m"]:
            distance_m[~won] = [float(end) for end in flight["ended_m"].split()]
        kept = {"lane": won.index.to_numpy(), "is_success": won.to_numpy(), "distance_m": distance_m}
        arrays |= {f"{name}_{key}": values for key, values in kept.items()}
    return arrays


@cache
def trainings(name: str) -> pd.DataFrame:
    """Return the flights of the policies of a table; of others than Table I's lanes and distances are not known."""
    return flights_of(rows_of(name), arrays_of if name == "rl_table1" else lambda row: {})


def policies(table: str, command: str, clock_speed: float, variant: str = "", profile: str = "airsim") -> pd.DataFrame:
    """Return the flights of the policies of one training, seed by seed."""
    keys = {"command": command, "clock_speed": clock_speed, "variant": variant, "profile": profile}
    return where(trainings(table), **keys)


def flown(which: pd.DataFrame, command: str | None = None, at: float = 1.0) -> pd.DataFrame:
    """Return those flown with a command, by default that of the training, at a ClockSpeed, by default in real time."""
    return where(which, **{"with": command or which.command.iloc[0], "at": at})


def won(flights: pd.DataFrame) -> list[int]:
    """Return how many games each policy won."""
    return [success.successes for success in flights.success]


@cache
def evidence(part: str) -> claims.Flown:
    """Return what `uavaccel run paper` has found of a part: evidence/PART.json of its run."""
    kept = json.loads(gzip.decompress((TABLES / f"paper/{part}.json.gz").read_bytes()))
    return claims.Flown(table_of(kept["games"]), kept["summary"])


@cache
def verdicts(profile: str) -> dict[str, dict[str, str]]:
    """Return the verdict on each claim, and what decides it."""
    found: dict[str, Any] = {kind: evidence(f"{kind}-{profile}") for kind in ("dp1", "dp2")}
    found["rl"] = claims.trainings(trainings("rl_table1"), profile)
    return {claim.id: verdict(claim, found) for claim in claims_of_the_paper()}


def claims_of_the_paper() -> tuple[Claim, ...]:
    return read_claims(PaperConfig(suite="paper", parts={"dp1-airsim": Part(experiment="dp1")})).claims


# --- words ----------------------------------------------------------------------------------------------------------


def short(value: float, digits: int) -> str:
    """Return a number as the pages have it, without a zero before its point, .31."""
    text = f"{value:.{digits}f}".replace("-", "−")
    return "0" if float(text.replace("−", "")) == 0 else text.replace("0.", ".", 1) if abs(value) < 1 else text


def percent(flights: pd.DataFrame, digits: int = 0) -> str:
    return f"{100 * success_of(flights).pooled.ratio:.{digits}f}" if any(won(flights)) else "0"


def over_seeds(estimate: Estimate) -> str:
    value, low, high = (f"{100 * each:.1f}" for each in estimate)
    return f"{value} % [{low}, {high}]"


def apart(difference: Estimate) -> str:
    """Return a difference in points with its interval."""
    more, low, high = (f"{100 * each:+.1f}".replace("-", "−") for each in difference)
    return f"{more} [{low}, {high}]"


def counted(values: list[int]) -> str:
    return ", ".join(map(str, values))


NUMBERS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def in_words(count: int) -> str:
    return NUMBERS[count] if count < len(NUMBERS) else str(count)


# --- README.md ------------------------------------------------------------------------------------------------------


def readme() -> Page:
    return Page(readme_says(), (*SETTINGS, r"Python 3\.11", r"SIMUL 2022"))


def readme_says() -> Text:
    (slow, real), (calm, fast) = ([policies("rl_table1", each, k) for each in ("tcsc", "adsc")] for k in (1.0, 10.0))
    yield f"policies win {percent(flown(slow))} % (TCSC) and {percent(flown(real))} % (ADSC) of unseen lanes"
    yield f"at 10x, they win {percent(flown(fast))} % with ADSC and {percent(flown(calm))} % with TCSC."
    as_trained, other = flown(fast, at=10.0), flown(fast, "tcsc")
    yield f"The same ADSC policies of 10x win {percent(as_trained, 1)} % of the lanes flown as they were trained"
    yield f"{percent(other)} % with TCSC"
    yield f"at 50x it costs {points(effects()[0][1])} of success in real time"
    scripts = (ROOT / "docs/airsim-scripts.md").read_text(encoding="utf-8")
    lines = [line.split(" | ") for line in scripts.splitlines() if ".py | " in line]
    words = Counter(line[1].strip("*").split(":")[0].rstrip("*") for line in lines)
    yield f"[{words['passes']} of AirSim's {words['passes'] + words['fails']} example scripts]"


# --- results-paper.md -----------------------------------------------------------------------------------------------


def results_paper() -> Page:
    says = (headline, table_1, table_1_bullets, claims_table, on_evaluation_lanes, in_the_exact_simulator, the_learner)
    more = (interchanged, times, gaps, one_changed, what_helps, the_model, what_was_fitted, sensitivity)
    return Page((text for of in (*says, *more) for text in of()), SETTINGS)


def headline() -> Text:
    held = Counter(each["verdict"] for each in verdicts("airsim").values())
    native = Counter(each["verdict"] for each in verdicts("native").values())
    adsc, tcsc = (percent(flown(policies("rl_table1", command, 10.0))) for command in ("adsc", "tcsc"))
    yield f"**Trained with ADSC at 10x, policies win {adsc} % of unseen lanes in real time"
    yield f"trained with TCSC they win {tcsc} %, and {held['holds']} of the paper's {held.total()} claims hold under"
    assert not held["pending"] + native["pending"]
    yield (
        f"Of the paper's {held.total()} claims, {held['holds']} hold under `airsim`, {in_words(held['fails'])} fail "
        f"and {in_words(held['undecided'])} are undecided.**"
    )
    yield (
        f"Without AirSim's latencies (`native`) {native['holds']} hold, {in_words(native['fails'])} fail and "
        f"{in_words(native['undecided'])} are undecided."
    )


def table_1() -> Text:
    for clock in CLOCKS:
        cells, successes = [], []
        for command in ("tcsc", "adsc"):
            of, real = (flown(policies("rl_table1", command, k)) for k in (clock, 1.0))
            successes.append(success_of(of))
            p = permutation_p(of.ratio, real.ratio) if clock > 1 else None
            digits = 2 if p and p > 0.01 else 5
            cells.append(f"{over_seeds(success_of(of).estimate)} |{'' if p is None else ' ' + short(p, digits)} |")
        paper = [paper_results.SUCCESSES[command][clock] for command in ("tcsc", "adsc")]
        difference = apart(successes[0].difference(successes[1]))
        yield f"| {clock:g}x | {cells[0]} {paper[0]} | {cells[1]} {paper[1]} | {difference} |"


def table_1_bullets() -> Text:
    fast = policies("rl_table1", "adsc", 10.0)
    own, other, real = (
        over_seeds(success_of(flown(fast, command, at)).estimate)
        for command, at in ((None, 10.0), ("tcsc", 1.0), (None, 1.0))
    )
    yield f"ADSC's policies of 10x win {own} of the lanes flown as they were trained"
    yield f"{other} of the same lanes with TCSC, and {real} in real time."
    (alike,) = same_weights(trainings("rl_table1").query("profile == 'native' and command == 'tcsc' and flight == 0"))
    paused, running = (
        [success_of(flown(policies("rl_table1", command, k, profile="native"))).estimate for k in CLOCKS]
        for command in ("tcsc", "adsc")
    )
    (same,), lowest = set(paused), min(running)
    yield f"{in_words(len(alike['equal']))} seeds of TCSC learn the same weights at 1 to 100x, to the bit,"
    yield f"to the bit, and win {over_seeds(same)};"
    yield f"ADSC's lowest success is {over_seeds(lowest)}, at {CLOCKS[running.index(lowest)]:g}x"
    wins = zip(*(won(flown(policies("rl_table1", "adsc", k))) for k in (50.0, 100.0)), strict=True)
    yield f"than those of 50x, with each of the {in_words(sum(fewer < more for fewer, more in wins))} seeds"
    p = {n: fisher_exact_p((21, 100), (n, 100)) for n in (30, 13)}
    assert f"{p[30]:.2g}" == f"{p[13]:.2g}"
    yield f"(Fisher's exact test, p = {fisher_exact_p((23, 100), (1, 100)):.0e}"
    yield f"21 against 30 and 13 have p = {short(p[30], 2)})"
    yield f"At 1x, {percent(flown(policies('rl_table1', 'tcsc', 1.0)))} % succeed here"


def claims_table() -> Text:
    airsim, native = verdicts("airsim"), verdicts("native")
    for claim in claims_of_the_paper():
        here, there = airsim[claim.id], native[claim.id]
        words = {"pending": "no rows"}
        value = f": {here['value']}" if here["value"] else ""
        judged = f"{words.get(here['verdict'], here['verdict'])}{value}".replace("<", r"\<")
        basis = "" if claim.basis == "predicted" else f", {claim.basis}"
        yield f"| {claim.says} ({claim.place}{basis}) | {judged} | {words.get(there['verdict'], there['verdict'])} |"


def on_evaluation_lanes() -> Text:
    """The policies of Table I as another machine trained them, on the lanes on which variants were compared."""
    yield f"has the rows of {len(rows_of('rl_table1'))} trainings"
    before = pd.DataFrame(rows_of("rl_evaluation_lanes"))
    keys = ["profile", "command", "clock_speed"]
    both = before.merge(where(trainings("rl_table1"), flight=0), on=[*keys, "seed"], suffixes=("_before", ""))
    same = both.weights_sha256 == both.weights_sha256_before
    yield f"had trained {len(before)} of these policies, to the same weights in {same.sum()} of {len(same)},"
    cells, moved = [own for _, own in both.groupby(keys) if len(own) == 10], []
    for own in cells:
        here = success_of(own).estimate
        there = Success(tuple(map(Proportion.of, own.to_dict("records")))).estimate
        assert max(here.low, there.low) <= min(here.value, there.value)
        assert max(here.value, there.value) <= min(here.high, there.high)
        moved.append(abs(there.value - here.value))
    yield f"in the {len(cells)} cells with ten seeds successes are at most {short(100 * max(moved), 1)} points apart"


LEARNERS = {
    "Table I's": "",
    "no mirror images": "no_mirror",
    "one command's reward": "one_step",
    "a constant learning rate": "constant_rate",
    "a copy every 10 000 commands": "target_each_10000",
    "all four": "none_of_them",
}


def learner(variant: str, command: str) -> pd.DataFrame:
    return where(by_lane("rl_learner"), variant=variant, command=command).sort_values("seed")


def in_the_exact_simulator() -> Text:
    """The policies of Table I's first seeds on the same lanes in both simulators, lane by lane."""
    keys = ["profile", "command", "clock_speed", "seed", "with", "at", "variant"]
    both = by_lane("rl_exact").merge(by_lane("rl_test_lanes"), on=keys, suffixes=("", "_kernels"))
    assert (both.weights_sha256 == both.weights_sha256_kernels).all()
    for clock in CLOCKS:
        of = [where(both, command=command, clock_speed=clock) for command in ("tcsc", "adsc")]
        wins = [f"{counted(won(each))} ({counted([n.successes for n in each.success_kernels])})" for each in of]
        yield f"| {clock:g}x | {' | '.join(wins)} |"
    alike = both.assign(n=[int((one == other).sum()) for one, other in zip(both.won, both.won_kernels, strict=True)])
    fewest, lanes = alike.loc[alike.n.idxmin()], len(both.won[0])
    yield f"Of {len(both) * lanes:,}".replace(",", " ") + f" flights {alike.n.sum():,} end alike;".replace(",", " ")
    yield f"of a policy's {lanes}, {fewest.n} ({fewest.command.upper()} at {fewest.clock_speed:g}x) to {alike.n.max()}."
    assert all(mcnemar_exact(*each).p_value > 0.05 for each in zip(both.won, both.won_kernels, strict=True))
    yield f"none of the {len(both)} policies differs at p < .05"


def the_learner() -> Text:
    """What changes with the parts of the learner, paired by seed and lane."""
    base = {command: success_of(learner("", command)) for command in ("tcsc", "adsc")}
    without = {
        (variant, command): success_of(learner(variant, command)).difference(own, same_policies=True)
        for variant in LEARNERS.values()
        for command, own in base.items()
    }
    for name, variant in LEARNERS.items():
        cells = [
            f"{over_seeds(success_of(learner(variant, command)).estimate)} |"
            + (f" {apart(without[variant, command])} |" if variant else " |")
            for command in base
        ]
        yield f"| {name} | {' '.join(cells)}"

    def costs(variant: str, command: str) -> str:
        value, low, high = (short(-100 * each, 1) for each in without[variant, command])
        return f"{value} points [{high}, {low}]"

    yield f"TCSC's policies lose {costs('one_step', 'tcsc')} with one command's reward"
    others = [without[variant, "tcsc"].low for variant in ("no_mirror", "constant_rate", "target_each_10000")]
    yield f"by each of the other three changes at most {-100 * min(others):.1f}, by the ends of the intervals"
    *most, last = won(learner("no_mirror", "adsc"))
    before = won(learner("", "adsc"))
    yield f"win {counted(most)} and {last} of 300 instead of {min(before)} to {max(before)},"
    yield f"{max(before)}, {costs('no_mirror', 'adsc')} fewer."
    certain = sum(each.low > 0 or each.high < 0 for (variant, _), each in without.items() if variant)
    yield f"{in_words(certain).capitalize()} of the ten intervals exclude 0"


def sensitivity() -> Text:
    """What experiments/rl_sensitivity.yaml changes, paired by seed and lane; of `native` against Table I's seeds."""
    table = by_lane("rl_sensitivity").assign(timing="virtual", flight=0).sort_values("seed")
    yield f"{in_words(table.seed.nunique())} seeds each, {len(table)} trainings, {len(table.won.iloc[0])} test lanes"
    cells = pd.DataFrame(list(against_plain(table)))
    change = {
        (cell.variant, cell.command, cell.clock_speed): Estimate(**cell.difference) for cell in cells.itertuples()
    }
    shares = 100 * where(cells, command="adsc").groupby("clock_speed").success_ratio.agg(["min", "max"])
    low, middle, high = ("{:.1f} to {:.1f} %".format(*shares.loc[clock]) for clock in (5.0, 10.0, 50.0))
    yield f"{low} at 5x, {middle} at 10x, {high} at 50x."
    less, more = (apart(change[spread, "adsc", 10.0]) for spread in ("spread_0_25", "spread_1"))
    yield f"At 10x σ = .25 changes success by {less.replace(' [', ' points [')}, σ = 1 by {more}."
    best, worst = (
        [
            success_of(where(table, variant=f"frames_{rate}hz", command="tcsc", clock_speed=clock))
            for clock in (50.0, 100.0)
        ]
        for rate in (120, 30)
    )
    yield f"at 120 Hz it wins {' and '.join(over_seeds(each.estimate) for each in best)},"
    gains = [apart(change["frames_120hz", "tcsc", clock]) for clock in (50.0, 100.0)]
    yield f"{gains[0].replace(' [', ' points [')} and {gains[1]}; at 30 Hz"
    yield f"at 30 Hz {' and '.join(f'{100 * each.estimate.value:.1f}' for each in worst)} %"
    awaited = {key: each for key, each in change.items() if key[1] == "adsc" or not key[0].startswith("callback")}
    certain = sum(each.low > 0 or each.high < 0 for each in awaited.values())
    yield f"{in_words(certain).capitalize()} of the {len(awaited)} differences that a change can reach exclude 0"
    others = where(table, command="tcsc").query("variant.str.startswith('callback')")
    same = others.merge(where(table, command="tcsc", variant=""), on=["clock_speed", "seed", "weights_sha256"])
    assert len(same) == len(others)
    yield f"its {len(others)} policies with"
    native, ten = table[table.profile == "native"], []
    for (_, clock), own in native.groupby(["variant", "clock_speed"]):
        plain = flown(policies("rl_table1", "adsc", float(clock), profile="native"))
        plain = plain[plain.seed.isin(own.seed)].sort_values("seed")
        ten.append(success_of(own).difference(success_of(plain), same_policies=True))
    assert all(each.low <= 0 <= each.high for each in ten)
    yield f"none of the {in_words(len(ten))} differences excludes 0"


def interchanged() -> Text:
    """In real time, and at the ClockSpeed of the training, with the own command and with the other one."""
    for clock in CLOCKS:
        both = {command: policies("rl_table1", command, clock) for command in ("tcsc", "adsc")}
        swapped = [percent(flown(of, OTHER[command]), 1) for command, of in both.items()]
        fast = [
            ", ".join(percent(flown(of, OTHER[command] if swap else None, clock), 1) for command, of in both.items())
            for swap in (False, True)
        ]
        yield f"| {clock:g}x | {', '.join(swapped)} |{' | |' if clock == 1 else f' {fast[0]} | {fast[1]} |'}"


def times() -> Text:
    own = where(trainings("rl_table1"), flight=0)
    for clock in CLOCKS:
        found = {command: times_of(flown(policies("rl_table1", command, clock)), own) for command in ("tcsc", "adsc")}
        hours = [each["training_wall_s"] / 36_000 for each in found.values()]  # of ten seeds
        one, whole = (
            ", ".join(f"{each[name]:.3g}x" for each in found.values())
            for name in ("training_speedup", "whole_training_speedup")
        )
        paper = paper_results.SIMULATION_SPEEDUP.get(clock), paper_results.TRAINING_SPEEDUP.get(clock)
        theirs = [
            f" {each:g}x{fitted} |" if each else " |" for each, fitted in zip(paper, ("", " (fitted)"), strict=True)
        ]
        hours_of = ", ".join(f"{each:.{int(each < 100)}f}" for each in hours)
        yield f"| {clock:g}x | {hours_of} | {one} |{theirs[0]} {whole} |{theirs[1]}"


GAPS = {
    "1x with 0 to .2 s of thinking, 5x with none": [(1.0, 0), (1.0, 50), (1.0, 100), (1.0, 200), (5.0, 0)],
    "10x with none": [(10.0, 0)],
    "5x, .05 s; 1x, .4 s": [(5.0, 50), (1.0, 400)],
    "5x, .1 s": [(5.0, 100)],
    "10x, .05 s": [(10.0, 50)],
    "5x, .2 s": [(5.0, 200)],
    "10x, .1 s": [(10.0, 100)],
    "5x, .4 s; 10x, .2 and .4 s": [(5.0, 400), (10.0, 200), (10.0, 400)],
}
THOUGHT_MS = (0, 50, 100, 200, 400)


def thinking(command: str, clock: float, ms: int, lane: str = "") -> pd.DataFrame:
    return policies("rl_collapse", command, clock, f"{lane}think_{ms}ms")


def gaps() -> Text:
    for name, cells in GAPS.items():
        of = [flown(thinking("adsc", *cell)) for cell in cells]
        left, counts = sorted(map(gap_s, of)), [won(each) for each in of]
        every = sorted(n for each in counts for n in each)
        many = f"{every[0]} to {every[-1]}, median {np.median(every):.0f}"
        gap = " to ".join(short(each, 2) for each in dict.fromkeys((left[0], left[-1])))
        yield f"| {gap} s ({name}) | {many if len(counts) > 3 else '; '.join(map(counted, counts))} |"
    clocks = (1.0, 5.0, 10.0)
    tcsc = [n for k in clocks for ms in THOUGHT_MS for n in won(flown(thinking("tcsc", k, ms)))]
    yield f"TCSC's {len(tcsc)} policies won {min(tcsc)} to {max(tcsc)} (median {np.median(tcsc):.0f})"
    short_gaps = [(5.0, 0), (5.0, 50), (5.0, 100), (5.0, 200), (10.0, 0), (10.0, 50)]
    as_trained = [n for k, ms in short_gaps for n in won(flown(thinking("adsc", k, ms), at=k))]
    yield f"still fly as they were trained ({min(as_trained)} to {max(as_trained)} of 300 at 5 and 10x)"
    hard_cells = [won(flown(thinking("tcsc", k, ms, "hard_"))) for k in clocks for ms in THOUGHT_MS]
    *others, worst = sorted(map(list, zip(*hard_cells, strict=True)), reverse=True)
    rest = [n for each in others for n in each]
    yield f"TCSC wins {min(worst)} to {max(worst)} with one seed and {min(rest)} to {max(rest)} with the others"
    hard = {k: [flown(thinking("adsc", k, 400, "hard_")).ratio.to_numpy() * 100] for k in clocks}
    yield "with .4 s of thinking, ADSC wins " + ", ".join(
        f"{short(ratio[0].min(), 1 if k > 1 else 0)} to {short(ratio[0].max(), 1 if k > 1 else 0)} % "
        f"{'of it ' if k == 1 else ''}at {k:g}x"
        for k, ratio in hard.items()
    )
    for ms in (200, 400):
        kept = [
            percent_of(flown(thinking("adsc", 5.0, ms, lane)), flown(thinking("adsc", 1.0, ms, lane)))
            for lane in ("", "hard_")
        ]
        yield (
            f"{kept[0]} of the success at 1x is left (hard lane {kept[1]})"
            if ms == 200
            else f"{kept[0]} (hard lane {kept[1]})"
        )


def percent_of(some: pd.DataFrame, others: pd.DataFrame) -> str:
    ratio = success_of(some).pooled.ratio / success_of(others).pooled.ratio
    return short(ratio, 2 if ratio > 0.1 else 3)


CHANGES = {
    "nothing": "think_200ms",
    "images at 15 Hz, two frames of 60 Hz older": "late_pictures",
    "gradient steps stall the agent for another .2 s": "learning_stalls",
    "plain DQN": "plain_dqn",
    "a reward for arriving only": "sparse_reward",
    "commands of .33 s": "short_commands",
}


def one_changed() -> Text:
    for name, variant in CHANGES.items():
        of = policies("rl_collapse", "adsc", 5.0, variant)
        yield f"| {name} | {counted(won(flown(of)))} | {counted(won(flown(of, at=5.0)))} |"


HELP = {
    "ADSC": ("adsc", "", None),
    "ADSC, observing last action and frames' age": ("adsc", "told", None),
    "ADSC, observing two commands' frames": ("adsc", "history_2", None),
    "ADSC, random latencies, 0 to 8 times as long": ("adsc", "random_latency", None),
    "TCSC": ("tcsc", "", None),
    "TCSC, flown with ADSC": ("tcsc", "", "adsc"),
}


def what_helps() -> Text:
    for name, (command, variant, by) in HELP.items():
        found = [counted(won(flown(policies("rl_latency", command, k, variant), by))) for k in (5.0, 10.0, 50.0)]
        yield f"| {name} | {' | '.join(found)} |"
    swapped = flown(policies("rl_latency", "tcsc", 5.0), "adsc", 5.0)
    yield f"Flown at 5x, ADSC takes TCSC's policies to {percent(swapped)} %."


def the_model() -> Text:
    fitted = Parameters(tick_us=45.0, call_ms=0.38, callback_ms=28.0)
    shipped = shipped_latency("airsim")
    assert shipped.model_dump(exclude={"name"}) == model(fitted).model_dump(exclude={"name"}), "fitted anew"
    yield f"{fitted.tick_us:g} µs of wall time, so at most {3000 / fitted.tick_us:.1f}x"
    yield f"| {fitted.call_ms:g} ms, half request, half reply |"
    yield f"| {fitted.callback_ms:g} ms |"
    cells = pd.DataFrame(evidence("dp1-airsim").summary["cells"])
    longest = cells[(cells.command == "tcsc") & (cells.clock_speed == 100) & (cells["rounds"] == 24)]
    found = longest[longest.t_move_s == 1].effective_speedup.item()
    yield f"{found:.1f}x for 62x (TCSC at 100x, T_move 1 s, 24 rounds)"
    yield f"{longest.effective_speedup.mean():.0f}x for 50x (averaged over T_move"
    yield f"a pooled STLC of {claims.median(evidence('dp1-airsim'), 'adsc', 5.0).value:.3f} for 1.78 (ADSC at 5x)"
    own = where(trainings("rl_table1"), flight=0)
    whole = [times_of(flown(policies("rl_table1", "tcsc", k)), own)["whole_training_speedup"] for k in (5.0, 10.0)]
    yield f"whole trainings are {whole[0]:.3g}x and {whole[1]:.3g}x as fast at 5x and 10x."
    dp2 = pd.DataFrame(evidence("dp2-airsim").summary["cells"]).query("command == 'tcsc'")
    yield f"here TCSC's differs by at most {short(dp2.attitude_error_deg_max.max(), 2)}° from that at"
    yield f"with it the largest DVS-ED at 50x is {dp2[dp2.clock_speed == 50].dvs_ed_percent_max.item():.0f} %."
    yield f"| the paper | {' | '.join(f'{each:g}' for each in paper_results.SIMULATION_SPEEDUP.values())} |"
    yield f"TCSC's worst cell has {cells[cells.command == 'tcsc'].stlc_median.min():.3f}."
    command_s = command_wall_s("adsc", 1.0, shipped)
    thinking_s = paper_results.THINKING_SHARE * command_s
    yield f"{1e3 * thinking_s:.1f} ms of {command_s:.3f} s outside the simulation"
    yield f"{1e3 * agent_costs(shipped)['inference_s']:.0f} ms per decision"
    for hz in (30.0, 60.0, 120.0):
        frames = shipped.platform.frames.model_copy(update={"hz": hz})
        at = shipped.model_copy(update={"platform": shipped.platform.model_copy(update={"frames": frames})})
        real_s = command_wall_s("adsc", 1.0, at)
        speedups = [f"{real_s / command_wall_s('tcsc', k, at):.1f}" for k in CLOCKS[1:]]
        yield f"| {hz:g} | {' | '.join(speedups)} |"


# --- elsewhere ------------------------------------------------------------------------------------------------------


def what_was_fitted() -> Text:
    rows = pd.DataFrame(rows_of("ablation_fitted"))
    for name, command, clock, column, digits in (
        ("ADSC at 5x, STLC", "adsc", 5.0, "stlc", 3),
        ("ADSC at 100x, STLC", "adsc", 100.0, "stlc", 3),
        ("TCSC at 100x, STLC", "tcsc", 100.0, "stlc", 3),
        ("TCSC at 100x, speed-up, mean over T_move", "tcsc", 100.0, "effective_speedup", 1),
        ("ADSC at 100x, the same", "adsc", 100.0, "effective_speedup", 1),
    ):
        of = rows[(rows.command == command) & (rows.clock_speed == clock)].set_index("variant")[column].astype(float)
        least, most = (f"{of[at]:.{digits}f}, {at}" for at in (of.idxmin(), of.idxmax()))
        yield f"| {name} | {of['as fitted']:.{digits}f} | {least} | {most} |"


SETTINGS = (
    r"[Aa]gents that think for \.2 s|with \.[24] s of thinking",
    r"of 300|Figures? \d|23 successes to 1|gap of 1\.17 s|agent's 47\.8 ms|T_move (?:\.2 and )?1 s",
    r"per cent of 3 000 lanes|hours of 5 000 games|gaps of 1\.2 m and rows 7 m apart",
    r"(?<![\d.])(?:1|5|10|50|100)x",
    r"(?<![\d.])1 to 100x|1, 5 and 10x|50 and 100x|5 and 10x|5, 10, 50 and 100x",
    r"95 % (?:Wilson )?intervals?",
    r"60 frames a second|fit 60 Hz|Decisions of 0 and 5 ms instead of \.5",
)


# --- results.md, real-time.md ---------------------------------------------------------------------------------------


def results() -> Page:
    return Page((text for of in (dp1_under_native, dp2_under_native, the_policy_that_ships) for text in of()), SETTINGS)


def dp1_under_native() -> Text:
    flown_games = evidence("dp1-native")
    cells = pd.DataFrame(flown_games.summary["cells"])
    each = f"{len(flown_games.scores) // len(CLOCKS) // 2} games each"
    yield f"{len(flown_games.scores) // 1000} {len(flown_games.scores) % 1000} games"
    yield f"The worst cell of each ClockSpeed, {each}:"
    by = {command: [cells[(cells.command == command) & (cells.clock_speed == k)] for k in CLOCKS] for command in OTHER}
    worst = {command: [(own.stlc_median.min(), own.position_rmse_m.max()) for own in of] for command, of in by.items()}
    yield f"| ADSC, lowest median STLC | {' | '.join(f'{stlc:.3f}' for stlc, _ in worst['adsc'])} |"
    yield f"| ADSC, largest median position RMSE, m | {' | '.join(short(rmse, 3) for _, rmse in worst['adsc'])} |"
    both = [f"{stlc:.3f}; {short(rmse, 3)}" for stlc, rmse in worst["tcsc"]]
    yield f"| TCSC, lowest median STLC; RMSE | {' | '.join(both)} |"
    for command, name in (
        ("adsc", "| ADSC, effective speed-up at 24 rounds, T_move .1 / .2 / .5 / 1 s"),
        ("tcsc", "| TCSC, the same"),
    ):
        found = []
        for own in by[command]:
            speedups = own[own["rounds"] == 24].sort_values("t_move_s").effective_speedup
            texts = [f"{value:.{int(value < 20)}f}" for value in speedups]
            found.append("1" if set(texts) == {"1.0"} else " / ".join(texts))
        yield f"{name} | {' | '.join(found)} |"


def dp2_under_native() -> Text:
    summary = evidence("dp2-native").summary
    cells = pd.DataFrame(summary["cells"])
    images = int(cells.images.iloc[0]) - 1
    yield f"A planned path of {images // 3} commands through a lane, T_move 1 s, T_sample .33 s, {images} images,"
    numbers = ["position_error_m_median", "position_error_m_max", "attitude_error_deg_max"]
    numbers += ["dvs_ed_percent_median", "dvs_ed_percent_max"]
    assert not cells[cells.command == "tcsc"][numbers].to_numpy().any()
    yield "| TCSC, `virtual`, 1x to 100x | 0, 0 m | 0° | 0, 0 % |"
    for k in (10.0, 50.0, 100.0):
        own = cells[(cells.command == "adsc") & (cells.clock_speed == k)].iloc[0]
        error, most, turned, median, largest = own[numbers]
        angle = short(turned, 3 if turned < 0.01 else 2)
        dvs_ed = f"{short(median, 1)}, {largest:.1f} %"
        yield f"| ADSC, `virtual`, {k:g}x | {short(error, 2)}, {short(most, 2)} m | {angle}° | {dvs_ed} |"
    study = summary["guard_study"]
    passed = {kind: 100 * each["on"]["share_passed"] for kind, each in study["by_kind"].items()}
    perturbed = f"{100 * study['share']:.0f} % of them perturbed"
    yield f"The image guard on {study['streams']} streams of these images, {perturbed}"
    yield f"salt-and-pepper noise passes in {passed['salt_and_pepper']:.0f} % of the cases"
    yield f"changed colours in {passed['colours']:.0f} %, changed brightness in {passed['brightness']:.0f} %"
    yield f"empty images in {passed['empty']:.1f} %."


def the_policy_that_ships() -> Text:
    won_of = Proportion.pooled([Proportion(int(row["is_success"]), 1) for row in rows_of("shipped_test")])
    low, high = (100 * end for end in won_of.interval)
    yield f"Of the first {won_of.games} test lanes, on which nothing was chosen, it wins {won_of.successes}"
    yield f"wins {won_of.successes} ({100 * won_of.ratio:.1f} %, {low:.1f} to {high:.1f} %) in the kernels"


def real_time() -> Page:
    return Page((), SETTINGS)


# --- benchmark.md ---------------------------------------------------------------------------------------------------

BENCHMARK = "benchmark_v1"
DELAYS = [(0.0, 1.0), (0.02, 1.0), (0.05, 1.0), (0.1, 1.0), (0.05, 5.0), (0.05, 20.0)]
"""The columns of its table: seconds of thinking, and ClockSpeed."""


def benchmark() -> Page:
    return Page(benchmark_says(), (*SETTINGS, r"(?<![\d.])20x|(?:20|50|100) ms|\(\.25 s\)|\(1 s\)"))


def benchmark_says() -> Text:
    table = pd.read_csv(TABLES / f"{BENCHMARK}.csv").set_index(["environment", "agent", "latency_s", "clock_speed"])
    config = configure(RunRequest(BENCHMARK))[1]
    cells = dict.fromkeys(case.cell for case in Realtime().cases(config) if isinstance(case, Evaluation))
    yield f"All {len(table)} cells" if len(table) == len(cells) else f"{len(table)} of its {len(cells)} cells"
    for task, agent in dict.fromkeys((*cell.split("-")[:2],) for cell in cells):
        if (task, agent, *DELAYS[0]) in table.index:
            scores = (short(table.score_mean[(task, agent, *at)], 2) for at in DELAYS)
            yield f"| {task}, {agent} | {' | '.join(scores)} |".replace("_", " ")


# --- why.md ---------------------------------------------------------------------------------------------------------

WHOLE = {"a gap of .78 s": "gap-0.776", "a gap of 1.2 s": "gap-1.2", "a gap of 2 s": "gap-2"}
ALONE = {
    "the speed at the start: at rest": "start-0",
    "the way unseen in 2 s, the speed kept": "way-2",
    "the age of the pictures: .95 s": "age-0.95",
    "the time: a metre takes 3 s": "duration-3",
}
FROM_REST = ("gap_50x", "gap_100x", "gap_50x_long", "gap_100x_long", "start_50x", "start_50x_long")
TEN = "10x's whole gap"
METRES = "50x's metres a command, by commands of .3 s"
SHOWN = (
    "50x's speed at the start",
    "the same, from rest with 1 000 commands a game",
    "the rest of 50x's gap, at speed",
    "the rest of 50x's gap, from rest",
    METRES,
    "50x's seconds a metre",
    "pictures .96 s old",
    TEN,
    "5x's whole gap",
    "5x's whole gap, in trainings of 1 200 to 2 000 games",
    "100x's gap instead of 50x's",
    "100x's gap instead of 50x's, with 1 000 commands a game",
    "100x's metres a command instead of 50x's, by commands of .42 s",
    "in flight, 50x's speed at the start",
    "in flight, the rest of 50x's gap",
    "in flight, pictures .96 s old",
)
ALONE_IN_TRAINING = {
    "pictures .96 s old": "age_1s",
    "a metre takes 4.56 s, as at 50x": "duration_50x",
    "commands of .3 s: 50x's metres": "metres_50x",
    "commands of .42 s: 100x's metres": "metres_100x",
    "5x's gap": "gap_5x",
    "a gap of 1.2 s": "gap_1s",
    "a gap of 2 s": "gap_2s",
    "10x's gap": "gap_10x",
    "its speed at the start alone": "start_10x",
    "its rest alone": "way_10x",
    "100x's gap": "gap_100x",
}
OF_MEDIATION = (
    r"(?:gap of|after|[Aa]t|of|in|what|that of) 2 s\b|63 ms|of 1 s north at 1 m/s|lanes 0 to 99|gap of \.068 s",
    r"won, of 100|0 is at rest|`start_speed: 1`|\.3 s at full speed|3 000 games|300 (?:lanes|commands)|, of 300",
    r"1 000 commands|Pictures \.96 s old|are\s+2\.08 s|win 41 %|23 of 100 games|150 m of obstacles",
    r"(?:in )?all 18|first 74|15 trainings repeated",
    r"21 effects|is \.062 of the velocity|leaves \+\.04 m/s\s+where ADSC's leaves −\.02|ClockSpeed 1,",
    r"for 60 ms",
)


def why() -> Page:
    told = (parts_of_gaps, moved_in_training, moved_in_flight, law_of_gaps)
    return Page((text for of in told for text in of()), (*SETTINGS, *OF_MEDIATION))


@cache
def matrix() -> pd.DataFrame:
    return pd.read_csv(TABLES / "mediation_matrix.csv")


def won_by(policy: str, flight: str = "gap-0.068") -> list[int]:
    """Return the games, of 300, that each training of a kind won in a flight, by default in real time."""
    flown = matrix()[matrix().policy == policy][f"successes.{flight}"].dropna()
    return [int(count) for count in flown]


def shares_won(policy: str, flight: str = "gap-0.068", words: str = "{:.0f} ({:.0f} to {:.0f})") -> str:
    """Return mean, least and most of what trainings of a kind won in a flight, per cent."""
    wins = np.array(won_by(policy, flight)) / 3
    return words.format(wins.mean(), wins.min(), wins.max())


@cache
def effects() -> list[tuple[str, dict[str, Any]]]:
    """Return the contrasts of experiments/mediation.yaml by their labels."""
    experiment = parse_yaml((ROOT / "experiments/mediation.yaml").read_text("utf-8"), "mediation.yaml")
    contrasts = [validate(Contrast, each, "contrasts") for each in experiment["contrasts"]]
    cells = {cell: won_by(*cell.split("/")) for each in contrasts for cell in (*each.without, *each.moved)}
    tables = {cell: pd.DataFrame({"won": [np.array([count / 300]) for count in wins]}) for cell, wins in cells.items()}
    return [(each.label, effect(tables, each)) for each in contrasts]


def points(told: dict[str, Any]) -> str:
    """Return what is lost, in points, with its interval."""
    lost, low, high = (short(-100 * told[name], 0) for name in ("effect", "high", "low"))
    return f"{lost} points [{low}, {high}]"


def moved_in_training() -> Text:
    """Of the policies in docs/tables/mediation_matrix.csv, a row for each training."""
    rows, found, won = matrix(), effects(), shares_won
    shown = dict(found)
    for label in SHOWN:
        told = shown[label]
        added, low, high = (signed(100 * told[name]) for name in ("effect", "low", "high"))
        ends = f"{100 * told['without']:.0f} % | {100 * told['moved']:.0f} % | {added} [{low}, {high}]"
        yield f"| {label} | {ends} | {told['trainings']} |"
    yield f"the start costs {points(found[0][1]).replace('points', 'points of success')}"
    whole = "{1:.0f} to {2:.0f} %, on average {0:.0f} %"
    yield f"policies win {won('start_50x', words=whole)}, of 300 lanes in real time"
    at_10x = where(by_lane("rl_sensitivity"), command="adsc", clock_speed=10.0)
    half, twice = (success_of(where(at_10x, variant=spread)).estimate.value for spread in ("spread_0_25", "spread_1"))
    yield f"spread](results-paper.md#what-was-fitted-and-chosen) lowers it to {100 * half:.1f} %, twice as"
    yield f"twice as much raises it to {100 * twice:.1f} %."
    yield f"restored, {won('way_50x', words=whole)}; with TCSC {won('tcsc', words=whole)}."
    yield f"| no gap | {won('tcsc')}: this is TCSC | {won('start_50x')} |"
    yield f"| 50x's gap of 3.57 s | {won('way_50x')} | {won('gap_50x')} |"
    for label, policy in ALONE_IN_TRAINING.items():
        yield f"| {label} | {won(policy)} |"
    kinds, matrix_rows = rows.policy.nunique(), rows["successes.way-0.712"].notna()
    yield f"has {kinds} training conditions of 3 000 games, ten seeds each"
    yield f"of the {len(rows)} policies {matrix_rows.sum()}, two or three of each condition and TCSC's ten"
    rested, real = (
        [count / 3 for policy in FROM_REST for count in won_by(policy, flight)]
        for flight in ("start-0.062", "gap-0.068")
    )
    yield f"The {in_words(len(FROM_REST))} kinds whose commands begin nearly at rest, {len(real)} trainings, win"
    yield f"win {np.mean(rested):.0f} % from 50x's speed and {np.mean(real):.0f} % in real time,"
    yield f"in real time, none above {max(real):.0f} %."
    longer, own = (won(policy, words="{:.0f} %") for policy in ("start_50x_long", "gap_50x_long"))
    yield f"the policies still win {longer}, with the gap {own}."
    yield f"cover as little, and cost {points(shown[METRES])}"
    yield f"a constant gap costs {points(shown[TEN])}"
    usual, old, gap, start, way, ten = (
        won("tcsc", flight, "{:.0f} %")
        for flight in ("usual", "age-0.96", "gap-2", "start-0.062", "way-0.712", "gap-0.712")
    )
    yield f"(.96 s: from {usual} to {old}), then by the whole gap of 2 s ({gap})"
    yield f"by the speed of 50x ({start})."
    yield f"The rest of 10x's gap alone ({way}) loses what the whole gap ({ten}) does not"
    weak = shown["5x's whole gap, in trainings of 1 200 to 2 000 games"]
    effect_of, low, high = (f"{100 * weak[name]:.0f}" for name in ("effect", "low", "high"))
    yield f"In these {weak['trainings']} trainings 5x's gap raises success, by {effect_of} points [{low}, {high}]"
    for games in (1200, 1400, 1600, 1800, 2000):
        yield f"| {games} | {won(f'weak_{games}')} | {won(f'weak_5x_{games}')} |"


def signed(value: float) -> str:
    return f"{value:+.0f}".replace("-", "\N{MINUS SIGN}")


def parts_of_gaps() -> Text:
    rows = {(row["command"], round(row["gap_s"], 1)): row for row in rows_of("gap_parts")}
    adsc = [row for (command, _), row in rows.items() if command == "adsc"]
    for row in adsc:
        speed, unseen, metres = (short(row[name], 2) for name in ("start_speed_m_s", "unseen_m", "metres_per_command"))
        lasts, gap, age = (f"{row[name]:.3g}" for name in ("seconds_per_command", "gap_s", "picture_age_s"))
        gap, age = gap.removeprefix("0"), age.removeprefix("0")
        yield f"| {row['clock_speed']:g}x | {gap} | {speed} | {metres} | {lasts} | {age} | {unseen} |"
    yield f"after 2 s the drone flies backwards at {short(-rows['tcsc', 2.0]['start_speed_m_s'], 2)} m/s."
    metres = next(row["metres_per_command"] for row in adsc if row["clock_speed"] == 50)
    more = next(row["metres_per_command"] for row in adsc if row["clock_speed"] == 100)
    yield f"Its commands advance {short(more, 2)} m instead of {short(metres, 2)},"
    yield f"at {short(metres, 2)} m a command, 300 commands end after {300 * metres:.0f} m"


def moved_in_flight() -> Text:
    """Of the lanes in docs/tables/mediation_flight.csv, which has columns for each flight's outcome."""
    lanes = pd.read_csv(TABLES / "mediation_flight.csv")
    won_of = {flight: int(lanes[f"{flight}_is_success"].sum()) for flight in ("usual", *(WHOLE | ALONE).values())}
    cells = {f"shipped/{flight}": pd.DataFrame({"won": [lanes[f"{flight}_is_success"]]}) for flight in won_of}
    asked = Share(usual="shipped/usual", whole="shipped/gap-2", parts=())
    for label, flight in (WHOLE | ALONE).items():
        low, high = (100 * end for end in Proportion(won_of[flight], len(lanes)).interval)
        line = f"| {label} | {won_of[flight]} | {low:.0f} to {high:.0f} % | "
        if label in ALONE:
            found: Any = share_of_loss(cells, asked, f"shipped/{flight}")
            line += "{} [{}, {}] |".format(*(short(found[name], 2) for name in ("share", "low", "high")))
        yield line


def law_of_gaps() -> Text:
    table = fit_gap_law.judged(pd.read_csv(TABLES / "gap_law.csv"))
    of = table.set_index("condition")

    def seconds(value: float) -> str:
        return f"{value:.2g}".removeprefix("0")

    def gap(row: Any) -> str:
        if row.at_least_s == 0.0:
            return f"below {row.below_s:g}".replace("0.", ".")
        return f"above {row.at_least_s:g}".replace(" 0.", " .") if np.isinf(row.below_s) else seconds(row.at_least_s)

    for _, own in table.groupby("task", sort=False):
        yield f"| {', '.join(map(seconds, own.control_s))} | {', '.join(gap(row) for row in own.itertuples())} |"
    others = tuple(set(table.task) - set(fit_gap_law.PREDICTED))
    there, back = (fit_gap_law.fit(table, half) for half in (fit_gap_law.PREDICTED, others))
    assert there.law == back.law == ("control_s",)
    yield f"errs least, and predicts the others to a factor of {there.error:.1f}, a constant to {there.constant:.0f};"
    yield f"the other way to {back.error:.1f} and {back.constant:.0f}"
    every = fit_gap_law.halves(table)
    low, high = np.quantile([found.error for found in every], TAILS)
    chosen = sum(found.law == ("control_s",) for found in every)
    error = np.median([found.error for found in every])
    yield f"{chosen} of all {len(every)} halves choose it, with a median error of {error:.1f},"
    yield f"and 95 % between {low:.1f} and {high:.1f}"
    plain, long, fast, small = (gap(of.loc[name]) for name in ("hover", "hover_long", "hover_fast", "hover_small"))
    yield f"commands of .2 and .5 s bear {plain} and {long} s; half of the room, by speed or radius, {fast} and {small}"
    yield f"; Navigate at half its speed {gap(of.loc['navigate_slow'])}."
    yield f"two trainings by motors differ by a factor of {of.at_least_s.motors / of.at_least_s.motors_near:.1f}"
    yield f"about {seconds(fit_gap_law.fit(table, ()).factor)} T_move"


PAGES = {
    "README.md": readme,
    "docs/results-paper.md": results_paper,
    "docs/results.md": results,
    "docs/real-time.md": real_time,
    "docs/benchmark.md": benchmark,
    "docs/why.md": why,
}
