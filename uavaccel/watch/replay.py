"""Recorded flights as they are watched: a run's game, what `uavaccel fly --out` has kept, a square flown for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavaccel.commands import COMMANDS, VelocityGoal, velocities
from uavaccel.draw.page import clock_label, command_name
from uavaccel.errors import UsageError, UserError
from uavaccel.files import read_arrays, read_json, read_lines
from uavaccel.fly.log import MESSAGES, TRAJECTORY
from uavaccel.fly.options import SUMMARY
from uavaccel.kinematics import Vector
from uavaccel.suites.flight import Commands, Flight, flight_of
from uavaccel.units import NS_PER_S, ned_to_mujoco, quaternion_ned_to_mujoco, seconds_to_ns, to_ns
from uavaccel.wire.api import CALLS
from uavaccel.wire.latency import shipped_latency
from uavaccel.wire.session import open_session

SAMPLES = ("time_ns", "position_m", "orientation_wxyz")
T_MOVE_S = 2.0  # of the square's commands
SHORT_S, STANDS = 1e-6, 0.1  # seconds of a wall clock, in which a clock is paused if less than this share passes
UNKNOWN = (np.nan, np.nan, np.nan)  # a command's velocity
Floats = NDArray[np.float64]


class Track:
    """A flight, and how simulated time passed over its client's wall clock; times in seconds.

    `marks` (m, 2) pairs the wall clock with simulated time, which passes evenly between two of them. By default the
    client's clock has run with the simulation's, as where a run has kept simulated time alone.
    """

    def __init__(self, name: str, flight: Flight, marks: Floats | None = None) -> None:
        self.name, self.flight = name, flight
        self.time_s = flight.time_ns / NS_PER_S
        self.start_s, self.end_s = flight.commands.start_ns / NS_PER_S, flight.commands.end_ns / NS_PER_S
        if marks is None:
            first, last = self.time_s[0], self.time_s[-1]
            marks = np.array([[0.0, first], [(last - first) / flight.clock_speed, last]])
        self.marks = marks

    @property
    def wall_s(self) -> float:
        """How long the flight took the client."""
        return float(self.marks[-1, 0])

    def simulated_s(self, wall_s: float) -> float:
        """Simulated time at this moment of the client's clock; the first and the last beyond the flight."""
        return float(np.interp(wall_s, self.marks[:, 0], self.marks[:, 1]))

    def pose(self, time_s: float) -> Floats:
        """Place and attitude (7,) in MuJoCo's frame at a simulated time, between samples on the straight line."""
        place = [np.interp(time_s, self.time_s, column) for column in self.flight.position_m.T]
        after = int(np.searchsorted(self.time_s[:-1], time_s))
        earlier, later = self.flight.orientation_wxyz[[max(after - 1, 0), after]]
        share = np.interp(time_s, self.time_s[[max(after - 1, 0), after]], (0.0, 1.0))
        # q and -q are one attitude: the nearer of them
        turned = (1.0 - share) * earlier + share * (later if earlier @ later >= 0.0 else -later)
        return np.append(ned_to_mujoco(place), quaternion_ned_to_mujoco(turned / np.linalg.norm(turned)))

    def farthest_from(self, other: Track) -> float:
        """The longest way, in metres, from a place of this flight to the nearest one of another's."""
        apart = self.flight.position_m[:, None] - other.flight.position_m[None]
        return float(np.sqrt((apart**2).sum(axis=2).min(axis=1).max()))

    def command(self, time_s: float) -> int | None:
        """The command that is flown at a simulated time; None while the client thinks."""
        begun = int(np.searchsorted(self.start_s, time_s, side="right")) - 1
        return begun if begun >= 0 and time_s < self.end_s[begun] else None

    def towards(self, time_s: float) -> Vector | None:
        """The velocity, NED in m/s, of the command that is flown at a simulated time; None where nobody kept it."""
        number, known = self.command(time_s), self.flight.commands.velocity_m_s
        if number is None or number >= len(known) or np.isnan(known[number]).any():
            return None
        north, east, down = known[number].tolist()
        return north, east, down

    def state(self, wall_s: float) -> str:
        """In words, what drone and client do at this moment of the client's clock."""
        if wall_s >= self.wall_s:
            return "done"
        if not len(self.start_s):
            return "flies"
        time_s = self.simulated_s(wall_s)
        if self.command(time_s) is not None:
            return "flies its command"
        # a script's messages tell the times of its calls, so that a pause seems to begin a little before its end
        stands = self.simulated_s(wall_s + SHORT_S) - time_s < STANDS * SHORT_S * self.flight.clock_speed
        return "client thinks, clock paused" if stands else "client thinks, drone flies on"


