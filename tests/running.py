"""Runs of suites, for tests that do not need the command line."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.web_pages import assert_sound
from uavaccel.cli.main import app
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.report import Summary
from uavaccel.suites.runner import run_suite, start_run
from uavaccel.suites.session import RunRequest, configure
from uavaccel.suites.suite import AnySuite


def fly_into(out: Path, suite: AnySuite, config: Experiment, resume: bool = False, jobs: int = 1) -> RunDirectory:
    """Fly without a report, whose figures would take longer than most tests' flights."""
    run = start_run(suite, config, out, {}, resume)
    run_suite(suite, config, run, jobs)
    return run


def run_into(out: Path, suite: AnySuite, config: Experiment, resume: bool = False, jobs: int = 1) -> Summary:
    """Fly and report; the summary. Each suite's page is looked at on the way."""
    run = fly_into(out, suite, config, resume, jobs)
    summary = suite.report(run).write()
    assert_sound((out / "report.html").read_text(encoding="utf-8"))
    return summary


@contextmanager
def stopped_at(here: Callable[[RunDirectory, Any], bool]) -> Iterator[None]:
    """Interrupt a run, or a part of it, before the row of which this is true is in its file."""
    append = RunDirectory.append_row

    def append_or_stop(run: RunDirectory, row: Any, on_disk: bool = True) -> None:
        if here(run, row):
            raise KeyboardInterrupt
        append(run, row, on_disk)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RunDirectory, "append_row", append_or_stop)
        with pytest.raises(KeyboardInterrupt):
            yield


def configured(experiment: str, *overrides: str, **options: Any) -> Any:
    """The configuration of an experiment as the command line puts it together."""
    return configure(RunRequest(experiment, options, overrides))[1]


def typed(line: str) -> str:
    """What a command prints, called as its shell would."""
    done = CliRunner().invoke(app, line.split(), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def full_device(path: Path) -> None:
    """Make a file of a path to which nothing can be written, as on a full disk; skips where that is not allowed."""
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 7))
        path.open("wb").close()
    except OSError:
        pytest.skip("no device can be made here")
