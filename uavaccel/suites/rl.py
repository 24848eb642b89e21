"""The paper's RL experiment: policies trained under a command and a ClockSpeed, flown in real time (section IV-D).

Each case trains a policy and evaluates it, in runs of other suites below parts/, resumed where they stopped.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
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
from uavaccel.suites.suite import AnySuite, GameResult, Suite
from uavaccel.suites.train import CHECKPOINTS

SimulatedTiming = Literal["virtual", "lockstep"]
Flown: TypeAlias = pd.DataFrame
"""Flights of policies, a row each, as `Rl.score` returns them."""

OF_DECISIONS = ("inference_s",)  # keys of a training that also apply to its evaluations
EVALUATION_SEED = 0  # the same lanes and latencies for every policy
OF_EXACT = "exact"  # name of an evaluation in the exact simulator
WITHOUT_IMAGES = tuple(phase for phase in PHASES if phase != "rendering")  # ADSC takes its images in a pause
SIMULATION = ("simulation", "rendering")  # the paper's "simulation" renders the images
TOGETHER = "together"  # the folder of the report of several runs, in the first one's
MAY_DIFFER = {"cells", "command", "clock_speed", "profile", "timing", "seed", "seeds"}  # between these


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
    def _has_what_it_selects(self) -> RlConfig:
        for name in ("command", "clock_speed"):
            known = {value for block in self.cells for value in getattr(block, name)}
            for value in getattr(self, name):
                if value not in known:
                    raise ValueError(f"{name} = {value} is in no cell; there are {listed(sorted(known))}")
        if not any(self.selected(block) for block in self.cells):
            raise ValueError("command, clock_speed, profile and timing together select no cell")
        return self

    @model_validator(mode="after")
    def _names_each_cell_once(self) -> RlConfig:
        names: set[tuple[object, ...]] = set()
        for block in self.cells:
            for clock_speed, command in product(block.clock_speed, block.command):
                name = f"{block.profile} {block.timing} {command} at {clock_speed:g}x"
                if (block.variant, name) in names:
                    raise ValueError(f"cells has {name} twice; give one a `variant`")
                names.add((block.variant, name))
        return self

    def selected(self, block: Block) -> list[tuple[float, CommandName]]:
        """Return ClockSpeed and command of each cell of a block that a run selects."""
        if block.profile != (self.profile or block.profile) or block.timing != (self.timing or block.timing):
            return []
        cells = product(block.clock_speed, block.command)
        return [
            (clock_speed, command)
            for clock_speed, command in cells
            if clock_speed in (self.clock_speed or (clock_speed,)) and command in (self.command or (command,))
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


ARRAYS = {f"*_{name}": ArrayForm(form.kinds, ("n",)) for name, form in OUTCOMES.items()}
"""The outcomes of each evaluation's lanes, under the name of the flight."""


@dataclass(frozen=True)
class TrainingCase:
    """One training of a command at a ClockSpeed with a seed, and the evaluations of its policy."""

    block: Block = field(compare=False)
    clock_speed: float
    command: CommandName
    seed: int
    exact: bool = False
    """Whether this is no training, but the evaluation of its policy in the exact simulator."""
    games: int = field(default=0, compare=False)
    typical_s: float = field(default=0.0, compare=False)
    timing: str = "virtual"  # all cells run side by side, whichever simulated clock they have

    @property
    def trained(self) -> str:
        names = [self.block.variant, self.block.profile, self.block.timing, self.command, f"{self.clock_speed:g}x"]
        return "-".join([name for name in names if name] + [f"seed{self.seed}"])

    @property
    def id(self) -> str:
        return f"{self.trained}-{OF_EXACT}" if self.exact else self.trained

    def simulated_s(self) -> float:
        return self.typical_s


