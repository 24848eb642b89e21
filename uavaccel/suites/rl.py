"""The paper's RL experiment: policies trained under a command and a ClockSpeed, flown in real time (section IV-D).

Each case trains a policy and evaluates it, in runs of other suites below parts/, resumed where they stopped.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NotRequired, TypeAlias

import numpy as np
import pandas as pd
from pydantic import Field, model_validator
from typing_extensions import TypedDict

from uavaccel.config import ClockSpeed, CommandName, Config, Games, NameOrNone, Seed
from uavaccel.draw import style
from uavaccel.draw.page import Block as PageBlock
from uavaccel.draw.page import (
    Column,
    Heading,
    Picture,
    Table,
    clock_label,
    command_name,
    counted,
    fill,
    in_words,
    listed,
)
from uavaccel.envs.simulators import EXACT
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.forms import ArrayForm, Count, NotNegative, Positive
from uavaccel.metrics.estimates import Success
from uavaccel.metrics.intervals import Proportion, fisher_exact_p, mcnemar_exact, permutation_p, sign_flip_p
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT, FLIGHT, SENSES
from uavaccel.sim.lane import LENGTH_M, Difficulty, sample_layout
from uavaccel.suites import experiment, paper_results, plots
from uavaccel.suites.experiment import (
    ClockSpeeds,
    CommandNames,
    Experiment,
    GameRow,
    Phases,
    ProfileName,
    Timing,
    subset,
)
from uavaccel.suites.parts import OUTCOMES, Part, Run, SuiteOfRuns, evaluate_part, outcomes, part_folder, train_part
from uavaccel.suites.report import Report, Summary, method_note, table_of
from uavaccel.suites.suite import GameResult, SimpleCase

if TYPE_CHECKING:  # it loads what draws
    from matplotlib.axes import Axes

SimulatedTiming = Literal["virtual", "lockstep"]
Flights: TypeAlias = pd.DataFrame
"""Flights of policies, a row each, as `flights_of` returns them."""

KEY = ["variant", "profile", "timing", "command", "clock_speed"]
"""The conditions of a training; trainings that have them in common differ in their seed alone."""
LEARNED = ("trained_games", "trained_successes", "weights_sha256")
OTHER: dict[str, CommandName] = {"adsc": "tcsc", "tcsc": "adsc"}
EVALUATION_SEED = 0  # the same lanes and latencies for every policy
OF_EXACT = "exact"  # name of an evaluation in the exact simulator
THINKING = re.compile(r"_?think_\d+ms$")  # suffix of variants that differ in the duration of a decision alone
LEAST = 3  # gaps that a run needs for a figure of them, and cells for a line in it
OF_SAME_POLICIES = ("difference", "only_first", "only_second", "mcnemar_p", "sign_flip_p")
AGAINST = ("difference", "permutation_p", "fisher_p", "mcnemar_p")  # tests against other trainings
COLLAPSED = 0.5  # share of the best success on the lane


class Block(Config):
    """Trainings that differ in command and ClockSpeed."""

    profile: ProfileName
    """How the simulator handles time: native is exact to the step, airsim behaves like AirSim."""
    timing: SimulatedTiming = "virtual"
    """Which simulated wall clock the policies are trained under: virtual with latencies, lockstep without."""
    command: CommandNames = ("adsc", "tcsc")
    """tcsc pauses the simulation while the program works, adsc does not; each value is flown."""
    clock_speed: ClockSpeeds
    """Simulated seconds per wall second that are asked for; each value is flown."""
    variant: NameOrNone = ""
    """Distinguishes these trainings from others of the same command and ClockSpeed; claims use those without one."""
    task: dict[str, Any] = Field(default_factory=dict)
    """Dotted keys of the task, in training and evaluation."""
    training: dict[str, Any] = Field(default_factory=dict)
    """Other dotted keys of the training; `inference_s`, the time of a decision, also applies to evaluations."""


class RlConfig(Experiment):
    """`suite: rl`."""

    suite: Literal["rl"]
    seeds: Annotated[int, Field(ge=1, le=1000)] = 1
    """Trainings of each cell, with seeds `seed`, `seed` + 1 and so on; evaluations have seed 0 or their keys'."""
    games: Games = 5000
    """Games of each training."""
    cells: Annotated[tuple[Block, ...], Field(min_length=1)]
    """Which policies are trained: blocks of profile, timing, commands and ClockSpeeds."""
    training: Part = Part(experiment="train")
    """How each policy is trained: an experiment, and keys that differ from it."""
    evaluation: Part = Part(experiment="evaluate", keys={"games": 100})
    """How each policy is evaluated: an experiment, and keys that differ from it."""
    evaluation_clock_speed: ClockSpeed = 1.0
    """ClockSpeed of the evaluations; 1 is real time, as in the paper (section IV-D), on a simulated wall clock."""
    as_trained: bool = False
    """Whether policies are also evaluated at the ClockSpeed of their training."""
    interchange: bool = True
    """Whether policies are also evaluated with the command that they were not trained with (section III-C3)."""
    exact_seeds: Annotated[int, Field(ge=0, le=1000)] = 0
    """Number of seeds whose policies are also evaluated in the exact simulator, once all are trained."""
    exact: Part = Part(experiment="evaluate")
    """That evaluation: in real time, with the command of the training, on the lanes of `evaluation`."""

    command: tuple[CommandName, ...] = ()
    """Commands to select; this and the next three keys select all cells where they are left out."""
    clock_speed: tuple[float, ...] = ()
    """Choose the cells of these ClockSpeeds; without values, all."""
    profile: ProfileName | None = None
    """Choose the cells of this profile; without it, of both."""
    timing: SimulatedTiming | None = None
    """Choose the cells of this timing; without it, of both."""

    @model_validator(mode="after")
    def _selects_cells_that_are_there_once(self) -> RlConfig:
        for name in ("command", "clock_speed"):
            known = sorted({value for block in self.cells for value in getattr(block, name)})
            if unknown := [value for value in getattr(self, name) if value not in known]:
                raise ValueError(f"{name} = {unknown[0]} is in no cell; there are {listed(known)}")
        if not self.selected():
            raise ValueError("command, clock_speed, profile and timing together select no cell")
        names = Counter(
            (block.variant, f"{block.profile} {block.timing} {command} at {clock_speed:g}x")
            for block in self.cells
            for clock_speed, command in product(block.clock_speed, block.command)
        )
        (_, name), count = names.most_common(1)[0]
        if count > 1:
            raise ValueError(f"cells has {name} twice; give one a `variant`")
        return self

    def selected(self) -> list[tuple[Block, float, CommandName]]:
        """Return block, ClockSpeed and command of each cell that a run selects, block by block, slow clocks first."""
        return [
            (block, clock_speed, command)
            for block in self.cells
            if block.profile == (self.profile or block.profile) and block.timing == (self.timing or block.timing)
            for clock_speed, command in product(block.clock_speed, block.command)
            if clock_speed in (self.clock_speed or block.clock_speed) and command in (self.command or block.command)
        ]


