"""What experiments have in common that fly a path with ADSC and TCSC and compare it with real time: DP1 and DP2."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

from uavaccel.commands import COMMANDS
from uavaccel.config import CommandName, Seed
from uavaccel.files import Plain
from uavaccel.forms import Positive
from uavaccel.kinematics import Vector, VelocityGoal
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.sim.profile import PROFILES
from uavaccel.suites.experiment import FlightExperiment, GameRow, ProfileName, Timing
from uavaccel.suites.suite import Suite
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:  # they load the simulation
    from uavaccel.sim.recording import Recording
    from uavaccel.suites.report import Report
    from uavaccel.wire.session import Client, Session

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

    def simulated_s(self) -> float:
        """Return the simulated time of the commands, without gaps between them."""
        raise NotImplementedError


ConfigType = TypeVar("ConfigType", bound=FlightExperiment)
CaseType = TypeVar("CaseType", bound=FlightCase)


class PathSuite(Suite[ConfigType, CaseType]):
    """A suite whose cases are flights of a path in a scene."""

    scene: ClassVar[str]
    case: type[CaseType]

    def title(self, report: Report) -> str:
        return f"{self.name.upper()}, {report.config.profile} profile, seed {report.config.seed}"

    def case_of(self, row: Plain) -> str:
        return self.case(**{field.name: row.get(field.name) for field in fields(self.case)}).id

    def open(self, config: ConfigType, timing: str, run: RunDirectory) -> AbstractContextManager[Session]:
        from uavaccel.wire.session import open_session

        return open_session(timing, config.profile, self.scene, config.latency)


def fly_path(
    case: FlightCase, config: Any, client: Any, velocities: Iterable[Vector], t_move_s: float, t_sample_s: float
) -> tuple[int, Iterator[list[Any]]]:
    """Return the wall time in ns at which the path starts, and the samples of the command of each velocity, as flown.

    `velocities` are NED in m/s, and `client` is the game's, or one that wraps it and samples more.
    """
    command = COMMANDS[case.command]
    t_th_ns = PROFILES[config.profile].t_th_ns(config.t_th_wall_s, case.clock_speed, t_sample_s)
    goals = (VelocityGoal(velocity, config.height_m) for velocity in velocities)
    command.begin(client)
    return client.now_ns(), (list(command.fly(client, goal, t_move_s, t_sample_s, t_th_ns)) for goal in goals)


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


def reference_of(game: Any, itself: bool, **more: Plain) -> Plain:
    """Return what a summary says of the flights that a cell is compared with, of which `game` is one."""
    keys = {key: game[key] for key in ("clock_speed", "timing")}
    return {**keys, "provenance": timing_provenance(game["timing"]), "is_this_cell": itself, **more}
