"""Agents that need time to think, in environments that go on meanwhile: who is best, and how fast may one simulate?

Agents are trained, then evaluated with weights from the run (realtime_agents.py) under latencies and ClockSpeeds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Discriminator, Field, field_validator, model_validator

from uavaccel.config import CommandName, Config, Games, Seconds, Seed
from uavaccel.draw import style
from uavaccel.draw.page import Block, Heading, Table, counted, listed
from uavaccel.errors import UserError, suggestion
from uavaccel.forms import ArrayForm, Count, NotNegative, Number, Positive
from uavaccel.own_code import errors_named, file_of, own_module
from uavaccel.realtime.policies import TCP, load_policy
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.resources import require
from uavaccel.suites import plots
from uavaccel.suites import realtime_report as told
from uavaccel.suites.experiment import ClockSpeeds, CommandNames, Experiment, GameRow, Row, Timing, distinct, subset
from uavaccel.suites.parts import Part, acquire_gpu, part_folder, train_part
from uavaccel.suites.report import Report, Summary, method_note, records
from uavaccel.suites.suite import GameResult, SimpleCase, Suite
from uavaccel.suites.train import recent_mean

DRONES = "uavaccel/"
OF_THE_CASES = {"timing", "command", "clock_speed"}  # keys of a drone's environment
EPISODE_S = 20.0  # simulated seconds of an evaluation's episode, about
EVALUATION_SEED = 1_000_000  # episodes of an evaluation begin with others than those of trainings
UNDER = ("timing", "latency_s", "clock_speed", "command")  # the conditions of an evaluation

Delay = Annotated[float, Field(ge=0.0, le=60.0)]
Layers = tuple[Annotated[int, Field(ge=1, le=4096)], ...]


class EnvironmentBlock(Config):
    """A Gymnasium environment, and how long each of its agents is trained."""

    id: str
    """As for gymnasium.make; of "module:Name-v0" the module is one of your own, in the working directory or beside the
    YAML file. Those of this package keep their own clocks."""
    keys: dict[str, Any] = Field(default_factory=dict)
    """Further keywords of gymnasium.make."""
    train_steps: Annotated[int, Field(ge=1, le=1_000_000_000)] = 300_000
    """Decisions, of all parallel environments together."""
    default_action: int | tuple[float, ...] | None = None
    """Applied before the first action; 0 where actions are a Box, and needed where they are not."""
    period_s: Seconds | None = None
    """Simulated seconds of a step, where the environment does not say."""
    scale: tuple[float, float] | None = None
    """Returns that have score 0 and score 1; None: there are no scores."""

    @field_validator("scale")
    @classmethod
    def _scale_rises(cls, scale: tuple[float, float] | None) -> tuple[float, float] | None:
        if scale is not None and not scale[0] < scale[1]:
            raise ValueError(f"must rise, not {list(scale)}")
        return scale


class FlightBlock(Config):
    """A task of this package whose agents `uavaccel train` trains; return and score are 1 for a game won, else 0."""

    trainings: Annotated[dict[str, Part], Field(min_length=1)]
    """By the agent: the experiment of its training, and keys that differ from it. Other agents do not fly it."""
    evaluation: Part = Part(experiment="evaluate", keys={"simulator": "kernels", "games": 100})
    """How each is evaluated: its `inference_s`, command and ClockSpeed are those of a cell."""


class AgentBlock(Config):
    """An agent: what it is trained on, what it sees, and how much longer than others it thinks.

    It is trained by PPO, unless it has policies of its own.
    """

    policies: dict[str, str] = Field(default_factory=dict)
    """Files with what it is, by the environment, which it flies without a training: .zip of stable-baselines3, .onnx,
    .pt of TorchScript, or file.py:function. It flies no others."""

    training_delay_s: tuple[Delay, Delay] = (0.0, 0.0)
    """Range of simulated seconds from an observation to its action, one drawn for each episode of the training."""
    observe_age: bool = False
    """Whether it sees how old its last observation was when the action was applied."""
    observe_actions: Annotated[int, Field(ge=0, le=64)] = 0
    """How many of its latest actions it sees."""
    chunk: Annotated[int, Field(ge=1, le=64)] = 1
    """Actions that it plans at once, a control period each; the first is applied, the rest while it thinks."""
    frozen_prefix: bool = False
    """Whether a chunk begins at its observation: its actions for the periods until it arrives are dropped."""
    observe_planned: Annotated[int, Field(ge=0, le=64)] = 0
    """Of how many next periods it sees the actions that are applied unless others arrive."""
    look_ahead: bool = False
    """Whether it decides upon what the simulator itself predicts for the moment at which its action is applied."""
    hidden: Layers = (64, 64)
    """Units of its network's layers."""
    latency_factor: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0
    """It thinks so many times the latency of a cell: of a larger network, say."""

    @field_validator("policies")
    @classmethod
    def _policies_are_files(cls, policies: dict[str, str]) -> dict[str, str]:
        if servers := [place for place in policies.values() if place.startswith(TCP)]:
            raise ValueError(f"{servers[0]}: no server, whose answers nobody can repeat; name a file")
        return policies

    @model_validator(mode="after")
    def _range_rises(self) -> AgentBlock:
        if self.training_delay_s[0] > self.training_delay_s[1]:
            raise ValueError(f"training_delay_s must rise, not {list(self.training_delay_s)}")
        return self

    @model_validator(mode="after")
    def _predicts_what_it_sees(self) -> AgentBlock:
        for name in ("chunk", "observe_age", "observe_actions", "observe_planned"):
            if self.look_ahead and getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"look_ahead predicts an observation, for a single action: leave out {name}")
        return self

    def training_keys(self) -> dict[str, Any]:
        """Return the keys on which its training depends."""
        return self.model_dump(exclude={"look_ahead", "latency_factor"})


