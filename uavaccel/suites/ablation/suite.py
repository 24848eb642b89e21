"""The suite `ablation`: the games of DP1 under several variants of its configuration, with the same seeds in each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from uavaccel.config import Config, validate
from uavaccel.files import Plain
from uavaccel.records import RunDirectory
from uavaccel.suites.ablation.report import AblationReport
from uavaccel.suites.dp1 import Dp1Config
from uavaccel.suites.experiment import Experiment, merged
from uavaccel.suites.old_dp1 import flights as dp1
from uavaccel.suites.old_dp1.flights import SCENE, fly_game
from uavaccel.suites.suite import GameResult, Suite
from uavaccel.wire.session import Session, open_session


class Variant(Config):
    """A variant of the experiment, by what it changes."""

    name: str
    """The name in the table and on the figure's axis; where all names are numbers, they are values on it."""
    changes: dict[str, Plain] = Field(default_factory=dict)
    """Values by dotted key of the DP1 configuration, as for --set."""


class AblationConfig(Experiment):
    """`suite: ablation`."""

    suite: Literal["ablation"]
    title: str = "Ablation"
    """Title of the report."""
    axis: str = "variant"
    """Label of the figure's axis: the quantity whose values are the variants' names."""
    times_clock_speed: bool = False
    """Whether the figure's axis is the variants' value times ClockSpeed."""
    base: dict[str, Plain]
    """A DP1 configuration; `suite` and `seed` may be left out. Its latency is a block or what ships for the profile."""
    variants: Annotated[tuple[Variant, ...], Field(min_length=1)]
    """The variants of the DP1 configuration, each flown in full."""

    @field_validator("variants")
    @classmethod
    def _distinct(cls, variants: tuple[Variant, ...]) -> tuple[Variant, ...]:
        names = [variant.name for variant in variants]
        if len(set(names)) < len(names):
            raise ValueError("must have names of their own")
        return variants

    @model_validator(mode="after")
    def _can_be_flown(self) -> AblationConfig:
        for variant in self.variants:
            self.experiment(variant)
        return self

    @property
    def timing(self) -> str:
        return str(self.base.get("timing", "virtual"))

    def experiment(self, variant: Variant) -> Dp1Config:
        """Return the DP1 experiment of a variant. Raises UserError, which names the variant and the key."""
        known = {**self.base, "suite": "dp1", "seed": self.seed}
        validate(Dp1Config, known, "base")
        return validate(Dp1Config, merged(known, variant.changes), f"variant {variant.name!r}")


@dataclass(frozen=True)
class Case:
    """A game of DP1 under a variant, by its place in the configuration."""

    variant: int
    game: dp1.Case

    @property
    def id(self) -> str:
        return f"v{self.variant:02d}-{self.game.id}"

    @property
    def timing(self) -> str:
        return self.game.timing

    def simulated_s(self) -> float:
        return self.game.simulated_s()


class AblationRow(dp1.Dp1Row):
    """The row of a game of DP1 under a variant."""

    variant: str


class Sessions:
    """A session per variant, opened when its first game is flown."""

    def __init__(self, config: AblationConfig, timing: str, stack: ExitStack) -> None:
        self._config, self._timing, self._stack = config, timing, stack
        self._opened: dict[int, tuple[Dp1Config, Session]] = {}

    def of(self, variant: int) -> tuple[Dp1Config, Session]:
        """Return the variant's experiment and its session."""
        if variant not in self._opened:
            config = self._config.experiment(self._config.variants[variant])
            session = open_session(self._timing, config.profile, SCENE, config.latency)
            self._opened[variant] = config, self._stack.enter_context(session)
        return self._opened[variant]


class Ablation(Suite[AblationConfig, Case]):
    """`uavaccel run ablation`."""

    name = "ablation"
    config = AblationConfig
    report_class = AblationReport
    row = AblationRow
    arrays = dp1.ARRAYS

    def cases(self, config: AblationConfig) -> Iterator[Case]:
        for index, variant in enumerate(config.variants):
            for game in dp1.cases(config.experiment(variant)):
                if game.role != "figure2":
                    yield Case(index, game)

    @contextmanager
    def open(self, config: AblationConfig, timing: str, run: RunDirectory) -> Iterator[Sessions]:
        with ExitStack() as stack:
            yield Sessions(config, timing, stack)

    def fly(self, config: AblationConfig, case: Case, opened: Sessions) -> GameResult:
        experiment, session = opened.of(case.variant)
        row, arrays = fly_game(experiment, case.game, session)
        name = config.variants[case.variant].name
        return GameResult(row | {"suite": self.name, "case": case.id, "variant": name}, arrays)