class TrainingResult(TypedDict):
    """What a row keeps of the summary of its training."""

    games: Games
    successes: Count
    commands: Count
    sim_time_s: NotNegative
    phase_s: Phases
    weights_sha256: str


class EvaluationResult(TypedDict):
    """What a row keeps of the summary of one evaluation."""

    command: CommandName
    clock_speed: Positive
    timing: Timing
    simulator: str
    games: Games
    successes: Count


class RlRow(GameRow):
    """The row of a training with the evaluations of its policy, or of its evaluation in the exact simulator alone."""

    variant: str
    profile: ProfileName
    timing: SimulatedTiming
    command: CommandName
    clock_speed: Positive
    seed: Seed
    training: NotRequired[TrainingResult]
    evaluations: list[EvaluationResult]


@dataclass(frozen=True)
class TrainingCase(SimpleCase):
    """A training and its policy's evaluations, or, if `exact`, the policy's evaluation in the exact simulator.

    `timing` is virtual in all, so that cells run side by side whichever simulated clock they have.
    """

    block: Block
    clock_speed: float
    command: CommandName
    seed: int
    exact: bool
    games: int = 0


class Rl(SuiteOfRuns[RlConfig, TrainingCase]):
    """`uavaccel run rl`."""

    name = "rl"
    config = RlConfig
    row = RlRow
    grows = ("seeds", "exact_seeds")
    arrays: ClassVar = {f"*_{name}": ArrayForm(form.kinds, ("n",)) for name, form in OUTCOMES.items() if name != "game"}

    def check(self, config: RlConfig) -> None:
        """Check that training and evaluations of each cell can be configured. Raises UserError."""
        last = {case.exact: case for case in self.cases(config.model_copy(update={"seeds": 1}))}
        if not config.exact_seeds:
            return
        evaluation, exact = (self.runs(config, last[exact])[-1][1] for exact in (False, True))
        if exact.simulator != EXACT:
            raise UserError(f"exact.keys.simulator = {exact.simulator}: exact_seeds needs {EXACT}")
        if evaluation.simulator == EXACT:
            raise UserError(f"evaluation.keys.simulator = {EXACT}: exact_seeds needs kernels; or exact_seeds = 0")
        flown = [(each.task.split, each.first_lane, each.games) for each in (exact, evaluation)]
        if flown[0] != flown[1]:
            raise UserError(
                "exact.keys: games, first_lane and task.split must be those of evaluation.keys, lane for lane"
            )

    def cases(self, config: RlConfig) -> Iterator[TrainingCase]:
        """Yield the cases seed by seed, block by block, slow clocks first; then evaluations in the exact simulator.

        An interrupted run has complete tables of fewer seeds.
        """
        sizes: dict[tuple[object, ...], tuple[int, float]] = {}  # of trainings that differ in their seed alone
        for exact, seeds in ((False, config.seeds), (True, min(config.exact_seeds, config.seeds))):
            for seed, cell in product(range(config.seed, config.seed + seeds), config.selected()):
                block, clock_speed, command = cell
                kind = block.variant, block.profile, block.timing, command, f"{clock_speed:g}x"
                name = "-".join(filter(None, (*kind, f"seed{seed}", OF_EXACT if exact else "")))
                case = TrainingCase(name, "virtual", 0.0, *cell, seed, exact)
                if (exact, *kind) not in sizes:
                    sizes[exact, *kind] = self.size(config, case)
                games, typical_s = sizes[exact, *kind]
                yield replace(case, games=games, typical_s=typical_s)

    def games(self, config: RlConfig, case: TrainingCase) -> int:
        return case.games

    def stage(self, case: TrainingCase) -> int:
        """Policies are evaluated in the exact simulator once all of them are trained."""
        return int(case.exact)

    def provenance(self, config: RlConfig) -> Mapping[str, Any]:
        try:
            return super().provenance(config)
        except UserError as error:
            raise UserError(f"{error}; without a GPU: uavaccel run rl_smoke") from error

    def renders(self, config: RlConfig) -> bool:
        return super().renders(config.model_copy(update={"seeds": 1}))

    def runs(self, config: RlConfig, case: TrainingCase) -> list[Run]:
        """Return the training of a case and the evaluations of its policy."""
        return [part.resolve(seed) for part, seed in parts_of(config, case).values()]

    def fly(self, config: RlConfig, case: TrainingCase, opened: RunDirectory) -> GameResult:
        """Train, unless a policy exists, and evaluate; the row has the summaries, the arrays each lane's outcome."""
        row = subset(vars(case.block), "variant", "profile", "timing")
        row |= subset(vars(case), "command", "clock_speed", "seed") | {"evaluations": []}
        arrays: dict[str, np.ndarray] = {}
        host, policy = {"evaluations_s": 0.0}, case.id.removesuffix(f"-{OF_EXACT}")
        agent = str(part_folder(opened, f"{policy}/training").resolve())
        for name, (part, seed) in parts_of(config, case, agent).items():
            place = f"{policy}/{name}"
            if name == "training":
                report = train_part(opened, place, part.resolve(seed))
                row["training"] = subset(report.summary, *TrainingResult.__annotations__)
                host["training_s"] = experiment.whole_wall_s(report.timings)
                continue
            report, took = experiment.timed(partial(evaluate_part, opened, place, part.resolve(seed)))
            row["evaluations"].append(subset(report.summary, *EvaluationResult.__annotations__))
            flight = name.removeprefix("evaluation-")
            arrays |= {f"{flight}_{key}": values for key, values in outcomes(report.run).items()}
            host["evaluations_s"] += took["host_wall_s"]
        return GameResult(row, arrays, host)

    def status(self, rows: Sequence[Any]) -> str:
        flown = rows[-1]["evaluations"][0]
        return f"{rows[-1]['case']} won {flown['successes']} of {flown['games']}"

    def score(self, report: Report) -> Flights:
        return flights_of(report.games.to_dict("records"), report.arrays)

    def summary(self, report: Report) -> Summary:
        """Summarise each training, the seeds of each condition pooled, and the comparisons between conditions."""
        config, real_time = report.config, report.config.evaluation_clock_speed
        trained, exact = (where(report.scores, exact=each) for each in (False, True))
        own = where(trained, flight=0)
        groups, exacts = ([group for _, group in some.groupby(KEY, sort=False)] for some in (trained, exact))
        faster = [(group, clock) for group in groups if (clock := group.clock_speed.iloc[0]) != real_time]
        variants = list(against_plain(own))
        return {
            "suite": "rl",
            "seed": config.seed,
            "training_games": config.games,
            "evaluation_clock_speed": real_time,
            "cells": [
                {
                    **subset(training, *KEY, "seed", *LEARNED),
                    **training["success"].as_summary(),
                    "distance_m_median": float(np.median(training["distance_m"])),
                    **times_of(own.loc[[number]], own),
                }
                for number, training in own.iterrows()
            ],
            "pooled": [summary_of_seeds(where(group, flight=0), own) for group in groups],
            "interchange": [test for group in groups for test in interchange(group, real_time)],
            "interchange_as_trained": [test for group, clock in faster for test in interchange(group, clock)],
            "as_trained": [test for group, _ in faster for test in as_trained(group, trained)],
            "exact": [side_by_side(where(own, **key_of(group)), group) for group in exacts],
            "same_weights": list(same_weights(own)),
            **({"variants": variants} if variants else {}),
        }

    def title(self, report: Report) -> str:
        return "Policies by the command and ClockSpeed of their training"

    def headline(self, report: Report) -> str:
        """Return the success after each kind's slowest and fastest training; of variants alone the collapse."""
        plain: dict[str, list[str]] = {}
        for cell in sorted(report.summary["pooled"], key=lambda cell: cell["clock_speed"]):
            if not cell["variant"]:
                success = f"{cell['success_ratio']:.1%} after training at {clock_label(cell['clock_speed'])}"
                plain.setdefault(panel_name(cell), []).append(success)
        said = [f"{name} wins {' and '.join(dict.fromkeys((each[0], each[-1])))}" for name, each in plain.items()]
        ratios = plots.span([cell["success_ratio"] for cell in report.summary["pooled"]], "{:.1%}")
        of_variants = collapse(over_gaps(report.summary["pooled"])).rstrip(".") or f"variants alone win {ratios}"
        return "; ".join(said) or of_variants

    def source(self, report: Report) -> str:
        cells, games = report.summary["cells"], report.summary["training_games"]
        lanes, clock = listed(sorted({cell["games"] for cell in cells})), report.summary["evaluation_clock_speed"]
        trained = f"{counted(len(cells), 'training')} of {counted(games, 'game')}"
        flown = f"{trained}, each policy flown on {counted(lanes, 'lane')} at {clock_label(clock)}"
        seeds = listed(sorted(report.games.seed.unique().tolist()))
        return f"modelled, but for the times of this machine · {flown} · seed {seeds}"

    def overview(self, report: Report) -> Table:
        return Table.of(report.summary["pooled"], OVERVIEW)

    def page(self, report: Report) -> Iterator[PageBlock | str]:
        summary, cells = report.summary, pd.DataFrame(report.summary["pooled"])
        cells = cells.assign(panel=[panel_name(cell) for cell in summary["pooled"]])
        yield Heading("Table I: success by training")
        yield Table.of(summary["pooled"], SUCCESS)
        yield success_figure(report, cells)
        yield distances_figure(report)
        if lines := over_gaps(summary["pooled"]):
            yield Heading("Success in real time over the gap of the training")
            yield collapse(lines)
            yield gaps_figure(report, lines)
            yield Table.of(pd.concat(lines.values()), GAPS)
        if interchanged := [*summary["interchange"], *summary["interchange_as_trained"]]:
            yield Heading("Commands interchanged")
            yield Table.of(interchanged, INTERCHANGED)
        if tests := summary["as_trained"]:
            yield Heading("Flown at the ClockSpeed of the training")
            yield Table.of(tests, AS_TRAINED)
        if variants := summary.get("variants"):
            yield Heading("What a variant changes")
            if len({cell["clock_speed"] for cell in variants}) > 1:
                yield variants_figure(report, pd.DataFrame(variants))
            yield Table.of(variants, VARIANTS)
        if exact := summary["exact"]:
            yield Heading("The same policies in the exact simulator")
            lanes, same = (sum(policy[name] for policy in exact) for name in ("lanes", "same_end"))
            flights = counted(lanes, "flight")
            yield f"Of {flights} of a policy over a lane in real time {same} end alike in both, won or lost."
            yield Table.of(exact, EXACT_TOO)
        yield Heading("Time of the training")
        took_s = {entry["case"]: entry["training_s"] for entry in report.timings if "training_s" in entry}
        machine_s = report.games.assign(machine_s=report.games["case"].map(took_s).astype(float)).groupby(KEY).machine_s
        times = cells.join(machine_s.sum(min_count=1), on=KEY)
        yield Table.of(times, TIMES)
        yield from time_saved(times)
        if (cells.timing == "virtual").any():
            yield time_figure(report, cells[cells.timing == "virtual"])
        yield Heading("Each training")
        for family in summary["same_weights"]:
            clocks = listed(clock_label(clock) for clock in family["clock_speed"])
            seeds, equal = len(family["seeds"]), len(family["equal"])
            others = "one training each" if equal == seeds else f"{seeds - equal} learned others"
            of = f"{panel_name(family)}: of {counted(seeds, 'seed')} {equal}"
            yield f"{of} learned the same weights at {clocks}: {others}."
        yield Table.of(summary["cells"], TRAININGS, folded=counted(len(summary["cells"]), "training"))
        yield method_note(" ".join([WHAT_N_TELLS, *([WHAT_A_GAP_IS] if lines else []), HOW_TIME_IS_MODELLED]))


