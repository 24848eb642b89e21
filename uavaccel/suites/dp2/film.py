"""A game of DP2 as a film, from the images that the run kept."""

from __future__ import annotations

from uavaccel.config import validate
from uavaccel.draw.film import PANEL, Film
from uavaccel.draw.style import clock_label, command_name
from uavaccel.errors import UserError
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.sim.chase import ChaseView
from uavaccel.suites.dp2.cases import Dp2Row
from uavaccel.suites.dp2.config import Dp2Config
from uavaccel.suites.dp2.scores import counts_of
from uavaccel.suites.suite import choose_row


def film_game(run: RunDirectory, case: str | None) -> tuple[str, Film]:
    """The case's film, by default of the fastest game, TCSC before ADSC. Raises UserError without images."""
    row = choose_row(run, case, sorted(run.rows(), key=_interest, reverse=True))
    config = validate(Dp2Config, run.config(), str(run.path / "config.yaml"))
    arrays = run.load_arrays(row)
    if "image" not in arrays:
        raise UserError(f"{run.path / row['arrays']}: holds no images")
    on, off = counts_of(arrays, config.dvs_preset, config.sensor_seed)
    images = arrays.get("colour", arrays["image"])  # in colour where the run kept it
    position_m, layout = arrays["position_m"], config.layout()
    chase = ChaseView(layout, position_m, arrays["orientation_wxyz"], PANEL)
    film = Film(_title(row), arrays["time_s"], images, on, off, position_m, layout, chase)
    return row["case"], film


def _interest(row: Dp2Row) -> tuple[bool, bool, float]:
    return row["role"] == "game", row["command"] == "tcsc", row["clock_speed"]


def _title(row: Dp2Row) -> str:
    if row["timing"] == "lockstep":
        return f"{command_name(row['command'])} in lockstep, without latency"
    clock = f"{command_name(row['command'])} at ClockSpeed {clock_label(row['clock_speed'])}"
    achieved = f"achieved {row['real_time_factor']:.1f}x, {timing_provenance(row['timing'])}"
    end = f", hit {row['collision']['object']}" if row["collision"] else ""
    return f"{clock} ({achieved}{end})"
