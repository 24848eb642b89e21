"""Suites that evaluate one policy under several conditions, each in a run directory of its own below the run's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np

from uavaccel.errors import UserError
from uavaccel.forms import ArrayForm, Count, NotNegative, Number
from uavaccel.limits import Games
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT, policy_sha256
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.old_report import Arrays
from uavaccel.suites.parts import Part, fly_part, part_run, part_suite
from uavaccel.suites.rows import GameRow, Row
from uavaccel.suites.suite import AnySuite, GameResult, SimpleCase, Suite


class PolicyExperiment(Experiment):
    """Keys of suites that evaluate one policy under several conditions."""

    agent: str = DEFAULT
    """The policy, as `uavaccel evaluate` takes it."""
    games: Games = 300
    """Number of evaluation lanes, which are the same under each condition."""
    evaluation: Part = Part(experiment="evaluate")
    """How each policy is evaluated: an experiment, and keys that differ from it."""


@dataclass(frozen=True)
class EvaluationCase(SimpleCase):
    """An evaluation under one condition: the dotted keys that set it, and the keys of its row that name it."""

    keys: Mapping[str, object]
    labels: Mapping[str, object]


class PolicyRow(GameRow):
    """The row of an evaluation; suites add the keys of their conditions."""

    games: Games
    successes: Count
    distance_m_median: Number
    sim_time_s: NotNegative


OUTCOMES = {
    "lane": ArrayForm("iu", ("games",)),
    "is_success": ArrayForm("b", ("games",)),
    "distance_m": ArrayForm("f8", ("games",)),
}
"""The arrays of an evaluation, as `outcomes` makes them."""

PolicyConfig = TypeVar("PolicyConfig", bound=PolicyExperiment)


class PolicySuite(Suite[PolicyConfig, EvaluationCase]):
    """One policy, evaluated on the same lanes in every case."""

    batch = 1
    arrays = OUTCOMES
    kept: ClassVar[Sequence[str]] = ("games", "successes", "distance_m_median", "sim_time_s")
    """Keys of the evaluation's summary that its row keeps."""

    def evaluations(self, config: PolicyConfig) -> Iterator[EvaluationCase]:
        """Yield every condition, whether or not it is flown."""
        return self.cases(config)

    def part(self, config: PolicyConfig, case: EvaluationCase) -> Part:
        """Return the evaluation of a case."""
        keys = {"agent": config.agent, "games": config.games, **config.evaluation.keys, **case.keys}
        return Part(experiment=config.evaluation.experiment, keys=keys)

    def first(self, config: PolicyConfig) -> tuple[AnySuite, EvaluateConfig]:
        """Return suite and configuration of the first evaluation, which represents all where they do not differ."""
        suite, evaluation = part_suite(self.part(config, next(self.evaluations(config))), config.seed)
        if not isinstance(evaluation, EvaluateConfig):
            raise UserError(f"evaluation.experiment = {config.evaluation.experiment}: is no evaluation")
        return suite, evaluation

    def check(self, config: PolicyConfig) -> None:
        self.first(config)
        for case in self.evaluations(config):
            part_suite(self.part(config, case), config.seed)

    def games(self, config: PolicyConfig, case: EvaluationCase) -> int:
        return config.games

    def renders(self, config: PolicyConfig) -> bool:
        suite, evaluation = self.first(config)
        return suite.renders(evaluation)

    def provenance(self, config: PolicyConfig) -> Mapping[str, object]:
        """Return the policy's hash. Raises UserError for a device that this machine does not have."""
        suite, evaluation = self.first(config)
        suite.provenance(evaluation)
        return {"policy_sha256": policy_sha256(config.agent)}

    def open(
        self, config: PolicyConfig, timing: str, run: RunDirectory
    ) -> AbstractContextManager[RunDirectory]:
        return on_own_gpu(run)

    def fly(self, config: PolicyConfig, case: EvaluationCase, opened: RunDirectory) -> GameResult:
        """Evaluate; the row has keys of the evaluation's summary, the arrays the outcome of each lane."""
        summary = fly_part(opened, case.id, self.part(config, case), config.seed)
        found = {name: summary[name] for name in self.kept}
        row = {"suite": self.name, "case": case.id, **case.labels, **found}
        return GameResult(row, outcomes(part_run(opened, case.id)))

    def status(self, rows: Sequence[Row]) -> str:
        return f"{rows[-1]['case']} won {rows[-1]['successes']} of {rows[-1]['games']}"


def outcomes(run: RunDirectory) -> Arrays:
    """Return lane, success and metres north (n,) of an evaluation's games."""
    rows = run.rows()
    return {
        "lane": np.array([row["lane"] for row in rows], np.int64),
        "is_success": np.array([row["is_success"] for row in rows], bool),
        "distance_m": np.array([row["distance_m"] for row in rows], np.float64),
    }


def agent_name(agent: str) -> str:
    """Return an agent as it is named in a sentence."""
    return "the policy that ships" if agent == DEFAULT else agent
