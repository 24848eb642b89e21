"""What TensorBoard reads of a training's curves is what was drawn."""

from __future__ import annotations

from pathlib import Path

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from uavaccel.suites.training.rows import CurvesFile


def test_tensorboard_reads_what_was_drawn_of_each_start(tmp_path: Path) -> None:
    folder = tmp_path / "curves"
    for start in range(2):
        curves = CurvesFile(folder)
        for step in (2 * start, 2 * start + 1):
            curves.add(step, {"games/return": 0.5 * step, "games/distance_m": -step})
        curves.close()
    found = []
    for path in sorted(folder.iterdir()):
        read = EventAccumulator(str(path))
        read.Reload()
        assert read.Tags()["scalars"] == ["games/return", "games/distance_m"]
        found += [(each.step, each.value) for each in read.Scalars("games/return")]
    assert sorted(found) == [(step, 0.5 * step) for step in range(4)]
