"""The paper's RL experiment: policies trained under a command and a ClockSpeed, flown in real time (section IV-D).

Each case trains a policy and evaluates it, in runs of other suites below parts/, resumed where they stopped.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NotRequired, TypeAlias

import numpy as np
import pandas as pd
from pydantic import Field, model_validator
from typing_extensions import TypedDict

from uavaccel.config import Config
from uavaccel.draw.labels import clock_label
from uavaccel.draw.page import Block as PageBlock
from uavaccel.draw.page import Column, Heading, Table, listed
from uavaccel.envs.simulators import EXACT
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.forms import ArrayForm, Count, NotNegative, Positive
from uavaccel.limits import ClockSpeed, Games, Seed
from uavaccel.metrics.equivalence import success_estimate
from uavaccel.metrics.intervals import Proportion, fisher_exact_p, mcnemar_exact
from uavaccel.metrics.seeds import permutation_p, sign_flip_p
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT, FLIGHT, SENSES
from uavaccel.suites import paper_results, rl_figures
from uavaccel.suites.experiment import ClockSpeeds, CommandName, CommandNames, Experiment, ProfileName, Timing
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.host_time import cumulative_wall_s, timed
from uavaccel.suites.parts import OUTCOMES, Part, fly_part, outcomes, part_folder, part_run, part_suite
from uavaccel.suites.report import Report, Summary, table_of
from uavaccel.suites.rl_figures import KEY, collapse, over_gaps, panel_name
from uavaccel.suites.rows import GameRow, Phases, Row
from uavaccel.suites.suite import AnySuite, GameResult, SimpleCase, Suite
from uavaccel.suites.train import CHECKPOINTS

SimulatedTiming = Literal["virtual", "lockstep"]
Flown: TypeAlias = pd.DataFrame
"""Flights of policies, a row each, as `Rl.score` returns them."""

OF_DECISIONS = ("inference_s",)  # keys of a training that also apply to its evaluations
EVALUATION_SEED = 0  # the same lanes and latencies for every policy
OF_EXACT = "exact"  # name of an evaluation in the exact simulator
TOGETHER = "together"  # the folder of the report of several runs, in the first one's
MAY_DIFFER = {"cells", "command", "clock_speed", "profile", "timing", "seed", "seeds"}  # between these
LEARNED = ("trained_games", "trained_successes", "weights_sha256")


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
    variant: Annotated[str, Field(pattern=r"^[a-z0-9_]*$")] = ""
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
        if not any(self.selected(block) for block in self.cells):
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

    def selected(self, block: Block) -> list[tuple[float, CommandName]]:
        """Return ClockSpeed and command of each cell of a block that a run selects."""
        if block.profile != (self.profile or block.profile) or block.timing != (self.timing or block.timing):
            return []
        clocks, commands = self.clock_speed or block.clock_speed, self.command or block.command
        cells = product(block.clock_speed, block.command)
        return [(clock, command) for clock, command in cells if clock in clocks and command in commands]


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
    """A training and the evaluations of its policy, or, if `exact`, its policy's evaluation in the exact simulator.

    `timing` is virtual in all, so that cells run side by side whichever simulated clock they have.
    """

    block: Block
    clock_speed: float
    command: CommandName
    seed: int
    exact: bool
    games: int = 0

    @property
    def trained(self) -> str:
        """The name of the policy: the folder of its parts."""
        return self.id.removesuffix(f"-{OF_EXACT}")


class Rl(Suite[RlConfig, TrainingCase]):
    """`uavaccel run rl`."""

    name = "rl"
    config = RlConfig
    row = RlRow
    arrays: ClassVar = {f"*_{name}": ArrayForm(form.kinds, ("n",)) for name, form in OUTCOMES.items()}
    batch: ClassVar[int] = 1

    def check(self, config: RlConfig) -> None:
        """Check that training and evaluations of each cell can be configured. Raises UserError."""
        last = {case.exact: case for case in self.cases(config.model_copy(update={"seeds": 1}))}
        if not config.exact_seeds:
            return
        evaluation, exact = (_configured(config, last[exact])[-1][1] for exact in (False, True))
        if exact.simulator != EXACT or evaluation.simulator == EXACT:
            raise UserError(
                f"exact_seeds: needs exact.keys.simulator = {EXACT}, not {exact.simulator}, beside an evaluation by "
                f"the kernels, not by {evaluation.simulator}; or exact_seeds = 0"
            )
        if (exact.first_lane, exact.games) != (evaluation.first_lane, evaluation.games):
            raise UserError("exact.keys: games and first_lane must be those of evaluation.keys, lane for lane")

    def cases(self, config: RlConfig) -> Iterator[TrainingCase]:
        """Yield the cases seed by seed, so that an interrupted run has complete tables of fewer seeds.

        Those of a seed are in the order of the blocks, slow clocks first. The evaluations in the exact simulator
        follow, in the same order.
        """
        sizes: dict[tuple[object, ...], tuple[int, float]] = {}  # of trainings that differ in their seed alone
        for exact, seeds in ((False, config.seeds), (True, min(config.exact_seeds, config.seeds))):
            for seed, block in product(range(config.seed, config.seed + seeds), config.cells):
                for clock_speed, command in config.selected(block):
                    kind = block.variant, block.profile, block.timing, command, f"{clock_speed:g}x"
                    name = "-".join(filter(None, (*kind, f"seed{seed}", OF_EXACT if exact else "")))
                    case = TrainingCase(name, "virtual", 0.0, block, clock_speed, command, seed, exact)
                    if (exact, *kind) not in sizes:
                        parts = _configured(config, case)
                        games_s = [game.simulated_s() for suite, part in parts for game in suite.cases(part)]
                        sizes[exact, *kind] = len(games_s), sum(games_s)
                    games, typical_s = sizes[exact, *kind]
                    yield replace(case, games=games, typical_s=typical_s)

    def games(self, config: RlConfig, case: TrainingCase) -> int:
        return case.games

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        return ("seeds", "exact_seeds")

    def stage(self, case: TrainingCase) -> int:
        """Policies are evaluated in the exact simulator once all of them are trained."""
        return int(case.exact)

    def provenance(self, config: RlConfig) -> Mapping[str, Any]:
        """Check that this machine has the devices of training and evaluation. Raises UserError."""
        try:
            for suite, part in _configured(config, next(self.cases(config)))[:2]:
                suite.provenance(part)
        except UserError as error:
            raise UserError(f"{error}; without a GPU: uavaccel run rl_smoke") from error
        return {}

    def renders(self, config: RlConfig) -> bool:
        cases = self.cases(config.model_copy(update={"seeds": 1}))
        return any(suite.renders(part) for case in cases for suite, part in _configured(config, case))

    def open(self, config: RlConfig, timing: str, run: RunDirectory) -> AbstractContextManager[RunDirectory]:
        _, training = _configured(config, next(self.cases(config)))[0]
        return on_own_gpu(run, str(getattr(training, "device", "cpu")))

    def fly(self, config: RlConfig, case: TrainingCase, opened: RunDirectory) -> GameResult:
        """Train, unless the case evaluates a policy that exists, and evaluate.

        The row has the summaries of both, the arrays the outcome of each evaluated lane.
        """
        row: dict[str, Any] = {name: getattr(case.block, name) for name in ("variant", "profile", "timing")}
        row |= {name: getattr(case, name) for name in ("command", "clock_speed", "seed")} | {"evaluations": []}
        arrays: dict[str, np.ndarray] = {}
        host = {"evaluations_s": 0.0}
        agent = str(part_folder(opened, f"{case.trained}/training").resolve())
        for name, (part, seed) in parts_of(config, case, agent).items():
            folder = part_folder(opened, place := f"{case.trained}/{name}")
            begun = name != "training" and (folder / "config.yaml").is_file()
            if begun and RunDirectory(folder).config().get("agent") != agent:
                shutil.rmtree(folder)  # begun before the run was moved, it names its policy by another path
            report, took = timed(partial(fly_part, opened, place, part, seed, pages=False))
            summary, flown = report.summary, part_run(opened, place)
            if name == "training":
                # gigabytes that are of no use once the training is over
                shutil.rmtree(folder / CHECKPOINTS, ignore_errors=True)
                row["training"] = {key: summary[key] for key in TrainingResult.__annotations__}
                host["training_s"] = (cumulative_wall_s(flown.timings()) or [0.0])[-1]
            else:
                row["evaluations"].append({key: summary[key] for key in EvaluationResult.__annotations__})
                flight = name.removeprefix("evaluation-")
                arrays |= {f"{flight}_{key}": values for key, values in outcomes(flown).items()}
                host["evaluations_s"] += took["host_wall_s"]
        return GameResult(row, arrays, host)

    def status(self, rows: Sequence[Row]) -> str:
        flown = rows[-1]["evaluations"][0]
        return f"{rows[-1]['case']} won {flown['successes']} of {flown['games']}"

    def score(self, report: Report) -> Flown:
        """Return a row for each flight of a policy, the one in real time with its own command, flight 0, first.

        It has the conditions of the training, `with` and `at`, command and ClockSpeed of the flight, `success`, a
        Proportion, `won`, the outcome by lane, and `distance_m`; and, unless `exact`, the numbers of the training, its
        seconds by phase, `simulation_s`, which as in the paper has rendering, and `wall_s`.
        """
        flights = []
        for game in report.games.to_dict("records"):
            arrays, trained, evaluations = report.arrays(game), game.get("training"), game["evaluations"]
            shared = {key: game[key] for key in (*KEY, "seed")} | {"exact": trained is None}
            learned = {} if trained is None else {**trained, **trained["phase_s"]}
            shared |= {f"trained_{name}": learned.get(name) for name in ("games", "successes")}
            shared |= {name: learned.get(name) for name in ("commands", "sim_time_s", "weights_sha256", *PHASES)}
            for number, flown in enumerate(evaluations):
                flight = flight_name(flown["command"], flown["clock_speed"], evaluations[0]["clock_speed"])
                lane, won, distance_m = (
                    arrays[f"{OF_EXACT if trained is None else flight}_{name}"] for name in OUTCOMES
                )
                own = {"flight": number, "with": flown["command"], "at": flown["clock_speed"]}
                own |= {"success": Proportion.of(flown), "ratio": flown["successes"] / flown["games"]}
                flights.append(shared | own | {"won": pd.Series(won, lane), "distance_m": distance_m})
        table = table_of(flights)
        simulation_s, wall_s = (table[list(phases)].sum(axis=1) for phases in (PHASES[:2], PHASES))
        return table.assign(simulation_s=simulation_s, wall_s=wall_s)

    def summary(self, report: Report) -> Summary:
        """Summarise each training, the seeds of each condition pooled, and the comparisons between conditions."""
        config, flights = report.config, report.scores
        trained, real_time = where(flights, exact=False), config.evaluation_clock_speed
        own = where(trained, flight=0)
        groups = [group for _, group in trained.groupby(KEY, sort=False)]
        faster = [group for group in groups if group.clock_speed.iloc[0] != real_time]
        exact = [group for _, group in where(flights, exact=True).groupby(KEY, sort=False)]
        return {
            "suite": "rl",
            "seed": config.seed,
            "training_games": config.games,
            "evaluation_clock_speed": real_time,
            "cells": [
                {
                    **{key: training[key] for key in (*KEY, "seed", *LEARNED)},
                    **training.success.as_summary(),
                    "distance_m_median": float(np.median(training.distance_m)),
                    **_times(own.loc[[number]], own),
                }
                for number, training in own.iterrows()
            ],
            "pooled": [summary_of_seeds(where(group, flight=0), own) for group in groups],
            "interchange": [test for group in groups for test in interchange(group, real_time)],
            "interchange_as_trained": [
                test for group in faster for test in interchange(group, group.clock_speed.iloc[0])
            ],
            "as_trained": [test for group in faster for test in as_trained(group, trained)],
            "exact": [side_by_side(where(own, **key_of(group)), group) for group in exact],
            "same_weights": list(same_weights(own)),
        }

    def title(self, report: Report) -> str:
        return "Policies by the command and ClockSpeed of their training"

    def headline(self, report: Report) -> str:
        """Return the success after the slowest and the fastest training of each kind, and how many there were.

        Where all trainings are variants it is the gap from which on success collapses.
        """
        cells, trained, pooled = (report.summary[key] for key in ("cells", "training_games", "pooled"))
        plain: dict[str, list[str]] = {}
        for cell in sorted(pooled, key=lambda cell: cell["clock_speed"]):
            if not cell["variant"]:
                success = f"{cell['success_ratio']:.1%} after training at {clock_label(cell['clock_speed'])}"
                plain.setdefault(panel_name(cell), []).append(success)
        said = [f"{name}: {', '.join(dict.fromkeys((found[0], found[-1])))}" for name, found in plain.items()]
        if not said and (lines := over_gaps(pooled)):
            said = [collapse(lines).rstrip(".")]
        lanes = f"{listed(sorted({cell['games'] for cell in cells}))} lanes"
        clock = clock_label(report.summary["evaluation_clock_speed"])
        said.append(f"{len(cells)} trainings of {trained} games, each policy flown on {lanes} at {clock}")
        return "; ".join([*said, "all times are modelled but those of this machine"])

    def overview(self, report: Report) -> Table:
        return Table.of(map(named, report.summary["pooled"]), OVERVIEW)

    def page(self, report: Report) -> Iterator[PageBlock | str]:
        summary, cells = report.summary, rl_figures.pooled_cells(report)
        pooled = [named(cell) for cell in summary["pooled"]]
        yield Heading("Table I: success by training")
        yield Table.of(pooled, SUCCESS)
        yield WHAT_N_TELLS
        yield rl_figures.success_figure(report, cells)
        yield rl_figures.distances_figure(report, cells)
        if lines := over_gaps(summary["pooled"]):
            yield Heading("Success in real time over the gap of the training")
            yield collapse(lines)
            yield rl_figures.gaps_figure(report, lines)
            yield Table.of([named(cell) for line in lines.values() for cell in line.to_dict("records")], GAPS)
            yield WHAT_A_GAP_IS
        if interchanged := [*summary["interchange"], *summary["interchange_as_trained"]]:
            yield Heading("Commands interchanged")
            flown = [
                {**test, **flight, "with": flight["command"], "command": test["command"], "alone": test[alone]}
                for test in interchanged
                for flight, alone in zip(test["flown_with"], ("only_first", "only_second"), strict=True)
            ]
            yield Table.of(map(named, flown), INTERCHANGED)
        if tests := summary["as_trained"]:
            yield Heading("Flown at the ClockSpeed of the training")
            yield Table.of(map(named, tests), AS_TRAINED)
        if exact := summary["exact"]:
            yield Heading("The same policies in the exact simulator")
            lanes, same = (sum(policy[name] for policy in exact) for name in ("lanes", "same_end"))
            yield f"Of {lanes} flights of a policy over a lane in real time {same} end alike in both, won or lost."
            yield Table.of(map(named, exact), EXACT_TOO)
        yield Heading("Time of the training")
        times = training_hours(report, pooled)
        yield Table.of(times, TIMES)
        yield time_saved(times)
        yield HOW_TIME_IS_MODELLED
        if (cells.timing == "virtual").any():
            yield rl_figures.time_figure(report, cells)
        yield Heading("Each training")
        for family in summary["same_weights"]:
            clocks = listed(clock_label(clock) for clock in family["clock_speed"])
            seeds, equal = len(family["seeds"]), len(family["equal"])
            others = "one training each" if equal == seeds else f"{seeds - equal} learned others"
            yield f"{panel_name(family)}: of {seeds} seeds {equal} learned the same weights at {clocks}: {others}."
        yield Table.of(map(named, summary["cells"]), TRAININGS, folded=f"{len(summary['cells'])} trainings")

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        """Write one report of the cells of several runs, in the folder `together` of the first."""
        report = Together([self.report(run) for run in runs])
        report.write()
        return [report.run.path / "report.html"]


class Together(Report):
    """The report of several runs as if one had flown the cells of all; it has a folder, but no rows, of its own."""

    def __init__(self, reports: Sequence[Report]) -> None:
        """Raises UserError where two runs hold the same cell, or were not trained and evaluated alike."""
        first, configs = reports[0], [report.config for report in reports]
        self._of: dict[str, Report] = {}
        alike = {key: value for key, value in dict(first.config).items() if key not in MAY_DIFFER}
        for report in reports:
            for key, value in alike.items():
                if getattr(report.config, key) != value:
                    other = f"{report.run.path}: {key} differs from that of {first.run.path}"
                    raise UserError(f"{other}: they make no one table")
            for case in report.games["case"]:
                if case in self._of:
                    raise UserError(f"{report.run.path}: has {case}, which {self._of[case].run.path} has too")
                self._of[case] = report
        blocks = [block for config in configs for block in config.cells]
        alike["cells"] = [block for number, block in enumerate(blocks) if block not in blocks[:number]]
        seed, end = min(config.seed for config in configs), max(config.seed + config.seeds for config in configs)
        self.suite, self.config = first.suite, RlConfig(**alike, seed=seed, seeds=end - seed)
        self.games = pd.concat([report.games for report in reports], ignore_index=True)
        self.timings = [entry for report in reports for entry in report.timings]
        shutil.rmtree(place := first.run.path / TOGETHER, ignore_errors=True)
        made_of = {str(report.run.path): report.run.manifest() for report in reports}
        self.run = RunDirectory.create(place, self.config, {**first.run.manifest(), "runs": made_of})

    def arrays(self, game: Mapping[str, Any] | pd.Series) -> dict[str, np.ndarray]:
        return self._of[game["case"]].arrays(game)


def other_command(command: str) -> CommandName:
    return "adsc" if command == "tcsc" else "tcsc"


def flight_name(command: str, clock_speed: float, real_time: float) -> str:
    """Return the name of an evaluation: the suffix of its folder, and the prefix of its arrays' names."""
    return command if clock_speed == real_time else f"{command}-{clock_speed:g}x"