# --- parts --------------------------------------------------------------------------------------------------------


def flight_name(command: str, clock_speed: float, real_time: float) -> str:
    """Return the name of an evaluation: the suffix of its folder, and the prefix of its arrays' names."""
    return command if clock_speed == real_time else f"{command}-{clock_speed:g}x"


def parts_of(config: RlConfig, case: TrainingCase, agent: str = DEFAULT) -> dict[str, tuple[Part, int]]:
    """Return the training of a case, and the evaluations of the policy `agent`, by folder, each with its seed.

    Evaluations are in real time with the cell's own command, then the other, then with both as trained.
    """
    block, real_time = case.block, config.evaluation_clock_speed
    flown_in = {"task.timing": block.timing, "task.profile": block.profile}
    task = {f"task.{key}": value for key, value in block.task.items()}
    keys = {f"task.{key}": value for key, value in block.task.items() if key.split(".")[0] not in SENSES + FLIGHT}
    keys |= {key: value for key, value in block.training.items() if key == "inference_s"} | {"agent": agent}

    def part(base: Part, command: str, clock_speed: float, keys: Mapping[str, Any]) -> Part:
        clock = {"task.command": command, "task.clock_speed": clock_speed, **flown_in}
        return Part(experiment=base.experiment, keys={**base.keys, **clock, **keys})

    if case.exact:
        return {f"evaluation-{OF_EXACT}": (part(config.exact, case.command, real_time, keys), EVALUATION_SEED)}
    learned = {"games": config.games, **task, **block.training}
    parts = {"training": (part(config.training, case.command, case.clock_speed, learned), case.seed)}
    clocks = dict.fromkeys([real_time, case.clock_speed] if config.as_trained else [real_time])
    commands = [case.command, OTHER[case.command]] if config.interchange else [case.command]
    for clock_speed, command in product(clocks, commands):
        name = f"evaluation-{flight_name(command, clock_speed, real_time)}"
        parts[name] = part(config.evaluation, command, clock_speed, keys), EVALUATION_SEED
    return parts