class RealtimeConfig(Experiment):
    """`suite: realtime`."""

    suite: Literal["realtime"]
    timing: Literal["virtual", "wall"] = "virtual"
    """virtual: the wall clock is simulated, and flights repeat; wall: measured, in a process of its own."""
    flights: dict[str, FlightBlock] = Field(default_factory=dict)
    """Tasks of this package that are learned by `uavaccel train`, by the names that rows and figures have for them."""
    environments: dict[str, EnvironmentBlock] = Field(default_factory=dict)
    """What else is flown, by the names that rows and figures have for it."""
    agents: Annotated[dict[str, AgentBlock], Field(min_length=1)]
    """Who flies it, by the names that rows and figures have for them."""
    latency_s: Annotated[tuple[Delay, ...], AfterValidator(distinct)] = (0.0, 0.02, 0.05, 0.1, 0.2)
    """Wall time from an observation to its action."""
    clock_speed: ClockSpeeds = (1.0,)
    """Simulated seconds per wall second that are asked for; each value is flown."""
    command: CommandNames = ("adsc", "tcsc")
    """tcsc pauses the simulation while the program works, adsc does not; each value is flown."""
    seeds: Annotated[int, Field(ge=1, le=1000)] = 3
    """Trainings of each agent in each environment."""
    episodes: Games = 10
    """Of each trained agent under each latency, ClockSpeed and command; flights have the games of their evaluation."""
    cells: tuple[str, ...] = ()
    """Fly these cells alone, and the trainings that they need: names such as hopper-naive-adsc-20ms-5x, in which * is
    anything; without any, all."""

    @model_validator(mode="after")
    def _flights_fit(self) -> RealtimeConfig:
        if not (self.flights or self.environments):
            raise ValueError("needs at least one of environments or flights")
        if self.flights and self.timing == "wall":
            raise ValueError("flights need timing virtual: their clock is simulated")
        if both := sorted(self.flights.keys() & self.environments.keys()):
            raise ValueError(f"flights.{both[0]}: one of the environments has the same name")
        for name, flight in self.flights.items():
            if unknown := [agent for agent in flight.trainings if agent not in self.agents]:
                raise ValueError(f"flights.{name}.trainings: {unknown[0]} is none of the agents, {listed(self.agents)}")
        return self

    @model_validator(mode="after")
    def _cases_differ(self) -> RealtimeConfig:
        for name in (*self.flights, *self.environments, *self.agents):
            if not name.replace("_", "").isalnum():
                raise ValueError(f"{name!r} names files: letters, digits and _ alone")
        for name, agent in self.agents.items():
            if unknown := sorted(agent.policies.keys() - self.environments.keys()):
                raise ValueError(f"agents.{name}.policies: {unknown[0]} is none of the environments")
        if self.timing == "wall" and any(agent.look_ahead for agent in self.agents.values()):
            raise ValueError("look_ahead needs timing virtual: it looks into the simulator")
        if self.timing == "wall" and any(block.id.startswith(DRONES) for block in self.environments.values()):
            raise ValueError(f"environments of {DRONES[:-1]} keep their own wall clock: their tasks' timing is wall")
        for name, block in self.environments.items():
            if block.id.startswith(DRONES) and (own := sorted(OF_THE_CASES & block.keys.keys())):
                raise ValueError(f"environments.{name}.keys: a drone has {own[0]} of each cell, not of its own")
        return self

    def delay_s(self, agent: str, latency_s: float) -> float:
        """Return the wall time for which an agent thinks where others think for `latency_s`."""
        return latency_s * self.agents[agent].latency_factor

    def scale(self, name: str) -> tuple[float, float] | None:
        """Return the returns that have score 0 and 1 in a flight or an environment; None where there are no scores."""
        return (0.0, 1.0) if name in self.flights else self.environments[name].scale

    def flies(self, environment: str, agent: str) -> bool:
        """Return whether an agent can fly there: a drone takes no chunks, and has no model to look ahead with."""
        block, drone = self.agents[agent], self.environments[environment].id.startswith(DRONES)
        there = not block.policies or environment in block.policies
        return there and not (drone and (block.chunk > 1 or block.look_ahead))

    def trained_as(self, environment: str, agent: str) -> str:
        """Return the first agent with the same training there that can fly there."""
        if environment in self.flights:
            return agent
        training = self.agents[agent].training_keys()
        others = (other for other in self.agents if self.flies(environment, other))
        return next(other for other in others if self.agents[other].training_keys() == training)