def parts_of(config: RlConfig, case: TrainingCase, agent: str = DEFAULT) -> dict[str, tuple[Part, int]]:
    """Return the training of a case, and the evaluations of the policy `agent`, by folder, each with its seed.

    Evaluations are in real time with the cell's own command, then the other, then both as trained, on the clock of the
    training and with the policy's own observation.
    """
    block, real_time = case.block, config.evaluation_clock_speed
    flown_in = {"task.timing": block.timing, "task.profile": block.profile}
    task = {f"task.{key}": value for key, value in block.task.items()}
    keys = {f"task.{key}": value for key, value in block.task.items() if key.split(".")[0] not in SENSES + FLIGHT}
    keys |= {key: value for key, value in block.training.items() if key in OF_DECISIONS} | {"agent": agent}

    def part(base: Part, command: str, clock_speed: float, keys: Mapping[str, Any]) -> Part:
        clock = {"task.command": command, "task.clock_speed": clock_speed, **flown_in}
        return Part(experiment=base.experiment, keys={**base.keys, **clock, **keys})

    if case.exact:
        return {f"evaluation-{OF_EXACT}": (part(config.exact, case.command, real_time, keys), EVALUATION_SEED)}
    learned = {"games": config.games, **task, **block.training}
    parts = {"training": (part(config.training, case.command, case.clock_speed, learned), case.seed)}
    clocks = dict.fromkeys([real_time, case.clock_speed] if config.as_trained else [real_time])
    commands = [case.command, other_command(case.command)] if config.interchange else [case.command]
    for clock_speed, command in product(clocks, commands):
        name = f"evaluation-{flight_name(command, clock_speed, real_time)}"
        parts[name] = part(config.evaluation, command, clock_speed, keys), EVALUATION_SEED
    return parts


