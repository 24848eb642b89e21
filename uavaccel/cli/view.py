"""`uavaccel view`: a game of a run, or of a policy, as a film and a contact sheet."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from uavaccel.config import validate
from uavaccel.draw.film import Film, write_contact_sheet, write_video
from uavaccel.draw.style import clock_label, command_name
from uavaccel.errors import UserError
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT, policy_folder
from uavaccel.rl.policy import MANIFEST
from uavaccel.suites.dp2.flights import Dp2Config
from uavaccel.suites.dp2.scores import count_events
from uavaccel.suites.evaluation.film import best_first, film_lane
from uavaccel.suites.evaluation.flights import EvaluateConfig, lane_case

Row = Mapping[str, Any]

console = Console(highlight=False, soft_wrap=True)


def view_game(source: str, case: str | None, out: Path | None) -> None:
    """Write CASE.mp4 and CASE.png into `out`, by default the folder view/ of the run, and print their paths.

    `source` is a run directory of dp2 or of an evaluation, or a policy: "default", its folder, a training's run
    directory. Without `case`: the fastest TCSC game, the best evaluated one, a policy's first evaluation lane.
    Raises UserError if there is no such game.
    """
    if (policy_folder(source) / MANIFEST).is_file():
        folder = Path("runs") if source == DEFAULT else Path(source)
        name, film = _fly_policy(source, case or lane_case(0))
    else:
        run = RunDirectory(source)
        folder, (name, film) = run.path, _show_run(run, case)
    folder = out or folder / "view"
    console.print(str(write_video(film, folder / f"{name}.mp4")))
    console.print(str(write_contact_sheet(film, folder / f"{name}.png")))


def _fly_policy(policy: str, case: str) -> tuple[str, Film]:
    lane = re.fullmatch(r"lane-(\d+)", case)
    if not lane:
        raise UserError(f"--case {case}: must be an evaluation lane, as lane-000007")
    task = {"split": "evaluation", "timing": "lockstep"}
    config = validate(EvaluateConfig, {"agent": policy, "task": task}, "view")
    return case, film_lane(config, int(lane[1]))


def _show_run(run: RunDirectory, case: str | None) -> tuple[str, Film]:
    suite = run.config().get("suite")
    if suite == "dp2":
        row = choose(run.rows(), case, run.path)
        return row["case"], film_of(run, row)
    if suite == "evaluate":
        row = choose(best_first(run.rows()), case, run.path)
        config = validate(EvaluateConfig, run.config(), str(run.path / "config.yaml"))
        return row["case"], film_lane(config, int(row["lane"]))
    raise UserError(f"{run.path}: a run of {suite} keeps no images to show; one of dp2 or evaluate does")


def choose(rows: Sequence[Row], case: str | None, run_dir: Path) -> Row:
    """The row of a case; without one the first, or of DP2's the fastest game, TCSC before ADSC."""
    if not rows:
        raise UserError(f"{run_dir / 'rows.jsonl'}: holds no finished game")
    if case is None:
        return max(rows, key=_interest)
    by_name = {row["case"]: row for row in rows}
    if case not in by_name:
        close = difflib.get_close_matches(case, by_name, n=1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(by_name)}"
        raise UserError(f"--case {case}: not in {run_dir}; {hint}")
    return by_name[case]


def _interest(row: Row) -> Any:
    return row.get("role") == "game", row.get("command") == "tcsc", row.get("clock_speed", 0.0)


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
