"""`uavaccel run`, also behind `train` and `evaluate`: configuration, machine check, games, report, resuming."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from itertools import accumulate, islice
from pathlib import Path
from typing import get_origin

from pydantic import BaseModel
from rich import table as rich_table
from rich.console import Console

from uavaccel.bench.machine import check_machine
from uavaccel.cli.checks import check_out, check_watchable
from uavaccel.cli.progress import Progress, working
from uavaccel.cli.terminal import console
from uavaccel.clock import calendar_time
from uavaccel.config import apply_overrides
from uavaccel.draw.page import Table
from uavaccel.errors import Interrupted, UsageError, UserError, mistake_of
from uavaccel.files import Plain
from uavaccel.limits import MOST_GAMES
from uavaccel.manifest import describe_run
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.suites.engines import LOKY, check_engine
from uavaccel.suites.experiment import Experiment, is_file, merged, read_mapping, timing_of
from uavaccel.suites.old_report import Summary
from uavaccel.suites.own_code import told
from uavaccel.suites.registry import find_suite, suite_of
from uavaccel.suites.runner import begin_run, check_cases, check_jobs, run_suite
from uavaccel.suites.suite import AnySuite, Case, configuration
from uavaccel.watch.beside import PageAddress, page_beside
from uavaccel.watch.server import free_port

COLUMN_GAP = 2  # characters between the columns of a table, as wide as rich pads them
TABLE_WIDTH = 170  # where the output is no terminal


def resumed_config(
    out: Path | None, resume: bool, suite_name: str | None
) -> tuple[AnySuite, dict[str, Plain]]:
    """Return the suite and the configuration of the run in `out`.

    Raises UsageError if nothing says what to fly, UserError if the folder has no run of this suite.
    """
    if not resume or out is None:
        raise UsageError(
            "name an experiment, as in `uavaccel run dp1`, or a run's folder: --out FOLDER --resume"
        )
    if not (out / "config.yaml").is_file():
        raise UserError(
            f"--out {out}: no run to go on with: no config.yaml in it; name an experiment to begin one"
        )
    run = RunDirectory(out)
    suite = suite_of(run)
    if suite_name not in (None, suite.name):
        raise UserError(
            f"--out {out}: is a run of {suite.name}, not of {suite_name}; go on with `uavaccel run`"
        )
    return suite, run.config()


def resumption_notes(run: RunDirectory, games: int, now: Mapping[str, Plain]) -> Iterator[str]:
    """Yield lines about a run that is resumed: from where, and which versions have changed since it was begun."""
    yield f"going on with {run.path}: {len(run.rows())} of {games} games are flown"
    manifest = run.manifest()
    before = [manifest, *manifest.get("resumed", [])[:-1]][-1].get("versions", {})
    changed = [
        f"{name} {before[name]} then, {version} now"
        for name, version in now.get("versions", {}).items()
        if name in before and before[name] != version
    ]
    if changed:
        yield f"warning: flown so far with other versions: {'; '.join(changed)}"
    first, commit = (each.get("git") or {} for each in (manifest, now))
    if first.get("commit") and commit.get("commit") and first["commit"] != commit["commit"]:
        yield f"warning: begun with another commit of uavaccel: {first['commit'][:12]}, now {commit['commit'][:12]}"


@dataclass(frozen=True)
class RunRequest:
    """The request on the command line; options that were not given are None."""

    experiment: str | None
    """A name or a file; None for that of the run in `out`, to resume."""
    options: Mapping[str, object] = field(default_factory=dict)
    overrides: Sequence[str] = ()
    jobs: int = 1
    out: Path | None = None
    resume: bool = False
    dry_run: bool = False
    suite: str | None = None
    """The suite that the command is restricted to."""
    engine: str = LOKY
    page: PageAddress | None = None
    """Where a page in the browser shows the flights, if anywhere."""
    trust: bool = False
    """Whether code that a resumed run names may run; that of an experiment which is named here may."""

    def told(self) -> AbstractContextManager[None]:
        """Return the context in which own code runs as far as it was asked for."""
        file = self.experiment if self.experiment is not None and is_file(self.experiment) else None
        return told(
            self.trust or self.experiment is not None, None if file is None else Path(file).resolve().parent
        )


BeforeReport = Callable[[RunDirectory], None]


def run_experiment(request: RunRequest, before_report: BeforeReport | None = None) -> RunDirectory | None:
    """Fly and report an experiment; returns the run, or None for a dry run. Raises UserError with one line.

    `before_report` makes of the flown run what its report shows.
    """
    with request.told():
        return _run_experiment(request, before_report)


def _run_experiment(request: RunRequest, before_report: BeforeReport | None) -> RunDirectory | None:
    if request.resume and request.out is None and request.experiment is not None:
        raise UsageError("--resume: say which run to go on with: --out FOLDER")
    suite, config = configure(request)
    check_jobs(suite, config, request.jobs, request.engine)
    cases = list(islice(suite.cases(config), MOST_GAMES + 1))
    if len(cases) > MOST_GAMES:
        raise UserError(f"more than {MOST_GAMES} games in all: fewer games, or fewer values to combine")
    check_cases(suite, cases)
    check_engine(request.engine)
    if request.page is not None:
        check_watchable(getattr(config, "simulator", None), request.engine)
        free_port(request.page.host, request.page.port)
    if request.out is not None and not request.dry_run:
        check_out(request.out, request.resume)
    name = Path(request.experiment or suite.name).stem
    out = request.out or Path("runs") / f"{name}-{calendar_time()[:19].replace(':', '')}"
    flown = flown_cases(out) if request.resume else set()
    left = [case for case in cases if case.id not in flown]
    console.print(plan(suite, config, left, out))
    alone = sum(case.timing == "wall" for case in cases)
    if alone and (request.jobs > 1 or request.engine != LOKY):
        console.print(f"{alone} games on the wall clock fly alone, in this process, one by one")
    if request.dry_run:
        return None
    with resumable(out):
        manifest = manifest_of(suite, config)
        run = begin_run(suite, config, out, manifest, request.resume)
        if "resumed" in run.manifest():
            for line in resumption_notes(run, len(cases), manifest):
                console.print(line)
        with page_beside(request.page):
            fly(suite, config, cases, run, request.jobs, request.engine)
        try:
            if before_report is not None:
                before_report(run)
        finally:
            report_run(run)
    return run


def flown_cases(out: Path) -> set[str]:
    """Return the cases of the run in `out` that need not be flown again; none where no run has begun."""
    return RunDirectory(out).done_cases() if (out / "config.yaml").is_file() else set()


def configure(request: RunRequest) -> tuple[AnySuite, Experiment]:
    """Return the suite and the configuration of a request; without an experiment those of the run that is resumed.

    A shipped experiment with a single --clock is shortened, and measured on the wall clock.
    """
    with request.told():
        return _configure(request)


def _configure(request: RunRequest) -> tuple[AnySuite, Experiment]:
    own_file = request.experiment is None or is_file(request.experiment)
    if request.experiment is None:
        suite, mapping = resumed_config(request.out, request.resume, request.suite)
        source = str(request.out)
    else:
        mapping, source = read_mapping(request.experiment)
        name = apply_overrides(mapping, request.overrides).get("suite")
        suite = find_suite(name, source)
        if request.suite not in (None, suite.name):
            raise UsageError(
                f"{request.experiment}: is of {suite.name}, not of {request.suite}; `uavaccel run` flies it"
            )
    given = {key: value for key, value in request.options.items() if value is not None}
    if not own_file and suite.quick is not None and len(_values(given.get("clock_speed", ()))) == 1:
        mapping |= suite.quick
        given.setdefault("timing", "wall")
    options = {key: value for name in given for key, value in [place(suite, name, given[name])]}
    return suite, configuration(suite, merged(mapping, options, request.overrides), source)


def place(suite: AnySuite, name: str, value: object) -> tuple[str, object]:
    """Return the dotted key of an option, at the top of the configuration or in its task, and the value for that key.

    Raises UsageError if the suite has no such key, or takes one value and was given several.
    """
    short = name.replace("clock_speed", "clock").removesuffix("_s").removesuffix("_run")
    option, fields = f"--{short.replace('_', '-')}", suite.config.model_fields
    task = fields["task"].annotation if "task" in fields else None
    holder: type[BaseModel] = suite.config
    if name not in fields and isinstance(task, type) and issubclass(task, BaseModel):
        holder = task
    if name not in holder.model_fields:
        raise UsageError(f"{option}: {suite.name} has no such option")
    if get_origin(holder.model_fields[name].annotation) is not tuple:
        values = _values(value)
        if len(values) > 1:
            raise UsageError(f"{option}: {suite.name} takes one value, not {len(values)}")
        value = values[0]
    return (name if holder is suite.config else f"task.{name}"), value


def _values(value: object) -> list[object]:
    return list(value) if isinstance(value, list | tuple) else [value]


def manifest_of(suite: AnySuite, config: Experiment) -> dict[str, Plain]:
    """Return the run's manifest, after checks of the machine and of the renderer if the suite needs one."""
    name = None
    if suite.renders(config):
        from uavaccel.sim.camera.gl import describe_renderer

        renderer = describe_renderer()
        name = renderer.name
        console.print(f"renderer: {name}{' (software)' if renderer.software else ''}")
    manifest = describe_run(sys.argv, config.seed, calendar_time(), gl_renderer=name)
    manifest.update(suite.provenance(config))
    if timing_of(config) == "wall":
        manifest["host_check"] = check_machine()
        console.print(f"machine check: {manifest['host_check']['verdict']}")
    return manifest


