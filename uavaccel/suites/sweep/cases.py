"""The conditions of a sweep: which evaluation each is, and which of them change nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from uavaccel.suites.experiment import timing_of
from uavaccel.suites.parts import Part, part_cost, part_suite
from uavaccel.suites.sweep.conditions import keys_of, value_text
from uavaccel.suites.sweep.config import SweepConfig

AS_TRAINED = "as-trained"


@dataclass(frozen=True)
class Case:
    """One condition; without a name that of the training, and the other conditions that are no different from it."""

    condition: str = ""
    value: Any = None
    timing: str = "virtual"
    simulated: float = field(default=0.0, compare=False)
    same: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        return case_id(self.condition, self.value)

    def simulated_s(self) -> float:
        return self.simulated


def case_id(condition: str, value: Any) -> str:
    """Name of a condition's row."""
    return f"{condition}-{value_text(value)}".replace("/", "_") if condition else AS_TRAINED


def conditions(config: SweepConfig) -> Iterator[Case]:
    """As trained, then one at a time."""
    yield Case()
    for name, values in config.sweep.items():
        for value in values:
            yield Case(name, value)


def cases(config: SweepConfig) -> Iterator[Case]:
    """What is flown: a condition that changes nothing is flown once, as trained."""
    parts = {case: part_of(config, case) for case in conditions(config)}
    resolved = {case: part_suite(part, config.seed)[1] for case, part in parts.items()}
    usual = resolved[Case()]
    same = tuple(case.id for case, each in resolved.items() if each == usual and case.condition)
    for case, part in parts.items():
        if case.condition and case.id in same:
            continue
        simulated_s, _ = part_cost(part, config.seed)
        timing = timing_of(resolved[case])
        yield Case(case.condition, case.value, timing, simulated_s, () if case.condition else same)


def part_of(config: SweepConfig, case: Case) -> Part:
    """The evaluation that a case is."""
    swept = keys_of(case.condition, case.value) if case.condition else {}
    keys = {"agent": config.agent, "games": config.games, **config.evaluation.keys, **swept}
    return Part(experiment=config.evaluation.experiment, keys=keys)