# --- numbers ------------------------------------------------------------------------------------------------------


def flights_of(rows: Iterable[Mapping[str, Any]], arrays_of: Callable[[Any], Mapping[str, np.ndarray]]) -> Flights:
    """Return a row for each flight of a policy, the one in real time with its own command, flight 0, first.

    It has the conditions of the training, `with` and `at`, command and ClockSpeed of the flight, `success`, a
    Proportion, `won`, the outcome by lane, and `distance_m`; and, unless `exact`, the numbers of the training, its
    seconds by phase, `simulation_s`, which as in the paper has rendering, and `wall_s`. Where `arrays_of` a run's row
    is empty, as of rows that were kept alone, `won` and `distance_m` are None.
    """
    flights = []
    for row in rows:
        arrays, exact, evaluations = arrays_of(row), row.get("training") is None, row["evaluations"]
        learned = {} if exact else {**row["training"], **row["training"]["phase_s"]}
        shared = subset(row, *KEY, "seed") | {"exact": exact}
        shared |= {f"trained_{name}": learned.get(name) for name in ("games", "successes")}
        shared |= {name: learned.get(name) for name in ("commands", "sim_time_s", "weights_sha256", *PHASES)}
        for number, flown in enumerate(evaluations):
            command, clock_speed = flown["command"], flown["clock_speed"]
            name = OF_EXACT if exact else flight_name(command, clock_speed, evaluations[0]["clock_speed"])
            own = {"flight": number, "with": command, "at": clock_speed}
            own |= {"success": Proportion.of(flown), "ratio": flown["successes"] / flown["games"]}
            own["won"] = pd.Series(arrays[f"{name}_is_success"], arrays[f"{name}_lane"]) if arrays else None
            flights.append({**shared, **own, "distance_m": arrays.get(f"{name}_distance_m")})
    table = table_of(flights)
    simulation_s, wall_s = (table[list(phases)].sum(axis=1) for phases in (PHASES[:2], PHASES))
    return table.assign(simulation_s=simulation_s, wall_s=wall_s)


def where(flights: Flights, **wanted: Any) -> Flights:
    """Return the flights that have these values in these columns."""
    return flights[np.logical_and.reduce([flights[name] == value for name, value in wanted.items()])]


def key_of(flights: Flights) -> dict[str, Any]:
    """Return the conditions that the trainings of some flights have in common."""
    return subset(flights.iloc[0], *KEY)


def _success(flights: Flights) -> dict[str, Any]:
    """Return the success of all seeds together, with two 95 % intervals.

    Wilson's is of the games of these very policies; that over seeds also covers other trainings on other lanes.
    """
    success = success_of(flights)
    low, high = success.estimate.interval
    return {**success.pooled.as_summary(), "seeds_low": low, "seeds_high": high}


def success_of(flights: Flights) -> Success:
    """Return the success of the policies of some flights, lane by lane where all flew the same ones."""
    first, *others = flights.won.tolist()
    if first is None or not all(first.index.equals(won.index) for won in others):
        return Success(tuple(flights.success))
    return Success.on_lanes([first, *others])


