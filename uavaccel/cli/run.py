"""`uavaccel run` and `uavaccel report`: configuration, host check, flights, report, and what the terminal shows."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_origin

from rich.console import Console
from rich.table import Table

from uavaccel.bench.machine import check_host
from uavaccel.cli.progress import Progress
from uavaccel.cli.shared import check_jobs, given, resumable, time_stamp
from uavaccel.cli.suites import SuiteEntry, entry
from uavaccel.clock import calendar_time
from uavaccel.errors import UsageError
from uavaccel.manifest import describe_run
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment, read_mapping, resolve
from uavaccel.suites.runner import AnyCase, run_cases

TABLE_WIDTH = 170

console = Console(highlight=False)
if not console.is_terminal:
    console.width = TABLE_WIDTH  # a file or a pipe has room


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
    suite, config = configure(request)
    check_jobs(request.jobs, config.timing)
    cases = list(suite.cases(config))
    out = request.out or Path("runs") / f"{Path(request.experiment).stem}-{time_stamp()}"
    print_plan(suite, config, cases, request.jobs, out)
    if request.dry_run:
        return
    run = RunDirectory.create(out, config, manifest_of(suite, config), request.resume)
    with resumable(out):
        fly(suite, config, cases, run, request.jobs)
    report_run(out)


def configure(request: Request) -> tuple[SuiteEntry, Any]:
    """Suite and configuration. A shipped experiment with a single --clock is measured on a wall clock, quickly."""
    mapping, source = read_mapping(request.experiment)
    suite = entry(mapping.get("suite"), source)
    options = given(request.options)
    shipped = not request.experiment.endswith((".yaml", ".yml"))
    if shipped and len(options.get("clock_speed", ())) == 1:
        mapping |= suite.quick
        options.setdefault("timing", "wall")
    _fit_options(suite, options, mapping["suite"])
    return suite, resolve(suite.config, mapping, source, options, request.overrides)


def _fit_options(suite: SuiteEntry, options: dict[str, Any], name: str) -> None:
    """Turn an option given once into the one value that the suite takes. Raises UsageError where it takes none."""
    for key, value in options.items():
        option = f"--{key.replace('clock_speed', 'clock').removesuffix('_s').replace('_', '-')}"
        if key not in suite.config.model_fields:
            raise UsageError(f"{option}: {name} has no such option")
        several = get_origin(suite.config.model_fields[key].annotation) is tuple
        if isinstance(value, list) and not several:
            if len(value) > 1:
                raise UsageError(f"{option}: {name} takes one value, not {len(value)}")
            options[key] = value[0]


def manifest_of(suite: SuiteEntry, config: Experiment) -> dict[str, Any]:
    """What the run is made with. Checks the host first, and the renderer of a suite that needs one."""
    renderer = None
    if suite.renders:
        from uavaccel.sim.gl import describe_renderer

        renderer = describe_renderer()
        console.print(f"renderer: {renderer.name}{' (software)' if renderer.software else ''}")
    name = renderer.name if renderer else None
    manifest = describe_run(sys.argv, config.seed, calendar_time(), gl_renderer=name)
    if config.timing == "wall":
        manifest["host_check"] = check_host()
        console.print(f"host check: {manifest['host_check']['verdict']}")
    return manifest


def print_plan(suite: SuiteEntry, config: Any, cases: Sequence[AnyCase], jobs: int, out: Path) -> None:
    """Games, simulated seconds, estimated wall time and disk of the run to come."""
    simulated_s = sum(case.simulated_s() for case in cases)
    costs = [suite.cost(config, case) for case in cases]
    wall_s = sum(
        cost.wall_s / (1 if case.timing == "wall" else jobs) for case, cost in zip(cases, costs, strict=True)
    )
    disk_mb = sum(cost.disk_bytes for cost in costs) / 1e6
    console.print(
        f"{len(cases)} games, {simulated_s:,.0f} simulated s, timing {config.timing} "
        f"({'measured' if config.timing == 'wall' else 'modelled'}; references {config.reference_timing}): "
        f"about {wall_s / 60:.1f} min and {disk_mb:.0f} MB, into {out}"
    )


def fly(suite: SuiteEntry, config: Any, cases: Sequence[AnyCase], run: RunDirectory, jobs: int) -> None:
    """Fly what has no row yet, then record what else the suite's report needs."""
    done = run.done_cases()
    with Progress(sum(case.simulated_s() for case in cases), len(cases), console) as progress:
        for case in cases:
            if case.id in done:
                progress.skip(case.simulated_s())
        run_cases(suite.suite, config, cases, run, jobs, progress.flown)
    if suite.finish is not None:
        suite.finish(config, run)


def print_table(suite: SuiteEntry, summary: Mapping[str, Any]) -> None:
    """Every cell where there is room; else the suite's overview, if it has one."""
    wide = console.width >= TABLE_WIDTH
    header, rows = suite.table if wide or suite.overview is None else suite.overview
    lines = Table(*header, box=None, pad_edge=False)
    for row in rows(summary):
        lines.add_row(*row)
    console.print(lines)


def report_run(run_dir: Path) -> None:
    """Write a run's report; print its table and the paths of its figures."""
    run = RunDirectory(run_dir)
    suite = entry(run.config().get("suite"), str(run.path / "config.yaml"))
    summary = suite.write_report(run_dir)
    print_table(suite, summary)
    slow = [cell for cell in summary["cells"] if cell["lost_wall_s"]]
    if slow:
        lost_s = sum(cell["lost_wall_s"] for cell in slow)
        console.print(
            f"warning: the machine did not keep up in {len(slow)} cells and lost {lost_s:.3f} s of wall time"
        )
    for path in sorted((run_dir / "figures").glob("*.png")):
        console.print(str(path))
    console.print(f"report: {run_dir / 'report.html'}")
