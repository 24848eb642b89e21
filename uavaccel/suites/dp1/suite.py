"""The suite `dp1`: paths flown with ADSC and TCSC, compared with those of real time (paper, section III-C2a)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from uavaccel.files import Plain
from uavaccel.records import RunDirectory
from uavaccel.suites.dp1.config import Dp1Config
from uavaccel.suites.dp1.flights import ARRAYS, SCENE, Case, Dp1Row, cases, fly_game
from uavaccel.suites.report import Report
from uavaccel.suites.suite import Cost, GameResult, Suite, flying_s

if TYPE_CHECKING:
    from uavaccel.wire.session import Session

CALL_S = 150e-6  # approximate wall time of a call on a loopback socket
CALLS = 6  # per command
RECORDER_BYTES_PER_S = 20 * 14 * 8  # per simulated second


class Dp1(Suite[Dp1Config, Case]):
    """`uavaccel run dp1`."""

    name = "dp1"
    config = Dp1Config
    row = Dp1Row
    arrays = ARRAYS
    quick: ClassVar[Mapping[str, object]] = {"games": 3, "reference_games": 3}

    @property
    def report_class(self) -> type[Report]:
        from uavaccel.suites.dp1.report import Dp1Report  # loads what draws

        return Dp1Report

    def cases(self, config: Dp1Config) -> Iterator[Case]:
        return cases(config)

    def case_of(self, row: Plain) -> str:
        flown = row["role"], row["command"], row["clock_speed"], row["timing"]
        return Case(*flown, row["t_move_s"], row["rounds"], row["game"], ()).id

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        return ("games",)

    def open(self, config: Dp1Config, timing: str, run: RunDirectory) -> Session:
        from uavaccel.wire.session import open_session

        return open_session(timing, config.profile, SCENE, config.latency)

    def fly(self, config: Dp1Config, case: Case, opened: Session) -> GameResult:
        return GameResult(*fly_game(config, case, opened))

    def finish(self, config: Dp1Config, run: RunDirectory) -> None:
        """Record the messages of one command of each kind, for Figure 4."""
        from uavaccel.bench.traces import record_trace

        with self.open(config, config.timing, run) as session:
            for command in config.command:
                trace = record_trace(session, command, max(config.clock_speed), max(config.t_move_s))
                run.write_json(f"traces/{command}.json", trace)

    def cost(self, config: Dp1Config, case: Case) -> Cost:
        return game_cost(case)


def game_cost(case: Case) -> Cost:
    """Estimate the wall time and disk space of a game."""
    calls_s = CALLS * CALL_S * case.simulated_s() / case.t_move_s
    return Cost(flying_s(case, case.clock_speed) + calls_s, case.simulated_s() * RECORDER_BYTES_PER_S)