def _compare(some: Flights, others: Flights, *wanted: str, same_policies: bool = False) -> dict[str, Any]:
    """Return the wanted tests of the difference between two groups of flights; None without flights in both.

    `permutation_p` and, between equal seeds, `sign_flip_p` take trainings as their samples. Fisher's test of the pooled
    games and McNemar's of equal seeds and `lanes` compare these very policies alone. `difference` is the first success
    less the second with its interval over trainings and lanes, paired over lanes and, of the same policies, these.
    """
    if some.empty or others.empty:
        return dict.fromkeys(wanted)
    outcomes = [pd.concat(dict(zip(flights.seed, flights.won, strict=True))) for flights in (some, others)]
    first, second = pd.concat(outcomes, axis=1, join="inner").to_numpy(bool).T
    pairs = mcnemar_exact(first, second)
    won = [Proportion.pooled(flights.success.tolist()) for flights in (some, others)]

    def difference() -> dict[str, Any]:
        one, other = some, others
        if same_policies:  # of those that flew both ways
            one, other = (own[own.seed.isin({*some.seed} & {*others.seed})].sort_values("seed") for own in (one, other))
        return success_of(one).difference(success_of(other), same_policies)._asdict()

    tests: dict[str, Callable[[], Any]] = {
        "permutation_p": lambda: permutation_p(some.ratio, others.ratio),
        "sign_flip_p": lambda: sign_flip_p((some.set_index("seed").ratio - others.set_index("seed").ratio).dropna()),
        "difference": difference,
        "fisher_p": lambda: fisher_exact_p(*((success.successes, success.games) for success in won)),
        "mcnemar_p": lambda: pairs.p_value if len(first) else None,
        "only_first": lambda: pairs.only_first,
        "only_second": lambda: pairs.only_second,
        "lanes": lambda: len(first),
        "same_end": lambda: int((first == second).sum()),
    }
    return {name: tests[name]() for name in wanted}


def _at_1x(cell: Flights, own: Flights, command: str) -> Flights:
    """Return the trainings with that command at 1x; none in lockstep, or where they were not run."""
    return where(where(own, **key_of(cell) | {"command": command, "clock_speed": 1.0}), timing="virtual")


def times_of(cell: Flights, own: Flights) -> dict[str, Any]:
    """Return the modelled seconds of a cell's trainings, those of as many commands of ADSC at 1x, and speed-ups.

    Speed-ups are of a command's mean time, as other trainings fly games of other length, over that of ADSC at 1x.
    """
    baseline, phase_s = _at_1x(cell, own, "adsc"), {phase: cell[phase].sum() for phase in PHASES}
    known, commands = len(baseline) > 0, cell.commands.sum()
    slow, now = (flown[["simulation_s", "wall_s"]].sum() / flown.commands.sum() for flown in (baseline, cell))
    return {
        "commands": commands,
        "sim_time_s": cell.sim_time_s.sum(),
        "training_wall_s": sum(phase_s.values()),
        "real_time_s": slow.wall_s * commands if known else None,
        "training_speedup": slow.simulation_s / now.simulation_s if known else None,
        "whole_training_speedup": slow.wall_s / now.wall_s if known else None,
        "phase_s": phase_s,
    }


def summary_of_seeds(cell: Flights, own: Flights) -> dict[str, Any]:
    """Summarise all seeds of one training, compared with the same command at 1x and with the paper."""
    key = key_of(cell)
    slow = _at_1x(cell, own, key["command"])
    return {
        **key,
        "seeds": cell.seed.tolist(),
        "successes_by_seed": [success.successes for success in cell.success],
        **_success(cell),
        "trained_games": cell.trained_games.sum(),
        **_compare(cell, slow[slow.clock_speed != key["clock_speed"]], *AGAINST),
        **times_of(cell, own),
        "gap_s": gap_s(cell),
        **paper_results.of_training(key["profile"], key["variant"], key["command"], key["clock_speed"]),
    }


def gap_s(cell: Flights) -> float:
    """Return the mean gap (WHAT_A_GAP_IS) in a cell's trainings, at the speed that the profile's platform reaches.

    A command that a collision ends early counts as a whole one, and ADSC's calls in a pause count too.
    """
    first = cell.iloc[0]
    if first.command == "tcsc":
        return 0.0
    from uavaccel.envs.obstacle_lane import LaneTask
    from uavaccel.envs.simulators import speed_of

    speed = speed_of(LaneTask(timing=first.timing, profile=first.profile, clock_speed=first.clock_speed))
    running_s = cell.wall_s.sum() - cell.rendering.sum()
    return max(float((running_s * speed - cell.sim_time_s.sum()) / cell.commands.sum()), 0.0)


def interchange(group: Flights, clock_speed: float) -> Iterator[dict[str, Any]]:
    """Yield the comparison of the flights with either command at a ClockSpeed, if there are any."""
    command = group.command.iloc[0]
    both = [where(group, **{"with": each, "at": clock_speed}) for each in (command, OTHER[command])]
    if all(map(len, both)):
        yield {
            **key_of(group),
            "seeds": both[0].seed.tolist(),
            "flown_at": clock_speed,
            "flown_with": [{"command": flown["with"].iloc[0], **_success(flown)} for flown in both],
            **_compare(*both, *OF_SAME_POLICIES, same_policies=True),
        }


def as_trained(group: Flights, trained: Flights) -> Iterator[dict[str, Any]]:
    """Yield the comparison of flights at the training's ClockSpeed, if any, with those without the variant."""
    key = key_of(group)
    plain = where(trained, **key | {"variant": ""}) if key["variant"] else group[:0]
    own = {"with": key["command"], "at": key["clock_speed"]}
    slow, fast, plain_slow, plain_fast = (where(each, **at) for each in (group, plain) for at in ({"flight": 0}, own))
    if len(fast):
        plain_slow = plain_slow[plain_slow.seed.isin(plain_fast.seed)]
        yield {
            **key,
            "seeds": slow.seed.tolist(),
            "real_time": _success(slow) | _compare(slow, plain_slow, *AGAINST),
            "as_trained": _success(fast) | _compare(fast, plain_fast, *AGAINST),
            **_compare(slow, fast, "difference", "sign_flip_p", same_policies=True),
        }


def against_plain(own: Flights) -> Iterator[dict[str, Any]]:
    """Yield the comparison, in real time, of each variant and the cell without one, of the seeds that both have."""
    for _, group in own[own.variant != ""].groupby(KEY, sort=False):
        plain = where(own, **key_of(group) | {"variant": ""})
        plain, group = (some[some.seed.isin({*plain.seed} & {*group.seed})] for some in (plain, group))
        if len(plain):
            difference = _compare(group, plain, "difference", same_policies=True)
            yield {
                **key_of(group),
                "seeds": plain.seed.tolist(),
                "plain": _success(plain),
                **_success(group),
                **difference,
            }


