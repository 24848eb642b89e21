"""What the tests of the learning part share: a training small enough for a test, and a run that dies on the way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.running import run_into
from uavaccel.config import load_yaml, to_yaml, validate
from uavaccel.envs.batch import LanesHere
from uavaccel.records import RunDirectory
from uavaccel.rl import lanes
from uavaccel.rl.config import LearnerConfig
from uavaccel.suites import trainer
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.registry import configuration, find_suite
from uavaccel.suites.runner import run_suite, start_run
from uavaccel.suites.train import TrainConfig, Training

OPTIONS = {"learning_starts": 8, "batch_size": 8, "buffer_size": 300, "target_update_interval": 16}


def tiny_config(task: dict[str, Any] | None = None, **keys: Any) -> TrainConfig:
    """Four games of a dozen commands, and a network of a few hundred weights that learns after eight commands."""
    tiny = {"games": 4, "options": OPTIONS, "channels": [4, 4], "hidden": [16], "checkpoint_games": 2, **keys}
    return validate(TrainConfig, {**tiny, "task": {"max_commands": 12, **(task or {})}}, "test")


def train_into(out: Path, config: TrainConfig, resume: bool = False) -> dict[str, Any]:
    """Train; the summary."""
    return dict(run_into(out, Training(), config, resume))


def side_by_side(config: LearnerConfig, *_: Any) -> LanesHere:
    """As make_lanes, but in this process."""
    keywords: dict[str, Any] = {**config.task.model_dump(mode="json"), "report_host_times": True}
    return LanesHere(config.environment_class, config.environments, autoreset_mode="SameStep", **keywords)


def fly_here(put: Callable[[Any, str, Any], None] = setattr) -> None:
    """Trainings fly their lanes in this process and nobody draws them: both take longer than a small one itself."""
    put(trainer, "make_lanes", side_by_side)
    put(lanes, "start_exact_lanes", lambda *_: None)
    put(Training, "page", lambda *_: iter(()))
    put(Evaluation, "page", lambda *_: iter(()))


def kill_at_row(out: Path, config: Experiment, row: int) -> None:
    """Fly into `out`, in a process that dies without a word at the so-manieth row that any run in it writes."""
    out.with_suffix(".yaml").write_text(to_yaml(config))
    program = "import sys; from tests.learning import fly_until_killed; fly_until_killed(*sys.argv[1:])"
    command = [sys.executable, "-c", program, str(out.with_suffix(".yaml")), str(out), str(row)]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL


def fly_until_killed(file: str, out: str, rows: str) -> None:
    fly_here()
    append, left = RunDirectory.append_row, [int(rows)]

    def append_and_die(run: RunDirectory, row: Any, on_disk: bool = True) -> None:
        append(run, row, on_disk)
        left[0] -= 1
        if not left[0]:
            os.kill(os.getpid(), signal.SIGKILL)

    RunDirectory.append_row = append_and_die  # type: ignore[assignment, method-assign]
    mapping = load_yaml(Path(file))
    suite = find_suite(mapping["suite"], file)
    config = configuration(suite, mapping, file)
    run_suite(suite, config, start_run(suite, config, Path(out), {}))
