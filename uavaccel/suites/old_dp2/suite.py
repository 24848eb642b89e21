"""The suite `dp2`: a path through the lane, whose images are compared with those of real time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

from uavaccel.draw.style import clock_label, command_name
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.suites.old_dp2.config import Dp2Config
from uavaccel.suites.old_dp2.flights import ARRAYS, SCENE, Case, Dp2Row, cases, fly_game
from uavaccel.suites.old_dp2.report import Dp2Report
from uavaccel.suites.suite import GameResult, Suite
from uavaccel.wire.session import Session, open_session


def _interest(row: Dp2Row) -> tuple[bool, bool, float]:
    return row["role"] == "game", row["command"] == "tcsc", row["clock_speed"]


def _title(row: Dp2Row) -> str:
    if row["timing"] == "lockstep":
        return f"{command_name(row['command'])} in lockstep, without latency"
    clock = f"{command_name(row['command'])} at ClockSpeed {clock_label(row['clock_speed'])}"
    achieved = f"achieved {row['real_time_factor']:.1f}x, {timing_provenance(row['timing'])}"
    end = f", hit {row['collision']['object']}" if row["collision"] else ""
    return f"{clock} ({achieved}{end})"



class Dp2(Suite[Dp2Config, Case]):
    """`uavaccel run dp2`."""

    name = "dp2"
    config = Dp2Config
    row = Dp2Row
    arrays = ARRAYS
    report_class = Dp2Report
    quick: ClassVar[Mapping[str, object]] = {}

    def case_of(self, row: Plain) -> str:
        return Case(row["role"], row["command"], row["clock_speed"], row["timing"], 0.0).id

    def cases(self, config: Dp2Config) -> Iterator[Case]:
        return cases(config)

    def open(self, config: Dp2Config, timing: str, run: RunDirectory) -> Session:
        return open_session(timing, config.profile, SCENE, config.latency)

    def fly(self, config: Dp2Config, case: Case, opened: Session) -> GameResult:
        return GameResult(*fly_game(config, case, opened))

    def renders(self, config: Dp2Config) -> bool:
        return True