def side_by_side(kernels: Flights, exact: Flights) -> dict[str, Any]:
    """Compare the same policies on the same lanes in real time in the kernels and in the exact simulator."""
    kernels = kernels[kernels.seed.isin(exact.seed)]
    both = {"seeds": exact.seed.tolist(), "kernels": _success(kernels), "exact": _success(exact)}
    return {**key_of(exact), **both, **_compare(kernels, exact, "lanes", "same_end", "mcnemar_p")}


def same_weights(own: Flights) -> Iterator[dict[str, Any]]:
    """Yield how many seeds learned the same weights at all ClockSpeeds that a command was trained at, if several."""
    for conditions, family in own.groupby(KEY[:-1], sort=False):
        clocks, seeds = sorted(family.clock_speed.unique().tolist()), family.groupby("seed").weights_sha256
        whole = seeds.nunique()[seeds.size() == len(clocks)]
        if len(clocks) > 1:
            learned = {"seeds": whole.index.tolist(), "equal": whole.index[whole == 1].tolist()}
            yield {**dict(zip(KEY, conditions, strict=False)), "clock_speed": clocks, **learned}


def over_gaps(pooled: Sequence[Mapping[str, Any]]) -> dict[str, pd.DataFrame]:
    """Return the cells of each command on each `lane`, of all ClockSpeeds and durations of a decision, by rising gap.

    A lane is that of a profile and a variant: "airsim, hard" of hard_think_100ms; `best` is the best success on it.
    """
    cells = pd.DataFrame(pooled).query("timing == 'virtual'").sort_values(["gap_s", "clock_speed"], kind="stable")
    variant = cells.variant.str.replace(THINKING, "", regex=True).str.replace("_", " ")
    cells["lane"] = cells.profile + variant.where(variant == "", ", " + variant)
    cells = cells.groupby(["lane", "command"]).filter(lambda line: len(line) >= LEAST)
    if cells.gap_s.nunique() < LEAST:
        return {}
    cells["best"] = cells.groupby("lane").success_ratio.transform("max")
    lines = cells.groupby(["lane", "command"])
    return {f"{command_name(command)}, {lane}": line for (lane, command), line in lines}


def collapse(lines: Mapping[str, pd.DataFrame]) -> str:
    """Return in words from which gap on success stays below half of the lane's best."""
    said = []
    for label, line in lines.items():
        flies = line.gap_s[line.success_ratio >= COLLAPSED * line.best]
        fails = line.gap_s[~(line.gap_s <= flies.max())]  # all where none flies
        stays = f"success in real time stays below half of the best cell's {line.best.iloc[0]:.1%}"
        none = f"no gap was flown, up to {line.gap_s.max():.2f} s, from which {stays}"
        if line.gap_s.nunique() >= LEAST:
            found = f"{stays} from a gap of {fails.iloc[0]:.2f} simulated seconds on" if len(fails) else none
            said.append(f"{label}: {found}.")
    return " ".join(said)


# --- figures ------------------------------------------------------------------------------------------------------


def panel_name(cell: Mapping[str, Any]) -> str:
    """Return command and profile, as in "TCSC, airsim", with timing and variant where they are not the usual ones."""
    clock = "" if cell["timing"] == "virtual" else f" {cell['timing']}"
    variant = f", {cell['variant'].replace('_', ' ')}" if cell["variant"] else ""
    return f"{command_name(cell['command'])}, {cell['profile']}{clock}{variant}"


def look_of(cell: Mapping[str, Any], kinds: Sequence[Any]) -> style.LineStyle:
    """Return the colour of a cell's command, and the marker and dashes of what else is its `kind` of all of them."""
    number = list(kinds).index(cell["kind"])
    line = {"color": style.COMMAND_COLOUR[cell["command"]], "marker": style.marker(number)}
    return line | {"linestyle": ("-", "--", "-.")[number % 3]}


def draw_line(axes: Axes, cells: pd.DataFrame, places: Any, aside: float = 0.0, **look: Any) -> None:
    """Draw a line through the success of cells at `places`, with their intervals; dots, `aside`, are its seeds."""
    joined = {} if len(set(places)) > 1 else {"linestyle": "none"}
    plots.line(axes, places, cells.success_ratio, (cells.seeds_low, cells.seeds_high), **{**look, **joined})
    for place, won, games in zip(places, cells.successes_by_seed, cells.games, strict=True):
        seeds = np.divide(won, games / len(won)) if won else []
        axes.plot([place + aside] * len(won), seeds, ".", color=look["color"], markersize=4, alpha=0.6)


def success_figure(report: Report, cells: pd.DataFrame) -> Picture:
    """Draw success over ClockSpeed (Table I), the paper's own too, lines shifted a little; dots are seeds."""
    cells = cells.assign(kind=cells.profile + cells.timing + cells.variant).sort_values("clock_speed", kind="stable")
    clocks, kinds, lines = sorted(cells.clock_speed.unique()), cells.kind.unique(), []
    figure, [axes] = plots.panels(1, "Success by training", 3.4)
    for panel, own in cells.groupby("panel"):
        first, look = own.iloc[0], look_of(own.iloc[0], kinds)
        lines.append((own, {"label": panel, **look}))
        if len(known := own.dropna(subset="paper_successes")):
            won = [Proportion(int(successes), paper_results.GAMES) for successes in known.paper_successes]
            ratios, intervals = [success.ratio for success in won], [success.interval for success in won]
            known = known.assign(success_ratio=ratios, successes_by_seed=[[]] * len(known))
            known[["seeds_low", "seeds_high"]] = intervals
            label = f"{command_name(first.command)}, the paper's"
            lines.append((known, {"label": label, "color": look["color"], "alpha": 0.5, "linestyle": ":"}))
    for number, (own, look) in enumerate(lines):
        shift = plots.beside(number, len(lines), 0.06)
        draw_line(axes, own, np.searchsorted(clocks, own.clock_speed) + shift, 0.03, **look)
    plots.clock_axis(axes, clocks)
    axes.set(xlabel="ClockSpeed of the training", ylabel="success", ylim=(-0.03, 1.03))
    style.legend(figure)
    alt = f"Lines of success by ClockSpeed of the training. {report.headline()}."
    return report.figure("table1_success", figure, TABLE1, alt)