def recorded(source: str | Path, case: str | None = None, game: int | None = None) -> Track:
    """Return a game of a run or of a policy, as `flight_of` finds it, or the flight of a script in a folder.

    The flight's title says in words what it is. Raises UserError if there is none, or nothing recorded of it.
    """
    from uavaccel.rl.agents import policy_folder  # it loads what learns
    from uavaccel.rl.policy import MANIFEST

    folder = policy_folder(str(source))
    if case is not None and game is not None:
        raise UsageError("--case, --game: name the game by one of them")
    if (folder / TRAJECTORY).is_file():
        if case is not None or game is not None:
            raise UsageError(f"{folder}: is the flight of one script: without --case and --game")
        return script_track(folder)
    if not any((folder / name).is_file() for name in ("config.yaml", MANIFEST)):
        if flights := sorted(file.parent.name for file in folder.glob(f"*/{TRAJECTORY}")):
            raise UserError(f"{folder}: has several flights: name one of them, as in {folder / flights[0]}")
        raise UserError(
            f"{folder}: holds neither a run nor a flight: `uavaccel run` and `evaluate` keep runs, `uavaccel fly` "
            "keeps a flight with --out FOLDER"
        )
    name, flight = flight_of(source, case, game, pictures=False)
    titled = replace(flight, title=f"Game `{name}` of `{source}`: {flight.title}.")
    return Track(f"flight at {clock_label(flight.clock_speed)}", titled)


def script_track(folder: Path) -> Track:
    """Return a script's flight, with the commands and both clocks of its messages.

    A command ends with its answer, which a script only asks for with `join`, or at the next command. Raises UserError.
    """
    try:
        summary = read_json(folder / SUMMARY)
    except UserError as error:
        raise UserError(f"{error}: the flight is not whole") from error
    if not (isinstance(summary, dict) and isinstance(summary.get("clock_speed"), int | float)):
        raise UserError(f"{folder / SUMMARY}: is no summary of a flight: no number under 'clock_speed'")
    arrays, messages = read_arrays(folder / TRAJECTORY), read_lines(folder / MESSAGES)
    lengths = {len(arrays[name]) if name in arrays else None for name in SAMPLES}
    if None in lengths or len(lengths) > 1:
        raise UserError(f"{folder / TRAJECTORY}: is no trajectory: needs {', '.join(SAMPLES)}, of equal length")
    if lengths <= {0, 1}:
        raise UserError(f"{folder / TRAJECTORY}: has no path: no client connected, or it flew no time")
    speed, first_s, last_s = float(summary["clock_speed"]), *(arrays["time_ns"][[0, -1]] / NS_PER_S)
    calls = [row for row in messages if "call" in row]
    known = [(row["wall_ns"] / NS_PER_S, row["time_ns"] / NS_PER_S) for row in calls if row["time_ns"] is not None]
    marks = np.array([[0.0, first_s], [(last_s - first_s) / speed, last_s]])  # where no call tells a simulated clock
    if known:
        whole_s = max(known[-1][0], summary.get("script_s") or 0.0)
        marks = np.maximum.accumulate(np.array([(0.0, 0.0), *known, (whole_s, last_s)]))

    known_calls = (row for row in calls if row["method"] in CALLS)
    moves = [row for row in known_calls if CALLS[row["method"]].channel_of(row["params"]) == "move"]
    answered_ns = {row["answer"]: row["wall_ns"] for row in messages if "answer" in row}
    wall_ns = [(row["wall_ns"], answered_ns.get(row["call"], np.inf)) for row in moves]
    start_s, end_s = np.interp(np.reshape(wall_ns, (-1, 2)) / NS_PER_S, marks[:, 0], marks[:, 1]).T
    end_s = np.minimum(end_s, np.append(start_s, marks[-1, 1])[1 : len(moves) + 1])
    goals = [
        {"moveByVelocity": row["params"][:3], "moveByVelocityZ": [*row["params"][:2], 0.0]}.get(row["method"], UNKNOWN)
        for row in moves
    ]
    commands = Commands(to_ns(start_s), to_ns(end_s), np.array(goals, float).reshape(-1, 3))
    time_ns, position_m, orientation_wxyz = (arrays[name] for name in SAMPLES)
    where, title = str(summary.get("scene", "blocks")), f"The flight in `{folder}`."
    flight = Flight(title, speed, time_ns, position_m, orientation_wxyz, commands, scene=where)
    return Track(f"script at {clock_label(speed)}", flight, marks)


def fly_side_by_side(clock_speed: float, think_s: float, rounds: int, seed: int) -> list[Track]:
    """Fly a square under ADSC and TCSC, by a client that thinks `think_s` of wall time before each command.

    In `virtual`, with the latencies that ship: equal arguments, equal flights. Nobody thinks before the first command.
    """
    path, tracks = velocities("square", rounds), []
    with open_session("virtual", latency=shipped_latency()) as session:
        for name in ("adsc", "tcsc"):
            client, command = session.start_game(clock_speed, np.random.SeedSequence(seed)), COMMANDS[name]
            origin_ns = client.kinematics().time_ns
            command.begin(client)
            clocks_ns: list[tuple[Sequence[int], Sequence[int]]] = []  # wall and simulated, of call and return
            for number, velocity in enumerate(path):
                if number:
                    client.transport.clock.charge(seconds_to_ns(think_s))
                issued_ns = client.now_ns()
                for state in command.fly(client, VelocityGoal(velocity), T_MOVE_S, T_MOVE_S):
                    clocks_ns.append(((issued_ns, 0), (client.now_ns(), state.time_ns - origin_ns)))
            arrays = client.recording().arrays()
            marks = np.reshape(clocks_ns, (-1, 2)) / NS_PER_S
            marks[:, 0] -= marks[0, 0]
            marks[::2, 1] = arrays["command_start_s"]
            flight = Flight.of(name, clock_speed, arrays, path)
            tracks.append(Track(command_name(name), flight, np.maximum.accumulate(marks)))
    return tracks