class Rl(Suite[RlConfig, TrainingCase]):
    """`uavaccel run rl`."""

    name = "rl"
    config = RlConfig
    row = RlRow
    arrays = ARRAYS
    batch: ClassVar[int] = 1

    def check(self, config: RlConfig) -> None:
        """Check that training and evaluations of each cell can be configured. Raises UserError."""
        last = {cell.exact: cell for cell in self.cases(config.model_copy(update={"seeds": 1}))}
        if config.exact_seeds:
            _refuse_other_lanes(*(_configured(config, last[exact])[-1][1] for exact in (False, True)))

    def cases(self, config: RlConfig) -> Iterator[TrainingCase]:
        """Yield the cases seed by seed, so that an interrupted run has complete tables of fewer seeds.

        Those of a seed are in the order of the blocks, slow clocks first. The evaluations in the exact simulator
        follow, in the same order.
        """
        sizes: dict[str, TrainingCase] = {}  # trainings that differ in their seed alone are of one size
        for exact, seeds in ((False, config.seeds), (True, min(config.exact_seeds, config.seeds))):
            for seed, block in product(range(config.seed, config.seed + seeds), config.cells):
                for clock_speed, command in config.selected(block):
                    cell = TrainingCase(block, clock_speed, command, seed, exact)
                    if (kind := replace(cell, seed=0).id) not in sizes:
                        parts = _configured(config, cell)
                        games_s = [case.simulated_s() for suite, part in parts for case in suite.cases(part)]
                        sizes[kind] = replace(cell, games=len(games_s), typical_s=sum(games_s))
                    yield replace(sizes[kind], seed=seed)

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
        cells = self.cases(config.model_copy(update={"seeds": 1, "exact_seeds": 0}))
        trainings = [_configured(config, cell)[0] for cell in cells]
        return any(suite.renders(training) for suite, training in trainings)

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
            summary, took = timed(partial(fly_part, opened, place, part, seed, pages=False))
            if name == "training":
                # gigabytes that are of no use once the training is over
                shutil.rmtree(folder / CHECKPOINTS, ignore_errors=True)
                row["training"] = {key: summary[key] for key in TrainingResult.__annotations__}
                host["training_s"] = (cumulative_wall_s(part_run(opened, place).timings()) or [0.0])[-1]
            else:
                row["evaluations"].append({key: summary[key] for key in EvaluationResult.__annotations__})
                flown, flight = outcomes(part_run(opened, place)), name.removeprefix("evaluation-")
                arrays |= {f"{flight}_{key}": each for key, each in flown.items()}
                host["evaluations_s"] += took["host_wall_s"]
        return GameResult(row, arrays, host)

    def status(self, rows: Sequence[Row]) -> str:
        flown = rows[-1]["evaluations"][0]
        return f"{rows[-1]['case']} won {flown['successes']} of {flown['games']}"

    def score(self, report: Report) -> Flown:
        """Return a row for each flight of a policy, the one in real time with its own command, flight 0, first.

        It has the conditions of the training, `with` and `at`, command and ClockSpeed of the flight, `won`, the outcome
        by lane, and `distance_m`; and, unless `exact`, the numbers of the training, its seconds by phase.
        """
        flights = []
        for game in report.games.to_dict("records"):
            arrays, trained = report.arrays(game), game.get("training")
            learned = {} if trained is None else {**trained, **trained["phase_s"]}
            shared = {key: game[key] for key in (*KEY, "seed", "case")} | {"exact": trained is None}
            shared |= {name: learned.get(name) for name in ("commands", "sim_time_s", "weights_sha256", *PHASES)}
            shared |= {f"trained_{name}": learned.get(name) for name in ("games", "successes")}
            for number, each in enumerate(game["evaluations"]):
                clocks = each["clock_speed"], game["evaluations"][0]["clock_speed"]
                name = OF_EXACT if trained is None else flight_name(each["command"], *clocks)
                flown = {"flight": number, "with": each["command"], "at": each["clock_speed"]}
                flown |= {key: each[key] for key in ("successes", "games")}
                won = pd.Series(arrays[f"{name}_is_success"], arrays[f"{name}_lane"])
                flights.append(shared | flown | {"won": won, "distance_m": arrays[f"{name}_distance_m"]})
        return table_of(flights)

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
            "cells": [summary_of_training(own.loc[[number]], own) for number in own.index],
            "pooled": [summary_of_seeds(where(group, flight=0), own) for group in groups],
            "interchange": [test for group in groups for test in interchange(group, real_time)],
            "interchange_as_trained": [
                test for group in faster for test in interchange(group, group.clock_speed.iloc[0])
            ],
            "as_trained": [test for group in faster for test in as_trained(group, trained)],
            "exact": [side_by_side(where(own, **key_of(group)), group) for group in exact],
            "same_weights": same_weights(own),
        }

    def title(self, report: Report) -> str:
        return "Policies by the command and ClockSpeed of their training"

    def headline(self, report: Report) -> str:
        """Return the success after the slowest and the fastest training of each kind, and how many there were.

        Where all trainings are variants it is the gap from which on success collapses.
        """
        cells, trained, pooled = (report.summary[key] for key in ("cells", "training_games", "pooled"))
        lines = over_gaps(pooled)
        said = _slowest_and_fastest(pooled) or ([collapse(lines).rstrip(".")] if lines else [])
        lanes = f"{listed(sorted({cell['games'] for cell in cells}))} lanes"
        clock = clock_label(report.summary["evaluation_clock_speed"])
        said.append(f"{len(cells)} trainings of {trained} games, each policy flown on {lanes} at {clock}")
        return "; ".join([*said, "all times are modelled but those of this machine"])

    def overview(self, report: Report) -> Table:
        columns = {
            **TRAINED,
            "success [95 %]": "{over_seeds}",
            "the paper's": "{paper_successes} %",
            "training speed-up": "{training_speedup:.3g}x",
        }
        return Table.of(map(named, report.summary["pooled"]), columns)

    def page(self, report: Report) -> Iterator[PageBlock | str]:
        summary = report.summary
        pooled = [named(cell) for cell in summary["pooled"]]
        yield Heading("Table I: success by training")
        yield Table.of(pooled, SUCCESS)
        yield WHAT_N_TELLS
        yield rl_figures.success_figure(report)
        yield rl_figures.distances_figure(report)
        if lines := over_gaps(summary["pooled"]):
            yield Heading("Success in real time over the gap of the training")
            yield collapse(lines)
            yield rl_figures.gaps_figure(report, lines)
            yield Table.of([named(cell) for cells in lines.values() for cell in cells], GAPS)
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
            lanes, same = (sum(each[name] for each in exact) for name in ("lanes", "same_end"))
            yield f"Of {lanes} flights of a policy over a lane in real time {same} end alike in both, won or lost."
            yield Table.of(map(named, exact), EXACT_TOO)
        yield Heading("Time of the training")
        took_m = _machine_minutes(report)
        hours = [
            cell
            | {"h": cell["training_wall_s"] / 3600, "minutes": took_m.get(tuple(cell[key] for key in KEY))}
            | {"real_h": cell["real_time_s"] and cell["real_time_s"] / 3600}
            for cell in pooled
        ]
        yield Table.of(hours, TIMES)
        yield _time_saved(hours)
        yield HOW_TIME_IS_MODELLED
        if any(cell["timing"] == "virtual" for cell in pooled):
            yield rl_figures.time_figure(report)
        yield Heading("Each training")
        yield from map(_same_weights_in_words, summary["same_weights"])
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
        first, self._of = reports[0], dict[str, Report]()
        for report in reports:
            for key in type(first.config).model_fields.keys() - MAY_DIFFER:
                if getattr(report.config, key) != getattr(first.config, key):
                    other = f"{report.run.path}: {key} differs from that of {first.run.path}"
                    raise UserError(f"{other}: they make no one table")
            for case in report.games["case"]:
                if case in self._of:
                    raise UserError(f"{report.run.path}: has {case}, which {self._of[case].run.path} has too")
                self._of[case] = report
        configs = [report.config for report in reports]
        blocks = [block for config in configs for block in config.cells]
        first_seed, last = min(each.seed for each in configs), max(each.seed + each.seeds for each in configs)
        whole = {key: value for key, value in dict(first.config).items() if key not in MAY_DIFFER}
        whole["cells"] = [block for number, block in enumerate(blocks) if block not in blocks[:number]]
        self.suite, self.config = first.suite, RlConfig(**whole, seed=first_seed, seeds=last - first_seed)
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