def _configured(config: RlConfig, case: TrainingCase) -> list[tuple[AnySuite, Any]]:
    """Return suites and configurations of a case's training and evaluations. Raises UserError for invalid ones."""
    return [part_suite(part, seed) for part, seed in parts_of(config, case).values()]


def where(flights: Flown, **wanted: Any) -> Flown:
    """Return the flights that have these values in these columns."""
    return flights[np.logical_and.reduce([flights[name] == value for name, value in wanted.items()])]


def key_of(group: Flown) -> dict[str, Any]:
    """Return the conditions that a group of flights has in common."""
    return {key: group[key].iloc[0] for key in KEY}


def summary_of_seeds(group: Flown, own: Flown) -> dict[str, Any]:
    """Summarise all seeds of one training, compared with the same command at 1x and with the paper."""
    conditions = [key_of(group)[key] for key in ("profile", "variant", "command", "clock_speed")]
    simulation, whole = paper_results.speedups(*conditions)
    slow = _at_1x(group, own, conditions[2])
    return {
        **_identity(group),
        "successes_by_seed": [success.successes for success in group.success],
        **_success(group),
        "trained_games": group.trained_games.sum(),
        "paper_successes": paper_results.successes(*conditions),
        **_compare(group, slow[slow.clock_speed != conditions[3]]),
        **_times(group, own),
        "gap_s": gap_s(group),
        "paper_training_speedup": simulation,
        "paper_whole_training_speedup": whole,
    }