def plan(suite: AnySuite, config: Experiment, cases: Sequence[Case], out: Path) -> str:
    """Return the planned run in a line: games by clock, and simulated seconds; the first game tells what they take."""
    if not cases:
        return f"no game is left to be flown in {out}"
    clocks = Counter(case.timing for case in cases)
    by_clock = ", ".join(f"{count} {timing}" for timing, count in clocks.items())
    simulated_s = sum(case.simulated_s() for case in cases)
    games = sum(suite.games(config, case) for case in cases)
    what = f"{games} games" if games == len(cases) else f"{games:,} games in {len(cases)} cells"
    sources = " and ".join(sorted({timing_provenance(timing) for timing in clocks}))
    return (
        f"{what} ({by_clock}: {sources}), {simulated_s:,.0f} simulated s, wall time known after the first, into {out}"
    )


def fly(
    suite: AnySuite, config: Experiment, cases: Sequence[Case], run: RunDirectory, jobs: int, engine: str
) -> None:
    """Fly the cases that have no row yet."""
    with Progress(cases, jobs, run.rows(), suite.status, console) as progress:
        run_suite(suite, config, run, jobs, progress.flown, engine)


@contextmanager
def resumable(out: Path) -> Iterator[None]:
    """Turn Ctrl-C, and errors of the system such as a full disk, into a line that says how to resume what was begun."""
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted{_going_on(out)}") from None
    except (OSError, MemoryError) as error:
        if (refused := mistake_of(error)) is None:
            raise
        raise UserError(f"{refused}{_going_on(out)}") from error
    except UserError as error:
        if not isinstance(error.__cause__, OSError):
            raise
        raise UserError(f"{error}{_going_on(out)}") from error


