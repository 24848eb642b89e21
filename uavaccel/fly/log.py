"""What a flight leaves in its folder: messages, which may be compared with another flight's; trajectory; film."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import msgpack
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError, naming
from uavaccel.files import read_arrays, replacing, write_arrays
from uavaccel.kinematics import Kinematics
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:
    from uavaccel.sim.simulation import Simulation

MESSAGES, TRAJECTORY, TABLE, FILM = "messages.jsonl", "trajectory.npz", "trajectory.csv", "film.mp4"
LONG_BYTES = 200  # longer values, such as images, are logged as digests: a script may poll millions
INTERVAL_NS = 50_000_000  # between two samples of a trajectory
COLUMNS = "time_s,north_m,east_m,down_m,q_w,q_x,q_y,q_z,v_north_m_s,v_east_m_s,v_down_m_s"
FRAMES_PER_S = 12  # of simulated time, and of film
WIDTH, HEIGHT, BAND = 640, 360, 24

_encode = json.JSONEncoder(ensure_ascii=False, default=bytes.hex).encode


class DifferenceError(UserError):
    """Two flights that should be equal differ."""


class MessageLog:
    """Writes calls and answers in order, a line of JSON each; compares them with the log in the folder `reference`.

    Raises DifferenceError at the first line that differs. Raises UserError if the log cannot be written, and at every
    later message too, since scripts catch the exceptions of calls.
    """

    def __init__(self, folder: Path, reference: Path | None = None) -> None:
        self._path = folder / MESSAGES
        self._refused = ""
        with naming(self._path):
            self._file = self._path.open("w", encoding="utf-8", newline="\n")
        self._expected = None if reference is None else _lines(reference / MESSAGES)
        self.calls = 0

    def call(self, wall_ns: int, time_ns: int | None, method: str, params: Sequence[object]) -> int:
        """Log a call at the wall and the simulated time at which it is handled; returns its number."""
        self.calls += 1
        row = {"call": self.calls, "wall_ns": wall_ns, "time_ns": time_ns, "method": method}
        self._write(row | {"params": [brief(value) for value in params]})
        return self.calls

    def answer(self, number: int, wall_ns: int, error: str | None, result: object) -> None:
        """Log an answer at the wall time at which it is sent."""
        outcome = {"result": brief(result)} if error is None else {"error": error}
        self._write({"answer": number, "wall_ns": wall_ns, **outcome})

    def _write(self, row: Mapping[str, object]) -> None:
        line = _encode(row)
        self._check()
        try:
            self._file.write(line + "\n")
        except OSError as error:
            self._refuse(error)
        if self._expected is not None and (expected := next(self._expected, "(has ended)")) != line:
            raise differs(self.calls, expected, line)

    def abandon(self) -> None:
        """In a forked process, drop the buffered lines, which its parent writes, and keep and compare nothing."""
        self._expected = None
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), self._file.fileno())

    def _check(self) -> None:
        if self._refused:
            raise UserError(self._refused)

    def _refuse(self, error: OSError) -> NoReturn:
        if not self._file.closed:
            self.abandon()  # or closing the file would fail again
            self._file.close()
        try:
            with naming(self._path):
                raise error
        except UserError as refused:
            self._refused = str(refused)
            raise

    def close(self, ended: bool = True) -> None:
        """Close the log of a flight that has `ended`. Raises UserError if not all of it could be written.

        Raises DifferenceError if the reference has more lines.
        """
        self._check()
        try:
            self._file.close()
        except OSError as error:
            self._refuse(error)
        if ended and self._expected is not None and (expected := next(self._expected, None)) is not None:
            raise differs(self.calls, expected, "(has ended)")


def differs(call: int, first: str, second: str) -> DifferenceError:
    """Return the error for the user, with the number of the last call and the two lines."""
    return DifferenceError(f"the flights differ at call {call}\n  first:  {first}\n  second: {second}")


def brief(value: object) -> object:
    """Return the value itself, or the length and a digest of one that is long on the wire."""
    packed = msgpack.packb(value)
    if len(packed) <= LONG_BYTES:
        return value
    return {"bytes": len(packed), "sha256": hashlib.sha256(packed).hexdigest()[:32]}


def _lines(path: Path) -> Iterator[str]:
    with path.open(encoding="utf-8") as file:
        for line in file:
            yield line.rstrip("\n")


# --- trajectory, film ---------------------------------------------------------------------------------------------


def write_states(folder: Path, states: Sequence[Kinematics]) -> None:
    """Write the trajectory of one vehicle's states in the order of their times."""
    rows = [(*each.position_m, *each.orientation_wxyz, *each.linear_velocity_m_s) for each in states]
    time_ns = np.array([each.time_ns for each in states], np.int64)
    write_trajectory(folder, time_ns, np.array(rows, np.float64).reshape(-1, 10))


def write_trajectory(folder: Path, time_ns: NDArray[np.int64], rows: NDArray[np.float64]) -> None:
    """Write time_ns (n,), position_m (n, 3) NED, orientation_wxyz (n, 4) and velocity_m_s (n, 3), also as CSV.

    `rows` (n, 10) are position, orientation and velocity.
    """
    arrays = {"time_ns": time_ns, "position_m": rows[:, :3], "orientation_wxyz": rows[:, 3:7]}
    write_arrays(folder / TRAJECTORY, arrays | {"velocity_m_s": rows[:, 7:]})
    with replacing(folder / TABLE) as file:
        np.savetxt(file, np.column_stack([time_ns / NS_PER_S, rows]), "%.9g", ",", header=COLUMNS, comments="")


def largest_difference_m(folder: Path, reference: Path) -> float:
    """Return the largest distance between two flights' positions at equal simulated times."""
    one, other = (read_arrays(each / TRAJECTORY) for each in (folder, reference))
    _, here, there = np.intersect1d(one["time_ns"], other["time_ns"], return_indices=True)
    apart_m = np.linalg.norm(one["position_m"][here] - other["position_m"][there], axis=1)
    return float(apart_m.max(initial=0.0))


def equal(folder: Path, reference: Path) -> bool:
    return (folder / TRAJECTORY).read_bytes() == (reference / TRAJECTORY).read_bytes()


@contextmanager
def filming(simulation: Simulation, folder: Path) -> Iterator[None]:
    """Film what is flown in the `with` block as the front camera sees it, at its own pace, with time and place below.

    Raises UserError without OpenGL.
    """
    import cv2

    from uavaccel.draw.film import movie

    def frame() -> NDArray[np.uint8]:
        picture = world.camera(WIDTH, HEIGHT).colour(world.data)
        frame = np.zeros((HEIGHT + BAND, WIDTH, 3), np.uint8)
        frame[:HEIGHT] = picture[..., ::-1]
        state = simulation.kinematics()
        north, east, down = state.position_m
        speed = float(np.linalg.norm(state.linear_velocity_m_s))
        text = f"{state.time_ns / NS_PER_S:7.2f} s   {north:.1f} {east:.1f} {down:.1f} m NED   {speed:.1f} m/s"
        cv2.putText(frame, text, (8, HEIGHT + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255,) * 3, 1, cv2.LINE_AA)
        return frame

    world, every = simulation.world, NS_PER_S // FRAMES_PER_S // simulation.profile.tick_ns
    with movie(folder / FILM, (WIDTH, HEIGHT + BAND), FRAMES_PER_S) as add:
        end = world.watch(every, lambda _: add(frame()))
        try:
            yield
        finally:
            end()
