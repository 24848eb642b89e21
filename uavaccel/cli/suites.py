"""The suites that `uavaccel run` flies and `uavaccel report` reports on, by the key `suite` of their YAML."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.runner import AnyCase, Suite

VIRTUAL_RATE = 300.0  # simulated seconds a wall second and process, about
CALL_S = 150e-6  # wall time of a call on a loopback socket, about
IMAGE_S = 5e-3  # of an image: drawn in software, sent, deflated and looked at, about
IMAGE_BYTES = 9_000  # of a deflated one, about
RECORDER_BYTES_PER_S = 20 * 14 * 8  # of simulated time


class Cost(NamedTuple):
    """About what a game takes."""

    wall_s: float
    disk_bytes: float


class SummaryTable(NamedTuple):
    """A header, and the rows of text below it for a summary."""

    header: Sequence[str]
    rows: Callable[[Mapping[str, Any]], list[tuple[str, ...]]]


@dataclass(frozen=True)
class SuiteEntry:
    """What the command line needs of a suite."""

    config: type[Experiment]
    cases: Callable[[Any], Iterator[AnyCase]]
    suite: Suite
    cost: Callable[[Any, Any], Cost]
    """Of a configuration's case."""
    write_report: Callable[[Path], Mapping[str, Any]]
    table: SummaryTable
    overview: SummaryTable | None = None
    """Of fewer columns, for a narrow terminal."""
    renders: bool = False
    quick: Mapping[str, Any] = field(default_factory=dict)
    """Keys of a quick measurement: a shipped experiment with a single --clock."""
    finish: Callable[[Any, RunDirectory], None] | None = None
    """Records what is left once all games are flown."""


def entry(suite: Any, source: str) -> SuiteEntry:
    """The entry of a suite by name. Raises UserError, naming `source`, if there is none."""
    if suite not in _ENTRIES:
        raise UserError(f"{source}: suite = {suite!r} is unknown; there are {', '.join(_ENTRIES)}")
    return _ENTRIES[suite]()


def _dp1() -> SuiteEntry:
    from uavaccel.suites.dp1 import flights as dp1
    from uavaccel.suites.dp1 import report as dp1_report
    from uavaccel.suites.dp1 import table as dp1_table

    def cost(config: dp1.Dp1Config, case: dp1.Case) -> Cost:
        calls_s = 6 * CALL_S * case.simulated_s() / case.t_move_s
        return Cost(_flying_s(case, case.clock_speed) + calls_s, case.simulated_s() * RECORDER_BYTES_PER_S)

    return SuiteEntry(
        dp1.Dp1Config,
        dp1.cases,
        Suite(dp1.SCENE, dp1.run_case),
        cost,
        dp1_report.write_report,
        SummaryTable(dp1_table.HEADER, dp1_table.table),
        SummaryTable(dp1_table.OVERVIEW_HEADER, dp1_table.overview),
        quick={"games": 3, "reference_games": 3},
        finish=_record_traces,
    )


def _record_traces(config: Any, run: RunDirectory) -> None:
    """One trace of each command, for Figure 4."""
    from uavaccel.bench.traces import record_trace
    from uavaccel.suites.dp1 import flights as dp1
    from uavaccel.wire.session import open_session

    with open_session(config.timing, config.profile, dp1.SCENE, config.latency) as session:
        for command in config.command:
            trace = record_trace(session, command, max(config.clock_speed), max(config.t_move_s))
            run.write_json(f"traces/{command}.json", trace)


def _dp2() -> SuiteEntry:
    from uavaccel.suites.dp2 import flights as dp2
    from uavaccel.suites.dp2 import report as dp2_report
    from uavaccel.suites.dp2 import table as dp2_table

    def cost(config: dp2.Dp2Config, case: dp2.Case) -> Cost:
        images = case.simulated_s() / config.t_sample_s
        return Cost(_flying_s(case, case.clock_speed) + images * IMAGE_S, images * IMAGE_BYTES)

    return SuiteEntry(
        dp2.Dp2Config,
        dp2.cases,
        Suite(dp2.SCENE, dp2.run_case),
        cost,
        dp2_report.write_report,
        SummaryTable(dp2_table.HEADER, dp2_table.table),
        renders=True,
    )


def _flying_s(case: AnyCase, clock_speed: float) -> float:
    return case.simulated_s() / (clock_speed if case.timing == "wall" else VIRTUAL_RATE)


_ENTRIES: dict[str, Callable[[], SuiteEntry]] = {"dp1": _dp1, "dp2": _dp2}