def variants_figure(report: Report, variants: pd.DataFrame) -> Picture:
    """Draw success over ClockSpeed without a variant in the range of the means of all variants, itself one of them."""
    title = "Success in the range of all variants"
    figure, [axes] = plots.panels(1, title, 3.4)
    draw_variants(axes, variants)
    style.legend(figure)
    commands = listed(map(command_name, variants.command.unique()))
    alt = f"Lines of success by ClockSpeed of the training in bands: {commands}."
    return report.figure("variants", figure, f"{title}. {BAND}", alt)


def draw_variants(axes: Axes, variants: pd.DataFrame) -> None:
    """Draw a line in its band for each command of each profile and timing of `against_plain`'s cells."""
    clocks = sorted(variants.clock_speed.unique())
    kinds = list(dict.fromkeys(zip(variants.profile, variants.timing, strict=True)))
    for (profile, timing, command), own in variants.groupby(["profile", "timing", "command"], sort=False):
        cells = own.groupby("clock_speed")
        plain = pd.DataFrame(cells.plain.first().tolist())
        ends = cells.success_ratio.agg(["min", "max"])
        places = np.searchsorted(clocks, ends.index)
        low, high = (
            np.minimum(ends["min"], plain.success_ratio.values),
            np.maximum(ends["max"], plain.success_ratio.values),
        )
        look = look_of({"command": command, "kind": (profile, timing)}, kinds)
        label = panel_name({"command": command, "profile": profile, "timing": timing, "variant": ""})
        plots.band(axes, places, plain.success_ratio, low, high, label=label, **look)
        plots.line(axes, places, plain.success_ratio, (plain.seeds_low, plain.seeds_high), **look)
    plots.clock_axis(axes, clocks)
    axes.set(xlabel="ClockSpeed of the training", ylabel="success in real time", ylim=(-0.03, 1.03))


def gaps_figure(report: Report, lines: Mapping[str, pd.DataFrame]) -> Picture:
    """Draw success over the gap between two commands, linear up to .1 s and logarithmic beyond; dots are seeds.

    The intervals of two seeds, which span nearly everything, and of cells with equal gaps are left out.
    """
    title = "Success in real time over the gap of the training"
    figure, [axes] = plots.panels(1, title, 3.4)
    kinds = sorted({line.lane.iloc[0] for line in lines.values()})
    for label, line in lines.items():
        hidden = (line.seeds.map(len) == 2) | line.gap_s.duplicated(keep=False)
        shown = line.assign(**{end: line[end].mask(hidden) for end in ("seeds_low", "seeds_high")})
        first = {"kind": line.lane.iloc[0], "command": line.command.iloc[0]}
        draw_line(axes, shown, shown.gap_s, label=label, **look_of(first, kinds))
    axes.set_xscale("symlog", linthresh=0.1)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="gap between two commands of the training, simulated s", ylabel="success in real time")
    axes.set(xlim=(-0.01, None), ylim=(-0.03, 1.03))
    style.legend(figure)
    alt = f"Lines of success over the gap. {collapse(lines)}"
    return report.figure("success_over_gap", figure, f"{title}. {POINTS}", alt)


def distances_figure(report: Report) -> Picture:
    """Draw the share of games that got so far down the lane (Figure 8), a line per ClockSpeed; rows are marked."""
    flights = where(report.scores, exact=False, flight=0)
    flights, clocks = flights.assign(panel=flights.apply(panel_name, axis=1)), sorted(flights.clock_speed.unique())
    figure, panels = plots.facets(flights, "panel", "Distance travelled", across=2, height_in=2.4)
    for axes, panel, own in panels:
        for clock, policies in own.groupby("clock_speed"):
            places, share = style.survival(np.concatenate(policies.distance_m.tolist()), LENGTH_M)
            colour = style.shade(clocks.index(clock), len(clocks))
            axes.step(places, share, where="post", color=colour, label=f"trained at {clock_label(clock)}")
        for row_m in np.unique(sample_layout(0, Difficulty()).x_m):
            axes.axvline(row_m, color=style.GREY, linewidth=0.7, linestyle=":", zorder=0)
        axes.axvline(LENGTH_M, **style.LIMIT)
        axes.set(title=panel, xlabel="distance north, m", ylabel="share of games", ylim=(0.0, 1.05))
    plots.label_outer([axes for axes, *_ in panels])
    style.legend(figure, {"end of the lane": style.LIMIT})
    alt = f"Falling curves of the share of games by distance, a panel each: {listed(panel for _, panel, _ in panels)}."
    return report.figure("figure8_distances", figure, FIGURE8, alt)


def time_figure(report: Report, cells: pd.DataFrame) -> Picture:
    """Draw the time of a training, the mean of its seeds, by phase (Figure 9), rendering as part of simulation."""
    phase_s = pd.DataFrame(cells.phase_s.tolist(), cells.index).div(cells.seeds.map(len), axis=0)
    phase_s.insert(0, "simulation (with rendering)", phase_s.pop("simulation") + phase_s.pop("rendering"))
    cells, unit = cells.sort_values(["panel", "clock_speed"], kind="stable"), plots.time_unit(phase_s.sum(axis=1).max())
    most = cells.groupby("panel").size().max()
    title, height_in = "Time of the training by phase, speed-ups", 0.4 + 0.26 * most
    figure, panels = plots.facets(cells, "panel", title, across=1, height_in=height_in, sharex=False, sharey=False)
    for axes, panel, own in panels:
        bars = phase_s.loc[own.index].set_axis(own.clock_speed.map(clock_label))
        plots.phases(axes, bars, unit, [fill(speed_ups, cell) for cell in own.to_dict("records")])
        axes.set_title(panel)
    style.legend(figure)
    alt = f"Stacked bars of a training's {unit} by ClockSpeed, a panel each: {listed(panel for _, panel, _ in panels)}."
    return report.figure("figure9_training_time", figure, FIGURE9, alt)


def speed_ups(cell: Mapping[str, Any]) -> str:
    """Return the speed-ups of simulation and of the whole training, and the paper's, in words."""
    own = fill("{training_speedup:.3g}x, whole {whole_training_speedup:.3g}x", cell)
    paper = fill("{paper_training_speedup:g}x, {paper_whole_training_speedup:g}x", cell)
    return "" if own == "-" else own if paper == "-" else f"{own} (paper {paper})"


# --- tables and words -----------------------------------------------------------------------------------------------


