"""Ablations as a suite: the games of DP1 under every variant, with the same seeds in each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from uavaccel.records import RunDirectory
from uavaccel.suites.ablation.config import AblationConfig
from uavaccel.suites.ablation.report import AblationReport
from uavaccel.suites.dp1 import cases as dp1_cases
from uavaccel.suites.dp1.config import Dp1Config
from uavaccel.suites.dp1.flights import SCENE, fly_game
from uavaccel.suites.dp1.suite import game_cost
from uavaccel.suites.suite import Cost, GameResult, Suite
from uavaccel.wire.session import Session, open_session


@dataclass(frozen=True)
class Case:
    """A game of DP1 under a variant, by its place in the configuration."""

    variant: int
    game: dp1_cases.Case

    @property
    def id(self) -> str:
        return f"v{self.variant:02d}-{self.game.id}"

    @property
    def timing(self) -> str:
        return self.game.timing

    def simulated_s(self) -> float:
        return self.game.simulated_s()


class Sessions:
    """One session per variant, opened when its first game is flown."""

    def __init__(self, config: AblationConfig, timing: str, stack: ExitStack) -> None:
        self._config, self._timing, self._stack = config, timing, stack
        self._opened: dict[int, tuple[Dp1Config, Session]] = {}

    def of(self, variant: int) -> tuple[Dp1Config, Session]:
        """The variant's experiment and the session that it is flown in."""
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

    def cases(self, config: AblationConfig) -> Iterator[Case]:
        for index, variant in enumerate(config.variants):
            for game in dp1_cases.cases(config.experiment(variant)):
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

    def cost(self, config: AblationConfig, case: Case) -> Cost:
        return game_cost(case.game)
