"""Trainings with `simulator: kernels`: where nothing is seen they learn what the exact simulator's lanes teach."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.running import configured, fly_into
from uavaccel.records import RunDirectory
from uavaccel.rl.policy import trained_with
from uavaccel.suites.train import Training

TINY = (
    *("task.observation=state", "task.max_commands=6", "hidden=[16]", "mirror=false", "environments=3"),
    *("options.learning_starts=6", "options.batch_size=8", "options.buffer_size=200"),
)


def weights(out: Path, *overrides: str) -> str:
    fly_into(out, Training(), configured("train", *TINY, *overrides, games=9))
    return str(trained_with(out)["weights_sha256"])


@pytest.mark.slow
@pytest.mark.parametrize("timing", ["lockstep", "virtual"])
def test_lanes_over_arrays_teach_the_same_weights(timing: str, tmp_path: Path) -> None:
    """TCSC flies the same under any latencies, and these are charged: a game's phases are told."""
    exact = weights(tmp_path / "exact", f"task.timing={timing}")
    assert weights(tmp_path / "kernels", f"task.timing={timing}", "simulator=kernels") == exact
    row = RunDirectory(tmp_path / "kernels").rows()[-1]
    assert (row["phase_s"]["inference"] > 0) == (row["phase_s"]["learning"] > 0) == (timing == "virtual")