def _at_1x(group: Flown, own: Flown, command: str) -> Flown:
    """Return the trainings with that command at 1x; none in lockstep, or where they were not run."""
    slow = where(own, **(key_of(group) | {"command": command, "clock_speed": 1.0}))
    return where(slow, timing="virtual")


def _identity(flown: Flown) -> dict[str, Any]:
    """Return the conditions of a group of trainings, and its seeds."""
    return {**key_of(flown), "seeds": flown.seed.tolist()}


def _success(flown: Flown) -> dict[str, Any]:
    """Return the success of all seeds together in one of their flights, with two 95 % intervals.

    `wilson_low` and `wilson_high` are of the games of these very policies; `seeds_low` and `seeds_high` also cover what
    trainings with other seeds would have given (`success_estimate`).
    """
    success = flown.success.tolist()
    over_seeds = success_estimate(success)
    return {**Proportion.pooled(success).as_summary(), "seeds_low": over_seeds.low, "seeds_high": over_seeds.high}


def _paired(some: Flown, others: Flown) -> tuple[np.ndarray, np.ndarray]:
    """Return the outcomes (n,) of two groups of flights, paired by seed and lane."""
    outcomes = [pd.concat(dict(zip(flown.seed, flown.won, strict=True))) for flown in (some, others)]
    first, second = pd.concat(outcomes, axis=1, join="inner").to_numpy(bool).T
    return first, second