class TrainingRow(GameRow):
    """The row of a training."""

    kind: Literal["training"]
    environment: str
    agent: str
    seed: Seed
    steps: Count
    last_return: Number | None
    """The mean of its last hundred episodes; None where none was finished."""
    agent_sha256: str


class EvaluationRow(GameRow):
    """The row of the episodes of one trained agent under one latency, ClockSpeed and command."""

    kind: Literal["evaluation"]
    timing: Timing
    environment: str
    agent: str
    seed: Seed
    latency_s: NotNegative
    clock_speed: Positive
    command: CommandName
    returns: Annotated[list[Number], Field(min_length=1)]
    delays_s: Annotated[list[NotNegative], Field(min_length=1)]
    """Simulated seconds from an observation to its action: the median of each episode."""
    late_s: NotNegative
    """How late the environment was at most, behind the machine's clock; 0 where the clock is simulated."""


@dataclass(frozen=True)
class Training(SimpleCase):
    """A training of an agent. The length of its episodes is not known beforehand."""

    environment: str
    agent: str
    seed: int


@dataclass(frozen=True)
class Evaluation(Training):
    """The evaluation of a trained agent under one latency, ClockSpeed and command."""

    trained: str
    """The training: agents whose trainings do not differ share the one of the first of them."""
    latency_s: float
    clock_speed: float
    command: str

    @property
    def cell(self) -> str:
        """The name of its cell, as the key `cells` has it."""
        under = f"{self.command}-{self.latency_s * 1e3:g}ms-{self.clock_speed:g}x"
        return f"{self.environment}-{self.agent}-{under}"


def _import_modules(config: RealtimeConfig) -> None:
    """Import the modules that register environments, as in "module:Name-v0". Raises UserError as `own_module` does."""
    for name, block in config.environments.items():
        module, named, _ = block.id.partition(":")
        if named:
            own_module(module, f"environments.{name}.id")