def parts_of(config: RlConfig, cell: TrainingCase, agent: str = DEFAULT) -> dict[str, tuple[Part, int]]:
    """Return the training of a cell, and the evaluations of the policy `agent`, by folder, each with its seed.

    Evaluations are in real time with the cell's own command, then the other, then both as trained, on the clock of the
    training and with the policy's own observation.
    """
    block, real_time = cell.block, config.evaluation_clock_speed
    task = {f"task.{key}": value for key, value in block.task.items()}
    flown_in = {"task.timing": block.timing, "task.profile": block.profile}

    def part(base: Part, command: str, clock_speed: float, keys: Mapping[str, Any]) -> Part:
        clock = {"task.command": command, "task.clock_speed": clock_speed, **flown_in}
        return Part(experiment=base.experiment, keys={**base.keys, **clock, **keys})

    keys = {key: value for key, value in task.items() if key.split(".")[1] not in SENSES + FLIGHT}
    keys |= {key: value for key, value in block.training.items() if key in OF_DECISIONS} | {"agent": agent}
    if cell.exact:
        return {f"evaluation-{OF_EXACT}": (part(config.exact, cell.command, real_time, keys), EVALUATION_SEED)}
    learned = {"games": config.games, **task, **block.training}
    parts = {"training": (part(config.training, cell.command, cell.clock_speed, learned), cell.seed)}
    for clock_speed in dict.fromkeys([real_time, cell.clock_speed] if config.as_trained else [real_time]):
        for command in [cell.command, other_command(cell.command)] if config.interchange else [cell.command]:
            name = f"evaluation-{flight_name(command, clock_speed, real_time)}"
            parts[name] = part(config.evaluation, command, clock_speed, keys), EVALUATION_SEED
    return parts


