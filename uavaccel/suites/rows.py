"""Rows of rows.jsonl: the keys that games of several suites share, and how they are filled in."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, NotRequired, TypeVar, cast

import numpy as np
from pydantic import AfterValidator
from typing_extensions import TypedDict

from uavaccel.files import Plain
from uavaccel.forms import Count, NotNegative, Number, Positive
from uavaccel.limits import Seed
from uavaccel.suites.experiment import CommandName, FlightExperiment, ProfileName, Timing
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:  # environments load Gymnasium, a client the simulation
    from uavaccel.envs.values import Info
    from uavaccel.sim.recording import Recording
    from uavaccel.wire.client import Client

Row = Mapping[str, Plain]
"""A row as it is read back; suites declare the keys of their own rows as a `GameRow`."""

Disturbance = Literal["lost_wall_s", "stalled_wall_s", "restarts"]
DISTURBANCES: tuple[Disturbance, ...] = ("lost_wall_s", "stalled_wall_s", "restarts")
Entry = TypeVar("Entry")
Key = TypeVar("Key")


class Disturbances(TypedDict, total=False):
    """What disturbed a game on the machine's own clock; the keys are absent from the rows of undisturbed games."""

    lost_wall_s: NotNegative
    """Wall time that the simulation could not make good."""
    stalled_wall_s: NotNegative
    """Wall time during which the server did not answer."""
    restarts: Count
    """How often the server was started again."""
    disturbed: bool


class GameRow(Disturbances):
    """The keys that the row of a game has in every suite."""

    suite: str
    case: str
    arrays: NotRequired[str]
    arrays_sha256: NotRequired[str]


def _all_phases(spent_s: dict[str, float]) -> dict[str, float]:
    from uavaccel.envs.stopwatch import PHASES

    if missing := [phase for phase in PHASES if phase not in spent_s]:
        raise ValueError(f"should have the phase {missing[0]!r}")
    return spent_s


Phases = Annotated[dict[str, NotNegative], AfterValidator(_all_phases)]
"""Seconds of a game or a training by phase."""


class LaneRow(GameRow):
    """The row of a game in the obstacle lane, in a training as in an evaluation."""

    is_success: bool
    distance_m: Number
    collision: str | None
    lane: Count
    commands: Count
    phase_s: Phases
    sim_time_s: NotNegative
    conditions: NotRequired[Mapping[str, Number]]
    simulator: NotRequired[str]
    """The simulator of an evaluation, unless that is the exact one."""


Role = Literal["reference", "lockstep", "game", "figure2"]


class FlightRow(GameRow):
    """The row of a path that is flown with commands over the wire (DP1, DP2)."""

    role: Role
    command: CommandName
    clock_speed: Positive
    timing: Timing
    profile: ProfileName
    seed: Seed
    wall_s: Positive
    sim_time_s: Positive
    duration_s: Positive
    """Simulated seconds from the start of the first command to the end of the last one."""
    real_time_factor: Positive
    error: str | None
    """What ended the flight early, if anything did."""


@dataclass(frozen=True)
class FlightCase:
    """The conditions of a flight; the role "figure2" is DP1's alone."""

    role: Role
    command: CommandName
    clock_speed: float
    timing: Timing

    @property
    def id(self) -> str:
        """The case's name: role, unless that is "game", command and ClockSpeed."""
        prefix = "" if self.role == "game" else f"{self.role}-"
        return f"{prefix}{self.command}-k{self.clock_speed:g}"


def subset(row: Mapping[str, object], *keys: str) -> dict[str, Plain]:
    """Return the entries of a row under these keys."""
    return {key: row[key] for key in keys}


def named_seed(run_seed: int, name: str) -> np.random.SeedSequence:
    """Return the seed of a game by its name: the same in any subset of a run, and in any order."""
    return np.random.SeedSequence(run_seed, spawn_key=(zlib.crc32(name.encode()),))


def flight_row(
    case: FlightCase, config: FlightExperiment, client: Client, wall_s: float
) -> tuple[dict[str, Plain], Recording]:
    """Return the row of a flight that took `wall_s` from its first command on, and the server's recording of it."""
    speed, recording = client.speed(), client.recording()
    row: Plain = {
        "role": case.role,
        "command": case.command,
        "clock_speed": case.clock_speed,
        "timing": case.timing,
        "profile": config.profile,
        "seed": config.seed,
        "wall_s": wall_s,
        "sim_time_s": speed["simulated_ns"] / NS_PER_S,
        "duration_s": round(int(recording.commands[-1, 1]) * recording.tick_ns / NS_PER_S, 9),
        "real_time_factor": speed["real_time_factor"],
        "lost_wall_s": speed["lost_wall_ns"] / NS_PER_S,
        "error": speed["failure"],
    }
    if client.transport.stalled_ns:
        row["stalled_wall_s"] = client.transport.stalled_ns / NS_PER_S
    return row, recording


def with_lane(ended: Info, number: int) -> Info:
    """Return an info with what environments without lanes lack: the game's number as its lane, metres north."""
    return {"lane": number, "distance_m": ended["position_m"][0]} | ended


def lane_row(suite: str, case: str, ended: Info, t_move_s: float) -> LaneRow:
    """Return the row of a game in the lane from the info of its last step."""
    row: Plain = {"suite": suite, "case": case, "sim_time_s": ended["commands"] * t_move_s}
    row |= subset(ended, "is_success", "distance_m", "collision", "lane", "commands", "phase_s")
    row |= {key: found for key in DISTURBANCES if (found := ended.get(key))}
    if "conditions" in ended:
        row["conditions"] = ended["conditions"]
    return cast(LaneRow, row)


def disturbances(row: Row, restarts: int = 0) -> Disturbances:
    """Return the keys that mark a `wall` game as disturbed; none where it was not."""
    found: Disturbances = {"restarts": restarts} if restarts else {}
    if found or any(row.get(key) for key in DISTURBANCES):
        found["disturbed"] = True
    return found