class Realtime(Suite[RealtimeConfig, Training]):
    """`uavaccel run realtime`."""

    name = "realtime"
    unit = "cell"
    grows = ("seeds", "cells")
    config = RealtimeConfig
    row = Annotated[TrainingRow | EvaluationRow, Discriminator("kind")]
    arrays = {"*": ArrayForm("f")}  # noqa: RUF012
    batch = 1

    def check(self, config: RealtimeConfig) -> None:
        """Raise UserError for an environment that cannot be made, and for an agent that cannot act in it."""
        require("stable_baselines3", "suite realtime", "realtime", "stable-baselines3")
        _import_modules(config)
        for name, flight in config.flights.items():
            for agent, part in flight.trainings.items():
                if (of := part.resolve(config.seed)[0].name) != "train":
                    raise UserError(f"flights.{name}.trainings.{agent}: {part.experiment} is of {of}, not of train")
        known = dict.fromkeys(case.cell for case in _evaluations(config))
        for pattern in config.cells:
            if not any(fnmatchcase(cell, pattern) for cell in known):
                raise UserError(f"cells: none is called {pattern}; {suggestion(pattern, list(known))}")
        for name, agent in _pairs(config):
            _check_agent(config, name, agent)

    def cases(self, config: RealtimeConfig) -> Iterator[Training]:
        """Yield all trainings, then all evaluations. Under TCSC delays change nothing: one latency stands for all."""
        wanted, every = config.cells or ("*",), _evaluations(config)
        evaluations = [case for case in every if any(fnmatchcase(case.cell, cell) for cell in wanted)]
        needed = {case.trained for case in evaluations}
        for environment, agent, seed in _flown(config):
            if (name := f"{environment}-{agent}-s{seed}") in needed:
                yield Training(name, "virtual", 0.0, environment, agent, seed)
        yield from evaluations

    def stage(self, case: Training) -> int:
        return int(isinstance(case, Evaluation))

    def games(self, config: RealtimeConfig, case: Training) -> int:
        if not isinstance(case, Evaluation):
            return 1
        flight = config.flights.get(case.environment)
        return config.episodes if flight is None else int(flight.evaluation.keys.get("games", 1))

    def open(self, config: RealtimeConfig, timing: str, run: RunDirectory) -> AbstractContextManager[Any]:
        """Open the run, and what loads the weights of a training, the latest ones once for all of its evaluations."""
        _import_modules(config)  # in this worker

        @lru_cache(maxsize=1)
        def weights(case: str) -> Mapping[str, np.ndarray]:
            trained = next(row for row in run.rows() if row["case"] == case)
            return run.load_arrays(trained) if "arrays" in trained else {}

        return nullcontext((run, weights))

    def fly(self, config: RealtimeConfig, case: Training, opened: Any) -> GameResult:
        kind = "evaluation" if isinstance(case, Evaluation) else "training"
        row: dict[str, Any] = {"kind": kind, "environment": case.environment, "agent": case.agent, "seed": case.seed}
        run, weights_of = opened
        if case.environment in config.flights:
            return GameResult(row | flown(config, case, run))
        if isinstance(case, Evaluation):
            return GameResult(row | evaluated(config, case, weights_of(case.trained)))
        from uavaccel.suites import realtime_agents

        block, agent = config.environments[case.environment], config.agents[case.agent]
        if (policy := agent.policies.get(case.environment)) is not None:
            with closing(realtime_agents.timed(block, agent, 0.0, "adsc", 1.0)) as env:
                digest = load_policy(policy, env).sha256
            return GameResult(row | {"steps": 0, "last_return": None, "agent_sha256": digest})
        from uavaccel.suites.realtime_learner import train

        weights, learned = train(block, agent, config.seed + case.seed)
        return GameResult(row | learned, weights)

    def score(self, report: Report) -> pd.DataFrame:
        """Return the evaluations. Raises UserError where none is finished yet."""
        if (evaluations := report.games[report.games.kind == "evaluation"]).empty:
            raise UserError(f"{report.run.path / 'rows.jsonl'}: holds no finished evaluation yet")
        return evaluations

    def summary(self, report: Report) -> Summary:
        config, games = report.config, report.games
        cells = told.cells_of(report)
        adsc = cells[cells.command == "adsc"].groupby(["environment", "latency_s"], sort=False)
        rankings = [dict(zip(("environment", "latency_s"), at, strict=True)) | told.ranking(own) for at, own in adsc]
        return {
            "suite": "realtime",
            "seed": config.seed,
            "provenance": timing_provenance(config.timing),
            "cells": records(cells),
            "rankings": rankings,
            "tcsc_equal_at_every_clock_speed": told.tcsc_equal(report.scores),
            "trainings": records(games[games.kind == "training"].reindex(columns=told.TRAINING)),
        }

    def title(self, report: Report) -> str:
        return "Agents that need time to think"

    def headline(self, report: Report) -> str:
        """Return up to which ClockSpeed each ranking at the middle latency holds, and whether TCSC's returns do.

        Where nothing is compared, they are the returns of the first cell and of the last.
        """
        cells = report.summary["cells"]
        rankings, equal = report.summary["rankings"], report.summary["tcsc_equal_at_every_clock_speed"]
        rankings = [each for each in rankings if len(each["orders"][0]) > 1]
        latencies = sorted({each["latency_s"] for each in rankings})
        middle = latencies[len(latencies) // 2] if latencies else 0.0
        said = [told.up_to_which_speed(each, cells) for each in rankings if each["latency_s"] == middle]
        said = [f"with {1e3 * middle:g} ms to think, {'; '.join(said)}"] if said else []
        if equal is not None:
            said.append(f"under TCSC returns {'are the same to the bit' if equal else 'DIFFER'} at every ClockSpeed")
        return "; ".join(said or dict.fromkeys(map(told.cell_in_words, (cells[0], cells[-1]))))

    def source(self, report: Report) -> str:
        cells = pd.DataFrame(report.summary["cells"])
        counts = [counted(plots.span(cells[name], "{}"), what) for name, what in told.COUNTS.items()]
        every = len({case.cell for case in _evaluations(report.config)})
        some = f" · {len(cells)} of {every} cells" if len(cells) < every else ""
        return f"{report.summary['provenance']} · {', '.join(counts)} a cell{some} · seed {report.summary['seed']}"

    def overview(self, report: Report) -> Table:
        """Return ADSC's cells at the slowest ClockSpeed, at the least latency and at the middle one."""
        cells = pd.DataFrame(report.summary["cells"])
        own = cells[cells.command == "adsc"]
        latencies = sorted(own.latency_s.unique())
        shown = own.latency_s.isin([*latencies[:1], *latencies[len(latencies) // 2 :][:1]])
        return Table.of(own[shown & (own.clock_speed == own.clock_speed.min())], told.RETURNS)

    def page(self, report: Report) -> Iterator[Block | str]:
        cells = pd.DataFrame(report.summary["cells"])
        several = [each for each in report.summary["rankings"] if len(each["clock_speeds"]) > 1]
        if (cells.command == "adsc").any():
            yield told.returns_figure(report, cells)
        if several:
            yield told.rankings_figure(report)
            yield Heading("How fast may one simulate before the ranking changes?")
            yield told.rankings_table(several)
        report.run.write_text("results.csv", told.results(report))
        yield Heading("All cells")
        yield Table.of(cells, told.RETURNS, folded="all returns")
        yield method_note(told.READING)

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        """Write a figure and agreement.json of a run on the simulated clock against one on the machine's, given in
        either order, into the latter's folder.
        """
        reports = {str(run.config()["timing"]): self.report(run) for run in runs}
        if set(reports) != {"virtual", "wall"}:
            raise UserError("realtime: compares a run with timing virtual and one with timing wall")
        modelled, measured = reports["virtual"], reports["wall"]
        both = told.cells_of(modelled), told.cells_of(measured)
        if (pairs := both[0].merge(both[1], on=told.CELL, suffixes=("", "_measured"))).empty:
            raise UserError(f"{measured.run.path}: has no cell that {modelled.run.path} has too")
        measured.run.write_json("agreement.json", told.agreement(pairs))
        source = f"modelled: {modelled.run.path.name}; measured: {measured.run.path.name}"
        return [style.save(told.agreement_figure(pairs, source), measured.run.file("figures/agreement.png"))]

    def status(self, rows: Sequence[Row]) -> str:
        return str(rows[-1]["case"])


def _check_agent(config: RealtimeConfig, name: str, agent: str) -> None:
    """Raise UserError for an environment that cannot be made, and for an agent that cannot act in it."""
    from uavaccel.realtime.plant import is_of_mujoco, layers
    from uavaccel.suites import realtime_agents

    block = config.environments[name]
    try:
        with closing(realtime_agents.timed(block, config.agents[agent], 0.0, "adsc", 1.0)) as env:
            if config.agents[agent].look_ahead and not is_of_mujoco(env):
                raise UserError("look_ahead: looks into Gymnasium's MuJoCo environments alone")
            past = [type(each).__name__ for each in layers(env) if not isinstance(each, realtime_agents.TRANSPARENT)]
            if config.agents[agent].look_ahead and past[:-1]:
                raise UserError(f"look_ahead: looks past the wrapper {past[0]}: put what it does into the environment")
            if (policy := config.agents[agent].policies.get(name)) is not None:
                load_policy(policy, env)
            else:
                realtime_agents.check_learnable(env)
    except UserError as error:
        raise UserError(f"environments.{name}, agents.{agent}: {error}") from error
    except Exception as error:  # whatever a user's environment raises
        said = (str(error) or type(error).__name__).splitlines()[0]
        raise UserError(f"environments.{name}: {block.id} cannot be made: {said}") from error


def _pairs(config: RealtimeConfig) -> list[tuple[str, str]]:
    return [pair for pair in product(config.environments, config.agents) if config.flies(*pair)]


def _flown(config: RealtimeConfig) -> list[tuple[str, str, int]]:
    """Return each flight or environment with each agent that flies it, and each training's seed."""
    flights = [(name, agent) for name, flight in config.flights.items() for agent in flight.trainings]
    seeds = {name: range(1 if agent.policies else config.seeds) for name, agent in config.agents.items()}
    return [(*pair, seed) for pair in [*flights, *_pairs(config)] for seed in seeds[pair[1]]]


def _evaluations(config: RealtimeConfig) -> Iterator[Evaluation]:
    for (environment, agent, seed), command in product(_flown(config), config.command):
        trained = f"{environment}-{config.trained_as(environment, agent)}-s{seed}"
        latencies_s = config.latency_s if command == "adsc" else config.latency_s[-1:]
        for latency_s, speed in product(latencies_s, config.clock_speed):
            case = f"{environment}-{agent}-s{seed}-{command}-{latency_s * 1e3:g}ms-{speed:g}x"
            of = case, config.timing, config.episodes * EPISODE_S, environment, agent, seed
            yield Evaluation(*of, trained, latency_s, speed, command)


def evaluated(config: RealtimeConfig, case: Evaluation, weights: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Fly the episodes of a trained agent, and return what its row has beside the training's keys."""
    from uavaccel.suites import realtime_agents as agents

    block, agent = config.environments[case.environment], config.agents[case.agent]
    delay_s, wall = config.delay_s(case.agent, case.latency_s), case.timing == "wall"
    if wall:
        env: agents.Env = agents.measured(block, agent, case.command, case.clock_speed)
    else:
        env = agents.timed(block, agent, delay_s, case.command, case.clock_speed)
    with closing(env):
        policy = agents.policy_of(env, agent, weights, agent.policies.get(case.environment))
        if agent.look_ahead and case.command == "adsc":
            policy = agents.LookAhead(policy, env, block, delay_s, case.clock_speed)
        seeds = range(EVALUATION_SEED + config.seed, EVALUATION_SEED + config.seed + config.episodes)
        with errors_named(file_of(type(env.unwrapped))):
            met = [agents.fly_episode(env, policy, seed, delay_s if wall else 0.0) for seed in seeds]
    returns, delays_s, late_s = (list(each) for each in zip(*met, strict=True))
    return subset(vars(case), *UNDER) | {"returns": returns, "delays_s": delays_s, "late_s": max(late_s)}


def flown(config: RealtimeConfig, case: Training, run: RunDirectory) -> dict[str, Any]:
    """Train an agent of a flight below parts/, or fly its games, and return what its row has beside the common keys."""
    from uavaccel.suites.evaluate_lanes import GamesInBatch

    flight = config.flights[case.environment]
    if not isinstance(case, Evaluation):
        training = flight.trainings[case.agent].resolve(config.seed + case.seed)
        acquire_gpu(training[1].device)
        report = train_part(run, case.id, training)
        learned = {"steps": report.summary["commands"], "agent_sha256": report.summary["weights_sha256"]}
        return {**learned, "last_return": float(recent_mean(report.games["return"]).iloc[-1])}
    agent = str(part_folder(run, case.trained).resolve())
    thinks_s = config.delay_s(case.agent, case.latency_s)
    keys = flight.evaluation.keys | {"agent": agent, "inference_s": thinks_s, "task.mediation": {}}
    keys |= {f"task.{name}": getattr(case, name) for name in OF_THE_CASES}
    evaluation = Part(experiment=flight.evaluation.experiment, keys=keys).resolve(config.seed)[1]
    lanes = range(evaluation.first_lane, evaluation.first_lane + evaluation.games)
    with closing(GamesInBatch(evaluation, lanes)) as batch:
        won = [float(batch.game(lane).row["is_success"]) for lane in lanes]
    delay_s = thinks_s * case.clock_speed if case.command == "adsc" else 0.0
    return subset(vars(case), *UNDER) | {"returns": won, "delays_s": [delay_s] * len(won), "late_s": 0.0}
