"""`uavaccel view`: a game of a run as a film and a contact sheet."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from uavaccel.config import validate
from uavaccel.errors import UserError
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.report.dp2_scores import count_events
from uavaccel.report.style import clock_label, command_name
from uavaccel.report.video import Film, write_contact_sheet, write_video
from uavaccel.suites.dp2 import Dp2Config

Row = Mapping[str, Any]

console = Console(highlight=False, soft_wrap=True)


def view_run(run_dir: Path, case: str | None, out: Path | None) -> None:
    """Write CASE.mp4 and CASE.png into `out`, by default the run's folder view/, and print their paths.

    Without `case` the fastest TCSC game is shown. Raises UserError if the run has no such game, or no images.
    """
    run = RunDirectory(run_dir)
    suite = run.config().get("suite")
    if suite != "dp2":
        raise UserError(f"{run.path}: a run of {suite} keeps no images to show; one of dp2 does")
    row = choose(run.rows(), case, run.path)
    film = film_of(run, row)
    folder = out or run.path / "view"
    console.print(str(write_video(film, folder / f"{row['case']}.mp4")))
    console.print(str(write_contact_sheet(film, folder / f"{row['case']}.png")))


def choose(rows: Sequence[Row], case: str | None, run_dir: Path) -> Row:
    """The row of a case; without one, of the fastest game, TCSC before ADSC."""
    if not rows:
        raise UserError(f"{run_dir / 'rows.jsonl'}: holds no finished game")
    if case is None:
        return max(
            rows, key=lambda row: (row["role"] == "game", row["command"] == "tcsc", row["clock_speed"])
        )
    by_name = {row["case"]: row for row in rows}
    if case not in by_name:
        close = difflib.get_close_matches(case, by_name, n=1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(by_name)}"
        raise UserError(f"--case {case}: not in {run_dir}; {hint}")
    return by_name[case]


def film_of(run: RunDirectory, row: Row) -> Film:
    """A DP2 game as a film: in colour where the run kept it. Raises UserError if its images are gone."""
    config = validate(Dp2Config, run.config(), str(run.path / "config.yaml"))
    arrays = run.load_arrays(row["arrays"])
    if "image" not in arrays:
        raise UserError(f"{run.path / row['arrays']}: holds no images")
    on, off = count_events(arrays["image"], arrays["time_s"], config.dvs_preset, config.sensor_seed)
    images = arrays.get("colour", arrays["image"])
    return Film(_title(row), arrays["time_s"], images, on, off, arrays["position_m"], config.layout())


def _title(row: Row) -> str:
    clock = f"{command_name(row['command'])} at ClockSpeed {clock_label(row['clock_speed'])}"
    if row["timing"] == "lockstep":
        return f"{command_name(row['command'])} in lockstep, without latency"
    achieved = f"achieved {row['real_time_factor']:.1f}x, {timing_provenance(row['timing'])}"
    end = f", hit {row['collision']['object']}" if row["collision"] else ""
    return f"{clock} ({achieved}{end})"
