"""`uavaccel run` and `uavaccel report`: configuration, host check, flights, report, and what the terminal shows."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from uavaccel.cli.progress import Progress
from uavaccel.clock import calendar_time
from uavaccel.errors import UsageError, UserError
from uavaccel.manifest import describe_run
from uavaccel.records import RunDirectory
from uavaccel.report.dp1_report import write_report
from uavaccel.report.dp1_table import HEADER, OVERVIEW_HEADER, overview, table
from uavaccel.suites import dp1
from uavaccel.suites.experiment import read_mapping, resolve
from uavaccel.suites.host_check import check_host
from uavaccel.suites.runner import Suite, run_cases
from uavaccel.suites.traces import record_trace
from uavaccel.wire.session import open_session

SINGLE_CLOCK_GAMES = 3  # of a quick measurement: `run dp1 --clock 50` and nothing else
NPZ_BYTES_PER_S = 20 * 14 * 8  # of simulated time
VIRTUAL_RATE = 300.0  # simulated seconds a wall second and process, about
CALL_S = 150e-6  # wall time of a call on a loopback socket, about

TABLE_WIDTH = 170

console = Console(highlight=False)


@dataclass(frozen=True)
class Request:
    """What was asked for on the command line."""

    experiment: str
    options: dict[str, Any]
    overrides: Sequence[str]
    jobs: int
    out: Path | None
    resume: bool
    dry_run: bool


def run_experiment(request: Request) -> None:
    """Fly, report, print the table. Raises UserError or UsageError with one clear line."""
    config = configure(request)
    if request.jobs < 1 or (request.jobs > 1 and config.timing == "wall"):
        raise UsageError(
            "--jobs must be 1 with timing wall, since neighbours would spoil the measurement, or above 0"
        )
    cases = list(dp1.cases(config))
    out = (
        request.out
        or Path("runs")
        / f"{request.experiment.removesuffix('.yaml').split('/')[-1]}-{calendar_time()[:19].replace(':', '')}"
    )
    print_plan(config, cases, request.jobs, out)
    if request.dry_run:
        return
    manifest = describe_run(sys.argv, config.seed, calendar_time())
    if config.timing == "wall":
        manifest["host_check"] = check_host()
        console.print(f"host check: {manifest['host_check']['verdict']}")
    run = RunDirectory.create(out, config, manifest, request.resume)
    try:
        fly(config, cases, run, request.jobs)
    except KeyboardInterrupt:
        raise UserError(
            f"interrupted; go on with --out {out} --resume, the other options as they were"
        ) from None
    report_run(out)


def configure(request: Request) -> dp1.Dp1Config:
    """The configuration. A shipped experiment with a single --clock is measured, on a wall clock, in few games."""
    mapping, source = read_mapping(request.experiment)
    options = dict(request.options)
    single_clock = options["clock_speed"] is not None and len(options["clock_speed"]) == 1
    if single_clock and not request.experiment.endswith((".yaml", ".yml")):
        options["timing"] = options["timing"] or "wall"
        options["games"] = options["games"] or SINGLE_CLOCK_GAMES
        mapping["reference_games"] = SINGLE_CLOCK_GAMES
    if mapping.get("suite") != "dp1":
        raise UserError(f"{source}: suite = {mapping.get('suite')!r} is unknown; there is dp1")
    return resolve(dp1.Dp1Config, mapping, source, options, request.overrides)


def print_plan(config: dp1.Dp1Config, cases: Sequence[dp1.Case], jobs: int, out: Path) -> None:
    """Games, simulated seconds, estimated wall time and disk of the run to come."""
    simulated_s = sum(case.simulated_s() for case in cases)
    wall_s = sum(estimated_wall_s(case, jobs) for case in cases)
    disk_mb = simulated_s * NPZ_BYTES_PER_S / 1e6
    console.print(
        f"{len(cases)} games, {simulated_s:,.0f} simulated s, timing {config.timing} "
        f"({'measured' if config.timing == 'wall' else 'modelled'}; references {config.reference_timing}): "
        f"about {wall_s / 60:.1f} min and {disk_mb:.0f} MB, into {out}"
    )


def estimated_wall_s(case: dp1.Case, jobs: int) -> float:
    """About how long a game takes on this kind of machine."""
    if case.timing != "wall":
        return case.simulated_s() / VIRTUAL_RATE / jobs
    return case.simulated_s() / case.clock_speed + 6 * CALL_S * case.simulated_s() / case.t_move_s


def fly(config: dp1.Dp1Config, cases: Sequence[dp1.Case], run: RunDirectory, jobs: int) -> None:
    """Fly what has no row yet, then record one trace of each command."""
    done = run.done_cases()
    with Progress(sum(case.simulated_s() for case in cases), len(cases), console) as progress:
        for case in cases:
            if case.id in done:
                progress.skip(case.simulated_s())
        run_cases(Suite(dp1.SCENE, dp1.run_case), config, cases, run, jobs, progress.flown)
    with open_session(config.timing, config.profile, dp1.SCENE, config.latency) as session:
        for command in config.command:
            trace = record_trace(session, command, max(config.clock_speed), max(config.t_move_s))
            run.write_json(f"traces/{command}.json", trace)


def print_table(summary: dict[str, Any]) -> None:
    """Every cell where the terminal is wide enough, as a file or pipe is; else the worst of each ClockSpeed."""
    wide = not console.is_terminal or console.width >= TABLE_WIDTH
    header, rows = (HEADER, table(summary)) if wide else (OVERVIEW_HEADER, overview(summary))
    lines = Table(*header, box=None, pad_edge=False)
    for row in rows:
        lines.add_row(*row)
    console.print(lines, width=TABLE_WIDTH if wide else None)


def report_run(run_dir: Path) -> None:
    """Write a run's report; print its table and the paths of its figures."""
    summary = write_report(run_dir)
    print_table(summary)
    slow = [cell for cell in summary["cells"] if cell["lost_wall_s"]]
    if slow:
        lost_s = sum(cell["lost_wall_s"] for cell in slow)
        console.print(
            f"warning: the machine did not keep up in {len(slow)} cells and lost {lost_s:.3f} s of wall time"
        )
    for path in sorted((run_dir / "figures").glob("*.png")):
        console.print(str(path))
    console.print(f"report: {run_dir / 'report.html'}")