def _compare(some: Flown, others: Flown) -> dict[str, float | None]:
    """Return p-values of the difference between two groups of flights; None without a second group.

    `permutation_p` takes trainings as its samples; Fisher's test of the pooled games and McNemar's of equal seeds and
    lanes compare these very policies alone.
    """
    if others.empty:
        return dict.fromkeys(("permutation_p", "fisher_p", "mcnemar_p"))
    first, second = _paired(some, others)
    pooled = [Proportion.pooled(flown.success.tolist()) for flown in (some, others)]
    return {
        "permutation_p": permutation_p(some.ratio, others.ratio),
        "fisher_p": fisher_exact_p(*((success.successes, success.games) for success in pooled)),
        "mcnemar_p": mcnemar_exact(first, second).p_value if len(first) else None,
    }


def _times(cell: Flown, own: Flown) -> dict[str, Any]:
    """Return the modelled seconds of the trainings of a cell, those of as many commands of ADSC at 1x, and speed-ups.

    Speed-ups are of a command's mean time, as trainings that learn differently fly games of different length, over that
    of ADSC at 1x, as in the paper.
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


def gap_s(own: Flown) -> float:
    """Return the mean gap (WHAT_A_GAP_IS) in the trainings of a cell, at the speed that the profile's platform reaches.

    A few calls of a millisecond that ADSC makes in its pauses are counted too, and a command that a collision ends
    early counts as a whole one.
    """
    first = own.iloc[0]
    if first.command == "tcsc":
        return 0.0
    from uavaccel.envs.flyable import speed_of
    from uavaccel.envs.obstacle_lane import LaneTask

    task = LaneTask(timing=first.timing, profile=first.profile, clock_speed=first.clock_speed)
    running_s = own.wall_s.sum() - own.rendering.sum()
    return max(float((running_s * speed_of(task) - own.sim_time_s.sum()) / own.commands.sum()), 0.0)


def interchange(group: Flown, clock_speed: float) -> Iterator[dict[str, Any]]:
    """Yield the comparison of the flights with either command at a ClockSpeed, if there are any."""
    commands = group.command.iloc[0], other_command(group.command.iloc[0])
    own, other = (where(group, **{"with": command, "at": clock_speed}) for command in commands)
    if len(own) and len(other):
        test = mcnemar_exact(*_paired(own, other))
        yield {
            **_identity(own),
            "flown_at": clock_speed,
            "flown_with": [{"command": flown["with"].iloc[0], **_success(flown)} for flown in (own, other)],
            "only_first": test.only_first,
            "only_second": test.only_second,
            "mcnemar_p": test.p_value,
            "sign_flip_p": sign_flip_p(own.ratio.to_numpy() - other.ratio.to_numpy()),
        }


def as_trained(group: Flown, trained: Flown) -> Iterator[dict[str, Any]]:
    """Yield the comparison of flights at the training's ClockSpeed with those of trainings without the variant.

    There is none where policies were flown in real time alone.
    """
    key = key_of(group)
    plain = where(trained, **(key | {"variant": ""})) if key["variant"] else group[:0]
    own = {"with": key["command"], "at": key["clock_speed"]}
    slow, fast, plain_slow, plain_fast = (where(each, **at) for each in (group, plain) for at in ({"flight": 0}, own))
    plain_slow = plain_slow[plain_slow.seed.isin(plain_fast.seed)]
    if len(fast):
        yield {
            **_identity(slow),
            "real_time": _success(slow) | _compare(slow, plain_slow),
            "as_trained": _success(fast) | _compare(fast, plain_fast),
            "sign_flip_p": sign_flip_p(slow.ratio.to_numpy() - fast.ratio.to_numpy()),
        }


def side_by_side(kernels: Flown, exact: Flown) -> dict[str, Any]:
    """Compare the same policies on the same lanes in real time in the kernels and in the exact simulator."""
    kernels = kernels[kernels.seed.isin(exact.seed)]
    first, second = _paired(kernels, exact)
    return {
        **_identity(exact),
        "kernels": _success(kernels),
        "exact": _success(exact),
        "lanes": len(first),
        "same_end": int((first == second).sum()),
        "mcnemar_p": mcnemar_exact(first, second).p_value,
    }


def same_weights(own: Flown) -> Iterator[dict[str, Any]]:
    """Yield how many seeds learned the same weights at all ClockSpeeds that a command was trained at, if several."""
    for conditions, family in own.groupby(KEY[:-1], sort=False):
        clocks, seeds = sorted(family.clock_speed.unique().tolist()), family.groupby("seed").weights_sha256
        whole = seeds.nunique()[seeds.size() == len(clocks)]
        if len(clocks) > 1:
            learned = {"seeds": whole.index.tolist(), "equal": whole.index[whole == 1].tolist()}
            yield {**dict(zip(KEY, conditions, strict=False)), "clock_speed": clocks, **learned}


def named(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return an entry of the summary for tables, with its `panel`, and its success, nested ones too, in words.

    `of_games` has Wilson's interval, as in "23 of 100: 23.0% [15.8, 32.2]", `over_seeds` that over seeds and games.
    """
    words = {"panel": panel_name(entry)} if "variant" in entry else {}
    if "wilson_low" in entry:
        text = Proportion.of(entry).text(interval_digits=1)
        words["of_games"] = f"{entry['successes']} of {entry['games']}: {text}"
    if "seeds_low" in entry:
        low, high = 100 * entry["seeds_low"], 100 * entry["seeds_high"]
        words["over_seeds"] = f"{entry['success_ratio']:.1%} [{low:.1f}, {high:.1f}]"
    return {key: named(value) if isinstance(value, dict) else value for key, value in entry.items()} | words


