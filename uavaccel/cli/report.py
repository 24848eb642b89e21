"""`uavaccel report`: metrics and figures of finished runs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from uavaccel.cli.run import console, report_run
from uavaccel.records import RunDirectory
from uavaccel.suites.registry import suite_of


def report_runs(run_dirs: Sequence[Path]) -> None:
    """Each run's report; then those of one suite side by side. No game is flown. Raises UserError."""
    by_suite: dict[str, list[RunDirectory]] = defaultdict(list)
    for run_dir in run_dirs:
        run = RunDirectory(run_dir)
        report_run(run)
        by_suite[str(run.config()["suite"])].append(run)
    for runs in by_suite.values():
        if len(runs) > 1:
            for path in suite_of(runs[0]).compare(runs):
                console.print(str(path), markup=False)