def _configured(config: RlConfig, cell: TrainingCase) -> list[tuple[AnySuite, Any]]:
    """Return suites and configurations of the cell's training and evaluations. Raises UserError for invalid ones."""
    return [part_suite(part, seed) for part, seed in parts_of(config, cell).values()]


def _refuse_other_lanes(evaluation: Any, exact: Any) -> None:
    """Raise UserError unless both simulators evaluate on the same lanes."""
    if exact.simulator != EXACT or evaluation.simulator == EXACT:
        raise UserError(
            f"exact_seeds: needs exact.keys.simulator = {EXACT}, not {exact.simulator}, beside an evaluation by the "
            f"kernels, not by {evaluation.simulator}; or exact_seeds = 0"
        )
    if (exact.first_lane, exact.games) != (evaluation.first_lane, evaluation.games):
        raise UserError("exact.keys: games and first_lane must be those of evaluation.keys, lane for lane")


def where(flights: Flown, **wanted: Any) -> Flown:
    """Return the flights that have these values in these columns."""
    return flights[np.logical_and.reduce([flights[name] == value for name, value in wanted.items()])]


def key_of(group: Flown) -> dict[str, Any]:
    """Return the conditions that a group of flights has in common."""
    return {key: group[key].iloc[0] for key in KEY}


def _at_1x(group: Flown, own: Flown, command: str) -> Flown:
    """Return the trainings with that command at 1x; none in lockstep, or where they were not run.

    With ADSC they are the baseline of speed-ups, as in the paper.
    """
    slow = where(own, **(key_of(group) | {"command": command, "clock_speed": 1.0}))
    return where(slow, timing="virtual")


def summary_of_training(one: Flown, own: Flown) -> dict[str, Any]:
    """Summarise the single training of a table; `own` has those to compare with."""
    row = one.iloc[0]
    return {
        **{key: row[key] for key in (*KEY, "seed", "trained_games", "trained_successes", "weights_sha256")},
        **Proportion.of(row).as_summary(),
        "distance_m_median": float(np.median(row.distance_m)),
        **_times(one, _at_1x(one, own, "adsc")),
    }


def summary_of_seeds(group: Flown, own: Flown) -> dict[str, Any]:
    """Summarise all seeds of one training, compared with the same command at 1x and with the paper."""
    conditions = [key_of(group)[key] for key in ("profile", "variant", "command", "clock_speed")]
    simulation, whole = paper_results.speedups(*conditions)
    slow = _at_1x(group, own, conditions[2])
    return {
        **_identity(group),
        "successes_by_seed": group.successes.tolist(),
        **_success(group),
        "trained_games": group.trained_games.sum(),
        "paper_successes": paper_results.successes(*conditions),
        **_compare(group, slow[slow.clock_speed != conditions[3]]),
        **_times(group, _at_1x(group, own, "adsc")),
        "gap_s": gap_s(group),
        "paper_training_speedup": simulation,
        "paper_whole_training_speedup": whole,
    }