def time_saved(cells: pd.DataFrame) -> Iterator[str]:
    """Yield a comparison of the trainings' modelled real time with the time that they took, where both are known."""
    both = cells.dropna(subset=["real_time_s", "machine_s"])
    if len(both):
        real_s, took_s, games = both.real_time_s.sum(), both.machine_s.sum(), both.trained_games.sum()
        yield (
            f"These trainings' {counted(games, 'game')} would have taken {in_words(real_s)} in real time (modelled, "
            f"{real_s / games:.0f} s per game; the paper's 5 000 games took 182 hours, 131 s per game), and took "
            f"{in_words(took_s)} of this machine, measured, one after another: {real_s / took_s:.0f} times less."
        )


def over_seeds(entry: str = "") -> str:
    """Return the column of a success with its interval over seeds and games, that of a nested entry if one is named."""
    ratio, low, high = (f"{entry}[{key}]" if entry else key for key in ("success_ratio", "seeds_low", "seeds_high"))
    return f"{{{ratio}:.1%}} [{{{low}:.1%}}, {{{high}:.1%}}]"


DIFFERENCE = "{difference[value]:+.1%} [{difference[low]:+.1%}, {difference[high]:+.1%}]"
CELL: dict[str, Column] = {"trained with": panel_name, "ClockSpeed": "{clock_speed:g}x"}
TRAINED = {**CELL, "seeds": "{seeds!l}"}
OVERVIEW = {
    **TRAINED,
    "success [95 %]": over_seeds(),
    "the paper's": "{paper_successes} %",
    "training speed-up": "{training_speedup:.3g}x",
}
SUCCESS = {
    **TRAINED,
    "games won": "{successes} of {games}",
    "success [95 % over seeds and games]": over_seeds(),
    "won by each seed": "{successes_by_seed!l}",
    "the paper's, of 100": "{paper_successes}",
    "p against 1x, over seeds": "{permutation_p:.2g}",
    "of these policies: McNemar": "{mcnemar_p:.2g}",
}
GAPS = {**CELL, "gap, simulated s": "{gap_s:.3f}", "success in real time [95 % over seeds and games]": over_seeds()}
INTERCHANGED = {
    **TRAINED,
    "flown at": "{flown_at:g}x",
    "with its own command [95 %]": over_seeds("flown_with[0]"),
    "with the other one": over_seeds("flown_with[1]"),
    "difference [95 %]": DIFFERENCE,
    "lanes won with one alone": "{only_first}, {only_second}",
    "p over seeds": "{sign_flip_p:.2g}",
    "of these policies: McNemar": "{mcnemar_p:.2g}",
}
AS_TRAINED = {
    **TRAINED,
    "in real time [95 %]": over_seeds("real_time"),
    "p against the plain one, over seeds": "{real_time[permutation_p]:.2g}",
    "at the ClockSpeed of the training": over_seeds("as_trained"),
    "p against the plain one there": "{as_trained[permutation_p]:.2g}",
    "difference of the two [95 %]": DIFFERENCE,
    "its p, over seeds": "{sign_flip_p:.2g}",
}
VARIANTS = {
    **TRAINED,
    "in real time [95 %]": over_seeds(),
    "without the variant": over_seeds("plain"),
    "difference, paired by seed [95 %]": DIFFERENCE,
}
EXACT_TOO = {
    **TRAINED,
    "the kernels, won": "{kernels[successes]}",
    "the exact simulator, won": "{exact[successes]}",
    "end alike": "{same_end} of {lanes}",
    "McNemar p": "{mcnemar_p:.2g}",
}
TIMES = {
    **TRAINED,
    "modelled": "{training_wall_s!t}",
    "as ADSC at 1x": "{real_time_s!t}",
    "speed-up of simulation": "{training_speedup:.3g}x",
    "the paper's": "{paper_training_speedup:g}x",
    "of the whole training": "{whole_training_speedup:.3g}x",
    "the paper's, whole": "{paper_whole_training_speedup:g}x",
    "this machine": "{machine_s!t}",
}
TRAININGS = {
    **CELL,
    "seed": "{seed}",
    "training games won": "{trained_successes} of {trained_games}",
    "success [95 % Wilson]": "{successes} of {games}: {success_ratio:.1%} [{wilson_low:.1%}, {wilson_high:.1%}]",
    "weights (SHA-256)": "{weights_sha256}",
}
TABLE1 = "Table I as a picture: bars are 95 % intervals over seeds and games, of the paper's Wilson's; dots are seeds."
BAND = "A band spans the means of all variants; bars are 95 % intervals over seeds and games without one."
POINTS = "A point is a cell, with its 95 % interval over seeds and games; dots are seeds."
FIGURE8 = "Figure 8. How far the evaluated policies got, seeds pooled."
FIGURE9 = (
    "Figure 9. Modelled time of a training by phase, mean of its seeds; beside it the speed-up over ADSC at 1x of "
    "simulation alone and of the whole training."
)
WHAT_N_TELLS = (
    f"The paper evaluated one training of each kind in {paper_results.GAMES} games; of its differences only the "
    "collapse of ADSC (23 to 1) is significant by Fisher's exact test. Here a training, not a game, is one sample: an "
    "interval covers Wilson's over all games, Student's over the trainings (of a single seed it is Wilson's) and the "
    "lanes, which all fly; a difference is paired over lanes and, where the same policies flew twice, over these. "
    "Differences are tested by permuting the trainings. McNemar's test compares these very policies on the same "
    "lanes and says nothing about other seeds."
)
WHAT_A_GAP_IS = (
    "The gap is the mean simulated time between the end of a command and the next one in the training, worked out from "
    "the modelled wall time of its commands without that of images, which ADSC takes in a pause. With TCSC the clock "
    "is paused while an agent decides: its gap is 0 at every ClockSpeed."
)
HOW_TIME_IS_MODELLED = (
    "Times are of the simulated wall clock, summed over the lanes flown side by side, each charged as if alone; "
    "simulation holds rendering, as in the paper. Speed-ups are of a command's mean time with ADSC at 1x over that of "
    "the cell: of simulation alone, and with image processing, inference and learning, whose costs are keys of the "
    "configuration and no measurements of the paper's machine."
)