def _going_on(out: Path) -> str:
    begun = (out / "config.yaml").is_file()
    return f"; go on with: uavaccel run --out {shlex.quote(str(out))} --resume" if begun else ""


def report_run(run: RunDirectory) -> Summary:
    """Write a run's report, and print its result and the paths of its figures."""
    report = suite_of(run).report(run)
    with working("the report", console):
        summary = report.write()
    if headline := report.headline():
        console.print(headline)
    if pace := report.pace():
        console.print(pace)
    if table := report.overview():
        show_table(table)
    cells = summary.get("cells", ())
    if lost := [cell["lost_wall_s"] for cell in cells if cell.get("lost_wall_s")]:
        console.print(
            f"warning: the machine did not keep up: {sum(lost):.3f} s of wall time lost "
            f"in {len(lost)} of {len(cells)} cells"
        )
    for path in sorted((run.path / "figures").glob("*.png")):
        console.print(str(path))
    console.print(f"report: {run.path / 'report.html'}")
    return summary


def show_table(table: Table) -> None:
    """Print the columns of a table that fit into the terminal uncut, and say how many more the report has.

    In a file there is room for all.
    """
    width = console.width if console.is_terminal else TABLE_WIDTH
    fit = columns_within(table, width)
    lines = rich_table.Table(*table.header[:fit], box=None, pad_edge=False)
    for row in table.rows:
        lines.add_row(*row[:fit])
    Console(highlight=False, width=width).print(lines)
    if left := len(table.header) - fit:
        console.print(f"{left} more column{'s' if left > 1 else ''} in the report")


def columns_within(table: Table, width: int) -> int:
    """Return how many columns, from the left and at least one, fit into `width` characters.

    A column is as wide as its widest cell, or the longest word of its header, which may be broken into lines.
    """
    widths = [
        max(map(len, [*name.split(), *cells, ""])) + COLUMN_GAP
        for name, *cells in zip(table.header, *table.rows, strict=True)
    ]
    fit = sum(end - COLUMN_GAP <= width for end in accumulate(widths))
    return max(fit, 1)