def _identity(flown: Flown) -> dict[str, Any]:
    """Return the conditions of a group of trainings, and its seeds."""
    return {**key_of(flown), "seeds": flown.seed.tolist()}


def _proportions(flown: Flown) -> list[Proportion]:
    return [Proportion(*each) for each in zip(flown.successes.tolist(), flown.games.tolist(), strict=True)]


def _success(flown: Flown) -> dict[str, Any]:
    """Return the success of all seeds together in one of their flights, with two 95 % intervals.

    `wilson_low` and `wilson_high` are of the games of these very policies; `seeds_low` and `seeds_high` also cover what
    trainings with other seeds would have given (`success_estimate`).
    """
    evaluated = _proportions(flown)
    over_seeds = success_estimate(evaluated)
    return {**Proportion.pooled(evaluated).as_summary(), "seeds_low": over_seeds.low, "seeds_high": over_seeds.high}


def _ratios(flown: Flown) -> np.ndarray:
    return (flown.successes / flown.games).to_numpy(float)


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
    counts = [(each.successes, each.games) for each in map(Proportion.pooled, map(_proportions, (some, others)))]
    return {
        "permutation_p": permutation_p(_ratios(some), _ratios(others)),
        "fisher_p": fisher_exact_p(*counts),
        "mcnemar_p": mcnemar_exact(first, second).p_value if len(first) else None,
    }


def _times(own: Flown, baseline: Flown) -> dict[str, Any]:
    """Return the modelled seconds of the trainings, those of as many commands of the baseline, and the speed-ups.

    Speed-ups are of a command's mean time, as trainings that learn differently fly games of different length.
    """
    commands, known = own.commands.sum(), len(baseline) > 0
    simulation, whole = (
        _per_command(baseline, phases) / _per_command(own, phases) if known else None for phases in (SIMULATION, PHASES)
    )
    phase_s = {phase: own[phase].sum() for phase in PHASES}
    return {
        "commands": commands,
        "sim_time_s": own.sim_time_s.sum(),
        "training_wall_s": sum(phase_s.values()),
        "real_time_s": _per_command(baseline, PHASES) * commands if known else None,
        "training_speedup": simulation,
        "whole_training_speedup": whole,
        "phase_s": phase_s,
    }


def _per_command(own: Flown, phases: Sequence[str]) -> float:
    """Return the modelled wall seconds that some phases take per command."""
    return float(sum(own[phase].sum() for phase in phases) / own.commands.sum())


def gap_s(own: Flown) -> float:
    """Return the mean simulated time between the end of a command and the next one in the trainings of one cell.

    With TCSC the clock is paused meanwhile: 0. With ADSC it is the simulated time from command to command less
    T_move: all of the wall time but that of images, at the speed that the profile's platform reaches. A few calls of a
    millisecond that ADSC makes in its pauses are counted too, and a command that a collision ends early counts as a
    whole one.
    """
    first = own.iloc[0]
    if first.command == "tcsc":
        return 0.0
    from uavaccel.envs.flyable import speed_of
    from uavaccel.envs.obstacle_lane import LaneTask

    task = LaneTask(timing=first.timing, profile=first.profile, clock_speed=first.clock_speed)
    t_move_s = own.sim_time_s.sum() / own.commands.sum()
    return max(_per_command(own, WITHOUT_IMAGES) * float(speed_of(task)) - t_move_s, 0.0)


def interchange(group: Flown, clock_speed: float) -> Iterator[dict[str, Any]]:
    """Yield the comparison of the flights with either command at a ClockSpeed, if there are any."""
    commands = group.command.iloc[0], other_command(group.command.iloc[0])
    own, other = (where(group, **{"with": command, "at": clock_speed}) for command in commands)
    if own.empty or other.empty:
        return
    test = mcnemar_exact(*_paired(own, other))
    yield {
        **_identity(own),
        "flown_at": clock_speed,
        "flown_with": [{"command": flown["with"].iloc[0], **_success(flown)} for flown in (own, other)],
        "only_first": test.only_first,
        "only_second": test.only_second,
        "mcnemar_p": test.p_value,
        "sign_flip_p": sign_flip_p(_ratios(own) - _ratios(other)),
    }