def training_hours(report: Report, pooled: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Return the cells with the modelled hours of their trainings, and the minutes that this machine took for them."""
    took_s = {entry["case"]: entry["training_s"] for entry in report.timings if "training_s" in entry}
    games = report.games.assign(minutes=report.games["case"].map(took_s).astype(float) / 60)
    minutes = games.groupby(KEY).minutes.sum(min_count=1).rename("minutes")
    cells = pd.DataFrame(pooled).join(minutes, on=KEY)
    return cells.assign(h=cells.training_wall_s / 3600, real_h=cells.real_time_s.astype(float) / 3600)


def time_saved(cells: pd.DataFrame) -> str:
    """Compare the modelled real time of the trainings with the time that they took on this machine."""
    both = cells.dropna(subset=["real_h", "minutes"])
    if both.empty:
        return "No training of ADSC at 1x to say what the others would have taken in real time."
    hours, took_h, games = both.real_h.sum(), both.minutes.sum() / 60, both.trained_games.sum()
    return (
        f"These trainings' {games} games would have taken {hours:.3g} hours in real time (modelled, "
        f"{3600 * hours / games:.0f} s per game; the paper's 5 000 games took 182 hours, 131 s per game). This machine "
        f"took {took_h:.2g} hours of training, measured, one after another: {hours / took_h:.0f} times less."
    )


CELL: dict[str, Column] = {"trained with": "{panel}", "ClockSpeed": "{clock_speed:g}x"}
TRAINED = {**CELL, "seeds": "{seeds!l}"}
OVERVIEW = {
    **TRAINED,
    "success [95 %]": "{over_seeds}",
    "the paper's": "{paper_successes} %",
    "training speed-up": "{training_speedup:.3g}x",
}
SUCCESS = {
    **TRAINED,
    "games won": "{successes} of {games}",
    "success [95 % over seeds and games]": "{over_seeds}",
    "won by each seed": "{successes_by_seed!l}",
    "the paper's, of 100": "{paper_successes}",
    "p against 1x, over seeds": "{permutation_p:.2g}",
    "of these policies: McNemar": "{mcnemar_p:.2g}",
}
GAPS = {**CELL, "gap, simulated s": "{gap_s:.3f}", "success in real time [95 % over seeds and games]": "{over_seeds}"}
INTERCHANGED = {
    "trained with": "{panel} {clock_speed:g}x",
    "seeds": "{seeds!l}",
    "flown with": "{with!u} {flown_at:g}x",
    "success [95 % over seeds and games]": "{over_seeds}",
    "won with it alone": "{alone}",
    "p over seeds": "{sign_flip_p:.2g}",
    "of these policies: McNemar": "{mcnemar_p:.2g}",
}
AS_TRAINED = {
    **TRAINED,
    "success in real time [95 %]": "{real_time[over_seeds]}",
    "p against the plain one, over seeds": "{real_time[permutation_p]:.2g}",
    "success at the ClockSpeed of the training [95 %]": "{as_trained[over_seeds]}",
    "p against the plain one there": "{as_trained[permutation_p]:.2g}",
    "p of the two, over seeds": "{sign_flip_p:.2g}",
}
EXACT_TOO = {
    **TRAINED,
    "the kernels": "{kernels[of_games]}",
    "the exact simulator": "{exact[of_games]}",
    "end alike": "{same_end} of {lanes}",
    "McNemar p": "{mcnemar_p:.2g}",
}
TIMES = {
    **CELL,
    "trainings": lambda cell: len(cell["seeds"]),
    "modelled hours": "{h:.3g}",
    "as ADSC at 1x, hours": "{real_h:.3g}",
    "speed-up of simulation": "{training_speedup:.3g}x",
    "the paper's": "{paper_training_speedup:g}x",
    "of the whole training": "{whole_training_speedup:.3g}x",
    "the paper's, whole": "{paper_whole_training_speedup:g}x",
    "this machine, minutes": "{minutes:.3g}",
}
TRAININGS = {
    **CELL,
    "seed": "{seed}",
    "training games won": "{trained_successes} of {trained_games}",
    "success [95 % Wilson]": "{of_games}",
    "weights (SHA-256)": "{weights_sha256}",
}
WHAT_N_TELLS = (
    f"The paper evaluated one training of each kind in {paper_results.GAMES} games. Of its differences only the "
    "collapse of ADSC (23 to 1) is significant by Fisher's exact test; 21 against 30, and 21 against 13, have p = "
    "0.19. Here a training, not a game, is one sample: an interval covers both Wilson's interval over all games and "
    "Student's over the trainings, so that it has a width at 0 and 100 % too, and differences are tested by permuting "
    "the trainings. The interval of a single seed is Wilson's, of its games alone. McNemar's test compares these very "
    "policies on the same lanes and says nothing about other seeds."
)
WHAT_A_GAP_IS = (
    "The gap is the mean simulated time between the end of a command and the next one in the training, worked out from "
    "the modelled wall time of its commands without that of images, which ADSC takes in a pause. With TCSC the clock "
    "is paused while an agent decides: its gap is 0 at every ClockSpeed."
)
HOW_TIME_IS_MODELLED = (
    "Hours are of the simulated wall clock, summed over the lanes flown side by side, each charged as if alone; "
    "simulation holds rendering, as in the paper. Speed-ups are of a command's mean time with ADSC at 1x, the paper's "
    "baseline, over that of the cell: of simulation alone, and with image processing, inference and learning, whose "
    "costs are keys of the configuration and no measurements of the paper's machine."
)
