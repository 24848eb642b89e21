"""`uavaccel report`: metrics and figures of finished runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uavaccel.cli.run import console, report_run
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.report import report_evaluations
from uavaccel.suites.training.report import report_trainings


def report_runs(run_dirs: Sequence[Path]) -> None:
    """Each experiment's report; one figure for all evaluations, one for all trainings. Raises UserError."""
    together: dict[str, list[RunDirectory]] = {"evaluate": [], "train": []}
    for run_dir in run_dirs:
        run = RunDirectory(run_dir)
        suite = str(run.config().get("suite"))
        if suite not in together:
            report_run(run_dir)
        elif not run.rows():
            raise UserError(f"{run_dir / 'rows.jsonl'}: holds no finished game")
        else:
            together[suite].append(run)
    if together["evaluate"]:
        console.print(str(report_evaluations(together["evaluate"])))
    if together["train"]:
        console.print(str(report_trainings(together["train"])))