def as_trained(group: Flown, trained: Flown) -> Iterator[dict[str, Any]]:
    """Yield the comparison of flights at the training's ClockSpeed with those of trainings without the variant.

    There is none where policies were flown in real time alone.
    """
    key = key_of(group)
    own = {"with": key["command"], "at": key["clock_speed"]}
    plain = where(trained, **(key | {"variant": ""})) if key["variant"] else group.head(0)
    slow, fast, plain_slow, plain_fast = (where(each, **at) for each in (group, plain) for at in ({"flight": 0}, own))
    if fast.empty:
        return
    plain_slow = plain_slow[plain_slow.seed.isin(plain_fast.seed)]
    yield {
        **_identity(slow),
        "real_time": _success(slow) | _compare(slow, plain_slow),
        "as_trained": _success(fast) | _compare(fast, plain_fast),
        "sign_flip_p": sign_flip_p(_ratios(slow) - _ratios(fast)),
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


def same_weights(own: Flown) -> list[dict[str, Any]]:
    """Return how many seeds learned the same weights at all ClockSpeeds that a command was trained at, if several."""
    found = []
    for conditions, family in own.groupby(KEY[:-1], sort=False):
        clocks, seeds = sorted(family.clock_speed.unique().tolist()), family.groupby("seed").weights_sha256
        whole = seeds.nunique()[seeds.size() == len(clocks)]
        if len(clocks) > 1:
            learned = {"seeds": whole.index.tolist(), "equal": whole.index[whole == 1].tolist()}
            found.append({**dict(zip(KEY, conditions, strict=False)), "clock_speed": clocks, **learned})
    return found


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


def _slowest_and_fastest(pooled: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return, for each kind of training without a variant, success after its slowest and its fastest ClockSpeed."""
    plain: dict[str, list[str]] = {}
    for cell in sorted(pooled, key=lambda cell: cell["clock_speed"]):
        if not cell["variant"]:
            said = f"{cell['success_ratio']:.1%} after training at {clock_label(cell['clock_speed'])}"
            plain.setdefault(panel_name(cell), []).append(said)
    return [f"{name}: {', '.join(dict.fromkeys((said[0], said[-1])))}" for name, said in plain.items()]


def _same_weights_in_words(trained: Mapping[str, Any]) -> str:
    """Return in words whether trainings at several ClockSpeeds learned the same weights."""
    clocks = listed(clock_label(clock) for clock in trained["clock_speed"])
    seeds, equal = len(trained["seeds"]), len(trained["equal"])
    same = "one training each" if equal == seeds else f"{seeds - equal} learned others"
    return f"{panel_name(trained)}: of {seeds} seeds {equal} learned the same weights at {clocks}: {same}."


def _machine_minutes(report: Report) -> dict[tuple[object, ...], float]:
    """Return how long the trainings of each cell took on this machine, one after another, by `KEY`."""
    took_s = {entry["case"]: entry["training_s"] for entry in report.timings if "training_s" in entry}
    measured = report.games.assign(minutes=report.games["case"].map(took_s) / 60).dropna(subset="minutes")
    return measured.groupby(KEY).minutes.sum().to_dict()


def _time_saved(cells: Sequence[Mapping[str, Any]]) -> str:
    """Compare the modelled real time of the trainings with the time that they took on this machine."""
    both = [cell for cell in cells if cell["real_h"] is not None and cell["minutes"] is not None]
    if not both:
        return "No training of ADSC at 1x to say what the others would have taken in real time."
    hours, took_h = sum(cell["real_h"] for cell in both), sum(cell["minutes"] for cell in both) / 60
    games = sum(cell["trained_games"] for cell in both)
    return (
        f"These trainings' {games} games would have taken {hours:.3g} hours in real time (modelled, "
        f"{3600 * hours / games:.0f} s per game; the paper's 5 000 games took 182 hours, 131 s per game). This machine "
        f"took {took_h:.2g} hours of training, measured, one after another: {hours / took_h:.0f} times less."
    )


CELL: dict[str, Column] = {"trained with": "{panel}", "ClockSpeed": "{clock_speed:g}x"}
TRAINED = {**CELL, "seeds": "{seeds!l}"}
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
